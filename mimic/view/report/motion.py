"""The motion in a report: measured, predicted and target over each joint's worst second."""

from __future__ import annotations

import numpy as np

from mimic.sysid.result import Calibration, Traces
from mimic.view.report.sections import key, section
from mimic.view.report.svg import Plot, figure

WINDOW = 1.0
"""Length of the part that is drawn [s]."""


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
