"""Smoothing without lag, at the true times of the frames."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.signal import butter, sosfiltfilt

from mimic.types import FloatArray, IntArray

MAX_BRIDGE = 0.25
"""Longer gaps between seen frames end a segment [s]."""
STEADY = 1.2
"""Steps that differ by less than this factor are even frames with rounded stamps (33 and 34 ms, 80 and 90 ms)."""


def segments(t: FloatArray, rows: IntArray, shots: IntArray) -> list[IntArray]:
    """Return the seen rows in runs that neither a shot change nor a gap beyond MAX_BRIDGE interrupts."""
    if len(rows) == 0:
        return []
    shot = np.searchsorted(shots, rows, "right")
    ends = np.flatnonzero((np.diff(t[rows]) > MAX_BRIDGE) | (np.diff(shot) > 0)) + 1
    return np.split(rows, ends)


def smooth(t: FloatArray, values: FloatArray, shots: IntArray, cutoff_hz: float) -> FloatArray:
    """Return values without what is faster than the cut-off, without lag; rows that are NaN stay NaN.

    A Butterworth low-pass of 2nd order runs forward and backward over each segment, on an even grid as fine as the
    frames are where they are densest; uneven frames go onto it and back by pchip. A segment that is too short or too
    slow for the cut-off is left as it is.

    Args:
        t: Times (T,), strictly increasing [s].
        values: Any quantity (T, ...); a row is NaN as a whole where nothing was seen.
        shots: Rows at which a new shot begins.
        cutoff_hz: -6 dB frequency of the two passes together [Hz].
    """
    result = np.array(values, dtype=np.float64)
    flat = result.reshape(len(t), -1)
    for rows in segments(t, np.flatnonzero(np.isfinite(flat).all(axis=1)), shots):
        if len(rows) < 5:
            continue
        times = t[rows]
        steps = np.diff(times)
        even = steps.max() < STEADY * steps.min()
        step = float(steps.mean() if even else np.quantile(steps, 0.1))
        if cutoff_hz >= 0.9 * 0.5 / step:
            continue
        grid = np.linspace(times[0], times[-1], round((times[-1] - times[0]) / step) + 1)
        on_grid = flat[rows] if even else PchipInterpolator(times, flat[rows], axis=0)(grid)
        sos = butter(2, cutoff_hz * 2 * (grid[1] - grid[0]), output="sos")
        smoothed = sosfiltfilt(sos, on_grid, axis=0, padlen=min(9, len(grid) - 1))
        flat[rows] = smoothed if even else PchipInterpolator(grid, smoothed, axis=0)(times)
    return result
