"""Plots of a calibration: residuals over time, against the state and over frequency; errors stage by stage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mimic.records import FloatArray
from mimic.sysid.result import Calibration, Errors
from mimic.view.report.svg import Plot, figure

SPECTRUM_BINS = 110
"""Of a spectrum, on its logarithmic scale."""

BINS = 24
"""Number of bins in a plot against the state; each has the same number of samples."""


@dataclass(frozen=True)
class Unit:
    """Unit of the errors in a report."""

    name: str
    factor: float
    """Factor from the calibration's unit to this one."""

    def text(self, value: float) -> str:
        """Return a value of the calibration with this unit."""
        return f"{figure(value * self.factor)} {self.name}"


def unit_for(calibration: Calibration) -> Unit:
    """Return the unit in which the errors have one to three digits before the point."""
    errors = [calibration.nominal, calibration.baseline, calibration.final]
    return unit_of_size(max((Errors.total(e.held_out) for e in errors), default=1.0), calibration.unit)


def unit_of_size(largest: float, unit: str) -> Unit:
    """Return the unit, with its prefix, in which a value [unit] has one to three digits before the point."""
    factor, prefix = next((pair for pair in ((1.0, ""), (1e3, "m")) if largest * pair[0] >= 0.3), (1e6, "µ"))
    return Unit(prefix + unit, factor)


def _spread(values: FloatArray) -> float:
    """Return an axis limit that covers all samples except outliers."""
    finite = np.abs(values[np.isfinite(values)])
    return float(max(np.quantile(finite, 0.999) * 1.1, 1e-12)) if finite.size else 1.0


def over_time(calibration: Calibration, unit: Unit) -> list[str]:
    """Return a plot for each joint: residual before and after over time."""
    traces = calibration.traces
    return _over_time(calibration, traces.before * unit.factor, traces.after * unit.factor, unit.name)


def torque_over_time(calibration: Calibration) -> list[str]:
    """Return the same plots for the measured torque; empty if it was not part of the fit."""
    traces = calibration.traces
    if traces.torque_before is None or traces.torque_after is None:
        return []
    unit = "N" if calibration.unit == "m" else "N m"
    return _over_time(calibration, traces.torque_before, traces.torque_after, unit)


def _over_time(calibration: Calibration, before: FloatArray, after: FloatArray, unit: str) -> list[str]:
    traces = calibration.traces
    plots = []
    for j, joint in enumerate(calibration.joints):
        limit = max(_spread(before[:, j]), _spread(after[:, j]))
        rms = " → ".join(f"{figure(float(np.sqrt(np.nanmean(r[:, j] ** 2))))}" for r in (before, after))
        plot = Plot(
            x=(float(traces.t[0]), float(traces.t[-1])),
            y=(-limit, limit),
            title=joint,
            y_label=f"rms {rms} {unit}",
            x_label="time [s]" if j + 1 == len(calibration.joints) else "",
        )
        plot.curve(traces.t, before[:, j], "before")
        plot.curve(traces.t, after[:, j], "after")
        plots.append(plot.svg(f"residual of {joint} over time, before and after"))
    return plots


def against_state(calibration: Calibration, unit: Unit) -> list[str]:
    """Return three plots for each joint: median and middle 80 % of the residual against velocity, torque, position."""
    traces = calibration.traces
    plots = []
    angle = calibration.unit
    force = "N" if angle == "m" else "N m"
    for j, joint in enumerate(calibration.joints):
        limit = max(_spread_of_bins(traces.before[:, j]), _spread_of_bins(traces.after[:, j])) * unit.factor
        for name, state, scale in (
            ("velocity", traces.dq[:, j], f"{angle}/s"),
            ("torque" if force == "N m" else "force", traces.tau[:, j], force),
            ("position", traces.q[:, j], angle),
        ):
            low, high = np.nanquantile(state, [0.002, 0.998])
            plot = Plot(
                x=(float(low), float(high)),
                y=(-limit, limit),
                size=(310, 130),
                title=f"{joint} · {name}",
                y_label=unit.name,
                x_label=f"{name} [{scale}]",
            )
            for kind, residual in (("before", traces.before[:, j]), ("after", traces.after[:, j])):
                x, bands = _binned(state, residual * unit.factor)
                plot.band(x, bands[0], bands[2], kind)
                plot.curve(x, bands[1], f"{kind} thick")
            plots.append(plot.svg(f"residual of {joint} against {name}"))
    return plots


def _spread_of_bins(residual: FloatArray) -> float:
    low, high = np.nanquantile(residual, [0.03, 0.97])
    return float(1.25 * max(abs(low), abs(high), 1e-12))


def _binned(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the middle of each bin (B,), and the 10, 50 and 90 % quantiles of y in it (3, B)."""
    ok = np.isfinite(x) & np.isfinite(y)
    x = x[ok]
    y = y[ok]
    if len(x) < 2 * BINS:
        return np.zeros(0), np.zeros((3, 0))
    order = np.argsort(x, kind="stable")
    parts = np.array_split(order, BINS)
    return np.array([np.median(x[p]) for p in parts]), np.array([np.quantile(y[p], [0.1, 0.5, 0.9]) for p in parts]).T


def spectra(calibration: Calibration, unit: Unit) -> list[str]:
    """Return a plot for each joint: amplitude density of the residual over frequency, and of white noise."""
    from scipy.signal import welch

    traces = calibration.traces
    plots = []
    rate = 1.0 / float(np.median(np.diff(traces.t)))
    for j, joint in enumerate(calibration.joints):
        curves = {}
        for kind, residual in (("before", traces.before[:, j]), ("after", traces.after[:, j])):
            rows = np.nan_to_num(residual[np.isfinite(residual)] * unit.factor)
            hertz, power = welch(rows, fs=rate, nperseg=min(len(rows), int(8 * rate)))
            curves[kind] = _log_binned(hertz[1:], np.sqrt(power[1:]))
        floor = float(calibration.noise[j]) * unit.factor * np.sqrt(2.0 / rate)
        values = np.concatenate([c[1] for c in curves.values()])
        low = min(values.min(), floor) * 0.7
        high = max(values.max(), floor) * 1.4
        plot = Plot(
            x=(curves["before"][0][0], rate / 2),
            y=(max(low, high * 1e-6), high),
            size=(310, 140),
            title=joint,
            y_label=f"{unit.name}/√Hz",
            x_label="frequency [Hz]",
            log=(True, True),
        )
        plot.level(floor, "noise")
        for kind, (x, y) in curves.items():
            plot.curve(x, y, f"{kind} thick")
        plots.append(plot.svg(f"spectrum of the residual of {joint}"))
    return plots


def _log_binned(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return means over bins of equal width on a logarithmic scale; a peak inside a bin keeps its height."""
    edges = np.geomspace(x[0], x[-1] * 1.0001, SPECTRUM_BINS + 1)
    index = np.searchsorted(edges, x, side="right")
    groups = [np.flatnonzero(index == k) for k in np.unique(index)]
    means = np.array([np.sqrt((y[g] ** 2).mean()) for g in groups])
    peaks = np.array([y[g].max() for g in groups])
    return np.array([x[g].mean() for g in groups]), np.where(peaks > 2.0 * means, peaks, means)
