"""The shared clock of human and robot: zero is the first video frame and the first tick of tracking."""

from __future__ import annotations

import numpy as np

from mimic.geometry import heading_from_quat
from mimic.records import PHASES, FloatArray, IntArray, RunLog

TRACK = PHASES.index("track")
TIME_TOLERANCE = 1e-3
"""Tolerance of frame times [s]: without it, rounding could delay a video frame by one film frame."""

PHASE_TITLES = {
    "lie": "lying",
    "stand_up": "standing up",
    "blend": "to the first target",
    "track": "following",
    "hold": "holding",
    "sit_down": "sitting down",
    "damp": "damped",
}
"""What a picture says of each phase."""

_FOLLOW = 0.8
"""Standard deviation of the filter on the camera path [s]."""


def shared_time(log: RunLog) -> FloatArray:
    """Return the time of each tick in the video (ticks,) [s]; negative while the robot stands up.

    A log without tracking begins at zero.
    """
    tracking = np.flatnonzero(log.phase == TRACK)
    return log.t - log.t[tracking[0] if len(tracking) else 0]


def frame_numbers(t: FloatArray, frames: FloatArray) -> IntArray:
    """Return the number of the video frame at each time [s]: the first one before the video, the last one after it.

    Args:
        t: Times on the shared clock (N,) [s].
        frames: Times of the frames of the video (F,), at least one [s].
    """
    return np.clip(np.searchsorted(frames, t + TIME_TOLERANCE, side="right") - 1, 0, len(frames) - 1)


def hold_first_row(t: FloatArray, start: float) -> tuple[FloatArray, IntArray]:
    """Return times and rows, with the first row repeated at ``start`` [s] if that is earlier."""
    rows = np.arange(len(t), dtype=np.int64)
    if len(t) and start < t[0]:
        return np.concatenate([[start], t]), np.concatenate([rows[:1], rows])
    return t, rows


def nearest(t: FloatArray, wanted: FloatArray) -> IntArray:
    """Return the row of the increasing times ``t`` that is nearest to each wanted time."""
    middles = (t[1:] + t[:-1]) / 2
    return np.searchsorted(middles, wanted)


def camera_path(log: RunLog, position: FloatArray) -> FloatArray:
    """Return the point on the floor that the camera looks at (ticks, 2) [m]: the smoothed base position (ticks, 3)."""
    from scipy.ndimage import gaussian_filter1d

    dt = float(np.median(np.diff(log.t))) if len(log.t) > 1 else 1.0
    return gaussian_filter1d(position[:, :2], _FOLLOW / dt, axis=0, mode="nearest")


def initial_heading(log: RunLog) -> float:
    """Return the commanded initial heading of the robot [rad]; the camera is placed in this direction."""
    heading = float(log.heading_des[0])
    return heading if np.isfinite(heading) else float(heading_from_quat(log.quat_WB[0]))
