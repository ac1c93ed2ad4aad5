"""How far a person crouches and leans, and what that asks of the robot's trunk.

A detector sees depth badly: when a person bows to the camera, it leans the trunk by half. What it sees well is that the
trunk becomes shorter in the picture, and to which side it goes; the rest is taken as the way forward.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mimic.geometry import R_CT
from mimic.records import LANDMARKS, SIDES, BoolArray, FloatArray, PoseTrack
from mimic.robot.description import RobotDescription

BODY = [f"{side}_{part}" for part in ("shoulder", "hip", "ankle") for side in SIDES]
"""Landmarks that tell height and lean."""

SMOOTHING = 0.12
"""Standard deviation of the filter over height and lean [s]: squats last a second, a detector's noise a frame."""

COLUMNS = [LANDMARKS.index(name) for name in BODY]

STANDING = 0.9
"""Quantile of the hips' height, and of the trunk's length in the picture, that counts as standing."""

BACKWARD = np.radians(-20.0)
"""Whoever seems to lean further back than this [rad] does not lean forward."""

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
    seen = pose.valid[:, columns].all(axis=1)
    if seen.mean() < FEWEST:
        return unknown
    height, up, left, ahead = _measured(pose.landmarks[:, columns], heading)[seen].T
    share = height / np.quantile(height, STANDING)
    lean = _lean(up, left, ahead, np.quantile(np.hypot(up, left), STANDING))
    found = np.stack([share - 1.0, lean], axis=-1)
    whole = np.stack([np.interp(pose.t, pose.t[seen], column) for column in found.T], axis=-1)
    step = float(np.median(np.diff(pose.t)))
    return gaussian_filter1d(whole, SMOOTHING / step, axis=0, mode="nearest")


def _measured(body: FloatArray, heading: FloatArray | float) -> FloatArray:
    """Return hips above the lower ankle, and hips -> shoulders up, left and forward (..., 4) [m].

    Args:
        body: The landmarks BODY (..., 6, 3), camera axes [m].
        heading: Of the torso (...,) [rad].
    """
    shoulders, hips, ankles = np.split(body, 3, axis=-2)
    height = ankles[..., 1].max(axis=-1) - hips[..., 1].mean(axis=-1)
    trunk = (shoulders.mean(axis=-2) - hips.mean(axis=-2)) @ R_CT
    cosine = np.cos(heading)
    sine = np.sin(heading)
    ahead = trunk[..., 0] * cosine + trunk[..., 1] * sine
    left = trunk[..., 1] * cosine - trunk[..., 0] * sine
    return np.stack([height, trunk[..., 2], left, ahead], axis=-1)


def _lean(up: FloatArray, left: FloatArray, ahead: FloatArray, length: float) -> FloatArray:
    """Return the forward lean (...,) [rad] of a trunk of this length [m]; 0 where it clearly leans back."""
    forward = np.sqrt(np.maximum(length**2 - up**2 - left**2, 0.0))
    return np.where(np.arctan2(ahead, up) > BACKWARD, np.arctan2(forward, np.maximum(up, 0.0)), 0.0)


class LiveTrunk:
    """The same of a person in front of a camera: standing is the highest that was seen."""

    def __init__(self) -> None:
        self._standing = 0.0
        self._length = 0.0
        self._found: FloatArray | None = None
        self._t = 0.0

    def see(self, t: float, landmarks: FloatArray, valid: BoolArray, heading: float) -> FloatArray:
        """Return height above standing, as a share of it, and forward lean [rad] (2,); zeros until both are known.

        Args:
            t: Time of the frame [s].
            landmarks: Mid-hip -> landmark (33, 3), camera axes [m].
            valid: Which landmarks count (33,).
            heading: Of the torso [rad].
        """
        if self._found is None:
            self._found = np.zeros(2)
            self._t = t
        if not valid[COLUMNS].all():
            return self._found
        passed = max(t - self._t, 0.0)
        self._t = t
        height, up, left, ahead = _measured(landmarks[COLUMNS], heading)
        self._standing = max(self._standing, float(height))
        self._length = max(self._length, float(np.hypot(up, left)))
        now = np.array([height / self._standing - 1.0, float(_lean(up, left, ahead, self._length))])
        self._found = self._found + (now - self._found) * passed / (SMOOTHING + passed)
        return self._found


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
