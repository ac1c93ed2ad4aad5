"""Where a stock CyberDog 2 is and how its messages map to the joints: ``assets/cyberdog2/board.toml``, or your copy."""

from __future__ import annotations

import ipaddress
from pathlib import Path

from mimic.config.ranges import required
from mimic.errors import ConfigError
from mimic.frozen import frozen, frozen_arrays
from mimic.hardware.robot.board_wiring import ByPart, CommandRanges, JointWiring, read_board


@frozen
class StockRanges(CommandRanges):
    """Ranges of a command, and how far a desired position may be from the measured one."""

    cut: ByPart
    """Largest distance of a desired position from the measured one that the firmware lets pass [rad]."""
    cut_margin: float = required(0.0, 1.0, "rad")
    """Distance that mimic keeps from it."""

    def __post_init__(self) -> None:
        CommandRanges.__post_init__(self)
        if not min(self.cut) > self.cut_margin:
            raise ConfigError(f"cut_margin is {self.cut_margin:g} rad; expected less than each cut: {self.cut}")


@frozen_arrays
class BoardWiring(JointWiring):
    """Addresses, order and signs of a board. Joint arrays are (12,) in the order of JOINTS."""

    address: str
    """Multicast group."""
    port: int = required(1, 0xFFFF)
    state_port: int = required(1, 0xFFFF)
    """Of the orientation."""
    ttl: int = required(0, 255)
    temperature_unit: float = required(1e-6, 1e3, "degC")
    limits: StockRanges

    def __post_init__(self) -> None:
        JointWiring.__post_init__(self)
        try:
            multicast = ipaddress.IPv4Address(self.address).is_multicast
        except ValueError:
            multicast = False
        if not multicast:
            raise ConfigError(f"address is {self.address!r}; expected a multicast group, such as 239.255.76.67")


def load_board(path: Path | None = None) -> BoardWiring:
    """Read the wiring of a board; see `mimic.hardware.robot.board_wiring.read_board`."""
    return read_board(BoardWiring, "cyberdog2", path)
