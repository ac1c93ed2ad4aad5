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
_JUST_USABLE = 0.5
"""Visibility at which a landmark may just be used."""
_PALEST = 0.25
"""Share of its colour that the least sure wrist keeps."""
_WELL_KNOWN_DEPTH = 0.08
"""Standard deviation of the depth of a wrist that is sure [m]."""
_UNKNOWN_DEPTH = 0.16
"""… and of one about which nothing is known [m]."""
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
    return {side: (points[:, i], seen[:, i]) for side, i in _wrist_columns(pose).items()}


def _wrist_columns(pose: PoseTrack) -> dict[str, int]:
    return {side: pose.names.index(f"{side}_wrist") for side in SIDES if f"{side}_wrist" in pose.names}


def certainty(pose: PoseTrack) -> dict[str, FloatArray]:
    """Return how sure each side's wrist is (T,), 0 to 1: the less of its visibility and of what is known of its depth.

    Visibility counts from just usable to fully visible, the spread of the depth from _UNKNOWN_DEPTH to
    _WELL_KNOWN_DEPTH.
    """
    known = (_UNKNOWN_DEPTH - np.nan_to_num(pose.depth_spread)) / (_UNKNOWN_DEPTH - _WELL_KNOWN_DEPTH)
    sure = {}
    for side, i in _wrist_columns(pose).items():
        seen = (pose.score[:, i] - _JUST_USABLE) / (1 - _JUST_USABLE)
        sure[side] = np.clip(np.minimum(seen, known[:, SIDES.index(side)]), 0, 1)
    return sure


def doubtful(colour: Colour, sure: float) -> Colour:
    """Return a colour that is paler the less sure what it shows is (0 to 1)."""
    share = _PALEST + (1 - _PALEST) * float(sure)
    red, green, blue = (round(255 - share * (255 - c)) for c in colour)
    return red, green, blue


def heads(pose: PoseTrack, points: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the centre of the head (T, 3) in the axes of ``points`` (T, L, 3), and whether it is known (T,)."""
    ears = [pose.names.index(name) for name in ("left_ear", "right_ear") if name in pose.names]
    if len(ears) < 2:
        return np.full((len(points), 3), np.nan), np.zeros(len(points), dtype=np.bool_)
    middle = points[:, ears].mean(axis=1)
    seen = np.stack([*pose.valid[:, ears].T, *np.isfinite(middle).T])
    return middle, np.all([seen[:2].any(axis=0), *seen[2:]], axis=0)
