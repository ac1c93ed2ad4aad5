"""Stick figure of a person: bones, colours, and the visible segments in each frame."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mimic.geometry import R_CT
from mimic.records import SIDES, BoolArray, FloatArray, IntArray, PoseTrack

Colour = tuple[int, int, int]
"""Red, green, blue, 0 to 255."""

LEFT = (32, 190, 170)
"""Colour of the left side of person and robot, sRGB; distinct from the robot and its orange toes."""
RIGHT = (232, 84, 150)
"""Colour of the right side."""
CENTRE = (150, 158, 170)
"""Colour of the trunk and head."""

COLOURS = {"left": LEFT, "right": RIGHT, "centre": CENTRE}

_LIMBS = (
    ("shoulder", "elbow"),
    ("elbow", "wrist"),
    ("wrist", "index"),
    ("hip", "knee"),
    ("knee", "ankle"),
    ("ankle", "foot_index"),
)
_CENTRE = (
    ("left_shoulder", "right_shoulder"),
    ("left_hip", "right_hip"),
    ("left_shoulder", "left_hip"),
    ("right_shoulder", "right_hip"),
    ("left_ear", "nose"),
    ("right_ear", "nose"),
)
_FEET = ("left_ankle", "right_ankle", "left_heel", "right_heel", "left_foot_index", "right_foot_index")

_FEET_SHARE = 0.2
"""Minimum share of visible feet from which the floor height is estimated."""
_HIP_HEIGHT = 0.9
"""Assumed height of the hips if no foot is visible [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Segments:
    """Visible bones of one side in each frame."""

    ends: FloatArray
    """Both ends of all visible bones in all frames (S, 2, D)."""
    counts: IntArray
    """Number of bones in each frame (T,)."""


def soft(colour: Colour) -> Colour:
    """Return the paler colour of a target, next to the actual value."""
    red, green, blue = ((c + 255) // 2 for c in colour)
    return red, green, blue


def bones(names: tuple[str, ...]) -> dict[str, list[tuple[int, int]]]:
    """Return the pairs of landmarks in a track to connect on each side."""

    def known(pairs: Iterable[tuple[str, str]]) -> list[tuple[int, int]]:
        return [(names.index(a), names.index(b)) for a, b in pairs if a in names and b in names]

    left = known((f"left_{a}", f"left_{b}") for a, b in _LIMBS)
    right = known((f"right_{a}", f"right_{b}") for a, b in _LIMBS)
    return {"left": left, "right": right, "centre": known(_CENTRE)}


def visible(points: FloatArray, valid: BoolArray) -> BoolArray:
    """Return which points (T, L, D) are visible (T, L)."""
    return valid & np.isfinite(points).all(axis=-1)


def segments(points: FloatArray, seen: BoolArray, pairs: list[tuple[int, int]]) -> Segments:
    """Return the bones between points (T, L, D) with both ends visible (T, L)."""
    if not pairs:
        return Segments(ends=np.zeros((0, 2, points.shape[-1])), counts=np.zeros(len(points), dtype=np.int64))
    begin, end = np.array(pairs).T
    drawn = seen[:, begin] & seen[:, end]
    return Segments(ends=np.stack([points[:, begin], points[:, end]], axis=2)[drawn], counts=drawn.sum(axis=1))


def standing_points(pose: PoseTrack) -> FloatArray:
    """Return the landmarks (T, L, 3) [m] with x towards the camera, y to the person's left, z up from the floor.

    The floor height is a low quantile of the height of the feet; without feet, it is 0.9 m below the hips.
    """
    points = pose.landmarks @ R_CT
    feet = [pose.index(name) for name in _FEET if name in pose.names]
    heights = points[:, feet, 2][visible(pose.landmarks, pose.valid)[:, feet]]
    floor = float(np.quantile(heights, 0.1)) if feet_seen(pose) else -_HIP_HEIGHT
    return points - [0.0, 0.0, floor]


def feet_seen(pose: PoseTrack) -> bool:
    """Return whether the feet are visible often enough to estimate the floor height."""
    feet = [pose.index(name) for name in _FEET if name in pose.names]
    return bool(feet) and float(visible(pose.landmarks, pose.valid)[:, feet].mean()) > _FEET_SHARE


def wrists(pose: PoseTrack, points: FloatArray) -> dict[str, tuple[FloatArray, BoolArray]]:
    """Return for each side the wrist (T, D) in the axes of ``points`` (T, L, D), and whether it is visible (T,)."""
    seen = visible(points, pose.valid)
    columns = {side: pose.names.index(f"{side}_wrist") for side in SIDES if f"{side}_wrist" in pose.names}
    return {side: (points[:, i], seen[:, i]) for side, i in columns.items()}
