"""Corrects swapped left and right sides of the detector, over the whole clip.

BlazePose sometimes swaps left and right for a while (32 of 100 frames of one real view). A frame-by-frame decision
locks onto the wrong side when that lasts; the minimum-cost path over the clip does not.
"""

from __future__ import annotations

import re

import numpy as np

from mimic.records import LANDMARKS, BoolArray, FloatArray, IntArray

FLIP_COST = 0.02
"""A change of sides must bring the limbs at least this much closer to their last position [m]."""
SWAPPED_COST = 0.05
"""Cost of each second spent swapped [m/s]: the detector is right most of the time. A real swap saves 0.2-0.5 m at each
end, so one of ten seconds is still found; a doubtful one, which saves 0.05 m, cannot last longer than a second."""
MEMORY = 0.3
"""Time constant of the weight of the last detected position [s]."""

_LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")


def other_side() -> IntArray:
    """Return for each landmark the index of its counterpart on the other side (L,); its own index if it has none."""
    swap = {"left": "right", "right": "left"}
    other = [re.sub("left|right", lambda side: swap[side[0]], name) for name in LANDMARKS]
    return np.array([LANDMARKS.index(name) for name in other])


def side_costs(before: FloatArray, now: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how far the limbs moved if both rows have the same sides, and if one of them is swapped [m].

    Causal: one row needs only the previous row.

    Args:
        before, now: Mid-hip -> landmark of two rows (..., 33, 3) [m].

    Returns:
        Mean distance over the limbs (...,) for "same" and for "swapped".
    """
    limbs = [i for i, name in enumerate(LANDMARKS) if name.split("_")[-1] in _LIMBS]
    swapped = other_side()[limbs]
    same = np.linalg.norm(now[..., limbs, :] - before[..., limbs, :], axis=-1).mean(axis=-1)
    other = np.linalg.norm(now[..., swapped, :] - before[..., limbs, :], axis=-1).mean(axis=-1)
    return same, other


def decide_sides(t: FloatArray, landmarks: FloatArray, shots: IntArray) -> BoolArray:
    """Return the rows whose left and right must be swapped (T,): the minimum-cost path over the clip (Viterbi).

    A row is compared with the two rows before it, so that one frame between both sides decides nothing.

    Args:
        t: Times (T,) [s].
        landmarks: Mid-hip -> landmark (T, 33, 3) [m], NaN rows if no person was detected.
        shots: Rows at which a new shot begins; each shot is decided by itself.
    """
    swapped = np.zeros(len(t), dtype=np.bool_)
    rows = np.flatnonzero(np.isfinite(landmarks[:, 0, 0]))
    if len(rows) < 2:
        return swapped
    times = t[rows]
    shot = np.searchsorted(shots, rows, "right")
    usual = float(np.median(np.diff(times)))
    near, far = (_costs(times, landmarks[rows], lag, usual, shot) for lag in (1, 2))
    total = _START
    came_from = np.zeros((len(rows), 2, 2), dtype=np.int64)
    for k in range(1, len(rows)):
        before = far[k - 2] if k > 1 else near[0]
        total, came_from[k] = _viterbi_step(total, near[k - 1], before, times[k] - times[k - 1])
    before, now = np.unravel_index(int(total.argmin()), total.shape)
    for k in range(len(rows) - 1, -1, -1):
        swapped[rows[k]] = bool(now)
        earlier = came_from[k, before, now]
        now = before
        before = earlier
    return swapped


_START = np.array([[0.0, np.inf], [np.inf, 0.0]])
"""Costs of the first row as [row before, row]: there is no row before it, so that it counts as alike."""


def _costs(t: FloatArray, landmarks: FloatArray, lag: int, usual: float, shot: IntArray) -> FloatArray:
    """Return the cost of each row (N - lag, 2, 2) as [swapped ``lag`` rows before, swapped] [m]."""
    same, other = side_costs(landmarks[:-lag], landmarks[lag:])
    weight = np.exp(-np.maximum(t[lag:] - t[:-lag] - lag * usual, 0) / MEMORY) * (shot[lag:] == shot[:-lag])
    stay = weight * same
    flip = weight * (other + FLIP_COST)
    return np.stack([stay, flip, flip, stay], axis=-1).reshape(-1, 2, 2)


def _viterbi_step(total: FloatArray, near: FloatArray, far: FloatArray, gap: float) -> tuple[FloatArray, IntArray]:
    """Return the costs [row before, row] after another row, and the best state of the row before the row before.

    Args:
        total: Costs so far (2, 2).
        near, far: Costs of this row against the one before it and the one before that (2, 2).
        gap: Time since the row before [s].
    """
    costs = total[:, :, None] + 0.5 * (near[None] + far[:, None])
    state_cost = SWAPPED_COST * min(gap, MEMORY)
    return costs.min(axis=0) + (0.0, state_cost), costs.argmin(axis=0)


class LiveSides:
    """The same decision row by row, from past rows only."""

    def __init__(self) -> None:
        self._rows: list[tuple[float, FloatArray]] = []
        self._total = _START

    def decide(self, t: float, landmarks: FloatArray) -> bool:
        """Return whether left and right of a row (33, 3) [m] at time t [s] must be swapped."""
        self._rows = [*self._rows, (t, np.array(landmarks))][-3:]
        if len(self._rows) > 1:
            times, points = map(np.array, zip(*self._rows, strict=True))
            one_shot = np.zeros(len(times), dtype=np.int64)
            near, far = (_costs(times, points, lag, 1 / 30, one_shot) for lag in (1, len(times) - 1))
            self._total, _ = _viterbi_step(self._total, near[-1], far[-1], times[-1] - times[-2])
            self._total = self._total - self._total.min()
        return bool(self._total.argmin() % 2)


def swap_sides(values: FloatArray, swapped: BoolArray) -> FloatArray:
    """Return values (T, 33, ...) with left and right swapped in the marked rows (T,)."""
    result = values.copy()
    result[swapped] = values[swapped][:, other_side()]
    return result
