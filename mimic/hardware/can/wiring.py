"""The wiring of motors and IMU: ``assets/<robot>/bus.toml``, or your copy of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from mimic.errors import ConfigError
from mimic.hardware.motors.interface import MotorFacts, MotorProtocol
from mimic.hardware.motors.makers import make_motors
from mimic.hardware.toml_fields import number, read_file, table, whole
from mimic.io.assets import shipped
from mimic.records import JOINTS, LEGS, FloatArray, IntArray

DEFAULT_MAKER = "cybergear"
"""Maker of the motors if a file names none."""

IMU_MESSAGES = ("quaternion", "rate_of_turn", "group_counter", "status_word", "sample_time")
"""Messages that an IMU may send."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ImuWiring:
    """Where the IMU is and what it sends."""

    kind: str
    bus: int
    quat_BI: FloatArray
    """Turns IMU axes into base axes, wxyz (4,)."""
    rate: Mapping[str, float]
    """Messages per second of each kind [Hz]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Wiring:
    """Which motor moves which joint. Joint arrays are (12,) in the order of JOINTS."""

    path: Path
    """File that it was read from."""
    maker: str
    """Maker of the motors; a name in `mimic.hardware.motors.makers.MAKERS`."""
    buses: int
    """Number of buses."""
    bitrate: int
    """[bit/s]"""
    host: int
    """Id of this computer."""
    position_range: float
    """End of the range of positions on the bus [rad]."""
    bus: IntArray
    motor: IntArray
    """Id on its bus."""
    sign: FloatArray
    """Joint angle over motor angle, +1 or -1; the same for velocities and torques."""
    offset: FloatArray
    """Joint angle where the motor reads zero [rad]."""
    imu: ImuWiring

    def motors(self) -> MotorProtocol:
        """Return the protocol of the motors."""
        return make_motors(self.maker, host=self.host, position_range=self.position_range)

    def q_of(self, p: FloatArray) -> FloatArray:
        """Return joint angles (12,) [rad] of motor readings (12,) [rad]."""
        return self.sign * p + self.offset

    def p_of(self, q: FloatArray) -> FloatArray:
        """Return motor readings (12,) [rad] at joint angles (12,) [rad]."""
        return self.sign * (q - self.offset)

    def joint_of(self, bus: int, motor: int) -> int | None:
        """Return the index of the joint that a motor moves, or None where there is none."""
        return self._joints.get((bus, motor))

    @cached_property
    def _joints(self) -> dict[tuple[int, int], int]:
        return {(int(bus), int(motor)): j for j, (bus, motor) in enumerate(zip(self.bus, self.motor, strict=True))}


def load_wiring(path: Path | None = None, *, buses: int = 1, robot: str = "cyberdog2") -> Wiring:
    """Read the wiring of a robot.

    Args:
        path: File; None takes the one that ships with the robot.
        buses: Number of buses.
        robot: Robot whose shipped file is read if no path is given.

    Raises:
        AssetError: If there is no such file.
        ConfigError: If it is not TOML or not consistent: an unknown maker, a missing joint, an id given twice, no
            layout for so many buses.
    """
    path = shipped("assets", robot, "bus.toml") if path is None else path
    return read_file(path, lambda raw: _Reader(path, raw).wiring(buses))


class _Reader:
    """Reads values from the file and checks them."""

    def __init__(self, path: Path, raw: Mapping[str, Any]) -> None:
        self._path = path
        self._raw = raw

    def wiring(self, buses: int) -> Wiring:
        raw = self._raw
        joints = table(raw, "joints", "the file")
        unknown = [j for j in joints if j not in JOINTS]
        missing = [j for j in JOINTS if j not in joints]
        if unknown:
            raise ConfigError(f"[joints] names {', '.join(unknown)}; the robot has {', '.join(JOINTS)}")
        if missing:
            raise ConfigError(f"[joints] lacks {', '.join(missing)}")
        rows = {j: table(joints, j, "[joints]") for j in JOINTS}
        maker = raw.get("motor", DEFAULT_MAKER)
        if not isinstance(maker, str):
            raise ConfigError(f"motor is {maker!r}; expected the maker of the motors, such as {DEFAULT_MAKER!r}")
        position_range = number(raw, "position_range", "the file")
        host = whole(raw, "host", "the file", 0, 0xFFFF)
        facts = make_motors(maker, host=host, position_range=position_range).facts
        if host not in facts.host_ids:
            ids = facts.host_ids
            raise ConfigError(f"host of the file is {host}; expected a whole number from {ids[0]} to {ids[-1]}")
        motor = np.array([_motor_id(rows[j], j, facts) for j in JOINTS])
        if host in motor:
            raise ConfigError(
                f"host of the file is {host}, the id of {JOINTS[list(motor).index(host)]}; give it another"
            )
        sign = np.array([number(rows[j], "sign", j) for j in JOINTS])
        for joint, value in zip(JOINTS, sign, strict=True):
            if value not in (-1.0, 1.0):
                raise ConfigError(f"sign of {joint} is {value:g}; expected 1 or -1")
        bus = self._buses_of_joints(buses)
        seen: dict[tuple[int, int], str] = {}
        for joint, place in zip(JOINTS, zip(bus.tolist(), motor.tolist(), strict=True), strict=True):
            if place in seen:
                raise ConfigError(f"{seen[place]} and {joint} both have motor {place[1]} on bus {place[0]}")
            seen[place] = joint
        bitrate = whole(raw, "bitrate", "the file", 10_000, 1_000_000)
        return Wiring(
            path=self._path,
            maker=maker,
            buses=buses,
            bitrate=bitrate,
            host=host,
            position_range=position_range,
            bus=bus,
            motor=motor,
            sign=sign,
            offset=np.array([number(rows[j], "offset", j) for j in JOINTS]),
            imu=self._imu(buses),
        )

    def _buses_of_joints(self, buses: int) -> IntArray:
        layouts = table(self._raw, "layout", "the file")
        if str(buses) not in layouts:
            raise ConfigError(
                f"[layout] has no line for {buses} bus{'es' if buses != 1 else ''}; it has {', '.join(layouts)}"
            )
        row = layouts[str(buses)]
        fits = isinstance(row, list) and len(row) in (len(LEGS), len(JOINTS))
        if not fits or any(type(b) is not int or not 0 <= b < buses for b in row):
            raise ConfigError(
                f"[layout] {buses} is {row}; expected a bus from 0 to {buses - 1} for each of {len(LEGS)} legs, or of "
                f"{len(JOINTS)} joints"
            )
        return np.repeat(row, len(JOINTS) // len(row))

    def _imu(self, buses: int) -> ImuWiring:
        raw = table(self._raw, "imu", "the file")
        kind = raw.get("kind")
        if not isinstance(kind, str):
            raise ConfigError(f"kind of [imu] is {kind!r}; expected a name, such as xsens_mti")
        quat = raw.get("quat_BI")
        if not isinstance(quat, list) or len(quat) != 4 or not all(isinstance(v, int | float) for v in quat):
            raise ConfigError(f"quat_BI of [imu] is {quat}; expected four numbers, w x y z")
        length = float(np.linalg.norm(quat))
        if not abs(length - 1.0) < 0.01:
            raise ConfigError(f"quat_BI of [imu] has length {length:.3f}; expected 1")
        rates = table(raw, "rate", "[imu]")
        for name in rates:
            if name not in IMU_MESSAGES:
                raise ConfigError(f"rate of [imu] names {name!r}; known are {', '.join(IMU_MESSAGES)}")
            if not 0.0 < number(rates, name, "rate of [imu]") <= 400.0:
                raise ConfigError(f"rate of {name} is {rates[name]} Hz; expected more than 0, at most 400")
        for name in IMU_MESSAGES[:2]:
            if name not in rates:
                raise ConfigError(f"rate of [imu] lacks {name}; the robot needs it")
        return ImuWiring(
            kind=kind,
            bus=whole(raw, "bus", "[imu]", 0, buses - 1),
            quat_BI=np.array(quat) / length,
            rate={name: float(value) for name, value in rates.items()},
        )


def _motor_id(row: Mapping[str, Any], joint: str, facts: MotorFacts) -> int:
    return whole(row, "motor", joint, facts.motor_ids[0], facts.motor_ids[-1])
