"""Gaps, target times and what lies between two targets."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.signal import find_peaks

from mimic.geometry import smoothstep
from mimic.records import BoolArray, FloatArray, IntArray

HOLD = 0.3
"""How long a hand that is not seen stays where it was, or where it will be seen again [s]."""
EASE = 0.7
"""Time to ease to rest [s]."""
GLIMPSE = 0.25
"""An arm that is seen for less than this between long gaps counts as not seen [s]."""
PROMINENCE = 0.015
"""A turn of a toe that stands out by less than this is not a turning point [m]."""
RATE_OF_PEAKS = 0.1
"""Targets at this spacing or closer need no peak keeping: they keep 99 % of a punch as they are [s]."""


def without_glimpses(t: FloatArray, valid: BoolArray) -> BoolArray:
    """Return where one hand counts as seen (T,): short glimpses between long gaps do not.

    Parts with gaps shorter than it takes to leave and come back belong together.
    """
    seen = np.flatnonzero(valid)
    if not len(seen):
        return valid
    parts = np.split(seen, np.flatnonzero(np.diff(t[seen]) > 2 * HOLD) + 1)
    frame = float(np.median(np.diff(t)))
    kept = np.zeros_like(valid)
    for part in parts:
        kept[part] = len(part) * frame >= GLIMPSE
    return kept


def fill_gaps(t: FloatArray, p: FloatArray, valid: BoolArray, waiting: FloatArray) -> FloatArray:
    """Return the positions of one hand without gaps: held for a moment, then eased to where it waits, and back.

    Args:
        t: Time (T,) [s], increasing.
        p: Position (T, 3) [m]; not looked at where not valid.
        valid: (T,).
        waiting: Where a hand that is not seen waits (3,) [m].
    """
    seen = np.flatnonzero(valid)
    if not len(seen):
        return np.tile(waiting, (len(t), 1))
    filled = np.array(p)
    gaps = np.flatnonzero(~valid)
    after = np.searchsorted(seen, gaps)
    before = after - 1
    has_before = before >= 0
    has_after = after < len(seen)
    last = seen[np.maximum(before, 0)]
    following = seen[np.minimum(after, len(seen) - 1)]
    since = np.where(has_before, t[gaps] - t[last], np.inf)
    until = np.where(has_after, t[following] - t[gaps], np.inf)
    bridged = has_before & has_after
    share = np.where(has_before, 0.0, 1.0)
    share[bridged] = since[bridged] / (since[bridged] + until[bridged])
    bridge = p[last] + ease(share)[:, None] * (p[following] - p[last])
    away = ease((np.minimum(since, until) - HOLD) / EASE)[:, None]
    filled[gaps] = bridge + away * (waiting - bridge)
    return filled


def target_times(t: FloatArray, p: FloatArray, rate: float) -> FloatArray:
    """Return the times of one hand's targets [s]: every `rate`, ends included, at a turning point where there is one.

    With more than 0.1 s between targets, a target moves to the turning point within half a step that is farthest from
    where the hand usually is (its median), if there is any: of a punch and the return before the next one, the punch
    stays. The first and the last target stay at the ends.

    Args:
        t: Time of the rows (T,) [s], increasing.
        p: Position of the toe without gaps (T, 3) [m].
        rate: Time between two targets [s].
    """
    steps = max(1, round((t[-1] - t[0]) / rate))
    times = t[0] + rate * np.arange(steps + 1)
    times[-1] = t[-1]
    if rate <= RATE_OF_PEAKS + 1e-9:
        return times
    turns = turning_points(p)
    outward = np.linalg.norm(p[turns] - np.median(p, axis=0), axis=1)
    nearest = np.floor((t[turns] - t[0]) / rate + 0.5).astype(int)
    for step in range(1, steps):
        mine = np.flatnonzero((nearest == step) & (t[turns] < times[-1]))
        if len(mine):
            times[step] = t[turns[mine[np.argmax(outward[mine])]]]
    return times


def turning_points(p: FloatArray) -> IntArray:
    """Return the rows of p (T, 3) where an axis turns back by at least PROMINENCE."""
    turns = [find_peaks(signed, prominence=PROMINENCE)[0] for axis in p.T for signed in (axis, -axis)]
    return np.unique(np.concatenate(turns)).astype(np.int64)


def between(t_rows: FloatArray, p: FloatArray, t: FloatArray) -> FloatArray:
    """Return positions at times t (N,) on the shape-preserving cubic through rows (T, 3); held beyond the ends."""
    return PchipInterpolator(t_rows, p, axis=0)(np.clip(t, t_rows[0], t_rows[-1]))


def ease(share: Any) -> Any:
    """Return a share that begins at 0 and ends at 1, both at rest; shares of the time beyond 0 to 1 are clipped."""
    return smoothstep(np.clip(share, 0.0, 1.0))
