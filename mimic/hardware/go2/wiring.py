"""Where a Go2 is and how its messages map to the joints: ``assets/go2/board.toml``, or your copy."""

from __future__ import annotations

from pathlib import Path

from mimic.config.ranges import required
from mimic.frozen import frozen_arrays
from mimic.hardware.robot.board_wiring import JointWiring, read_board


@frozen_arrays
class Go2Wiring(JointWiring):
    """Domain, order and signs of a Go2. Joint arrays are (12,) in the order of JOINTS."""

    domain: int = required(0, 230)
    """Of DDS."""
    motion_switcher: bool
    """Whether it has the service that releases its sport mode; a simulator may have none."""


def load_go2(path: Path | None = None) -> Go2Wiring:
    """Read the wiring of a Go2; see `mimic.hardware.robot.board_wiring.read_board`."""
    return read_board(Go2Wiring, "go2", path)
