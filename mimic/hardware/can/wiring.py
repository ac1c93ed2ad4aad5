"""The wiring of motors and IMU: ``assets/<robot>/bus.toml``, or your copy of it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path

import numpy as np

from mimic.config.ranges import Limited, required
from mimic.config.values import read_made
from mimic.errors import AssetError, ConfigError
from mimic.frozen import frozen, frozen_arrays
from mimic.hardware.motors.interface import MotorProtocol
from mimic.hardware.motors.makers import make_motors
from mimic.io.assets import shipped
from mimic.records import JOINTS, LEGS, FloatArray, IntArray

DEFAULT_MAKER = "cybergear"
"""Maker of the motors if a file names none."""

IMU_MESSAGES = ("quaternion", "rate_of_turn", "group_counter", "status_word", "sample_time")
"""Messages that an IMU may send."""


@frozen_arrays
class ImuWiring:
    """Where the IMU is and what it sends."""

    kind: str
    bus: int
    quat_BI: FloatArray
    """Turns IMU axes into base axes, wxyz (4,)."""
    rate: Mapping[str, float]
    """Messages per second of each kind [Hz]."""


@frozen
class _Imu:
    """The same in a file."""

    kind: str
    bus: int
    quat_BI: tuple[float, float, float, float]
    rate: Mapping[str, float]


@frozen
class _Motor(Limited):
    """A line of the table of joints."""

    motor: int
    sign: float
    offset: float = required(-1e3, 1e3, "rad")


@frozen
class _File(Limited):
    """What a file holds."""

    motor: str = DEFAULT_MAKER
    bitrate: int = required(10_000, 1_000_000)
    host: int
    position_range: float
    layout: Mapping[str, tuple[int, ...]]
    joints: Mapping[str, _Motor]
    imu: _Imu


@frozen_arrays
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


def load_wiring(path: Path | None = None, *, buses: int = 1) -> Wiring:
    """Read the wiring of a robot.

    Args:
        path: File; None takes the one that ships with the robot.
        buses: Number of buses.

    Raises:
        AssetError: If there is no such file.
        ConfigError: If it is not TOML or not consistent: an unknown maker, a missing joint, an id given twice, no
            layout for so many buses.
    """
    path = shipped("assets", "cyberdog2", "bus.toml") if path is None else path
    if not path.is_file():
        raise AssetError(f"there is no wiring file {path}")
    file = read_made(_File, path)
    try:
        return _wiring(file, path, buses)
    except ConfigError as reason:
        raise ConfigError(f"{path}: {reason}") from None


def _wiring(file: _File, path: Path, buses: int) -> Wiring:
    if set(file.joints) != set(JOINTS):
        raise ConfigError(f"[joints] names {', '.join(file.joints)}; the robot has {', '.join(JOINTS)}")
    facts = make_motors(file.motor, host=file.host, position_range=file.position_range).facts
    rows = [file.joints[joint] for joint in JOINTS]
    bus = _buses_of_joints(file.layout, buses)
    seen: dict[tuple[int, int], str] = {}
    for joint, row, on in zip(JOINTS, rows, bus.tolist(), strict=True):
        if row.motor not in facts.motor_ids:
            ids = facts.motor_ids
            raise ConfigError(f"motor of {joint} is {row.motor}; expected a whole number from {ids[0]} to {ids[-1]}")
        if row.sign not in (-1.0, 1.0):
            raise ConfigError(f"sign of {joint} is {row.sign:g}; expected 1 or -1")
        other = seen.setdefault((on, row.motor), joint)
        if other != joint:
            raise ConfigError(f"{other} and {joint} both have motor {row.motor} on bus {on}")
    motor = np.array([row.motor for row in rows])
    if file.host not in facts.host_ids or file.host in motor:
        ids = facts.host_ids
        raise ConfigError(f"host is {file.host}; expected a number from {ids[0]} to {ids[-1]} that no motor has")
    return Wiring(
        path=path,
        maker=file.motor,
        buses=buses,
        bitrate=file.bitrate,
        host=file.host,
        position_range=file.position_range,
        bus=bus,
        motor=motor,
        sign=np.array([row.sign for row in rows]),
        offset=np.array([row.offset for row in rows]),
        imu=_imu(file.imu, buses),
    )


def _buses_of_joints(layouts: Mapping[str, tuple[int, ...]], buses: int) -> IntArray:
    row = layouts.get(str(buses))
    if row is None:
        raise ConfigError(f"[layout] has no line for {buses} bus{'es' * (buses != 1)}; it has {', '.join(layouts)}")
    if len(row) not in (len(LEGS), len(JOINTS)) or not {*row} <= {*range(buses)}:
        raise ConfigError(
            f"[layout] {buses} is {list(row)}; expected a bus from 0 to {buses - 1} for each of {len(LEGS)} legs, or "
            f"of {len(JOINTS)} joints"
        )
    return np.repeat(row, len(JOINTS) // len(row))


def _imu(imu: _Imu, buses: int) -> ImuWiring:
    length = float(np.linalg.norm(imu.quat_BI))
    if not abs(length - 1.0) < 0.01:
        raise ConfigError(f"quat_BI of [imu] has length {length:.3f}; expected 1")
    for name, rate in imu.rate.items():
        if name not in IMU_MESSAGES:
            raise ConfigError(f"rate of [imu] names {name!r}; known are {', '.join(IMU_MESSAGES)}")
        if not 0.0 < rate <= 400.0:
            raise ConfigError(f"rate of {name} is {rate:g} Hz; expected more than 0, at most 400")
    lacking = [name for name in IMU_MESSAGES[:2] if name not in imu.rate]
    if lacking:
        raise ConfigError(f"rate of [imu] lacks {lacking[0]}; the robot needs it")
    if not 0 <= imu.bus < buses:
        raise ConfigError(f"bus of [imu] is {imu.bus}; expected a whole number from 0 to {buses - 1}")
    return ImuWiring(kind=imu.kind, bus=imu.bus, quat_BI=np.array(imu.quat_BI) / length, rate=imu.rate)
