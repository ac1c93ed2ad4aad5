"""The motion in a report: measured, predicted and target over each joint's worst second, and errors by phase."""

from __future__ import annotations

import numpy as np

from mimic.records import BoolArray, FloatArray
from mimic.sysid.result import Calibration, Traces
from mimic.view.report.plots import Unit
from mimic.view.report.sections import joint_rows, key, section, table
from mimic.view.report.svg import Plot, figure

WINDOW = 1.0
"""Length of the part that is drawn [s]."""

RESTING = 0.03
"""Share of a joint's greatest speed below which it rests."""

TURNING = 0.05
"""So long before and after a change of direction a joint reverses [s]."""


def worst_second(traces: Traces, joint: int) -> slice:
    """Return the rows of the second in which the final model is furthest from the readings of a joint."""
    t = traces.t
    squares = np.nan_to_num(traces.after[:, joint] ** 2)
    total = np.concatenate([[0.0], np.cumsum(squares)])
    first = np.arange(len(t))
    last = np.searchsorted(t, t + WINDOW, side="right")
    whole = last < len(t)
    whole[0] = True  # a log shorter than that
    gain = np.where(whole, total[last] - total[first], -1.0)
    if traces.log is not None:  # no second lies across two logs
        gain = np.where(traces.log[np.minimum(last, len(t)) - 1] == traces.log, gain, -1.0)
    best = int(np.argmax(gain))
    return slice(best, int(last[best]))


def worst_seconds(c: Calibration) -> str:
    """Return the section with measured, predicted and target of each joint where the final model is worst."""
    traces = c.traces
    if not len(traces.t):
        return ""
    factor, unit = (180.0 / np.pi, "°") if c.unit == "rad" else (1e3, "mm")
    plots = []
    for j, joint in enumerate(c.joints):
        rows = worst_second(traces, j)
        t = traces.t[rows]
        q = traces.q[rows, j] * factor
        curves = {
            "before": q - traces.before[rows, j] * factor,
            "after": q - traces.after[rows, j] * factor,
            "measured": q,
        }
        if traces.target is not None:
            curves = {"target": traces.target[rows, j] * factor, **curves}
        low, high = (float(f(np.concatenate(list(curves.values())))) for f in (np.nanmin, np.nanmax))
        if not np.isfinite([low, high]).all() or len(t) < 2:
            continue
        margin = 0.06 * (high - low) + 1e-9
        error = np.sqrt(np.nanmean((traces.after[rows, j] * factor) ** 2))
        where = "" if traces.log is None or not c.logs else f" · {c.logs[int(traces.log[rows.start])].name}"
        plot = Plot(
            x=(float(t[0]), float(t[-1])),
            y=(low - margin, high + margin),
            size=(440, 190),
            title=joint + where,
            y_label=f"rms {figure(float(error))}{unit}",
            x_label="time [s]",
        )
        for kind, values in curves.items():
            plot.curve(t, values, f"{kind} thick" if kind in ("before", "after") else kind)
        plots.append(plot.svg(f"measured, predicted and target of {joint} in its worst second"))
    if not plots:
        return ""
    target = {"target": "target"} if traces.target is not None else {}
    marks = key(measured="measured", before="baseline model", after="final model", **target)
    lead = f"Positions [{unit}] in the second in which the final model is furthest off."
    return section("Worst second of each joint", lead, marks, f"<div class='grid2'>{''.join(plots)}</div>")


def phases(traces: Traces, joint: int) -> dict[str, BoolArray]:
    """Return the rows (T,) in which a joint rests, reverses, speeds up and slows down, by the predicted velocity.

    Where none was predicted, no row is in any of them.
    """
    t = traces.t
    v = traces.dq[:, joint]
    known = np.isfinite(v)
    v = np.where(known, v, 0.0)
    resting = np.abs(v) < RESTING * max(float(np.quantile(np.abs(v), 0.99)), 1e-9)
    sign = np.sign(np.where(resting, 0.0, v))
    moving = np.flatnonzero(sign)
    turns = moving[1:][sign[moving[1:]] != sign[moving[:-1]]]
    before = moving[:-1][sign[moving[1:]] != sign[moving[:-1]]]
    quick = t[turns] - t[before] < 4 * TURNING  # a rest between two motions is no reversal
    reversing = np.zeros(len(t), dtype=bool)
    for a, b in zip(before[quick], turns[quick], strict=True):
        reversing |= (t >= t[a] - TURNING) & (t <= t[b] + TURNING)
    speeding = np.gradient(np.abs(v), t) >= 0
    steady = known & ~reversing & ~resting
    return {
        "at rest": known & resting & ~reversing,
        "reversing": known & reversing,
        "speeding up": steady & speeding,
        "slowing down": steady & ~speeding,
    }


def by_phase(c: Calibration, unit: Unit) -> str:
    """Return the section with the errors in each phase of the motion, baseline and final."""
    traces = c.traces
    if len(traces.t) < 3:
        return ""
    squares = []
    counts = []
    names: tuple[str, ...] = ()
    for j in range(len(c.joints)):
        parts = phases(traces, j)
        names = tuple(parts)
        both = np.stack([traces.before, traces.after])
        squares.append(np.stack([np.nansum(both[:, where, j] ** 2, axis=1) for where in parts.values()], axis=1))
        counts.append([np.isfinite(traces.after[where, j]).sum() for where in parts.values()])

    def cells(joints: slice) -> list[str]:
        return _cells(np.sum(squares[joints], 0), np.sum(counts[joints], 0), unit)

    lead = (
        f"Root mean square of measured − predicted [{unit.name}], baseline → final, and the share of the time."
        f" Reversing: {1e3 * TURNING:.0f} ms around a change of direction."
    )
    return section("Errors by phase of the motion", lead, table(["joint", *names], joint_rows(c.joints, cells)))


def _cells(squares: FloatArray, counts: FloatArray, unit: Unit) -> list[str]:
    total = max(int(counts.sum()), 1)
    cells = []
    for before, after, n in zip(*squares, counts, strict=True):
        if not n:
            cells.append("–")
            continue
        first, last = (figure(float(np.sqrt(s / n)) * unit.factor) for s in (before, after))
        cells.append(f"{first} → <b>{last}</b> <small>{100 * n / total:.0f} %</small>")
    return cells


def other_measures(c: Calibration) -> str:
    """Return a table of held-out errors as root mean square and mean absolute error, for angles in mrad and degrees."""
    traces = c.traces
    units = (("mrad", 1e3), ("°", 180.0 / np.pi)) if c.unit == "rad" else (("mm", 1e3),)
    headings = ["joint, held out"]
    for stage in ("baseline", "final"):
        headings += [f"{stage}<br><small>{m} [{u}]</small>" for m in ("RMS", "MAE") for u, _ in units]

    def cells(columns: slice) -> list[str]:
        found = []
        for residual in (traces.before, traces.after):
            part = residual[:, columns]
            sizes = (np.sqrt(np.nanmean(part**2)), np.nanmean(np.abs(part)))
            found += [figure(float(size) * factor) for size in sizes for _, factor in units]
        return found

    with np.errstate(invalid="ignore"):
        return table(headings, joint_rows(c.joints, cells))
