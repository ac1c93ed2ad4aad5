"""When targets were sent: between the row that first shows each one and the row before.

Loggers write rows on a clock of their own, with the newest target beside each reading. So a row brackets the time at
which its target was sent, and a clock that sends at a fixed rate is known far better than one bracket: it must pass
through all of them (a linear programme). What the brackets leave open shifts all targets alike, as a delay does, and
goes into the interval of the delay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.optimize import linprog

from mimic.io.joint_log import JointLog
from mimic.records import FloatArray, IntArray

SENT = "sent"
AT_ROW = "row"
"""Key and value of the metadata of a log that say that a target is sent at the time of the row that first shows it."""

SENT_COLUMN = "t_send."
"""Begins the name of the column with the time at which a joint's command was sent."""

LEAST_TARGETS = 25
"""Fewest targets that show a rate; over so many a clock drifts less than it jitters."""

MOST_WRONG = 0.2
"""Share that may be wrong of a whole that counts: of rows, or of targets that miss their bracket on a steady clock."""

ALIKE = 2e-5
"""Times that differ by less are one: it moves no joint by its noise [s]."""

MOST_RATES = 100000
"""Most rates that are tried, the lowest ones: single targets that come 1 ms apart would ask for any number."""

BEND = 10.0
"""Time between the places where the rate of a clock may change, where a steady one does not fit [s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SendingTimes:
    """When each target was sent, as far as a log tells."""

    how: str
    """Where the times are from: "t_send", "row", "periodic" or "bracket"."""
    rows: IntArray
    """Row that first shows each target, the first of the log included (K,)."""
    at: FloatArray
    """When each was sent, from the first row (K,) [s]."""
    earlier: float = 0.0
    """By how much all may have been sent earlier, together [s]: a delay that follows from them is as much longer."""
    later: float = 0.0
    """The same for later."""
    lost: int = 0
    """How many targets never arrived: these are left out."""
    spread: float = 0.0
    """Range of the times by which each was late beside the others [s]."""
    told: float = 0.0
    """How many numbers readings determined in all that."""

    def without(self, lost: IntArray) -> SendingTimes:
        """Return the times without some targets; one that stays is sent again, and arrives a period later."""
        after = np.append(np.diff(self.at), np.inf)
        period = np.median(after)
        again = after[lost] > 1.5 * period
        at = self.at.copy()
        at[lost[again]] += period
        kept = np.delete(np.arange(len(at)), lost[~again])
        return replace(self, rows=self.rows[kept], at=at[kept], lost=self.lost + len(lost), told=self.told + len(lost))

    def late(self, by: FloatArray, spread: float, told: float) -> SendingTimes:
        """Return the times with each target later by a time of its own (K,) [s], in their order."""
        return replace(self, at=np.maximum.accumulate(self.at + by), spread=spread, told=self.told + told)


def first_rows(q_des: FloatArray) -> IntArray:
    """Return the rows that first show a target (K,), the first one included."""
    return np.flatnonzero(np.concatenate([[True], (np.diff(q_des, axis=0) != 0).any(1)]))


def at_rows(log: JointLog) -> SendingTimes:
    """Return the times of targets that are sent when the row is written that first shows them."""
    asked = log.q_des if log.q_des is not None else np.zeros((len(log.t), 1))
    rows = first_rows(asked)
    return SendingTimes(how="row", rows=rows, at=(log.t - log.t[0])[rows])


def sending_times(log: JointLog) -> tuple[SendingTimes, ...]:
    """Return what the log allows: one where it says when targets were sent, else all that a fit must choose from.

    Args:
        log: Readings; without targets nothing was sent but at the first row.
    """
    own = at_rows(log)
    if len(own.rows) < 2 or log.metadata.get(SENT) == AT_ROW:
        return (own,)
    rows = own.rows
    high = own.at
    low = (log.t - log.t[0])[np.maximum(rows - 1, 0)]
    width = float(np.median((high - low)[1:]))
    own = replace(own, earlier=width)
    if (stamped := _stamped(log, rows)) is not None:
        return (SendingTimes(how="t_send", rows=rows, at=stamped),)
    periodic = _periodic(low[1:], high[1:])
    if periodic is not None:
        at, slack = periodic
        at = np.concatenate([[0.0], at])
        if _alike(at[1:], high[1:]):
            return (own,)  # one clock: a target is sent where its row is written, or always as long before
        return SendingTimes(how="periodic", rows=rows, at=at, earlier=slack, later=slack), own
    middle = np.concatenate([[0.0], (low + high)[1:] / 2])
    between = SendingTimes(how="bracket", rows=rows, at=middle, earlier=width / 2, later=width / 2)
    return (own,) if _alike(middle[1:], high[1:]) else (own, between)


def _alike(one: FloatArray, other: FloatArray) -> bool:
    return float(np.std(one - other)) < ALIKE


def _stamped(log: JointLog, rows: IntArray) -> FloatArray | None:
    """Return the logged times of sending (K,) [s], the mean over the joints; None without them or on another clock."""
    columns = [log.extra[SENT_COLUMN + j] for j in log.joints if SENT_COLUMN + j in log.extra]
    if not columns:
        return None
    stamps = np.stack(columns)[:, rows]
    known = np.isfinite(stamps)
    if not known.any(axis=0).all():
        return None
    at = np.where(known, stamps, 0.0).sum(axis=0) / known.sum(axis=0)
    between = 1.0 / log.rate
    fits = (at <= log.t[rows] + between) & (at >= log.t[np.maximum(rows - 1, 0)] - between)
    if fits.mean() < 1.0 - MOST_WRONG or (np.diff(at) <= 0).any():
        return None
    return np.concatenate([[0.0], (at - log.t[0])[1:]])


def _periodic(low: FloatArray, high: FloatArray) -> tuple[FloatArray, float] | None:
    """Return the times (K,) of a clock of a fixed rate through brackets, and by how much all may shift [s].

    A target that misses its bracket is put on its edge. None where no such clock is there.
    """
    if len(low) < LEAST_TARGETS or (count := _periods(low, high)) is None:
        return None
    for bends in (0, int((high[-1] - high[0]) / BEND)):
        clock, slack, missed = _through(_basis(count, bends), low, high)
        if (missed > ALIKE).mean() <= MOST_WRONG:
            return np.clip(clock, low, high), slack
    return None


def _periods(low: FloatArray, high: FloatArray) -> FloatArray | None:
    """Return how many periods after the first each target comes (K,); None where they share no period.

    The longest period at which the rows that show them are least spread over its phase, from few targets to all.
    """
    middle = (low + high) / 2
    gaps = np.diff(middle)
    first = middle[:100] - middle[0]
    least = 0.4 / np.quantile(gaps, 0.1)
    most = 1.3 / gaps.min()
    apart = 0.1 / first[-1]
    rates = least + apart * np.arange(min(np.ceil((most - least) / apart), MOST_RATES))
    if not len(rates):
        return None
    together = np.abs(sum(np.exp(2j * np.pi * rates * at) for at in first))
    good = np.flatnonzero(together >= (1.0 - MOST_WRONG) * together.max())
    rate = rates[good[0] : good[0] + 10][int(np.argmax(together[good[0] : good[0] + 10]))]
    slope = 1.0 / rate
    start = middle[0]
    known = len(first)
    while True:
        count = np.round((middle[:known] - start) / slope)
        if (np.diff(count) <= 0).any():
            return None
        slope, start = np.polyfit(count, middle[:known], 1)
        if known == len(middle):
            return count - count[0]
        known = min(2 * known, len(middle))


def _basis(count: FloatArray, bends: int) -> FloatArray:
    """Return the columns of a clock over its periods (K, 2 + bends): a line that may bend."""
    along = count / max(count[-1], 1.0)
    places = (np.arange(bends) + 1.0) / (bends + 1.0)
    return np.stack([np.ones_like(along), along, *(np.maximum(along - p, 0.0) for p in places)], axis=-1)


def _through(basis: FloatArray, low: FloatArray, high: FloatArray) -> tuple[FloatArray, float, FloatArray]:
    """Return the clock (K,) in the middle of all that pass through brackets, half of the way between the earliest and
    the latest [s], and by how much it misses each bracket (K,) [s].

    It has the rate of least squares if one of them has it: brackets of clocks with rates alike hardly bound the rate.

    Brackets that no clock passes together are missed by the least sum.
    """
    scale = float(np.median(high - low))
    count = basis.shape[1]
    near = basis @ np.linalg.lstsq(basis, (low + high) / 2, rcond=None)[0]
    lower = (low - near) / scale
    upper = (high - near) / scale
    miss = sparse.identity(len(low), format="csr")
    rows = sparse.vstack([sparse.hstack([-basis, -miss]), sparse.hstack([basis, -miss])], format="csr")
    cost = np.concatenate([np.zeros(count), np.ones(len(low))])
    made = linprog(
        cost,
        A_ub=rows,
        b_ub=np.concatenate([-lower, upper]),
        bounds=[(None, None)] * count + [(0.0, None)] * len(low),
        method="highs",
    )
    if made.x is None:
        return near, 0.0, np.full(len(low), np.inf)
    weights = made.x[:count]
    clock = basis @ weights
    outside = np.maximum(np.maximum(lower - clock, clock - upper), 0.0)
    lower = np.minimum(lower, clock)
    upper = np.maximum(upper, clock)
    first = float(lower.max())
    last = float(upper.min())  # of the least-squares line: near enough where rates are alike
    if first <= last:
        return near + scale * (first + last) / 2, scale * (last - first) / 2, scale * outside
    ends = []
    for sign in (1.0, -1.0):
        end = linprog(
            sign * basis.mean(axis=0),
            A_ub=np.concatenate([-basis, basis]),
            b_ub=np.concatenate([-lower, upper]),
            bounds=[(None, None)] * count,
            method="highs",
        )
        ends.append(basis @ (weights if end.x is None else end.x))
    slack = 0.5 * scale * float(np.mean(ends[1] - ends[0]))
    return near + scale * (ends[0] + ends[1]) / 2, max(slack, 0.0), scale * outside


def joined(times: Sequence[tuple[SendingTimes, ...]], begins: Sequence[tuple[int, float]]) -> tuple[SendingTimes, ...]:
    """Return the sending times of logs one after another: whoever writes the rows sends the targets too, or a clock of
    its own does, in all logs alike.

    What most targets have comes first, whatever the order of the logs.

    Args:
        times: What each log allows.
        begins: First row of each, and its time [s].
    """
    found = []
    for by_row in (True, False):
        own = [next((one for one in allowed if (one.how == "row") is by_row), allowed[0]) for allowed in times]
        first = sum(len(one.at) for one, allowed in zip(own, times, strict=True) if one is allowed[0])
        whole = SendingTimes(
            how=" and ".join(sorted({one.how for one in own})),
            rows=np.concatenate([one.rows + row for one, (row, _) in zip(own, begins, strict=True)]),
            at=np.concatenate([one.at + begin for one, (_, begin) in zip(own, begins, strict=True)]),
            earlier=max(one.earlier for one in own),
            later=max(one.later for one in own),
        )
        found.append((first, whole))
    if all(len(allowed) == 1 for allowed in times):
        found = found[:1]
    return tuple(one for _, one in sorted(found, key=lambda f: -f[0]))
