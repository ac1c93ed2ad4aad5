"""Where the joints are in the messages of a motion board, of any robot: ``assets/ROBOT/board.toml``, or your copy."""

from __future__ import annotations

import ipaddress
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mimic.errors import ConfigError
from mimic.hardware.toml_fields import number, read_file, table
from mimic.io.assets import shipped
from mimic.records import JOINTS, LEGS, FloatArray, IntArray

BOARDS = ("cyberdog2", "go2")
"""Names of boards that --robot takes; each is also the name of its robot."""

PARTS = ("abad", "hip", "knee")


@dataclass(frozen=True, kw_only=True)
class ReadingRanges:
    """Ranges outside of which a reading is that of a damaged message; from minus to plus where there is one number."""

    angle: float
    """[rad]"""
    velocity: float
    """[rad/s]"""
    torque: float
    """[N m]"""
    turn_rate: float
    """Of the base about each axis [rad/s]."""
    temperature: tuple[float, float]
    """Lowest and highest [degC]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointWiring:
    """Order, signs and ranges of a board. Joint arrays are (12,) in the order of JOINTS."""

    path: Path
    """File that it was read from."""
    index: IntArray
    """Place of each joint in a message."""
    sign: FloatArray
    """Joint angle over angle on the wire."""
    offset: FloatArray
    """Joint angle where the wire has zero [rad]."""
    quat: IntArray
    """Places of w, x, y, z in a quaternion of the board (4,)."""
    kp_max: float
    kd_max: float
    velocity_max: float
    torque_max: float
    readings: ReadingRanges
    host: str
    """Address that this computer should have, with its prefix length."""

    def joints(self, wire: Any) -> FloatArray:
        """Return values in joint order and sign (12,), without the offset, of values of a message (12,)."""
        return self.sign * np.asarray(wire, dtype=np.float64)[self.index]

    def angles(self, wire: Any) -> FloatArray:
        """Return joint angles (12,) [rad] of angles of a message (12,)."""
        return self.joints(wire) + self.offset

    def wire(self, values: FloatArray) -> FloatArray:
        """Return values of a message (12,) of joint velocities or torques (12,)."""
        placed = np.empty(len(JOINTS))
        placed[self.index] = self.sign * values
        return placed

    def wire_angles(self, q: FloatArray) -> FloatArray:
        """Return angles of a message (12,) [rad] of joint angles (12,) [rad]."""
        return self.wire(q - self.offset)

    def wire_gains(self, gains: FloatArray) -> FloatArray:
        """Return gains of a message (12,) of the joints' gains (12,)."""
        placed = np.empty(len(JOINTS))
        placed[self.index] = gains
        return placed


W = TypeVar("W", bound=JointWiring)


def read_board(kind: type[W], board: str, path: Path | None, more: Callable[[Mapping[str, Any]], dict[str, Any]]) -> W:
    """Read the wiring file of a board.

    Args:
        kind: Returned.
        board: Its name.
        path: File; None takes the one that ships with the robot.
        more: Returns the fields that this kind has besides those of a `JointWiring`.

    Raises:
        AssetError: If there is no such file.
        ConfigError: If it is not TOML, of another board, or not consistent.
    """
    file = shipped("assets", board, "board.toml") if path is None else path
    return read_file(file, lambda raw: kind(path=file, **_joint_fields(raw, board), **more(raw)))


def _joint_fields(raw: Mapping[str, Any], board: str) -> dict[str, Any]:
    if raw.get("board") != board:
        raise ConfigError(f"board is {raw.get('board')!r}; expected {board}, as in assets/{board}/board.toml")
    legs = raw.get("legs")
    if not isinstance(legs, list) or sorted(map(str, legs)) != sorted(LEGS):
        raise ConfigError(f"legs is {legs!r}; expected {', '.join(LEGS)} in the order of the messages")
    sign = numbers(raw, "sign")
    offset = numbers(raw, "offset")
    if any(value not in (-1.0, 1.0) for value in sign):
        raise ConfigError(f"sign is {sign}; expected 1 or -1 for {', '.join(PARTS)}")
    order = raw.get("quat")
    if not isinstance(order, str) or sorted(order) != sorted("wxyz"):
        raise ConfigError(f"quat is {order!r}; expected the order of its numbers, such as 'wxyz'")
    limits = table(raw, "limits", "the file")
    high = {name: number(limits, name, "[limits]") for name in ("kp", "kd", "velocity", "torque")}
    for name, value in high.items():
        if not 0.0 < value <= 500.0:
            raise ConfigError(f"{name} of [limits] is {value:g}; expected more than 0, at most 500")
    return {
        "index": np.array([len(PARTS) * legs.index(leg) + part for leg in LEGS for part in range(len(PARTS))]),
        "sign": np.tile(sign, len(LEGS)),
        "offset": np.tile(offset, len(LEGS)),
        "quat": np.array([order.index(letter) for letter in "wxyz"]),
        **{f"{name}_max": value for name, value in high.items()},
        "readings": _readings(raw),
        "host": _host(raw),
    }


def _readings(raw: Mapping[str, Any]) -> ReadingRanges:
    given = table(raw, "readings", "the file")
    most = {name: number(given, name, "[readings]") for name in ("angle", "velocity", "torque", "turn_rate")}
    for name, value in most.items():
        if value <= 0.0:
            raise ConfigError(f"{name} of [readings] is {value:g}; expected more than 0")
    low, high = numbers(given, "temperature", ("lowest", "highest"))
    if low >= high:
        raise ConfigError(f"temperature of [readings] is {[low, high]}; expected the lowest, then the highest")
    return ReadingRanges(**most, temperature=(low, high))


def numbers(raw: Mapping[str, Any], name: str, places: Sequence[str] = PARTS) -> list[float]:
    """Return a list of numbers, one for each place.

    Raises:
        ConfigError: If it is something else.
    """
    values = raw.get(name)
    if not isinstance(values, list) or len(values) != len(places):
        raise ConfigError(f"{name} is {values!r}; expected {len(places)} numbers, for {', '.join(places)}")
    return [number({name: value}, name, "the file") for value in values]


def _host(raw: Mapping[str, Any]) -> str:
    given = raw.get("host")
    try:
        return str(ipaddress.IPv4Interface(given))  # type: ignore[arg-type]
    except ValueError:
        raise ConfigError(f"host is {given!r}; expected an address, such as 192.168.44.100/24") from None
