"""Blocks of time, some of them held out, and the sums over each."""

from __future__ import annotations

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


def make_blocks(t: FloatArray, counts: BoolArray, seconds: float = 1.0, every: int = 4) -> Blocks:
    """Cut time into blocks and hold every fourth out.

    Args:
        t: Time of each reading (T,) [s].
        counts: Readings that count (T,).
        seconds: Length of a block [s].
        every: One block in this many is held out.
    """
    index = np.floor((t - t[0]) / seconds).astype(int)
    count = int(index.max()) + 1
    if np.sum(index == count - 1) < 0.5 * np.sum(index == 0) and count > 1:
        index[index == count - 1] = count - 2
        count -= 1
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
    """Hessian (B, P, P) and gradient (B, P) in which each chain has its weight, see `Problem.weigh`."""
    weight: FloatArray
    """Weight of the chain of each free parameter, 1 for those of the whole machine (P,)."""

    def over(self, blocks: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return Hessian (P, P) and gradient (P,) over some blocks."""
        return self.hessian[blocks].sum(0), self.gradient[blocks].sum(0)

    def weighed_over(self, blocks: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the same in which each chain has its weight."""
        return self.weighed[0][blocks].sum(0), self.weighed[1][blocks].sum(0)
