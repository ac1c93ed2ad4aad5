"""Residual -> which effect is missing, with held-out evidence, or "unexplained"."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mimic.calibrate.arrival import eased
from mimic.calibrate.events import Timing, timings
from mimic.calibrate.fit import Fit, deviations, fit, fit_all, fitting, left_out, prior
from mimic.calibrate.moving_base import BaseMotion, moving_base
from mimic.calibrate.problem import Key, Knob, Point, Problem
from mimic.calibrate.screen import Motion, Start, least_order, on_harmonic, screen
from mimic.calibration import Candidate
from mimic.robot.effects import CATALOGUE
from mimic.robot.servo import neutral
from mimic.types import BoolArray, FloatArray

LEAST_GAIN = 0.01
"""Share by which the error of a block judged without itself must fall."""

LEAST_Z = 3.0
"""Gain over its standard error; about Holm's correction over 25 candidates at 5 %."""

LATE_Z = 2.0
"""The same for single late targets: that the chains agree on them is tested target by target, and a short log has few blocks."""

LEAST_IMPROVEMENT = 0.35
"""What leaves the error of some joint, over its noise floor. Smaller crumbs are differences between integrators."""

LEAST_SHARE = 0.15
"""Share that it takes of what noise does not explain, on the joints where it acts; less is the nearest wrong name."""

MOSTLY = 0.5
"""The same for an effect that others have on joints where it was not found; less may be something else."""

MOST_AFRESH = 8
"""Most steps of a fit that begins with declared numbers as the model has them."""

SHARED: dict[Key, Key] = {("joint_delay", "time"): ("delay", "time")}
"""Numbers of joints that are a declared number of the machine where they are alike in all."""

ALIKE = 0.25
"""Quantile of such numbers over the joints that goes into the one that all share, and the share of the largest that then counts."""

LEAST_PARAMETER = 3.0
"""How far an effect's number is from none, in standard deviations."""

LEAST_MISSED = 0.1
"""What an effect at a joint must take of the error of its chain, in noise floors; less is a crumb."""

LEAST_BESIDE = 0.1
"""The same as a share of what it takes at the joint of the chain where it takes most."""

RIVAL_Z = 2.0
"""A rival closer than this to the best, in standard errors of the paired difference, cannot be told from it."""

TOLD_APART = 10.0
"""Difference of the logarithms of the probabilities of all latenesses from which on one law of them is not the other."""

FAR_BEYOND = 2.0
"""Steps by which a number would cross its bound, from which on an effect that pushes it there, or stands in its chain, is not named."""

FAR = 4.0
"""Mean square of what is left, in noise floors, from which on the declared numbers may be bent out of shape."""

FAR_Z = 6.0
"""Effects this far behind the best, in standard errors, are not fitted to the end."""

AGREEMENT = (0.75, 1.35)
"""What the chains must share of the lateness that each shows of single targets, when targets are late."""

PASSES = 12
"""Most rounds of finding which targets were late, and fitting all numbers."""

STRONG = 4
"""Effects that are fitted to the end and compared."""

REFINED = 6
"""Effects that are refitted at each stage by rank, besides all with a threshold."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Tried:
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

    def candidate(self, problem: Problem, best: Tried | None) -> Candidate:
        """Return the record of it."""
        machine, spec = problem.machine, CATALOGUE[self.name]
        names = tuple(np.array(machine.joints)[self.joints]) if spec.scope == "joint" else ()
        values = {p.name: self.fitted.point.values[self.name, p.name] for p in spec.parameters}
        return Candidate(
            name=self.name,
            gain=self.gain,
            z=self.z,
            improvement=self.improvement,
            values=values,
            joints=names,
            accepted=best is self,
            why="" if best is self else self.why or "another effect explains more",
            rival_z=0.0 if best is None or best is self else _apart(problem, best, self)[1],
        )


def paired(better: FloatArray, worse: FloatArray, channels: BoolArray | None = None) -> tuple[float, float]:
    """Return the gain of one fit over another and how sure it is, from blocks judged without themselves (B, C).

    The gain is half the log of the ratio of the sums. How sure is the larger of two: its mean over the blocks over its
    standard error, and the normal score of Wilcoxon's signed-rank test over those blocks of single channels where the
    two differ by more than a twentieth of the noise: an effect that acts in few blocks is seen by the second.
    """
    use = np.ones(better.shape[1], dtype=bool) if channels is None else channels
    good, bad = better[:, use], worse[:, use]
    gain = 0.5 * np.log(max(bad.sum(), 1e-12) / max(good.sum(), 1e-12))
    d = 0.5 * np.log(np.maximum(bad.sum(1), 1e-12) / np.maximum(good.sum(1), 1e-12))
    error = d.std(ddof=1) / np.sqrt(len(d)) if len(d) > 1 else np.inf
    by_mean = float(d.mean() / max(error, 1e-9))
    each = 0.5 * np.log(np.maximum(bad, 1e-12) / np.maximum(good, 1e-12)).reshape(-1)
    return float(gain), max(by_mean, _rank_score(each[np.abs(each) > MATERIAL]))


def _rank_score(d: FloatArray) -> float:
    """Return the normal score of the signed-rank test that d is positive; 0 with fewer than 6 values."""
    n = len(d)
    if n < 6:
        return 0.0
    ranks = np.argsort(np.argsort(np.abs(d))) + 1.0
    return float((ranks[d > 0].sum() - n * (n + 1) / 4) / np.sqrt(n * (n + 1) * (2 * n + 1) / 24))


MATERIAL = 0.025
"""Change of half the log of a block's sum of squares that counts: a twentieth of its noise."""


def present(problem: Problem, fitted: Fit, name: str, joints: BoolArray, deviation: FloatArray) -> BoolArray:
    """Return the joints where an effect's main number differs from none by more than LEAST_PARAMETER deviations (P,)."""
    spec = CATALOGUE[name]
    there = np.zeros(len(problem.machine.joints), dtype=bool)
    sized = [p for p in spec.parameters if not p.fixed and not p.shape]
    if not sized:  # read off the log, not fitted
        values = [fitted.point.values[name, p.name] != neutral(name, p.name, problem.machine) for p in spec.parameters]
        return np.any(values, axis=0) & joints
    for i, knob in enumerate(fitted.knobs):
        if knob.key[0] != name or knob.key[1] not in [p.name for p in sized]:
            continue
        value = fitted.point.values[knob.key][max(knob.joint, 0)]
        none = float(neutral(*knob.key, problem.machine)[max(knob.joint, 0)])
        if abs(value - none) > LEAST_PARAMETER * deviation[i]:
            there[slice(None) if knob.joint < 0 else knob.joint] = True
    if spec.scope != "joint":
        return there
    missed, chain = _missed(fitted, problem, name), problem.machine.chain
    strongest = np.array([missed[chain == c].max() for c in chain])
    return there & joints & (missed > np.maximum(LEAST_MISSED, LEAST_BESIDE * strongest))


def _missed(fitted: Fit, problem: Problem, name: str) -> FloatArray:
    """Return what is left more of a chain without an effect at one of its joints (J,), in noise floors, for a linear model.

    The other numbers make up for it as they can.
    """
    train = problem.blocks.train
    hessian = fitted.sums.over(train)[0] + np.diag(prior(fitted.knobs))
    scale = 1.0 / np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    inverse = np.linalg.pinv(hessian * scale[:, None] * scale, 1e-12) * scale[:, None] * scale
    readings = max(int(np.isin(problem.blocks.index, train).sum()), 1)
    rows = np.zeros(len(problem.machine.joints))
    sized = [p.name for p in CATALOGUE[name].parameters if not p.fixed and not p.shape]
    for joint in range(len(rows)):
        own = [i for i, k in enumerate(fitted.knobs) if k.key[0] == name and k.joint == joint and k.key[1] in sized]
        if own:
            keys = [fitted.knobs[i].key for i in own]
            away = np.array([fitted.point.values[k][joint] - neutral(*k, problem.machine)[joint] for k in keys])
            more = float(away @ np.linalg.lstsq(inverse[np.ix_(own, own)], away, rcond=None)[0])
            rows[joint] = np.sqrt(max(more, 0.0) / readings)
    return rows


def judge(problem: Problem, incumbent: Fit, before: FloatArray, name: str, fitted: Fit, joints: BoolArray) -> Tried:
    """Compare a fit that has one more effect with the one that lacks it, on the joints where it acts.

    Args:
        problem: Log and model.
        incumbent: The fit that lacks it.
        before: Its blocks, each judged without itself (B_train, C).
        name: The effect.
        fitted: The fit that has it.
        joints: Joints that may have it (J,).
    """
    after, moves = left_out(fitted, problem)
    fell = problem.mean_squares(incumbent.residual, False) - problem.mean_squares(fitted.residual, False)
    improvement = float(np.sqrt(np.maximum(fell, 0.0)).max())
    there = present(problem, fitted, name, joints, deviations(fitted, problem, moves)) & _better(problem, before, after)
    if name == "cogging":
        least = [least_order(q) for q in problem.replay.log.q.T]
        there &= fitted.point.values["cogging", "order"] >= least
    if name == "periodic_force":
        there &= ~on_harmonic(problem, fitted.point.values["periodic_force", "frequency"])
    channels = there[problem.channel_joint]
    gain, z = paired(after, before, channels) if there.any() else paired(after, before)
    why = ""
    if not there.any():
        why = f"no joint gains by a number that differs from none by {LEAST_PARAMETER:.0f} deviations"
    elif gain < LEAST_GAIN:
        why = f"gain {100 * gain:.1f} % is below {100 * LEAST_GAIN:.0f} %"
    elif z < LEAST_Z:
        why = f"gain is {z:.1f} standard errors, below {LEAST_Z:.0f}"
    elif improvement < LEAST_IMPROVEMENT:
        why = f"it removes {improvement:.2f} noise floors, below {LEAST_IMPROVEMENT}"
    elif (share := _share(problem, incumbent, fitted, channels)) < LEAST_SHARE:
        why = f"it takes {100 * share:.0f} % of what is unexplained on its joints, below {100 * LEAST_SHARE:.0f} %"
    else:
        why = _pushed(problem, incumbent, fitted, there)
    overall, _ = paired(after, before)
    return Tried(
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


def _share(problem: Problem, incumbent: Fit, fitted: Fit, channels: BoolArray) -> float:
    before, after = (problem.mean_squares(f.residual, False)[channels].sum() for f in (incumbent, fitted))
    return float((before - after) / max(before - channels.sum(), 1e-9))


def _better(problem: Problem, before: FloatArray, after: FloatArray) -> BoolArray:
    """Joints whose blocks are better off without having been used."""
    joints = len(problem.machine.joints)
    gain = np.log(np.maximum(before.sum(0), 1e-12) / np.maximum(after.sum(0), 1e-12))
    better = np.zeros(joints, dtype=bool)
    np.logical_or.at(better, problem.channel_joint, gain > 2 * LEAST_GAIN)
    return better


def _pushed(problem: Problem, incumbent: Fit, fitted: Fit, there: BoolArray) -> str:
    """Return why declared numbers of the joints where an effect acts forbid it, or nothing.

    A number that the log hardly determines stays near its prior and says nothing, and one that was at its bound without the
    effect was not pushed there.
    """
    for knob, bound in stopped(fitted, problem, FAR_BEYOND):
        if not CATALOGUE[knob.key[0]].declared or (knob.joint >= 0 and not there[knob.joint]):
            continue
        if abs(incumbent.point.values[knob.key][max(knob.joint, 0)] - bound) > 1e-9:
            label = f"{knob.key[0]}.{knob.key[1]}"
            label += "" if knob.joint < 0 else f" of {problem.machine.joints[knob.joint]}"
            return f"it pushes {label} onto its bound {bound:g}"
    return ""


def stopped(fitted: Fit, problem: Problem, least: float = 0.0) -> list[tuple[Knob, float]]:
    """Return numbers at a bound, and the bound, that the log would have cross it by so many steps.

    An effect's bound at which it is none is not one of them: there it ends. The other says how much of it a machine can have.
    """
    hessian, gradient = fitted.sums.over(problem.blocks.train)
    found = []
    for i, knob in enumerate(fitted.knobs):
        joint = max(knob.joint, 0)
        value, none = fitted.point.values[knob.key][joint], neutral(*knob.key, problem.machine)[joint]
        beyond = gradient[i] / (hessian[i, i] + 1.0 / knob.spread**2) / knob.step
        for bound, sign in zip(knob.bounds, (-1.0, 1.0), strict=True):
            counts = CATALOGUE[knob.key[0]].declared or abs(none - bound) > 1e-9
            if counts and abs(value - bound) < 1e-9 and sign * beyond > least:
                found.append((knob, bound))
    return found


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """What one stage of the search found."""

    tried: tuple[Tried, ...]
    """Refitted effects, best first."""
    best: Tried | None
    """The accepted one."""
    rivals: tuple[str, ...]
    """Effects that this log cannot tell from it."""
    others: tuple[Tried, ...] = ()
    """Those behind it that would be accepted too, best first."""
    base: BaseMotion | None = None
    """A motion of the base, where that is what explains the rest."""


def search(
    problem: Problem,
    incumbent: Fit,
    names: Sequence[str],
    joints: dict[str, BoolArray],
    motion: Motion,
    candidates: Sequence[str],
    tick: Callable[[str], None],
    refine: Callable[[Fit], Fit],
) -> Found:
    """Look for the one effect that explains most of what is left.

    Args:
        problem: Log and model.
        incumbent: The best fit so far.
        names: Effects that it fits.
        joints: Joints that have each of them.
        motion: What the model does.
        candidates: Effects to try.
        tick: Called with what is being done.
        refine: Returns a fit judged at finer steps.
    """
    before, _ = left_out(incumbent, problem)
    random = [n for n in candidates if CATALOGUE[n].random]
    late: tuple[Tried, ...] = ()
    if random:
        tick("looking for single late targets")
        late = _late(problem, incumbent, before, names, joints, random)
        if late and not late[0].why:  # first, since the rest is then judged without their noise
            rivals = tuple(t.name for t in late[1:] if not _told_apart(late[0], t))
            return Found(tried=late, best=late[0], rivals=rivals)
    tick("screening")
    picked = _pick(screen(problem, incumbent, [n for n in candidates if not CATALOGUE[n].read_off], motion))
    masks = {s.name: s.joints for s in picked}
    tick(f"refitting {len(picked)} effects")
    fits = fit_all(
        problem,
        [
            fitting(problem, s.point, [*names, s.name], {**joints, s.name: s.joints}, most=2, frozen=incumbent)
            for s in picked
        ],
    )
    for i, (s, f) in enumerate(zip(picked, fits, strict=True)):
        if s.name in {name for name, _ in SHARED} and (apart := _apart_from_shared(problem, f, s)) is not None:
            point, masks[s.name] = apart
            fits[i] = fit(problem, point, [*names, s.name], {**joints, s.name: masks[s.name]}, most=3)
    tried = [judge(problem, incumbent, before, s.name, f, masks[s.name]) for s, f in zip(picked, fits, strict=True)]
    hard = [t for t in tried if _astray(problem, incumbent, t, tried)]
    if hard:
        tick(f"refitting {', '.join(CATALOGUE[t.name].title for t in hard)} from the model's numbers")
        everywhere = np.ones(len(problem.machine.joints), dtype=bool)
        begins = {s.name: _afresh(problem, s.begin, everywhere) for s in picked}
        fits = fit_all(
            problem,
            [
                fitting(problem, begins[t.name], [*names, t.name], {**joints, t.name: masks[t.name]}, most=6)
                for t in hard
            ],
        )
        for t, f in zip(hard, fits, strict=True):
            again = judge(problem, incumbent, before, t.name, f, masks[t.name])
            if again.gain > t.gain:
                tried[tried.index(t)] = again
    tried.sort(key=lambda t: -t.gain)
    strong = [t for t in tried if t.gain >= LEAST_GAIN and t.z >= LEAST_Z]
    strong = [t for t in strong if paired(strong[0].squares, t.squares)[1] < FAR_Z][:STRONG]
    if strong:
        tick(f"comparing {', '.join(CATALOGUE[t.name].title for t in strong)}")
        fits = fit_all(
            problem,
            [
                fitting(problem, t.fitted.point, [*names, t.name], {**joints, t.name: masks[t.name]}, most=4)
                for t in strong
            ],
        )
        for t, f in zip(strong, fits, strict=True):
            tried[tried.index(t)] = judge(problem, incumbent, before, t.name, refine(f), masks[t.name])
    tried.sort(key=lambda t: -t.gain)
    base = _base(problem, incumbent, before, tried, tick)
    if base is not None:
        tried = [t if t.why else replace(t, why=_of_the_base(base, t)) for t in tried]
    good = [t for t in tried if not t.why]
    tried += late
    if not good:
        return Found(tried=tuple(tried), best=None, rivals=(), base=base)
    best = good[0]
    rivals = tuple(t.name for t in good[1:] if _rivals(problem, best, t))
    return Found(tried=tuple(tried), best=best, rivals=rivals, others=tuple(good[1:]))


def _apart_from_shared(problem: Problem, fitted: Fit, start: Start) -> tuple[Point, BoolArray] | None:
    """Return where to begin again with what an effect is alike in most joints put into the number that all share, and the
    joints where something is left of it (J,); None where it is not in most of them.

    A delay of all joints and the delay of the machine are the same thing: neither is sure as long as both are fitted.
    """
    values = dict(fitted.point.values)
    for (name, parameter), shared in SHARED.items():
        if name != start.name or shared not in values or not start.joints.all():
            continue
        alike = float(np.quantile(values[name, parameter], ALIKE))
        rest = np.maximum(values[name, parameter] - alike, 0.0)
        there = rest > ALIKE * rest.max()
        if not there.any() or there.all():
            return None
        values[shared] = values[shared] + alike
        values[name, parameter] = np.where(there, rest, 0.0)
        return Point(values), there
    return None


def _base(
    problem: Problem, incumbent: Fit, before: FloatArray, tried: Sequence[Tried], tick: Callable[[str], None]
) -> BaseMotion | None:
    """Return the motion of the base that explains what forces in the joints seem to, if it does so no worse."""
    shaken = next((t for t in tried if t.name == "periodic_force"), None)
    if shaken is None or shaken.joints.sum() < 2 or shaken.gain < LEAST_GAIN or shaken.z < LEAST_Z:
        return None
    tick("is it the base that moves")
    cosine, sine, frequency = (shaken.fitted.point.values[shaken.name, p] for p in ("cosine", "sine", "frequency"))
    base = moving_base(problem, incumbent, frequency, np.hypot(cosine, sine), shaken.joints)
    if base is None or (len(np.unique(problem.machine.chain)) == 1 and base.numbers >= 3 * shaken.joints.sum()):
        return None
    gain, z = paired(base.squares, before)
    better, sure = paired(shaken.squares, base.squares)
    if gain < LEAST_GAIN or z < LEAST_Z or (better >= LEAST_GAIN and sure >= RIVAL_Z):
        return None
    return base


def _of_the_base(base: BaseMotion, tried: Tried) -> str:
    """Return why an effect is not accepted beside a motion of the base, or nothing where it explains more."""
    gain, z = paired(tried.squares, base.squares)
    if gain >= LEAST_GAIN and z >= RIVAL_Z:
        return ""
    at = " and ".join(f"{f:.2f}" for f in base.frequencies)
    return f"one motion of the base at {at} Hz explains {'as much' if z > -RIVAL_Z else 'more'}, with {base.numbers} numbers"


def _late(
    problem: Problem,
    incumbent: Fit,
    before: FloatArray,
    names: Sequence[str],
    joints: dict[str, BoolArray],
    candidates: Sequence[str],
) -> tuple[Tried, ...]:
    """Return laws of single late targets, the better first; it is fitted to the end if the chains agree on it."""
    replay, found = problem.replay, []
    had = replay.late
    readings = np.isin(problem.blocks.index, problem.blocks.train).sum()
    for timing in _likelier(timings(problem, incumbent, candidates)):
        gain, z = paired(timing.squares, before)
        unexplained = before.sum() - float(readings * problem.channels)
        share = (before.sum() - timing.squares.sum()) / max(unexplained, 1e-9)
        why = ""
        if not AGREEMENT[0] < timing.agreement < AGREEMENT[1]:
            why = f"the chains share {100 * timing.agreement:.0f} % of the lateness that each shows"
        elif gain < LEAST_GAIN:
            why = f"gain {100 * gain:.1f} % is below {100 * LEAST_GAIN:.0f} %"
        elif z < LATE_Z:
            why = f"gain is {z:.1f} standard errors, below {LATE_Z:.0f}"
        elif share < LEAST_SHARE:
            why = f"it takes {100 * share:.0f} % of what is unexplained, below {100 * LEAST_SHARE:.0f} %"
        why = why or _holds_none(timing)
        fitted = replace(incumbent, point=timing.point)
        improvement = float(np.sqrt(max((before.sum(0) - timing.squares.sum(0)).max() / readings, 0.0)))
        if not why and not found:
            timing, fitted = arrivals(problem, timing, names, joints)
            replay.set_late(had)
            fell = problem.mean_squares(incumbent.residual, False) - problem.mean_squares(fitted.residual, False)
            improvement = float(np.sqrt(np.maximum(fell, 0.0)).max())
            why = _holds_none(timing)
        found.append(
            Tried(
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
    """Return why a law of lateness is refused whose number is not sure to differ from none, or nothing.

    Where joints are late together for another reason, such as a supply that sags, the mean lateness is one of few targets.
    """
    return "" if timing.interval[0] > 0.0 else "the interval of its number holds none"


def _likelier(laws: Sequence[Timing]) -> list[Timing]:
    """Return laws of lateness, first the one that its distribution shows; where it does not, the one that leaves less."""
    best = max((t.likelihood for t in laws), default=0.0)
    return sorted(laws, key=lambda t: (t.likelihood < best - TOLD_APART, t.squares.sum()))


def _told_apart(one: Tried, other: Tried) -> bool:
    """Return whether the log tells the first of two laws of lateness from the other."""
    if one.timing is None or other.timing is None:
        return False
    if one.timing.likelihood - other.timing.likelihood > TOLD_APART:
        return True
    return paired(one.squares, other.squares)[1] >= RIVAL_Z


def arrivals(
    problem: Problem, timing: Timing, names: Sequence[str], joints: dict[str, BoolArray], most: int = PASSES
) -> tuple[Timing, Fit]:
    """Return which targets were late, and the numbers, improved in turn as long as that pays; the replay has them then."""
    replay, found = problem.replay, []
    for _ in range(most):
        replay.set_late(timing.late)
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
    replay.set_late(timing.late)
    return timing, fitted


def _delay(point: Point) -> float:
    return float(point.values.get(("delay", "time"), np.zeros(1))[0])


def _astray(problem: Problem, incumbent: Fit, t: Tried, tried: Sequence[Tried]) -> bool:
    """Return whether an effect may have been fitted from a bad start: one with a threshold that leaves much, and explains nothing
    or more than any other; or the one that explains most, where declared numbers had stopped at their bounds without it."""
    most = t.gain == max(o.gain for o in tried)
    if most and _bent(incumbent):
        return True
    left = np.mean(problem.mean_squares(t.fitted.residual, False))
    return CATALOGUE[t.name].structural and (t.gain < LEAST_GAIN or t.z < LEAST_Z or most) and bool(left > FAR)


def _bent(fitted: Fit) -> bool:
    """Return whether a declared number stops at a bound where a machine cannot be."""
    for knob in fitted.knobs:
        value = fitted.point.values[knob.key][max(knob.joint, 0)]
        if CATALOGUE[knob.key[0]].declared and value != 0.0 and min(abs(value - b) for b in knob.bounds) < 1e-9:
            return True
    return False


def _afresh(problem: Problem, point: Point, joints: BoolArray) -> Point:
    """Return a start with the declared numbers of these joints (J,) as the model has them.

    Without the effect that is tried they were bent to make up for it.
    """
    values = dict(point.values)
    for name, parameter in values:
        if CATALOGUE[name].declared and CATALOGUE[name].scope != "machine":
            usual = neutral(name, parameter, problem.machine)
            values[name, parameter] = np.where(joints, usual, values[name, parameter])
    return Point(values)


def _rivals(problem: Problem, best: Tried, other: Tried) -> bool:
    gain, z = _apart(problem, best, other)
    return z < RIVAL_Z or gain < LEAST_GAIN


def _apart(problem: Problem, best: Tried, other: Tried) -> tuple[float, float]:
    """Return gain and z of one effect over another, where either acts."""
    return paired(best.squares, other.squares, (best.joints | other.joints)[problem.channel_joint])


def _pick(starts: Sequence[Start]) -> list[Start]:
    return [s for i, s in enumerate(starts) if (i < REFINED and s.gain > 0.004) or CATALOGUE[s.name].structural]


def whole_chains(problem: Problem, name: str, joints: BoolArray) -> BoolArray:
    """Return joints (J,) with an effect, and all others of their chains where it is one that they have together."""
    chain = problem.machine.chain
    return np.isin(chain, chain[joints]) if CATALOGUE[name].together else joints


def pruned(problem: Problem, best: Tried, names: Sequence[str], joints: dict[str, BoolArray]) -> Fit:
    """Return the accepted fit with the effect only where it is there."""
    spec = CATALOGUE[best.name]
    if spec.scope == "machine" or best.joints.all():
        return fit(problem, best.fitted.point, [*names, best.name], joints, most=2)
    values = dict(best.fitted.point.values)
    for p in spec.parameters:
        none = neutral(best.name, p.name, problem.machine)
        values[best.name, p.name] = np.where(best.joints, values[best.name, p.name], none)
    return fit(problem, Point(values), [*names, best.name], {**joints, best.name: best.joints}, most=3)


def further(problem: Problem, fitted: Fit, name: str, joints: BoolArray) -> BoolArray:
    """Return joints (J,) that lack an effect which others have, and where more is left than could count."""
    left = problem.mean_squares(fitted.residual, False)[: len(joints)] > 1.0 + LEAST_IMPROVEMENT**2
    spec = CATALOGUE[name]
    can = problem.machine.last if spec.tip else np.ones(len(joints), dtype=bool)
    return left & ~joints & can & (spec.scope != "machine" and not spec.read_off)


def wider(
    problem: Problem,
    narrow: Fit,
    name: str,
    names: Sequence[str],
    joints: Mapping[str, BoolArray],
    more: BoolArray,
) -> tuple[Fit, BoolArray] | None:
    """Return a fit with an effect on further joints, and all its joints, if it explains most of what is left there.

    A joint that has an effect may hide it behind numbers of its leg that were bent to make up for it, and another effect
    would be named in its place. So declared numbers of these legs begin as the model has them.

    Args:
        problem: Log and model.
        narrow: The fit with the effect where it was found.
        name: The effect.
        names: All effects of the fit.
        joints: Joints that have each of them.
        more: Joints that may have it too (J,).
    """
    chain = problem.machine.chain
    values = dict(_afresh(problem, narrow.point, np.isin(chain, chain[more])).values)
    for p in CATALOGUE[name].parameters:
        row = values[name, p.name]
        values[name, p.name] = np.where(more, np.median(row[joints[name]]), row)
    fitted = fit(problem, Point(values), names, {**joints, name: joints[name] | more}, most=MOST_AFRESH)
    there = present(problem, fitted, name, more, deviations(fitted, problem, left_out(fitted, problem)[1]))
    if not there.any() or _share(problem, narrow, fitted, there[problem.channel_joint]) < MOSTLY:
        return None
    return (fitted, joints[name] | there) if earns_its_keep(problem, fitted, narrow) else None


def lasts(problem: Problem, before: Fit, after: Fit, tried: Tried) -> bool:
    """Return whether an effect, fitted to the end, leaves less of the blocks held out from all fits, where it acts.

    What is read off the log is not asked.
    """
    if CATALOGUE[tried.name].read_off:
        return True
    channels = tried.joints[problem.channel_joint]
    left, had = (problem.mean_squares(f.residual, True)[channels].sum() for f in (after, before))
    return bool(left < had)


def earns_its_keep(problem: Problem, whole: Fit, without: Fit) -> bool:
    """Return whether an effect still pays beside the ones found after it."""
    gain, z = paired(left_out(whole, problem)[0], left_out(without, problem)[0])
    return gain >= LEAST_GAIN and z >= LEAST_Z
