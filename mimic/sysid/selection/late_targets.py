"""Delayed commands: which model of delay they follow, and which commands they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mimic.records import BoolArray, FloatArray
from mimic.sysid.jitter import Timing, eased, timings
from mimic.sysid.least_squares import Fit, fit
from mimic.sysid.residuals import Point, Problem
from mimic.sysid.selection.evidence import TriedEffect, paired, too_little
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
        gain, z = paired(problem, timing.squares, before)
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


def distinguishable(problem: Problem, one: TriedEffect, other: TriedEffect) -> bool:
    """Return whether the log separates the first of two delay models from the other."""
    if one.timing is None or other.timing is None:
        return False
    if one.timing.likelihood - other.timing.likelihood > TOLD_APART:
        return True
    return paired(problem, one.squares, other.squares)[1] >= RULES.apart


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
