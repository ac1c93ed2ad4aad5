"""Which of the detector's two sides is the person's left: decided over the whole clip.

BlazePose sometimes exchanges left and right for a while (32 of 100 frames of one real view). A choice frame by frame locks
onto the wrong side when that lasts; the cheapest path over the clip does not.
"""

from __future__ import annotations

import numpy as np

from mimic.types import LANDMARKS, BoolArray, FloatArray, IntArray

FLIP_COST = 0.02
"""Changing sides must bring the limbs this much closer to where they were [m]."""
SWAPPED_COST = 0.05
"""Price of a second spent exchanged [m/s]: the detector is right most of the time. A real exchange saves 0.2-0.5 m at each
end, so ten seconds of it are still found, and a doubtful one of 0.05 m does not outlive a second."""
MEMORY = 0.3
"""Time after which a place last seen says little about where a limb is now [s]."""

_LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")


def other_side(names: tuple[str, ...] = LANDMARKS) -> IntArray:
    """Return for each landmark the index of the same one on the other side (L,); its own where it has none."""
    swap = {"left": "right", "right": "left"}
    mirrored = ("_".join(swap.get(part, part) for part in name.split("_")) for name in names)
    return np.array([names.index(m) if m in names else i for i, m in enumerate(mirrored)])


def side_costs(before: FloatArray, now: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how far the limbs moved if both rows have the same sides, and if one of them is exchanged [m].

    Causal: one row needs only the row before.

    Args:
        before, now: Mid-hip -> landmark of two rows (..., 33, 3) [m].

    Returns:
        Mean distance over the limbs (...,) for "same" and for "exchanged".
    """
    limbs = [i for i, name in enumerate(LANDMARKS) if name.split("_")[-1] in _LIMBS]
    exchanged = other_side()[limbs]
    same = np.linalg.norm(now[..., limbs, :] - before[..., limbs, :], axis=-1).mean(axis=-1)
    other = np.linalg.norm(now[..., exchanged, :] - before[..., limbs, :], axis=-1).mean(axis=-1)
    return same, other


def decide_sides(t: FloatArray, landmarks: FloatArray, shots: IntArray) -> BoolArray:
    """Return the rows whose left and right must be exchanged (T,): the cheapest path over the clip (Viterbi).

    Args:
        t: Times (T,) [s].
        landmarks: Mid-hip -> landmark (T, 33, 3) [m], NaN rows where nothing was seen.
        shots: Rows at which a new shot begins; nothing is carried over them.
    """
    swapped = np.zeros(len(t), dtype=np.bool_)
    rows = np.flatnonzero(np.isfinite(landmarks[:, 0, 0]))
    if len(rows) < 2:
        return swapped
    same, other = side_costs(landmarks[rows[:-1]], landmarks[rows[1:]])
    gap = np.diff(t[rows])
    trust = np.exp(-np.maximum(gap - np.median(gap), 0) / MEMORY)
    trust[np.searchsorted(shots, rows[1:], "right") != np.searchsorted(shots, rows[:-1], "right")] = 0.0
    price = SWAPPED_COST * np.minimum(gap, MEMORY)
    stay, flip = trust * same, trust * (other + FLIP_COST)
    total = np.zeros(2)
    came_from = np.zeros((len(rows), 2), dtype=np.int64)
    for k in range(len(gap)):
        total, came_from[k + 1] = _next(total, stay[k], flip[k], price[k])
    state = int(total.argmin())
    for k in range(len(rows) - 1, -1, -1):
        swapped[rows[k]] = bool(state)
        state = int(came_from[k, state])
    return swapped


def _next(total: FloatArray, stay: float, flip: float, price: float) -> tuple[FloatArray, IntArray]:
    """Return the costs of both states after another row (2,), and the state each came from."""
    ways = np.array([[stay, flip], [flip, stay]]) + total[:, None]
    return ways.min(axis=0) + (0.0, price), ways.argmin(axis=0)


class LiveSides:
    """The same decision row by row, from what was seen so far."""

    def __init__(self) -> None:
        self._before: tuple[float, FloatArray] | None = None
        self._total = np.zeros(2)

    def decide(self, t: float, landmarks: FloatArray) -> bool:
        """Return whether left and right of a row (33, 3) [m] at time t [s] must be exchanged."""
        if self._before is not None:
            gap = t - self._before[0]
            trust = float(np.exp(-max(gap - 1 / 30, 0.0) / MEMORY))
            same, other = side_costs(self._before[1], landmarks)
            price = SWAPPED_COST * min(gap, MEMORY)
            self._total, _ = _next(self._total, trust * float(same), trust * (float(other) + FLIP_COST), price)
            self._total = self._total - self._total.min()
        self._before = t, np.array(landmarks)
        return bool(self._total.argmin())


def exchange_sides(values: FloatArray, swapped: BoolArray) -> FloatArray:
    """Return values (T, 33, ...) with the sides exchanged in the rows marked (T,)."""
    result = values.copy()
    result[swapped] = values[swapped][:, other_side()]
    return result
