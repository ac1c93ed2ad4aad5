"""Where a stock CyberDog 2 is and how its messages map to the joints: ``assets/cyberdog2/board.toml``, or your copy."""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mimic.errors import ConfigError
from mimic.hardware.toml_fields import number, read_file, table, whole
from mimic.io.assets import shipped
from mimic.records import JOINTS, LEGS, FloatArray, IntArray

BOARDS = ("cyberdog2",)
"""Names of boards that --robot takes."""

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
class BoardWiring:
    """Addresses, order and signs of a board. Joint arrays are (12,) in the order of JOINTS."""

    path: Path
    """File that it was read from."""
    address: str
    """Multicast group."""
    port: int
    state_port: int
    """Of the orientation."""
    ttl: int
    host: str
    """Address that this computer should have, with its prefix length."""
    index: IntArray
    """Place of each joint in a message."""
    sign: FloatArray
    """Joint angle over angle on the wire."""
    offset: FloatArray
    """Joint angle where the wire has zero [rad]."""
    quat: IntArray
    """Places of w, x, y, z in a quaternion of the board (4,)."""
    temperature_unit: float
    """[degC]"""
    kp_max: float
    kd_max: float
    velocity_max: float
    torque_max: float
    cut: FloatArray
    """Largest distance of a desired position from the measured one that the firmware lets pass (12,) [rad]."""
    cut_margin: float
    """Distance that mimic keeps from it [rad]."""
    readings: ReadingRanges

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


def load_board(path: Path | None = None, board: str = "cyberdog2") -> BoardWiring:
    """Read the wiring of a board.

    Args:
        path: File; None takes the one that ships with the robot.
        board: Board whose shipped file is read if no path is given; one of BOARDS.

    Raises:
        AssetError: If there is no such file.
        ConfigError: If it is not TOML or not consistent.
    """
    path = shipped("assets", board, "board.toml") if path is None else path
    return read_file(path, lambda raw: _wiring(path, raw))


def _wiring(path: Path, raw: Mapping[str, Any]) -> BoardWiring:
    if raw.get("board") not in BOARDS:
        raise ConfigError(f"board is {raw.get('board')!r}; expected {', '.join(BOARDS)}, as in assets/*/board.toml")
    legs = raw.get("legs")
    if not isinstance(legs, list) or sorted(map(str, legs)) != sorted(LEGS):
        raise ConfigError(f"legs is {legs!r}; expected {', '.join(LEGS)} in the order of the messages")
    sign, offset = _numbers(raw, "sign"), _numbers(raw, "offset")
    if any(value not in (-1.0, 1.0) for value in sign):
        raise ConfigError(f"sign is {sign}; expected 1 or -1 for {', '.join(PARTS)}")
    order = raw.get("quat")
    if not isinstance(order, str) or sorted(order) != sorted("wxyz"):
        raise ConfigError(f"quat is {order!r}; expected the order of its numbers, such as 'wxyz'")
    limits = table(raw, "limits", "the file")
    high = {name: number(limits, name, "[limits]") for name in ("kp", "kd", "velocity", "torque", "cut_margin")}
    cut = _numbers(limits, "cut")
    if min(cut) <= high["cut_margin"] or high["cut_margin"] < 0.0:
        raise ConfigError(f"cut_margin of [limits] is {high['cut_margin']:g} rad; expected less than each cut: {cut}")
    for name in ("kp", "kd", "velocity", "torque"):
        if not 0.0 < high[name] <= 500.0:
            raise ConfigError(f"{name} of [limits] is {high[name]:g}; expected more than 0, at most 500")
    return BoardWiring(
        path=path,
        address=_group(raw),
        port=whole(raw, "port", "the file", 1, 0xFFFF),
        state_port=whole(raw, "state_port", "the file", 1, 0xFFFF),
        ttl=whole(raw, "ttl", "the file", 0, 255),
        host=_host(raw),
        index=np.array([len(PARTS) * legs.index(leg) + part for leg in LEGS for part in range(len(PARTS))]),
        sign=np.tile(sign, len(LEGS)),
        offset=np.tile(offset, len(LEGS)),
        quat=np.array([order.index(letter) for letter in "wxyz"]),
        temperature_unit=number(raw, "temperature_unit", "the file"),
        kp_max=high["kp"],
        kd_max=high["kd"],
        velocity_max=high["velocity"],
        torque_max=high["torque"],
        cut=np.tile(cut, len(LEGS)),
        cut_margin=high["cut_margin"],
        readings=_readings(raw),
    )


def _readings(raw: Mapping[str, Any]) -> ReadingRanges:
    given = table(raw, "readings", "the file")
    most = {name: number(given, name, "[readings]") for name in ("angle", "velocity", "torque", "turn_rate")}
    for name, value in most.items():
        if value <= 0.0:
            raise ConfigError(f"{name} of [readings] is {value:g}; expected more than 0")
    low, high = _numbers(given, "temperature", ("lowest", "highest"))
    if low >= high:
        raise ConfigError(f"temperature of [readings] is {[low, high]}; expected the lowest, then the highest")
    return ReadingRanges(**most, temperature=(low, high))


def _numbers(raw: Mapping[str, Any], name: str, places: Sequence[str] = PARTS) -> list[float]:
    """Return a list of numbers, one for each place."""
    values = raw.get(name)
    if not isinstance(values, list) or len(values) != len(places):
        raise ConfigError(f"{name} is {values!r}; expected {len(places)} numbers, for {', '.join(places)}")
    return [number({name: value}, name, "the file") for value in values]


def _group(raw: Mapping[str, Any]) -> str:
    given = raw.get("address")
    try:
        if ipaddress.IPv4Address(given).is_multicast:  # type: ignore[arg-type]
            return str(given)
    except ValueError:
        pass
    raise ConfigError(f"address is {given!r}; expected a multicast group, such as 239.255.76.67")


def _host(raw: Mapping[str, Any]) -> str:
    given = raw.get("host")
    try:
        return str(ipaddress.IPv4Interface(given))  # type: ignore[arg-type]
    except ValueError:
        raise ConfigError(f"host is {given!r}; expected an address, such as 192.168.44.100/24") from None
