"""Which samples count, and the blocks of time that they are in, some of them held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mimic.io.joint_log import JointLog
from mimic.records import BoolArray, FloatArray, IntArray

SHORT, LEAST_BLOCKS = 9.5, 16
"""A log up to so long [s] is cut into so many blocks; fewer could not say how sure anything is."""

UNREAD = "unread"
"""Column of such rows: 1 where nothing is compared with the reading, which is interpolated."""

RECEIVED = "t_receive."
"""Begins the name of the column with the time at which a joint's answer came."""

ODD = 5.0
"""An answer this many standard deviations from the usual time is of no known time, or of another row."""

LEAST_ODD = 0.5e-3
"""[s]; what is less hardly matters."""

SPIKE = 100.0
"""Speed to a single reading and back from it, from which on no machine moved so [rad/s or m/s]."""


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


def make_blocks(
    t: FloatArray,
    counts: BoolArray,
    seconds: float = 1.0,
    every: int = 4,
    logs: Sequence[slice] = (),
    enabled: BoolArray | None = None,
) -> Blocks:
    """Cut time into blocks and hold every fourth of each log out, whatever logs are before it.

    Where a drive is switched in that one, the next is held out: a joint that is let go moves as in no other block, so
    that nothing fitted to the others says how.

    Args:
        t: Time of each reading (T,) [s].
        counts: Readings that count (T,).
        seconds: Length of a block [s].
        every: One block in this many is held out.
        logs: Rows of each log, of several.
        enabled: Where drives were switched on (T, J); always by default.
    """
    logs = logs or [slice(0, len(t))]
    total = float(sum(t[rows][-1] - t[rows][0] for rows in logs))
    seconds = seconds if total > SHORT else min(seconds, total / LEAST_BLOCKS)
    index, held_out, count = np.zeros(len(t), dtype=int), [], 0
    for rows in logs:
        own = np.floor((t[rows] - t[rows][0]) / seconds).astype(int)
        last = int(own.max())
        if last and np.sum(own == last) < 0.5 * np.sum(own == 0):
            own[own == last] = last - 1
            last -= 1
        index[rows] = count + own
        count += last + 1
        rest = np.ones(last + 1, dtype=bool)
        if enabled is not None:
            rest[own[1:][np.any(np.diff(enabled[rows], axis=0), axis=1)]] = False
        held = [np.flatnonzero(rest[b : b + every])[:1] + b for b in range(every // 2, last + 1, every)]
        held_out.append(np.isin(np.arange(last + 1), np.concatenate([[-1], *held])))
    return Blocks(index=np.where(counts, index, -1), held_out=np.concatenate(held_out))


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


def spikes(log: JointLog) -> BoolArray:
    """Return the position readings (T, J) that are far from neighbours which agree: corrupt frames."""
    t, q = log.t, log.q
    found = np.zeros(q.shape, dtype=bool)
    if len(t) < 3:
        return found
    up, down = np.diff(q[:-1], axis=0), -np.diff(q[1:], axis=0)
    times = np.maximum(np.diff(t)[:-1], np.diff(t)[1:])[:, None]
    least = np.minimum(np.abs(up), np.abs(down))
    found[1:-1] = (up * down > 0) & (least > SPIKE * times) & (np.abs(up - down) < 0.2 * least)
    return found


def missing(log: JointLog) -> BoolArray:
    """Return the rows (T,) with a reading that is not a number."""
    rows = np.asarray(~np.isfinite(log.q).all(axis=1))
    if log.tau is not None and np.isfinite(log.tau).any():
        rows |= ~np.isfinite(log.tau).all(axis=1)
    return rows


def at_odd_times(log: JointLog, most: float) -> BoolArray:
    """Return the rows (T,) in which a joint answered much earlier or later than usual.

    Early ones are the answers to the row before.

    Args:
        log: With the times at which answers came; without, no row is.
        most: Greatest share of the rows; of more, those that are furthest off.
    """
    odd = np.zeros(len(log.t))
    for joint in log.joints:
        if (came := log.extra.get(RECEIVED + joint)) is None or not np.isfinite(came).any():
            continue
        after = came - log.t
        away = np.abs(after - np.nanmedian(after))
        odd = np.fmax(odd, away / max(ODD * 1.4826 * float(np.nanmedian(away)), LEAST_ODD))
    return np.asarray(odd > max(1.0, float(np.quantile(odd, 1.0 - most))))


def filled(log: JointLog, rows: BoolArray) -> JointLog:
    """Return the log with the readings of some rows (T,) interpolated and masked."""
    values = {}
    for name in ("q", "dq", "tau"):
        channel = getattr(log, name)
        if channel is not None:
            values[name] = np.stack([_interpolated(log.t, column, rows) for column in channel.T], -1)
    mark = rows | (np.nan_to_num(log.extra.get(UNREAD, np.zeros(len(log.t)))) > 0)
    return replace(log, extra={**log.extra, UNREAD: mark.astype(float)}, **values)


def _interpolated(t: FloatArray, x: FloatArray, rows: BoolArray) -> FloatArray:
    known = ~rows & np.isfinite(x)
    return np.where(known, x, np.interp(t, t[known], x[known]) if known.any() else 0.0)


def valid_samples(log: JointLog) -> BoolArray:
    """Return the rows (T,) whose readings are not masked."""
    return np.asarray(np.nan_to_num(log.extra.get(UNREAD, np.zeros(len(log.t)))) == 0)
