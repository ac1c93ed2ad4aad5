"""The clock that human and robot share: zero is the first frame of the video and the first tick of tracking."""

from __future__ import annotations

import numpy as np

from mimic.frames import heading_from_quat
from mimic.types import PHASES, FloatArray, IntArray, PoseTrack, RunLog

TRACK = PHASES.index("track")

_FOLLOW = 0.8
"""Standard deviation of the filter with which a camera follows the robot [s]."""


def shared_time(log: RunLog) -> FloatArray:
    """Return the time of each tick in the video (ticks,) [s]; negative while the robot still stands up.

    A log that never tracks begins at zero.
    """
    tracking = np.flatnonzero(log.phase == TRACK)
    return log.t - log.t[tracking[0] if len(tracking) else 0]


def frame_times(stamps: FloatArray, pose: PoseTrack | None) -> FloatArray:
    """Return the time of each decoded frame since the first one (F,) [s], never decreasing.

    Args:
        stamps: Time of each frame as the file gives it (F,) [s].
        pose: A track of the same video has the better times: it mended stamps that run backwards.
    """
    if pose is not None and len(pose.t) == len(stamps):
        return pose.t
    return np.maximum.accumulate(stamps - stamps[0]) if len(stamps) else stamps


def from_start(t: FloatArray, start: float) -> tuple[FloatArray, IntArray]:
    """Return times and rows with the first row also at ``start`` [s], where that is earlier."""
    rows = np.arange(len(t), dtype=np.int64)
    if len(t) and start < t[0]:
        return np.concatenate([[start], t]), np.concatenate([rows[:1], rows])
    return t, rows


def nearest(t: FloatArray, wanted: FloatArray) -> IntArray:
    """Return the row of the increasing times ``t`` that is nearest to each wanted time."""
    middles = (t[1:] + t[:-1]) / 2
    return np.searchsorted(middles, wanted)


def followed(log: RunLog, position: FloatArray) -> FloatArray:
    """Return where on the floor a camera should look (ticks, 2) [m]: the base's position (ticks, 3), smoothed."""
    from scipy.ndimage import gaussian_filter1d

    dt = float(np.median(np.diff(log.t))) if len(log.t) > 1 else 1.0
    return gaussian_filter1d(position[:, :2], _FOLLOW / dt, axis=0, mode="nearest")


def front(log: RunLog) -> float:
    """Return the direction that the robot is meant to face when it begins [rad]; a camera stands there."""
    heading = float(log.heading_des[0])
    return heading if np.isfinite(heading) else float(heading_from_quat(log.quat_WB[0]))
