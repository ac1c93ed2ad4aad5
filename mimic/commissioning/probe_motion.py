"""The motion of a suspended robot: targets row by row."""

from __future__ import annotations

import numpy as np

from mimic.config.hardware import ProbeSettings
from mimic.dynamics.excitation import hung_ranges, probe_targets
from mimic.records import FloatArray
from mimic.robot.description import RobotDescription


def probe_motion(description: RobotDescription, settings: ProbeSettings) -> FloatArray:
    """Return targets (T, 12) [rad] inside the ranges in which no leg can touch anything."""
    return probe_targets(
        *hung_ranges(description),
        seconds=settings.seconds,
        rate_hz=settings.rate_hz,
        seed=settings.seed,
        kind=settings.kind,
        size=settings.amplitude,
    ).q_des


def recorded_motion(t: FloatArray, q: FloatArray, description: RobotDescription, settings: ProbeSettings) -> FloatArray:
    """Return the targets (T, 12) [rad] of a recorded run, inside the ranges of the suspended robot.

    Args:
        t: Times of the targets, increasing [s].
        q: Targets (ticks, 12) [rad].
        description: The robot.
        settings: Rate and length; a shorter recording is repeated.
    """
    low, high, _ = hung_ranges(description)
    span = float(t[-1] - t[0])
    at = t[0] + np.arange(round(settings.seconds * settings.rate_hz)) / settings.rate_hz % span
    return np.clip(np.stack([np.interp(at, t, column) for column in q.T], -1), low, high)
