"""Evidence for an effect: paired comparisons on blocks that each fit has not seen; and for delayed commands, which
model of delay they follow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.servo import neutral
from mimic.records import BoolArray, FloatArray
from mimic.sysid.jitter import Timing, eased, timings
from mimic.sysid.least_squares import Fit, Judged, deviations, fit, left_out, prior
from mimic.sysid.residuals import FreeParameter, Point, Problem
from mimic.sysid.result import RULES, Candidate

INDEPENDENT = 10.0
"""Readings a second that count in a likelihood: a drive forgets in about a tenth of a second [Hz]."""

MATERIAL = 0.0125
"""Change of half the log of a block's sum of squares and its noise that counts: a twentieth of the noise."""


LEAST_PERIODS = 1.5
"""Fewest periods of cogging in the range of motion; a longer wave is a spring, or whatever else depends on position."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TriedEffect:
    """An effect that was refitted, with its evidence."""

    name: str
    fitted: Fit
    squares: FloatArray
    """Each fitted block judged without itself (B,)."""
    gain: float
    z: float
    improvement: float
    """Of the joint that gains most, in noise floors."""
    joints: BoolArray
    """Joints where the effect is there (J,)."""
    why: str
    """Why it is not accepted; empty where it is."""
    allowed: BoolArray
    """Joints where it was fitted (J,)."""
    timing: Timing | None = None
    """Which targets were late, where that is the effect."""

    def likelihood(self, problem: Problem) -> float:
        """Return the logarithm of the probability of the log, see `likelihood`."""
        return likelihood(problem, self.squares, len(self.fitted.free_parameters))

    def candidate(self, problem: Problem, best: TriedEffect | None) -> Candidate:
        """Return the record of it."""
        machine, spec = problem.machine, CATALOGUE[self.name]
        names = tuple(np.array(machine.joints)[self.joints]) if spec.scope == "joint" else ()
        values = {p.name: self.fitted.point.values[self.name, p.name] for p in spec.parameters}
        log_odds = 0.0 if best is None else self.likelihood(problem) - best.likelihood(problem)
        return Candidate(
            name=self.name,
            gain=self.gain,
            z=self.z,
            improvement=self.improvement,
            values=values,
            joints=names,
            accepted=best is self,
            why="" if best is self else self.why or "another effect explains more",
            odds=float(np.exp(np.clip(log_odds, -700.0, 700.0))) if best is not None else 0.0,
            alternative_z=0.0 if best is None or best is self else _apart(problem, best, self)[1],
        )


def paired(
    problem: Problem, better: FloatArray, worse: FloatArray, channels: BoolArray | None = None
) -> tuple[float, float]:
    """Return the gain of one fit over another and its significance, from left-out blocks (B, C).

    The gain is half the log of the ratio of the sums. How sure is the larger of two: its mean over the blocks over its
    standard error, and the normal score of Wilcoxon's signed-rank test over those blocks of single channels where the
    two differ by more than a twentieth of the noise: an effect that acts in few blocks is seen by the second.

    Of each block what noise leaves is counted in both. Else a joint that rests, of which both leave a small part of
    the noise, says as much by their ratio as one that moves and is off by many times the noise.
    """
    use = np.ones(better.shape[1], dtype=bool) if channels is None else channels
    good, bad = better[:, use], worse[:, use]
    gain = 0.5 * np.log(max(bad.sum(), 1e-12) / max(good.sum(), 1e-12))
    noise = np.maximum(problem.readings, 1)[:, None]
    each = 0.5 * np.log((bad + noise) / (good + noise)).reshape(-1)
    whole = noise[:, 0] * int(use.sum())
    d = 0.5 * np.log((bad.sum(1) + whole) / (good.sum(1) + whole))
    error = d.std(ddof=1) / np.sqrt(len(d)) if len(d) > 1 else np.inf
    by_mean = float(d.mean() / max(error, 1e-9))
    return float(gain), max(by_mean, _rank_score(each[np.abs(each) > MATERIAL]))


def _rank_score(d: FloatArray) -> float:
    """Return the normal score of the signed-rank test that d is positive; 0 with fewer than 6 values."""
    n = len(d)
    if n < 6:
        return 0.0
    ranks = np.argsort(np.argsort(np.abs(d))) + 1.0
    return float((ranks[d > 0].sum() - n * (n + 1) / 4) / np.sqrt(n * (n + 1) * (2 * n + 1) / 24))


def evaluate(
    problem: Problem,
    incumbent: Fit,
    before: FloatArray,
    name: str,
    fitted: Fit,
    joints: BoolArray,
    judged: Judged | None = None,
) -> TriedEffect:
    """Compare a fit with one more effect to the fit without it, on the joints where it acts.

    Args:
        problem: Log and model.
        incumbent: The fit that lacks it.
        before: Its blocks, each judged without itself (B_train, C).
        name: The effect.
        fitted: The fit that has it.
        joints: Joints that may have it (J,).
        judged: Blocks of that fit, each without itself, where they are known.
    """
    after, moves = judged or left_out(fitted, problem)
    fell = problem.mean_squares(incumbent.residual, False) - problem.mean_squares(fitted.residual, False)
    improvement = float(np.sqrt(np.maximum(fell, 0.0)).max())
    there = present(problem, fitted, name, joints, deviations(fitted, problem, moves)) & _better(problem, before, after)
    if name == "cogging":
        least = [least_order(q) for q in problem.replay.log.q.T]
        there &= fitted.point.values["cogging", "order"] >= least
    if name == "periodic_force":
        there &= ~on_harmonic(problem, fitted.point.values["periodic_force", "frequency"])
    channels = there[problem.channel_joint]
    gain, z = paired(problem, after, before, channels if there.any() else None)
    why = ""
    if not there.any():
        why = f"no joint has a parameter {RULES.z:.0f} standard deviations from neutral"
    elif little := too_little(gain, z, RULES.z):
        why = little
    elif improvement < RULES.improvement:
        why = f"it removes {improvement:.2f} noise floors, below {RULES.improvement}"
    elif (share := share_taken(problem, incumbent, fitted, channels)) < RULES.share:
        why = f"it removes {100 * share:.0f} % of the unexplained error on its joints, below {100 * RULES.share:.0f} %"
    else:
        why = _pushed(problem, incumbent, fitted, there)
    overall, _ = paired(problem, after, before)
    return TriedEffect(
        name=name,
        fitted=fitted,
        squares=after,
        gain=overall,
        z=z,
        improvement=improvement,
        joints=there,
        why=why,
        allowed=joints,
    )


def too_little(gain: float, z: float, least: float) -> str:
    """Return why a gain is too small or not significant, or an empty string."""
    if gain < RULES.gain:
        return f"gain {100 * gain:.1f} % is below {100 * RULES.gain:.0f} %"
    return f"gain is {z:.1f} standard errors, below {least:.0f}" if z < least else ""


def present(problem: Problem, fitted: Fit, name: str, joints: BoolArray, deviation: FloatArray) -> BoolArray:
    """Return the joints (J,) where an effect's main parameter is significantly different from neutral."""
    spec = CATALOGUE[name]
    there = np.zeros(problem.joints, dtype=bool)
    sized = [p for p in spec.parameters if not p.fixed and not p.shape]
    if not sized:  # read off the log, not fitted
        values = [fitted.point.values[name, p.name] != neutral(name, p.name, problem.machine) for p in spec.parameters]
        return np.any(values, axis=0) & joints
    for i, free in enumerate(fitted.free_parameters):
        if free.key[0] != name or free.key[1] not in [p.name for p in sized]:
            continue
        none = float(neutral(*free.key, problem.machine)[max(free.joint, 0)])
        if abs(fitted.point.at(free) - none) > RULES.z * deviation[i]:
            there[slice(None) if free.joint < 0 else free.joint] = True
    if spec.scope != "joint":
        return there
    missed, chain = _missed(fitted, problem, name), problem.machine.chain
    strongest = np.array([missed[chain == c].max() for c in chain])
    return there & joints & (missed > RULES.negligible * np.maximum(1.0, strongest))


def _missed(fitted: Fit, problem: Problem, name: str) -> FloatArray:
    """Return what each joint's effect removes from its chain (J,) [noise floors], in a linear model.

    The other numbers make up for it as they can.
    """
    train = problem.blocks.train
    hessian = fitted.sums.over(train)[0] + np.diag(prior(fitted.free_parameters))
    scale = 1.0 / np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    inverse = np.linalg.pinv(hessian * scale[:, None] * scale, 1e-12) * scale[:, None] * scale
    readings = max(int(np.isin(problem.blocks.index, train).sum()), 1)
    rows = np.zeros(problem.joints)
    sized = [p.name for p in CATALOGUE[name].parameters if not p.fixed and not p.shape]
    for joint in range(len(rows)):
        own = [
            i
            for i, k in enumerate(fitted.free_parameters)
            if k.key[0] == name and k.joint == joint and k.key[1] in sized
        ]
        if own:
            keys = [fitted.free_parameters[i].key for i in own]
            away = np.array([fitted.point.values[k][joint] - neutral(*k, problem.machine)[joint] for k in keys])
            more = float(away @ np.linalg.lstsq(inverse[np.ix_(own, own)], away, rcond=None)[0])
            rows[joint] = np.sqrt(max(more, 0.0) / readings)
    return rows


def share_taken(problem: Problem, incumbent: Fit, fitted: Fit, channels: BoolArray) -> float:
    """Return the share of the unexplained error on these channels (C,) that a fit removes."""
    before, after = (problem.mean_squares(f.residual, False)[channels].sum() for f in (incumbent, fitted))
    return float((before - after) / max(before - channels.sum(), 1e-9))


def _better(problem: Problem, before: FloatArray, after: FloatArray) -> BoolArray:
    """Return the joints (J,) whose left-out blocks improve."""
    joints = problem.joints
    gain = np.log(np.maximum(before.sum(0), 1e-12) / np.maximum(after.sum(0), 1e-12))
    better = np.zeros(joints, dtype=bool)
    np.logical_or.at(better, problem.channel_joint, gain > 2 * RULES.gain)
    return better


def _pushed(problem: Problem, incumbent: Fit, fitted: Fit, there: BoolArray) -> str:
    """Return why baseline parameters of the affected joints forbid an effect, or an empty string.

    A number that the log hardly determines stays near its prior and says nothing, and one that was at its bound without
    the effect was not pushed there.
    """
    for free, bound in stopped(fitted, problem, RULES.beyond):
        if not CATALOGUE[free.key[0]].baseline or (free.joint >= 0 and not there[free.joint]):
            continue
        if abs(incumbent.point.at(free) - bound) > 1e-9:
            return f"it pushes {free.called(problem.machine.joints)} onto its bound {bound:g}"
    return ""


def stopped(fitted: Fit, problem: Problem, least: float = 0.0) -> list[tuple[FreeParameter, float]]:
    """Return the parameters at a bound that the log would push across it by so many steps.

    An effect's bound at which it is none is not one of them: there it ends. The other says how much of it a machine can
    have.
    """
    hessian, gradient = fitted.sums.over(problem.blocks.train)
    found = []
    for i, free in enumerate(fitted.free_parameters):
        value, none = fitted.point.at(free), neutral(*free.key, problem.machine)[max(free.joint, 0)]
        beyond = gradient[i] / (hessian[i, i] + 1.0 / free.spread**2) / free.step
        for bound, sign in zip(free.bounds, (-1.0, 1.0), strict=True):
            counts = CATALOGUE[free.key[0]].baseline or abs(none - bound) > 1e-9
            if counts and abs(value - bound) < 1e-9 and sign * beyond > least:
                found.append((free, bound))
    return found


def likelihood(problem: Problem, squares: FloatArray, numbers: int) -> float:
    """Return the logarithm of the probability of blocks that were left out, less the price of numbers.

    Residuals are normal, of a size that each channel has for itself; readings count as far as they are independent, a
    tenth of a second each. A number costs half the logarithm of that count (Schwarz 1978).

    Args:
        problem: Log and model.
        squares: Of each fitted block, judged without itself (B_train, C).
        numbers: How many were fitted.
    """
    readings = max(int(problem.blocks.fitted.sum()), 1)
    count = max(readings * min(INDEPENDENT / problem.replay.log.rate, 1.0), 1.0)
    size = np.maximum(squares.sum(0) / readings, 1e-12)
    return float(-0.5 * count * np.log(size).sum() - 0.5 * numbers * np.log(count * len(size)))


def hard_to_tell_apart(problem: Problem, best: TriedEffect, other: TriedEffect) -> bool:
    """Return whether the log leaves it open which of two effects it is."""
    gain, z = _apart(problem, best, other)
    return z < RULES.apart or gain < RULES.gain


def _apart(problem: Problem, best: TriedEffect, other: TriedEffect) -> tuple[float, float]:
    """Return gain and z of one effect over another, where either acts."""
    return paired(problem, best.squares, other.squares, (best.joints | other.joints)[problem.channel_joint])


def pays(problem: Problem, better: FloatArray, worse: FloatArray, z: float = RULES.z) -> bool:
    """Return whether left-out blocks (B, C) of one fit are surely better than those of another."""
    gain, sure = paired(problem, better, worse)
    return gain >= RULES.gain and sure >= z


def cross_validated(problem: Problem, fitted: Fit) -> FloatArray:
    """Return the mean square of each channel (C,) over the fitted blocks, each judged without itself."""
    readings = max(int(problem.blocks.fitted.sum()), 1)
    return left_out(fitted, problem)[0].sum(0) / readings


def earns_its_keep(problem: Problem, whole: Fit, without: Fit) -> bool:
    """Return whether an effect pays: a fit with it against one without."""
    return pays(problem, left_out(whole, problem)[0], left_out(without, problem)[0])


def least_order(q: FloatArray) -> float:
    """Return the least order at which a force over positions (T,) repeats often enough to be cogging."""
    return 2 * np.pi * LEAST_PERIODS / max(float(np.ptp(q)), 1e-9)


def on_harmonic(problem: Problem, frequency: FloatArray) -> BoolArray:
    """Return where a frequency [Hz] is a multiple of that with which the whole motion repeats, if it does.

    What depends on the state repeats with the motion, so that nothing external can be told from it there.
    """
    every = problem.period
    if every is None:
        return np.zeros(np.shape(frequency), dtype=bool)
    turns = np.asarray(frequency) * every
    return np.abs(turns - np.round(turns)) < 0.6 * every / problem.replay.log.duration


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
    readings = problem.blocks.fitted.sum()
    for timing in _likelier(timings(problem, incumbent, candidates)):
        gain, z = paired(problem, timing.squares, before)
        unexplained = before.sum() - float(readings * problem.channels)
        share = (before.sum() - timing.squares.sum()) / max(unexplained, 1e-9)
        why = ""
        if not AGREEMENT[0] < timing.agreement < AGREEMENT[1]:
            why = f"the chains agree on {100 * timing.agreement:.0f} % of the delays"
        elif little := too_little(gain, z, RULES.apart):
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
                joints=np.ones(problem.joints, dtype=bool),
                allowed=np.ones(problem.joints, dtype=bool),
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
