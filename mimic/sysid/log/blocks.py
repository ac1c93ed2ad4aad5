"""Blocks of time, some of them held out, and the sums over each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mimic.records import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Blocks:
    """Blocks of time, and which are held out."""

    index: IntArray
    """Block of each reading, -1 where it does not count (T,)."""
    held_out: BoolArray
    """True for blocks that nothing is fitted to (B,)."""

    @property
    def train(self) -> IntArray:
        """Blocks that are fitted."""
        return np.flatnonzero(~self.held_out)


SHORT, LEAST_BLOCKS = 9.5, 16
"""A log up to so long [s] is cut into so many blocks; fewer could not say how sure anything is."""


def make_blocks(
    t: FloatArray, counts: BoolArray, seconds: float = 1.0, every: int = 4, logs: Sequence[slice] = ()
) -> Blocks:
    """Cut time into blocks and hold every fourth out.

    Args:
        t: Time of each reading (T,) [s].
        counts: Readings that count (T,).
        seconds: Length of a block [s].
        every: One block in this many is held out.
        logs: Rows of each log, of several.
    """
    logs = logs or [slice(0, len(t))]
    total = float(sum(t[rows][-1] - t[rows][0] for rows in logs))
    seconds = seconds if total > SHORT else min(seconds, total / LEAST_BLOCKS)
    index, count = np.zeros(len(t), dtype=int), 0
    for rows in logs:
        own = np.floor((t[rows] - t[rows][0]) / seconds).astype(int)
        last = int(own.max())
        if last and np.sum(own == last) < 0.5 * np.sum(own == 0):
            own[own == last] = last - 1
            last -= 1
        index[rows] = count + own
        count += last + 1
    return Blocks(index=np.where(counts, index, -1), held_out=np.arange(count) % every == every // 2)


@dataclass(frozen=True, kw_only=True, eq=False)
class Sums:
    """Normal equations of each block over whitened residuals."""

    hessian: FloatArray
    """(B, P, P)"""
    gradient: FloatArray
    """(B, P)"""
    square: FloatArray
    """Sum of squares (B,)."""
    weighed: tuple[FloatArray, FloatArray]
    """Hessian (B, P, P) and gradient (B, P) in which each chain has its weight, see `Problem.weighed`."""
    weight: FloatArray
    """Weight of the chain of each free parameter, 1 for those of the whole machine (P,)."""

    def over(self, blocks: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return Hessian (P, P) and gradient (P,) over some blocks."""
        return self.hessian[blocks].sum(0), self.gradient[blocks].sum(0)

    def weighed_over(self, blocks: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the same in which each chain has its weight."""
        return self.weighed[0][blocks].sum(0), self.weighed[1][blocks].sum(0)
