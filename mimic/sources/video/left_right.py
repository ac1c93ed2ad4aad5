"""Corrects swapped left and right sides of the detector, over the whole clip.

BlazePose sometimes swaps left and right for a while (32 of 100 frames of one real view). A frame-by-frame decision
locks onto the wrong side when that lasts; the minimum-cost path over the clip does not.
"""

from __future__ import annotations

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


def other_side(names: tuple[str, ...] = LANDMARKS) -> IntArray:
    """Return for each landmark the index of its counterpart on the other side (L,); its own index if it has none."""
    swap = {"left": "right", "right": "left"}
    mirrored = ("_".join(swap.get(part, part) for part in name.split("_")) for name in names)
    return np.array([names.index(m) if m in names else i for i, m in enumerate(mirrored)])


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

    Args:
        t: Times (T,) [s].
        landmarks: Mid-hip -> landmark (T, 33, 3) [m], NaN rows if no person was detected.
        shots: Rows at which a new shot begins; each shot is decided by itself.
    """
    swapped = np.zeros(len(t), dtype=np.bool_)
    rows = np.flatnonzero(np.isfinite(landmarks[:, 0, 0]))
    if len(rows) < 2:
        return swapped
    same, other = side_costs(landmarks[rows[:-1]], landmarks[rows[1:]])
    gap = np.diff(t[rows])
    weight = np.exp(-np.maximum(gap - np.median(gap), 0) / MEMORY)
    weight[np.searchsorted(shots, rows[1:], "right") != np.searchsorted(shots, rows[:-1], "right")] = 0.0
    state_cost = SWAPPED_COST * np.minimum(gap, MEMORY)
    stay, flip = weight * same, weight * (other + FLIP_COST)
    total = np.zeros(2)
    came_from = np.zeros((len(rows), 2), dtype=np.int64)
    for k in range(len(gap)):
        total, came_from[k + 1] = _viterbi_step(total, stay[k], flip[k], state_cost[k])
    state = int(total.argmin())
    for k in range(len(rows) - 1, -1, -1):
        swapped[rows[k]] = bool(state)
        state = int(came_from[k, state])
    return swapped


def _viterbi_step(total: FloatArray, stay: float, flip: float, state_cost: float) -> tuple[FloatArray, IntArray]:
    """Return the costs of both states after another row (2,), and the previous state of each."""
    costs = np.array([[stay, flip], [flip, stay]]) + total[:, None]
    return costs.min(axis=0) + (0.0, state_cost), costs.argmin(axis=0)


class LiveSides:
    """The same decision row by row, from past rows only."""

    def __init__(self) -> None:
        self._previous: tuple[float, FloatArray] | None = None
        self._total = np.zeros(2)

    def decide(self, t: float, landmarks: FloatArray) -> bool:
        """Return whether left and right of a row (33, 3) [m] at time t [s] must be swapped."""
        if self._previous is not None:
            gap = t - self._previous[0]
            weight = float(np.exp(-max(gap - 1 / 30, 0.0) / MEMORY))
            same, other = side_costs(self._previous[1], landmarks)
            state_cost = SWAPPED_COST * min(gap, MEMORY)
            stay, flip = weight * float(same), weight * (float(other) + FLIP_COST)
            self._total, _ = _viterbi_step(self._total, stay, flip, state_cost)
            self._total = self._total - self._total.min()
        self._previous = t, np.array(landmarks)
        return bool(self._total.argmin())


def swap_sides(values: FloatArray, swapped: BoolArray) -> FloatArray:
    """Return values (T, 33, ...) with left and right swapped in the marked rows (T,)."""
    result = values.copy()
    result[swapped] = values[swapped][:, other_side()]
    return result
