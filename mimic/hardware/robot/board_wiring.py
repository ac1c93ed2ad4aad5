"""Where the joints are in the messages of a motion board, of any robot: ``assets/ROBOT/board.toml``, or your copy."""

from __future__ import annotations

import ipaddress
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mimic.config.ranges import Limited, required
from mimic.config.values import read_made
from mimic.errors import AssetError, ConfigError
from mimic.frozen import frozen, frozen_arrays
from mimic.io.assets import shipped
from mimic.records import JOINTS, LEGS, FloatArray, IntArray

BOARDS = ("cyberdog2", "go2")
"""Names of boards that --robot takes; each is also the name of its robot."""

PARTS = ("abad", "hip", "knee")

ByPart = tuple[float, float, float]
"""A number for each of PARTS."""


@frozen
class CommandRanges(Limited):
    """Largest numbers of a command."""

    kp: float = required(1e-3, 500.0, "N m/rad")
    kd: float = required(1e-3, 500.0, "N m s/rad")
    velocity: float = required(1e-3, 500.0, "rad/s")
    torque: float = required(1e-3, 500.0, "N m")


@frozen
class ReadingRanges(Limited):
    """Ranges outside of which a reading is that of a damaged message; from minus to plus where there is one number."""

    angle: float = required(1e-3, 1e3, "rad")
    velocity: float = required(1e-3, 1e3, "rad/s")
    torque: float = required(1e-3, 1e3, "N m")
    turn_rate: float = required(1e-3, 1e3, "rad/s")
    """Of the base about each axis."""
    temperature: tuple[float, float]
    """Lowest and highest [degC]."""

    def __post_init__(self) -> None:
        Limited.__post_init__(self)
        low, high = self.temperature
        if not low < high:
            raise ConfigError(f"temperature is {list(self.temperature)}; expected the lowest, then the highest")


@frozen_arrays
class JointWiring(Limited):
    """The file of a board: order, signs and ranges. Joint arrays are (12,) in the order of JOINTS."""

    path: Path
    """File that it was read from."""
    board: str
    host: str
    """Address that this computer should have, with its prefix length."""
    legs: tuple[str, str, str, str]
    """In the order of the messages."""
    sign: ByPart
    """Joint angle over angle on the wire."""
    offset: ByPart
    """Joint angle where the wire has zero [rad]."""
    quat: str
    """Order of a quaternion of the board."""
    limits: CommandRanges
    readings: ReadingRanges

    def __post_init__(self) -> None:
        Limited.__post_init__(self)
        if sorted(self.legs) != sorted(LEGS):
            raise ConfigError(f"legs is {self.legs}; expected {', '.join(LEGS)} in the order of the messages")
        if not {*self.sign} <= {-1.0, 1.0}:
            raise ConfigError(f"sign is {self.sign}; expected 1 or -1 for {', '.join(PARTS)}")
        if not np.isfinite(self.offset).all():
            raise ConfigError(f"offset is {self.offset}; expected finite numbers")
        if sorted(self.quat) != sorted("wxyz"):
            raise ConfigError(f"quat is {self.quat!r}; expected the order of its numbers, such as 'wxyz'")
        try:
            ipaddress.IPv4Interface(self.host)
        except ValueError:
            raise ConfigError(f"host is {self.host!r}; expected an address, such as 192.168.44.100/24") from None

    @cached_property
    def index(self) -> IntArray:
        """Place of each joint in a message."""
        return np.array([len(PARTS) * self.legs.index(leg) + part for leg in LEGS for part in range(len(PARTS))])

    @cached_property
    def signs(self) -> FloatArray:
        """Joint angle over angle on the wire."""
        return np.tile(self.sign, len(LEGS))

    @cached_property
    def offsets(self) -> FloatArray:
        """Joint angle where the wire has zero [rad]."""
        return np.tile(self.offset, len(LEGS))

    @cached_property
    def wxyz(self) -> list[int]:
        """Places of w, x, y, z in a quaternion of the board (4,)."""
        return [self.quat.index(letter) for letter in "wxyz"]

    def joints(self, wire: Any) -> FloatArray:
        """Return values in joint order and sign (12,), without the offset, of values of a message (12,)."""
        return self.signs * np.asarray(wire, dtype=np.float64)[self.index]

    def angles(self, wire: Any) -> FloatArray:
        """Return joint angles (12,) [rad] of angles of a message (12,)."""
        return self.joints(wire) + self.offsets

    def wire(self, values: FloatArray) -> FloatArray:
        """Return values of a message (12,) of joint velocities or torques (12,)."""
        return self.wire_gains(self.signs * values)

    def wire_angles(self, q: FloatArray) -> FloatArray:
        """Return angles of a message (12,) [rad] of joint angles (12,) [rad]."""
        return self.wire(q - self.offsets)

    def wire_gains(self, gains: FloatArray) -> FloatArray:
        """Return gains of a message (12,) of the joints' gains (12,)."""
        placed = np.empty(len(JOINTS))
        placed[self.index] = gains
        return placed


W = TypeVar("W", bound=JointWiring)


def read_board(kind: type[W], board: str, path: Path | None) -> W:
    """Read the wiring file of a board.

    Args:
        kind: Returned.
        board: Its name.
        path: File; None takes the one that ships with the robot.

    Raises:
        AssetError: If there is no such file.
        ConfigError: If it is not TOML, of another board, or not consistent.
    """
    file = shipped("assets", board, "board.toml") if path is None else path
    if not file.is_file():
        raise AssetError(f"there is no wiring file {file}")
    made = read_made(kind, file, path=file)
    if made.board != board:
        raise ConfigError(f"{file}: board is {made.board!r}; expected {board}, as in assets/{board}/board.toml")
    return made
