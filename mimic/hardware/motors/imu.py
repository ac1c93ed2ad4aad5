"""IMUs on the bus: the interface of an IMU, and the Xsens MTi-600 series.

To support another IMU, add a file with a class that has the methods of `Imu`, and a line in `make_imu`.

Source of ids and scales: xsens.dbc and xsens_parser.cpp of jiminghe/Xsens_MTi_CAN_ROS_Driver, commit e305ce3 (tested
on an MTi-680-DK by its author), the maker's xscandataidentifier.h and its document MT1604P.
"""

from __future__ import annotations

import struct
from typing import Any, Protocol

import numpy as np

from mimic.errors import ConfigError, FrameError
from mimic.frozen import frozen_arrays
from mimic.geometry import multiply_quats, rotation_from_quat
from mimic.hardware.can.frame import CanFrame
from mimic.hardware.can.wiring import ImuWiring
from mimic.records import FloatArray

STALE_AFTER = 0.03
"""A reading older than this is not used [s]: three missing samples at 100 Hz; a 50 Hz loop sees it within 50 ms."""


@frozen_arrays
class ImuReading:
    """The latest data of an IMU at one moment."""

    quat_WB: FloatArray
    """Orientation of the base, wxyz (4,); NaN if missing or stale."""
    omega_B: FloatArray
    """Angular velocity, base axes (3,) [rad/s]; NaN if missing or stale."""
    age: float
    """Age of the older of the two [s]; infinite before the first."""
    unchanged: float
    """Time since any content of the frames changed, the counter included [s]; infinite before the first frame."""
    count: int
    """Number of samples (orientation and angular velocity) received so far."""
    valid: bool | None
    """Whether the IMU marks its orientation as valid; None before its first status word."""
    problem: str | None
    """Why the reading must not be used, or None."""


class Imu(Protocol):
    """Collects the frames of an IMU and returns its latest reading."""

    def feed(self, frame: CanFrame, t: float) -> bool:
        """Take a frame received at time t [s]; return whether it belongs to the IMU.

        Raises:
            FrameError: If it has an identifier of the IMU but is malformed.
        """
        ...

    def reading(self, now: float) -> ImuReading:
        """Return the latest reading as of time ``now`` [s]."""
        ...


QUATERNION = 0x021
"""Identifier of the orientation: 11 bits, as the device ships."""
RATE_OF_TURN = 0x032
"""Of the angular velocity."""
STATUS_WORD = 0x011
"""Of the status word."""
SAMPLE_TIME = 0x005
"""Of the time of the sample."""
GROUP_COUNTER = 0x006
"""Of the counter of samples."""

LENGTH = {QUATERNION: 8, RATE_OF_TURN: 6, STATUS_WORD: 4, SAMPLE_TIME: 4, GROUP_COUNTER: 2}

NUMBERS = {SAMPLE_TIME: "time", GROUP_COUNTER: "counter", STATUS_WORD: "status"}
"""Name of each message that is one number, in the order in which an MTi sends them.

The counter goes on from 65535 to 0; the time is in the device's ticks, whose unit its documents disagree on (10 kHz or
1 MHz)."""

QUATERNION_SCALE = 32767.0
"""Word of 1. The maker's document divides quaternions by 32767, its DBC by 32768; normalised, both are one."""
RATE_SCALE = 512.0
"""Word of 1 rad/s."""

OTHER_OUTPUTS = frozenset(
    (0x001, 0x002, 0x007, 0x022, 0x031, 0x033, 0x034, 0x035, 0x041, 0x051, 0x052, 0x061, 0x062)
    + (0x071, 0x072, 0x073, 0x074, 0x075, 0x076, 0x079, 0x07A)
)
"""Identifiers of what else an MTi may send: errors, UTC, Euler angles, increments, accelerations, magnetic field,
temperature, pressure, position. Source: the DBC named above."""

ORIENTATION_VALID = 1 << 1
"""Bit of the status word."""


def decode_mti(frame: CanFrame) -> dict[str, Any] | None:
    """Return the content of a frame by name, or None if mimic does not read that message.

    ``quat_WI`` is the orientation of the IMU, wxyz (4,), normalised; ``omega_I`` its angular velocity (3,) [rad/s].

    Raises:
        FrameError: If its length is wrong, or its quaternion has no direction.
    """
    if frame.extended or frame.id not in LENGTH:
        return None
    if len(frame.data) != LENGTH[frame.id]:
        raise FrameError(f"{frame} has {len(frame.data)} bytes; message 0x{frame.id:03X} has {LENGTH[frame.id]}")
    if frame.id == QUATERNION:
        quat = np.array(struct.unpack(">4h", frame.data)) / QUATERNION_SCALE
        length = float(np.linalg.norm(quat))
        if not 0.98 < length < 1.02:
            raise FrameError(f"{frame} is a quaternion of length {length:.3f}; expected 1")
        return {"quat_WI": quat / length}
    if frame.id == RATE_OF_TURN:
        return {"omega_I": np.array(struct.unpack(">3h", frame.data)) / RATE_SCALE}
    return {NUMBERS[frame.id]: int.from_bytes(frame.data, "big")}


class XsensMti:
    """An Xsens MTi of the 600 series: orientation and rate of turn; counter and status word if it sends them."""

    def __init__(self, quat_BI: FloatArray) -> None:
        """Make a listener.

        Args:
            quat_BI: How the IMU sits on the base: turns IMU axes into base axes, wxyz (4,).
        """
        self._quat_IB = np.asarray(quat_BI) * np.array([1.0, -1.0, -1.0, -1.0])
        self._R_BI = rotation_from_quat(quat_BI)
        self._newest: dict[str, Any] = {}
        self._came = {QUATERNION: -np.inf, RATE_OF_TURN: -np.inf}
        self._content: dict[int, bytes] = {}
        self._changed = -np.inf
        self._samples = dict.fromkeys(self._came, 0)

    def feed(self, frame: CanFrame, t: float) -> bool:
        """Take a frame received at time t [s]; return whether it belongs to the IMU.

        Raises:
            FrameError: If it has an identifier of the IMU but is malformed.
        """
        content = decode_mti(frame)
        if content is None:
            return not frame.extended and frame.id in OTHER_OUTPUTS
        self._newest |= content
        if frame.id in self._came:
            self._came[frame.id] = t
            self._samples[frame.id] += 1
        if self._content.get(frame.id) != frame.data:
            self._content[frame.id] = frame.data
            self._changed = t
        return True

    def reading(self, now: float) -> ImuReading:
        """Return the latest reading as of time ``now`` [s]."""
        newest = self._newest
        age = now - min(self._came.values())
        valid = bool(newest["status"] & ORIENTATION_VALID) if "status" in newest else None
        counted = "counter" in newest or "time" in newest  # without, a robot at rest repeats itself
        problem = None
        if np.isinf(age):
            problem = "the IMU has not sent orientation and rate of turn yet"
        elif age > STALE_AFTER:
            problem = f"the IMU has been silent for {1e3 * age:.0f} ms"
        elif counted and now - self._changed > STALE_AFTER:
            problem = f"the IMU has repeated itself for {1e3 * (now - self._changed):.0f} ms"
        elif valid is False:
            problem = "the IMU calls its orientation invalid"
        quat_WB = np.full(4, np.nan)
        omega_B = np.full(3, np.nan)
        if age <= STALE_AFTER:
            quat_WB = multiply_quats(newest["quat_WI"], self._quat_IB)
            omega_B = self._R_BI @ newest["omega_I"]
        return ImuReading(
            quat_WB=quat_WB,
            omega_B=omega_B,
            age=age,
            unchanged=now - self._changed,
            count=min(self._samples.values()),
            valid=valid,
            problem=problem,
        )


def make_imu(wiring: ImuWiring) -> Imu:
    """Return the listener of an IMU.

    Raises:
        ConfigError: If mimic does not know its kind.
    """
    if wiring.kind == "xsens_mti":
        return XsensMti(wiring.quat_BI)
    raise ConfigError(f"the IMU is of kind {wiring.kind!r}; mimic knows xsens_mti")
