"""Checks that a clip shows one person in one shot."""

from __future__ import annotations

import numpy as np

from mimic.records import LANDMARKS, BoolArray, FloatArray, IntArray

CUT_CHANGE = 8.0
"""Minimum thumbnail change at a cut [grey levels of 255]; a hard cut between similar rooms gives 22."""
CUT_RATIO = 4.0
"""Minimum ratio to the change in neighbouring frames: 12 at that cut, at most 2.1 in fourteen clips without a cut."""
FRAME = 1 / 30
"""Frame interval of ``max_jump``; longer intervals allow proportionally larger movements [s]."""

_SHOULDERS, _WRISTS, _HIPS = (
    [LANDMARKS.index(f"{side}_{part}") for side in ("left", "right")] for part in ("shoulder", "wrist", "hip")
)
_TRUNK = _SHOULDERS + _HIPS


def person_rows(score: FloatArray, min_visibility: float) -> BoolArray:
    """Return the rows (T,) that show a person: both shoulders and a wrist are visible.

    A detection alone is not a person: BlazePose reports one in 23 % of the frames of a clip of bottles.

    Args:
        score: Visibility (T, 33).
        min_visibility: Minimum visibility of a detected landmark.
    """
    seen = score >= min_visibility
    return np.logical_and(seen[:, _SHOULDERS].all(axis=1), seen[:, _WRISTS].any(axis=1))


def shot_starts(change: FloatArray) -> IntArray:
    """Return the first row after each cut.

    Args:
        change: Difference of each frame's thumbnail from the previous one (T,) [grey levels].
    """
    neighbours = [np.roll(np.pad(change, 3), k)[3:-3] for k in (-3, -2, -1, 1, 2, 3)]
    return np.flatnonzero((change > CUT_CHANGE) & (change > CUT_RATIO * (np.max(neighbours, axis=0) + 1.0)))


def jump_share(
    t: FloatArray,
    landmarks: FloatArray,
    image: FloatArray,
    valid: BoolArray,
    size: tuple[int, int],
    max_jump: float,
) -> float:
    """Return the share of frames in which a wrist or the whole person jumps.

    Args:
        t: Times (T,) [s].
        landmarks: Mid-hip -> landmark (T, 33, 3) [m].
        image: Image coordinates (T, 33, 2), fractions of width and height.
        valid: Which landmarks are usable (T, 33).
        size: Width and height of the image [px].
        max_jump: A larger movement from one frame to the next is a jump [m].
    """
    rows = np.flatnonzero(valid[:, _SHOULDERS].all(axis=1))
    if len(rows) < 2:
        return 0.0
    limit = max_jump * np.maximum(1.0, np.diff(t[rows]) / FRAME)
    wrists = np.where(valid[rows][:, _WRISTS, None], landmarks[rows][:, _WRISTS], np.nan)
    wrists_moved = np.linalg.norm(np.diff(wrists, axis=0), axis=-1)
    pixels = image[rows][:, _TRUNK] * np.asarray(size, dtype=np.float64)
    metres = landmarks[rows][:, _TRUNK, :2]
    scale = np.median(spread_of(metres) / np.maximum(spread_of(pixels), 1e-9))
    body_moved = scale * np.linalg.norm(np.diff(pixels[:, :2].mean(axis=1), axis=0), axis=-1)
    return float(((wrists_moved > limit[:, None]).any(axis=1) | (body_moved > limit)).mean())


def spread_of(points: FloatArray) -> FloatArray:
    """Return the root mean square distance of points (T, N, 2) from their mean (T,)."""
    return np.sqrt(((points - points.mean(axis=1, keepdims=True)) ** 2).sum(axis=-1).mean(axis=1))


def upside_down(image: FloatArray, valid: BoolArray) -> bool:
    """Return whether the shoulders are below the hips in most frames that show them."""
    rows = valid[:, _TRUNK].all(axis=1)
    below = image[rows][:, _SHOULDERS, 1].mean(axis=1) > image[rows][:, _HIPS, 1].mean(axis=1)
    return bool(len(below)) and float(below.mean()) > 0.5
