"""Models of delayed commands: lost commands, and a delay with uniform jitter. Delays are in periods of the targets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mimic.records import FloatArray

CERTAIN = 0.25
"""Standard deviation of a lateness, in periods, up to which it says something of its own."""

LEAST_CORRELATION_OF_DRIFT = 0.5
"""Correlation of the lateness of neighbouring targets from which on it is no jitter: something slow."""

LEAST_ACTING = 0.1
"""Share of a period for which a target must act to be seen."""

WIDEST = 5.0
"""Most periods by which targets are taken to be late."""

BLURS = (0.0, 0.05, 0.1, 0.2, 0.3, 0.5)
"""Standard deviations in periods that a linear model may be wrong by about the lateness of a target."""

STRAY = 0.05
"""Share of targets whose lateness may be anything: what several losses in a row do is not the sum of what each does."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Lateness:
    """Of each target, in its periods (K,): estimate of the log alone, and its standard deviation."""

    value: FloatArray
    deviation: FloatArray


def usual_delay(x: Lateness) -> float:
    """Return the lateness that most targets have: the delay that they share."""
    known = x.deviation < CERTAIN
    return float(np.median(x.value[known])) if known.any() else 0.0


def lost(x: Lateness, gaps: FloatArray) -> tuple[float, tuple[float, float], FloatArray]:
    """Return the share of lost targets, its interval, and the delay of each target (K,) [periods].

    One that is sent again until another follows (K,) may be lost each time.
    """
    known = x.deviation < CERTAIN
    usual = usual_delay(x)
    value, variance = x.value - usual, x.deviation**2
    share = 0.02
    gone = np.zeros(len(value))
    for _ in range(20):
        odds = np.log(share / (1 - share)) + (value**2 - (value - 1.0) ** 2) / (2 * variance)
        gone = 1.0 / (1.0 + np.exp(-np.clip(odds, -50, 50)))
        if not known.any():
            break
        share = float(np.clip(gone[known].mean(), 1e-4, 0.9))
    count = int(known.sum())
    lost = int((gone[known] > 0.5).sum())
    if count < 20 or lost < 3:
        return 0.0, (0.0, 0.0), np.zeros(len(value))
    share = lost / count
    z = 1.96
    centre = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z * np.sqrt(share * (1 - share) / count + z * z / (4 * count**2)) / (1 + z * z / count)
    times = np.clip(np.round(value), 1.0, gaps)
    return share, (centre - half, centre + half), np.where(gone > 0.5, times, 0.0) + usual


def jittered(x: Lateness, gaps: FloatArray) -> tuple[float, tuple[float, float], FloatArray]:
    """Return the width of uniform jitter, its interval, and the expected delay of each target (K,) [periods]."""
    known = x.deviation < CERTAIN
    count = int(known.sum())
    if count < 20:
        return 0.0, (0.0, 0.0), np.zeros(len(x.value))
    usual = float(np.mean(x.value[known]))
    value = x.value - usual
    weight = 1.0 / (x.deviation[known] ** 2 + 0.05**2) ** 2
    squared = value[known] ** 2 - x.deviation[known] ** 2
    variance = float(np.sum(weight * squared) / weight.sum())
    if variance <= 0.0:
        return 0.0, (0.0, 0.0), np.zeros(len(value))
    both = known[1:] & known[:-1]
    if both.any() and np.mean(value[1:][both] * value[:-1][both]) > LEAST_CORRELATION_OF_DRIFT * variance:
        return 0.0, (0.0, 0.0), np.zeros(len(value))
    error = np.sqrt(np.sum((weight * (squared - variance)) ** 2)) / weight.sum()
    low, width, high = (width_of(max(variance + s * 1.96 * error, 0.0)) for s in (-1.0, 0.0, 1.0))
    expected = value * variance / (variance + x.deviation**2) + usual
    return width, (low, high), expected


def until_next(lost: FloatArray, gaps: FloatArray) -> FloatArray:
    """Return after how many periods each target acts (K,); 0 where it is not lost.

    Args:
        lost: How often each is lost (K,).
        gaps: How often it is sent before the next one is (K,), which takes its place if it is lost each time.
    """
    wait = np.zeros(len(lost))
    for k in reversed(np.flatnonzero(lost > 0.5)):
        wait[k] = np.round(lost[k])
        if wait[k] >= gaps[k] and k + 1 < len(lost):
            wait[k] += wait[k + 1]
    return wait


def likelihood(x: Lateness, places: FloatArray, value: float, jitter: bool) -> float:
    """Return the logarithm of the probability of the lateness of targets, in periods, under a law.

    Args:
        x: What is known of each target.
        places: Latenesses that the law has: equally likely ones of jitter, or none and a whole period.
        value: Width of jitter, or share of the lost.
        jitter: Which of the two.
    """
    known = x.deviation < CERTAIN
    v, deviation = x.value[known], x.deviation[known]
    if jitter:
        places = np.quantile(places, (np.arange(64) + 0.5) / 64)
        weights, centre = np.full(64, 1 / 64), float(np.mean(v) - np.mean(places))
    else:
        weights, centre = np.array([1.0 - value, value]), float(np.median(v))
    away = v[:, None] - centre - places
    found = []
    for blur in BLURS:
        s = np.hypot(deviation, blur)[:, None]
        density = (weights * np.exp(-0.5 * (away / s) ** 2) / s).sum(1) / np.sqrt(2 * np.pi)
        found.append(float(np.sum(np.log((1.0 - STRAY) * density + STRAY / WIDEST))))
    return max(found)


def in_order(width: float) -> FloatArray:
    """Return latenesses, in periods, of targets that are late by a uniform time and wait for those before them.

    Of those that the next leaves some time to act: the others are not seen.
    """
    drawn = np.random.default_rng(0).uniform(0.0, width, 4000)
    sent = np.arange(4000.0)
    arrival = np.maximum.accumulate(sent + drawn)
    return (arrival - sent)[np.append(np.diff(arrival), np.inf) > LEAST_ACTING]


def spread_of_means(low: float, high: float) -> float:
    """Return half the difference of the mean delays of two widths of jitter."""
    return float(np.mean(in_order(high)) - np.mean(in_order(low))) / 2


def width_of(variance: float) -> float:
    """Return the width of a uniform lateness of which, in order, this variance is left."""
    if variance <= 1.0 / 12.0:
        return float(np.sqrt(12.0 * variance))
    low, high = 1.0, WIDEST
    for _ in range(20):
        middle = (low + high) / 2
        low, high = (middle, high) if in_order(middle).var() < variance else (low, middle)
    return (low + high) / 2


MODELS = {"lost_commands": ("share", lost), "delay_jitter": ("spread", jittered)}
"""Parameter of each effect, and what finds it from the lateness of the targets."""
