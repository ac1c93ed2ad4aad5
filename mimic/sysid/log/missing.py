"""Masked samples: rows whose reading is missing or of an unknown time, while their target still acts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mimic.io.joint_log import JointLog
from mimic.records import BoolArray, FloatArray

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
