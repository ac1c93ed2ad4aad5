"""Zero-lag smoothing at the true times of the frames."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.signal import butter, sosfiltfilt

from mimic.records import FloatArray, IntArray

MAX_GAP = 0.25
"""A longer gap between frames with a person ends a segment [s]."""
UNIFORM_RATIO = 1.2
"""Frame intervals within this factor count as uniform with rounded stamps (33 and 34 ms, 80 and 90 ms)."""


def segments(t: FloatArray, rows: IntArray, shots: IntArray) -> list[IntArray]:
    """Return the rows with a person in runs without a cut and without a gap beyond MAX_GAP."""
    if len(rows) == 0:
        return []
    shot = np.searchsorted(shots, rows, "right")
    ends = np.flatnonzero((np.diff(t[rows]) > MAX_GAP) | (np.diff(shot) > 0)) + 1
    return np.split(rows, ends)


def smooth(t: FloatArray, values: FloatArray, shots: IntArray, cutoff_hz: float) -> FloatArray:
    """Return values low-passed at the cut-off, without lag; NaN rows stay NaN.

    A Butterworth low-pass of 2nd order runs forward and backward over each segment, on a uniform grid as fine as
    the densest frames. Non-uniform frames are resampled to this grid and back by PCHIP. A segment stays as it is if
    it is too short, or if its frame rate is too low for the cut-off.

    Args:
        t: Times (T,), strictly increasing [s].
        values: Any quantity (T, ...); the whole row is NaN if no person was detected.
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
        uniform = steps.max() < UNIFORM_RATIO * steps.min()
        step = float(steps.mean() if uniform else np.quantile(steps, 0.1))
        if cutoff_hz >= 0.9 * 0.5 / step:
            continue
        grid = np.linspace(times[0], times[-1], round((times[-1] - times[0]) / step) + 1)
        on_grid = flat[rows] if uniform else PchipInterpolator(times, flat[rows], axis=0)(grid)
        sos = butter(2, cutoff_hz * 2 * (grid[1] - grid[0]), output="sos")
        smoothed = sosfiltfilt(sos, on_grid, axis=0, padlen=min(9, len(grid) - 1))
        flat[rows] = smoothed if uniform else PchipInterpolator(grid, smoothed, axis=0)(times)
    return result


def interpolated(times: FloatArray, t: FloatArray, values: FloatArray) -> FloatArray:
    """Return values (T, ...) at other times, linear between rows, constant beyond them."""
    flat = values.reshape(len(t), -1)
    return np.stack([np.interp(times, t, column) for column in flat.T], axis=1).reshape(len(times), *values.shape[1:])
