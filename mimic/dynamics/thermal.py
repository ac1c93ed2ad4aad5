"""How warm the motors get: a winding inside a housing, each warmed by the square of the torque, fitted to the manual.

The winding's rise above the surroundings is the sum of two first-order responses to the torque squared, a fast one (the
winding over its housing) and a slow one (the housing over the air). Parameters and their source: robot.toml,
``[motor.thermal]``. Everything is linear in the torque squared, so a log that repeats has a closed form.
"""

from __future__ import annotations

from bisect import bisect_left

import numpy as np

from mimic.records import FloatArray
from mimic.robot.description import RobotDescription

AMBIENT = 25.0
"""Temperature of everything at the start of the overload table [degC]; manual."""
WINDING = 120.0
"""Temperature of the winding at its end [degC]; manual."""

LONGEST = 1e6
"""A limit that is not reached within this is never reached [s]; 11 days."""


def _modes(description: RobotDescription) -> tuple[FloatArray, FloatArray]:
    """Return the share of each response (2,) and its time constant (2,) [s], fast and slow."""
    thermal = description.thermal
    share = thermal.winding_share
    return np.array([share, 1.0 - share]), np.array([thermal.winding_seconds, thermal.housing_seconds])


def _responses(tau: FloatArray, dt: float, description: RobotDescription) -> tuple[FloatArray, FloatArray]:
    """Return both responses after each tick of a cold start (2, ticks, motors), and what a tick leaves of them (2,)."""
    from scipy.signal import lfilter

    share, seconds = _modes(description)
    heat = np.square(np.asarray(tau) / description.torque_rated)
    left = np.exp(-dt / seconds)
    gains = share * (1 - left)
    warmed = [lfilter([gain], [1.0, -keep], heat, axis=0) for gain, keep in zip(gains, left, strict=True)]
    return np.stack(warmed), left


def winding_rise(tau: FloatArray, dt: float, description: RobotDescription) -> FloatArray:
    """Return the rise of each winding after each tick, from cold; 1 is the limit.

    Args:
        tau: Torques (ticks, motors) [N m].
        dt: Time between two ticks [s].
        description: The robot.
    """
    return _responses(tau, dt, description)[0].sum(axis=0)


class MotorHeat:
    """The rise of each winding as it goes, one torque at a time; the same responses as `winding_rise`."""

    def __init__(self, description: RobotDescription, temperature: FloatArray) -> None:
        """Begin with motors that have this temperature all through [degC] (motors,); NaN counts as cold.

        Their housing is as warm as they say, above the 25 degC at which the limit of 120 degC was found.
        """
        self._share, self._seconds = _modes(description)
        self._rated = description.torque_rated
        warm = np.clip((np.nan_to_num(np.asarray(temperature), nan=AMBIENT) - AMBIENT) / (WINDING - AMBIENT), 0.0, None)
        self._rise = np.stack([np.zeros_like(warm), warm])
        self._heat = np.zeros_like(warm)

    def add(self, tau: FloatArray, dt: float) -> FloatArray:
        """Take the torques (motors,) [N m] of the next dt [s] and return the rise (motors,); 1 is the limit.

        A torque that is not known counts as the one before.
        """
        heat = np.square(np.asarray(tau) / self._rated)
        self._heat = np.where(np.isnan(heat), self._heat, heat)
        left = np.exp(-dt / self._seconds)[:, None]
        self._rise = left * self._rise + self._share[:, None] * (1 - left) * self._heat
        return self._rise.sum(axis=0)


def seconds_to_limit(tau: FloatArray, dt: float, description: RobotDescription) -> FloatArray:
    """Return when each winding reaches its limit if these torques repeat (motors,) [s]; infinite if never.

    Args:
        tau: Torques (ticks, motors) [N m].
        dt: Time between two ticks [s].
        description: The robot.
    """
    once, left = _responses(tau, dt, description)
    ticks = once.shape[1]
    kept = left[:, None] ** np.arange(1, ticks + 1)  # of what there was at the beginning of a repetition
    settled = once[:, -1] / (1 - kept[:, -1:])  # at the beginning of a repetition, after many

    def rise(motor: int, repetition: int) -> FloatArray:
        before = settled[:, motor] * (1 - kept[:, -1] ** repetition)
        return (before[:, None] * kept + once[:, :, motor]).sum(axis=0)

    most = int(LONGEST / (ticks * dt)) + 1
    found = np.full(once.shape[2], np.inf)
    for motor in range(once.shape[2]):
        if rise(motor, most).max() < 1.0:
            continue
        # the first repetition that reaches the limit: each is warmer than the one before
        first = bisect_left(range(most), 1.0, key=lambda repetition: rise(motor, repetition).max())
        found[motor] = (first * ticks + int(np.argmax(rise(motor, first) >= 1.0)) + 1) * dt
    return found
