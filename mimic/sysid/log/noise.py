"""What a log's curves say by themselves: noise floor, encoder steps, lag behind the target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import correlate
from scipy.stats import norm, truncnorm, uniform

from mimic.records import BoolArray, FloatArray

SURE = 3.0
"""Standard deviations that noise hardly reaches."""

MOST = 0.5
"""Share that is most of something: of what a target explains, and of readings: if their mean unit vector is as long,
wound round a circle of the length of a step, they are multiples of it."""

FINEST_STEP = 2.5
"""Least step of a coarse encoder that is looked for, in noise floors.

Rounding is a 3.5th of a step and in the floor too: where readings agree by a half, a step is 2.9 floors.
"""

LEAST_LEVELS = 6
"""Fewest steps in the range of motion: few places of a slow joint agree by themselves."""

SMOOTH = 0.03
"""Time over which signals are averaged where their noise would hide what they do [s]."""

FOLLOWS = 0.9
"""Correlation of a joint with a target that it certainly follows, and share of the best of what is as good."""

MEMORY = 0.1
"""Time in which a drive answers its target, and forgets where it was [s]."""

LOW = 0.1
"""Share that is little of a log: of its blocks, those its noise is taken from; of its time, that of single events."""


def rounding(x: FloatArray) -> FloatArray:
    """Return what single precision rounds off signals (T, J): less is no difference."""
    return np.finfo(np.float32).eps * np.abs(x).max(axis=0)


def resolution(x: FloatArray) -> float:
    """Return the smallest difference of values (T,): the step of a quantised signal, next to nothing of others."""
    steps = np.diff(np.unique(x))
    steps = steps[steps > rounding(x)]
    return float(steps.min()) if len(steps) else 0.0


def noise_floor(x: FloatArray, rate: float, known: BoolArray | None = None) -> FloatArray:
    """Return the standard deviation of white noise on each signal (T, J), motion left out.

    Third differences leave little of a smooth motion; blocks in which the machine moves fast are avoided by taking a
    low quantile of the blocks, whose bias is removed. No less than the resolution allows.

    Args:
        x: Signals, evenly sampled.
        rate: Readings per second [Hz].
        known: Rows that were read (T,), all by default; what is filled in between has no resolution.
    """
    rows = max(int(rate / 2), 32)
    kernel = np.array([1.0, -3.0, 3.0, -1.0])
    power = kernel @ kernel
    alike = np.correlate(kernel, kernel, "full") / power  # autocorrelation of the differences of white noise
    third = np.diff(x, 3, axis=0)
    blocks = [third[i : i + rows] for i in range(0, len(third) - rows + 1, rows)] or [third]
    variances = np.array([_variance(b) for b in blocks])
    live = np.where(variances > 0, variances, np.nan)  # a frozen reading tells nothing
    low = np.nan_to_num([np.nanquantile(c, LOW) if np.isfinite(c).any() else 0.0 for c in live.T])
    shrunk = 1.0 + norm.ppf(LOW) * np.sqrt(2.0 * (alike @ alike) / rows)
    white = np.sqrt(low / power / shrunk)
    return np.maximum(white, [resolution(c) * uniform.std() for c in (x if known is None else x[known]).T])


def _variance(x: FloatArray) -> FloatArray:
    """Return the variance of each column of white noise whose largest twentieth, steps and spikes, is left out."""
    size = np.sort(np.abs(x - np.median(x, axis=0)), axis=0)
    kept = 0.95
    return (size[: max(int(kept * len(size)), 1)] ** 2).mean(axis=0) / truncnorm.var(*norm.interval(kept))


@dataclass(frozen=True, kw_only=True, eq=False)
class Following:
    """How each position follows each target."""

    correlation: FloatArray
    """Of position i with target j (J, J), each at its best lag; negative where it is so by far more."""
    lag: FloatArray
    """Of each position behind its own target (J,) [s]; NaN where one of them rests, or it is out of the range."""
    moves: BoolArray
    """Whether the target moves (J,)."""


def following(t: FloatArray, q: FloatArray, target: FloatArray, lags: tuple[float, float] = (-0.1, 0.4)) -> Following:
    """Return how positions follow targets (T, J), from their correlation over a range of lags [s].

    Slow offsets are removed first, so that gravity and calibration of the encoder do not count.
    """
    dt = float(np.median(np.diff(t)))
    clock = np.arange(t[0], t[-1], dt)
    held = np.clip(np.searchsorted(t, clock, side="right") - 1, 0, len(t) - 1)
    x = _centred(np.stack([np.interp(clock, t, c) for c in q.T], -1), dt)
    y = _centred(target[held], dt)
    spread_x = x.std(axis=0)
    spread_y = y.std(axis=0)
    moves = np.ptp(target, axis=0) > rounding(target)
    shifts = np.arange(round(lags[0] / dt), round(lags[1] / dt) + 1)
    correlation = np.zeros((q.shape[1], q.shape[1]))
    lag = np.full(q.shape[1], np.nan)
    for i, j in np.argwhere((spread_x > 0)[:, None] & moves[None, :]):
        curve = correlate(x[:, i], y[:, j], method="fft")[shifts + len(clock) - 1]
        curve = curve / (len(clock) * spread_x[i] * spread_y[j]) / (1.0 - np.abs(shifts) / len(clock))
        up = int(curve.argmax())
        down = int(curve.argmin())
        k = down if -curve[down] * FOLLOWS > curve[up] else up  # a sine is its own opposite half a period later
        shift = int(shifts[k])
        late = x[max(shift, 0) :, i]
        early = y[max(-shift, 0) :, j]
        rows = min(len(late), len(early))
        correlation[i, j] = np.corrcoef(late[:rows], early[:rows])[0, 1]
        if i == j and 0 < k < len(shifts) - 1:
            lag[i] = (shift + _vertex(np.abs(curve), k)) * dt
    return Following(correlation=np.nan_to_num(correlation), lag=lag, moves=moves)


def _centred(x: FloatArray, dt: float) -> FloatArray:
    """Return signals less their slow part (moving mean of 4 s)."""
    return x - uniform_filter1d(x, int(4.0 / dt), axis=0, mode="nearest")


def _vertex(curve: FloatArray, k: int) -> float:
    """Return where the parabola through a peak and its neighbours is highest, from ``k``."""
    a, b, c = curve[k - 1 : k + 2]
    bend = a - 2 * b + c
    return 0.0 if bend >= 0 else 0.5 * (a - c) / bend


def smooth(t: FloatArray, x: FloatArray) -> FloatArray:
    """Return the moving mean of signals (T, ...) over ``SMOOTH``."""
    rows = int(SMOOTH / 2 / float(np.median(np.diff(t))))
    return uniform_filter1d(x, 2 * rows + 1, axis=0, mode="nearest")


def speed(t: FloatArray, q: FloatArray) -> FloatArray:
    """Return the speed of each joint (T, J), smoothed."""
    return smooth(t, np.gradient(q, t, axis=0))


def coarse_steps(q: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the encoder steps (J,), 0 where none is found, and noise floors that include the rounding (J,) [rad].

    Args:
        q: Readings (T, J) [rad].
        noise: Noise floors (J,) [rad]; they have a part of the rounding, as far as joints move in the time that they
            are taken from.
    """
    found = [_step_of(column, float(floor)) for column, floor in zip(q.T, noise, strict=True)]
    step, agreement = (np.array(row) for row in zip(*found, strict=True))
    beside = step / (2.0 * np.pi) * np.sqrt(-2.0 * np.log(np.clip(agreement, MOST, 1.0)))  # of a wrapped normal
    return step, np.maximum(noise, np.hypot(step * uniform.std(), beside))


def _step_of(q: FloatArray, noise: float) -> tuple[float, float]:
    """Return the step of a coarse encoder with readings q (T,), 0 if none, and how well they agree with it.

    Readings that are multiples of a step agree in phase when they are wound round a circle of that length.
    """
    there = np.zeros(len(q), dtype=bool)
    there[1:-1] = np.abs(q[2:] - q[:-2]) > SURE * np.sqrt(2) * noise  # readings of one that rests agree
    q = q - q.mean()
    moving = q[there]
    if not there.any() or np.ptp(moving) <= LEAST_LEVELS * FINEST_STEP * noise:
        return 0.0, 1.0
    least = LEAST_LEVELS / np.ptp(moving)
    most = 1.0 / (FINEST_STEP * noise)
    spacing = 1.0 / (6.0 * np.ptp(q))
    width = noise / 2  # of a bin: readings in it agree in phase by more than 0.9
    bins = 1.0 / (spacing * width)
    if bins * np.finfo(np.float32).eps > 1:  # it turns a hundred times, and single precision does not hold it
        return 0.0, 1.0
    counts = np.bincount(((q - q.min()) / width).astype(int))
    size = int(2 ** np.ceil(np.log2(max(bins, len(counts)))))
    around = np.fft.rfftfreq(size, width)
    agreement = np.abs(np.fft.rfft(counts, size)) / len(q)
    agreement[(around < least) | (around > most)] = 0.0
    best = around[int(np.argmax(agreement))]
    near = best + np.linspace(-1, 1, 41) * spacing
    agree = [_agreement(q, f) for f in near]
    found = float(near[int(np.argmax(agree))])
    sure = min(max(agree), _agreement(moving, found)) >= MOST
    return (1.0 / found, max(agree)) if sure else (0.0, 1.0)


def _agreement(q: FloatArray, around: float) -> float:
    return float(abs(np.mean(np.exp(2j * np.pi * around * q))))
