"""An Xsens MTi as it shows itself on the bus."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import Any

import numpy as np

from mimic.errors import FrameError
from mimic.frozen import frozen_arrays
from mimic.geometry import multiply_quats, rotation_from_quat
from mimic.hardware.can.frame import CanFrame
from mimic.hardware.can.wiring import ImuWiring
from mimic.hardware.motors.imu import (
    LENGTH,
    NUMBERS,
    ORIENTATION_VALID,
    QUATERNION,
    QUATERNION_SCALE,
    RATE_OF_TURN,
    RATE_SCALE,
)
from mimic.records import FloatArray

SELF_TEST_PASSED = 1
"""Bit of the status word."""

TICK = 1e-4
"""Unit of the sample time [s]; the maker's pages, which its own DBC contradicts."""

_MESSAGES = {
    "quat_WI": "quaternion",
    "omega_I": "rate_of_turn",
    "status": "status_word",
    "counter": "group_counter",
    "time": "sample_time",
}
"""Message of each field of a sample, as the wiring names it."""


def _words(values: FloatArray, scale: float) -> list[int]:
    if not np.all(np.isfinite(values)):
        raise FrameError(f"{values} cannot be sent; expected finite numbers")
    return [int(w) for w in np.clip(np.rint(np.asarray(values) * scale), -32768, 32767)]


@frozen_arrays
class MtiSample:
    """What an MTi sends at one moment; fields that it does not send are None."""

    quat_WI: FloatArray | None = None
    """Orientation of the IMU, wxyz (4,), normalised."""
    omega_I: FloatArray | None = None
    """Angular velocity, IMU axes (3,) [rad/s]."""
    status: int | None = None
    counter: int | None = None
    time: int | None = None


def encode_mti(sample: MtiSample) -> list[CanFrame]:
    """Return the frames of a sample in the order in which an MTi sends them; words saturate and are rounded.

    Raises:
        FrameError: If a number is not finite.
    """
    frames: list[tuple[int, bytes]] = []
    for id, name in NUMBERS.items():
        number = getattr(sample, name)
        if number is not None:
            size = LENGTH[id]
            frames.append((id, (number & (1 << 8 * size) - 1).to_bytes(size, "big")))
    if sample.quat_WI is not None:
        frames.append((QUATERNION, struct.pack(">4h", *_words(sample.quat_WI, QUATERNION_SCALE))))
    if sample.omega_I is not None:
        frames.append((RATE_OF_TURN, struct.pack(">3h", *_words(sample.omega_I, RATE_SCALE))))
    return [CanFrame(id, data, extended=False) for id, data in frames]


class EmulatedMti:
    """Samples orientation and rate of turn of the trunk it is mounted on, with a little noise."""

    def __init__(self, wiring: ImuWiring, *, noise: float, seed: int) -> None:
        """Mount it.

        Args:
            wiring: How it sits and what it sends how often.
            noise: Standard deviation of its rates of turn [rad/s]; its orientation has as much [rad], divided by ten.
            seed: Draws the noise.
        """
        self._quat_BI = wiring.quat_BI
        self._R_BI = rotation_from_quat(wiring.quat_BI)
        self._noise = noise
        self._rng = np.random.default_rng([seed, 19])
        self._rate = wiring.rate
        self.period = 1.0 / max(wiring.rate.values())
        """Time between two samples [s]."""
        self.next_sample = self.period
        """When the next one is taken [s]."""
        self._count = 0
        self._last: MtiSample | None = None

    def sample(
        self, quat_WB: FloatArray, omega_B: FloatArray, *, valid: bool, frozen: bool, stuck: bool, tilt: float
    ) -> list[CanFrame]:
        """Take the sample that is due and return its frames.

        Args:
            quat_WB: Orientation of the trunk, wxyz (4,).
            omega_B: Its angular velocity, base axes (3,) [rad/s].
            valid: Whether it calls its orientation valid.
            frozen: Repeat the last sample.
            stuck: Repeat the last sample under a new counter.
            tilt: Error of the orientation about its y axis [rad].
        """
        self._count += 1
        self.next_sample = (self._count + 1) * self.period
        if not (frozen and self._last is not None):
            newest = self._measure(quat_WB, omega_B, valid, tilt)
            if stuck and self._last is not None:
                newest = replace(newest, quat_WI=self._last.quat_WI, omega_I=self._last.omega_I)
            self._last = newest
        assert self._last is not None
        left_out: dict[str, Any] = {field: None for field, message in _MESSAGES.items() if not self._due(message)}
        return encode_mti(replace(self._last, **left_out))

    def _due(self, name: str) -> bool:
        """Return whether a message goes out with this sample: evenly, as often as it is asked for."""
        share = self._rate.get(name, 0.0) * self.period
        return int(self._count * share + 1e-6) > int((self._count - 1) * share + 1e-6)

    def _measure(self, quat_WB: FloatArray, omega_B: FloatArray, valid: bool, tilt: float) -> MtiSample:
        turn = np.concatenate([[1.0], self._rng.normal(0.0, self._noise / 20 + 1e-12, 3)])
        turn = multiply_quats(turn / np.linalg.norm(turn), [np.cos(tilt / 2), 0.0, np.sin(tilt / 2), 0.0])
        quat_WI = multiply_quats(multiply_quats(quat_WB, self._quat_BI), turn)
        return MtiSample(
            quat_WI=quat_WI,
            omega_I=self._R_BI.T @ omega_B + self._rng.normal(0.0, self._noise + 1e-12, 3),
            status=SELF_TEST_PASSED | (ORIENTATION_VALID if valid else 0),
            counter=self._count,
            time=round(self._count * self.period / TICK),
        )
