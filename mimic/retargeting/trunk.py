"""How far a person crouches and leans, and what that asks of the robot's trunk."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mimic.geometry import R_CT
from mimic.records import SIDES, FloatArray, PoseTrack
from mimic.robot.description import RobotDescription

BODY = [f"{side}_{part}" for part in ("shoulder", "hip", "ankle") for side in SIDES]
"""Landmarks that tell height and lean."""

SMOOTHING = 0.12
"""Standard deviation of the filter over height and lean [s]: squats last a second, a detector's noise a frame."""

STANDING = 0.9
"""Quantile of the hips' height that counts as standing."""

UPRIGHT = 0.93
"""Hips above this share of the standing height: the person stands, and the lean of then counts as none."""

STILL = 0.05
"""Hips lower by less than this share, and …"""

STILL_LEAN = np.radians(6.0)
"""… a lean of less [rad] count as none, of twice as much as they are: a person who boxes sways by as much."""

DEEPEST = 0.5
"""Share by which the hips of a person who squats come lower; the robot is then as low as it goes."""

FEWEST = 0.5
"""In at least this share of the rows shoulders, hips and ankles have to be seen."""


def person_trunk(pose: PoseTrack, heading: FloatArray) -> FloatArray:
    """Return how a person's trunk differs from standing, one row per row of the pose.

    Up is up in the image. Source of the scale: hips of .29 to .44 of their standing height in filmed squats.

    Args:
        pose: Landmarks in camera axes.
        heading: Of the torso (T,) [rad].

    Returns:
        Hips above standing, as a share of the standing height, and forward lean [rad], (T, 2); NaN where shoulders,
        hips and ankles are seen in too few rows.
    """
    unknown = np.full((len(pose.t), 2), np.nan)
    if not set(BODY) <= set(pose.names) or len(pose.t) < 2:
        return unknown
    columns = [pose.index(name) for name in BODY]
    shoulders, hips, ankles = np.split(pose.landmarks[:, columns], 3, axis=1)
    seen = pose.valid[:, columns].all(axis=1)
    if seen.mean() < FEWEST:
        return unknown
    height = (ankles[..., 1].max(axis=1) - hips[..., 1].mean(axis=1))[seen]
    share = height / np.quantile(height, STANDING)
    turn = np.stack([np.cos(heading), np.sin(heading)], axis=-1)[seen]
    trunk = (shoulders.mean(axis=1) - hips.mean(axis=1))[seen] @ R_CT
    lean = np.unwrap(np.arctan2((trunk[:, :2] * turn).sum(axis=-1), trunk[:, 2]))
    lean -= np.median(lean[share > UPRIGHT])
    found = np.stack([share - 1.0, lean], axis=-1)
    whole = np.stack([np.interp(pose.t, pose.t[seen], column) for column in found.T], axis=-1)
    step = float(np.median(np.diff(pose.t)))
    return gaussian_filter1d(whole, SMOOTHING / step, axis=0, mode="nearest")


def trunk_goals(person: FloatArray, description: RobotDescription) -> FloatArray:
    """Return height [m] and lean [rad] of the robot's trunk (T, 2) for those of a person; zeros where unknown."""
    numbers = description.trunk_numbers
    if numbers is None:
        return np.zeros_like(person)
    known = np.nan_to_num(person)
    lower = _beyond(-known[:, 0], STILL) / DEEPEST
    lean = _beyond(known[:, 1], STILL_LEAN)
    return np.stack([np.clip(lower, 0.0, 1.0) * numbers.height[0], np.clip(lean, *numbers.pitch)], axis=-1)


def _beyond(values: FloatArray, still: float) -> FloatArray:
    """Return values (T,) that count: none up to a bound, wholly from twice the bound on."""
    return values * np.clip(values / still - 1.0, 0.0, 1.0)
