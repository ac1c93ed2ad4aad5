"""Delayed commands: which model of delay they follow, and which commands they are. Delays are in periods of the
targets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mimic.records import BoolArray, FloatArray
from mimic.sysid.fit.least_squares import Fit, fit
from mimic.sysid.fit.point import Point
from mimic.sysid.fit.residuals import Problem
from mimic.sysid.selection.evidence import TriedEffect, paired, too_little
from mimic.sysid.selection.jitter import Timing, eased, timings
from mimic.sysid.thresholds import RULES

LATE_Z = 2.0
"""Gain of single late targets over its standard error, for which `mimic.sysid.thresholds.Thresholds.z` is too
much: that the chains agree on them is tested target by target, and a short log has few blocks.
"""

AGREEMENT = (0.75, 1.35)
"""What the chains must share of the lateness that each shows of single targets, when targets are late."""

PASSES = 12
"""Most rounds of finding which targets were late, and fitting all numbers."""

TOLD_APART = 10.0
"""Difference of the logarithms of the probabilities of all latenesses from which on one law of them is not the other.
"""


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


def late_targets(
    problem: Problem,
    incumbent: Fit,
    before: FloatArray,
    names: Sequence[str],
    joints: Mapping[str, BoolArray],
    candidates: Sequence[str],
) -> tuple[TriedEffect, ...]:
    """Return models of delayed commands, best first; the first is fully fitted if the chains agree."""
    found = []
    readings = np.isin(problem.blocks.index, problem.blocks.train).sum()
    for timing in _likelier(timings(problem, incumbent, candidates)):
        gain, z = paired(timing.squares, before)
        unexplained = before.sum() - float(readings * problem.channels)
        share = (before.sum() - timing.squares.sum()) / max(unexplained, 1e-9)
        why = ""
        if not AGREEMENT[0] < timing.agreement < AGREEMENT[1]:
            why = f"the chains agree on {100 * timing.agreement:.0f} % of the delays"
        elif little := too_little(gain, z, LATE_Z):
            why = little
        elif share < RULES.share:
            why = f"it removes {100 * share:.0f} % of the unexplained error, below {100 * RULES.share:.0f} %"
        why = why or _holds_none(timing)
        fitted = replace(incumbent, point=timing.point)
        improvement = float(np.sqrt(max((before.sum(0) - timing.squares.sum(0)).max() / readings, 0.0)))
        if not why and not found:
            _, timing, fitted = fit_delay_per_command(problem, timing, names, joints)
            fell = problem.mean_squares(incumbent.residual, False) - problem.mean_squares(fitted.residual, False)
            improvement = float(np.sqrt(np.maximum(fell, 0.0)).max())
            why = _holds_none(timing)
        found.append(
            TriedEffect(
                name=timing.name,
                fitted=fitted,
                squares=timing.squares,
                gain=gain,
                z=z,
                improvement=improvement,
                joints=np.ones(len(problem.machine.joints), dtype=bool),
                allowed=np.ones(len(problem.machine.joints), dtype=bool),
                why=why,
                timing=timing,
            )
        )
    return tuple(found)


def _holds_none(timing: Timing) -> str:
    """Return why a delay model whose interval includes zero is rejected, or an empty string.

    Where joints are late together for another reason, such as a supply that sags, the mean lateness is one of few
    targets.
    """
    return "" if timing.interval[0] > 0.0 else "the interval of its parameter includes zero"


def _likelier(laws: Sequence[Timing]) -> list[Timing]:
    """Return the delay models, most likely first; ties go to the smaller residual."""
    best = max((t.likelihood for t in laws), default=0.0)
    return sorted(laws, key=lambda t: (t.likelihood < best - TOLD_APART, t.squares.sum()))


def distinguishable(one: TriedEffect, other: TriedEffect) -> bool:
    """Return whether the log separates the first of two delay models from the other."""
    if one.timing is None or other.timing is None:
        return False
    if one.timing.likelihood - other.timing.likelihood > TOLD_APART:
        return True
    return paired(one.squares, other.squares)[1] >= RULES.apart


def fit_delay_per_command(
    problem: Problem, timing: Timing, names: Sequence[str], joints: Mapping[str, BoolArray], most: int = PASSES
) -> tuple[Problem, Timing, Fit]:
    """Fit the delay of each command and all parameters in turn; return the problem with the delays, too."""
    found = []
    for _ in range(most):
        problem = problem.changed(replay=problem.replay.with_late(timing.late))
        fitted = fit(problem, timing.point, names, joints, most=1)
        left = float(problem.mean_squares(fitted.residual, False).sum())
        if found and left > 0.99 * found[-1][2]:
            break
        found.append((timing, fitted, left))
        again = timings(problem, fitted, [timing.name])
        if not again:
            break
        late = again[0].late
        if timing.name == "delay_jitter":  # a target is lost or not
            had = timing.late + _delay(fitted.point) - _delay(again[0].point)
            late = eased(problem, again[0].point, had, late)
        timing = replace(again[0], late=late, squares=timing.squares, agreement=timing.agreement)
    timing, fitted, _ = found[-1]
    return problem.changed(replay=problem.replay.with_late(timing.late)), timing, fitted


def _delay(point: Point) -> float:
    return float(point.values.get(("delay", "time"), np.zeros(1))[0])


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
