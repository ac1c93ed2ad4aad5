"""Model selection at one stage: which effect explains the residual, with held-out evidence."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.servo import neutral
from mimic.records import BoolArray, FloatArray
from mimic.sysid.fit.least_squares import Fit, fit, fit_all, fitting, left_out
from mimic.sysid.fit.point import Key, Point
from mimic.sysid.fit.residuals import Problem
from mimic.sysid.fit.uncertainty import deviations
from mimic.sysid.selection.evidence import (
    ALTERNATIVE_Z,
    LEAST_GAIN,
    LEAST_IMPROVEMENT,
    LEAST_Z,
    TriedEffect,
    earns_its_keep,
    evaluate,
    hard_to_tell_apart,
    paired,
    present,
    share_taken,
)
from mimic.sysid.selection.late_targets import distinguishable, late_targets
from mimic.sysid.selection.moving_base import BaseMotion, moving_base
from mimic.sysid.selection.screening import PredictedMotion, StartingPoint, screen

MOSTLY = 0.5
"""Share that an effect takes of what noise does not explain, on joints where it was not found and others have it; less
may be something else.
"""

MOST_AFRESH = 8
"""Most steps of a fit that begins with baseline parameters as the model has them."""

SHARED: dict[Key, Key] = {("joint_delay", "time"): ("delay", "time")}
"""Numbers of joints that are a baseline parameter of the machine where they are alike in all."""

SHARED_QUANTILE = 0.25
"""Quantile of such numbers over the joints that goes into the one that all share, and the share of the largest that
then counts.
"""

POORLY_EXPLAINED = 4.0
"""Mean square of what is left, in noise floors, from which on the baseline parameters may be bent out of shape."""

HOPELESS_Z = 6.0
"""Effects this far behind the best, in standard errors, are not fitted to the end."""

STRONG = 4
"""Effects that are fitted to the end and compared."""

REFINED = 6
"""Effects that are refitted at each stage by rank, besides all with a threshold."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StageResult:
    """What one stage of the search found."""

    tried: tuple[TriedEffect, ...]
    """Refitted effects, best first."""
    best: TriedEffect | None
    """The accepted one."""
    alternatives: tuple[str, ...]
    """Effects that this log cannot tell from it."""
    others: tuple[TriedEffect, ...] = ()
    """Those behind it that would be accepted too, best first."""
    base: BaseMotion | None = None
    """A motion of the base, where that is what explains the rest."""


def search(
    problem: Problem,
    incumbent: Fit,
    names: Sequence[str],
    joints: dict[str, BoolArray],
    motion: PredictedMotion,
    candidates: Sequence[str],
    tick: Callable[[str], None],
    refine: Callable[[Fit], Fit],
) -> StageResult:
    """Find the one effect that explains most of the residual.

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
    late: tuple[TriedEffect, ...] = ()
    if random:
        tick("searching for delayed commands")
        late = late_targets(problem, incumbent, before, names, joints, random)
        if late and not late[0].why:  # first, since the rest is then judged without their noise
            alternatives = tuple(t.name for t in late[1:] if not distinguishable(late[0], t))
            return StageResult(tried=late, best=late[0], alternatives=alternatives)
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
    tried = [evaluate(problem, incumbent, before, s.name, f, masks[s.name]) for s, f in zip(picked, fits, strict=True)]
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
            again = evaluate(problem, incumbent, before, t.name, f, masks[t.name])
            if again.gain > t.gain:
                tried[tried.index(t)] = again
    tried.sort(key=lambda t: -t.gain)
    strong = [t for t in tried if t.gain >= LEAST_GAIN and t.z >= LEAST_Z]
    strong = [t for t in strong if paired(strong[0].squares, t.squares)[1] < HOPELESS_Z][:STRONG]
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
            tried[tried.index(t)] = evaluate(problem, incumbent, before, t.name, refine(f), masks[t.name])
    tried.sort(key=lambda t: -t.gain)
    base = _base(problem, incumbent, before, tried, tick)
    if base is not None:
        tried = [t if t.why else replace(t, why=_of_the_base(base, t)) for t in tried]
    good = [t for t in tried if not t.why]
    tried += late
    if not good:
        return StageResult(tried=tuple(tried), best=None, alternatives=(), base=base)
    best = good[0]
    alternatives = tuple(t.name for t in good[1:] if hard_to_tell_apart(problem, best, t))
    return StageResult(tried=tuple(tried), best=best, alternatives=alternatives, others=tuple(good[1:]))


def _apart_from_shared(problem: Problem, fitted: Fit, start: StartingPoint) -> tuple[Point, BoolArray] | None:
    """Return a new start with the part that most joints share moved to the machine's parameter, or None.

    A delay of all joints and the delay of the machine are the same thing: neither is sure as long as both are fitted.
    """
    values = dict(fitted.point.values)
    for (name, parameter), shared in SHARED.items():
        if name != start.name or shared not in values or not start.joints.all():
            continue
        alike = float(np.quantile(values[name, parameter], SHARED_QUANTILE))
        rest = np.maximum(values[name, parameter] - alike, 0.0)
        there = rest > SHARED_QUANTILE * rest.max()
        if not there.any() or there.all():
            return None
        values[shared] = values[shared] + alike
        values[name, parameter] = np.where(there, rest, 0.0)
        return Point(values), there
    return None


def _base(
    problem: Problem, incumbent: Fit, before: FloatArray, tried: Sequence[TriedEffect], tick: Callable[[str], None]
) -> BaseMotion | None:
    """Return the base motion that explains periodic forces in the joints at least as well, or None."""
    shaken = next((t for t in tried if t.name == "periodic_force"), None)
    if shaken is None or shaken.joints.sum() < 2 or shaken.gain < LEAST_GAIN or shaken.z < LEAST_Z:
        return None
    tick("testing for a moving base")
    cosine, sine, frequency = (shaken.fitted.point.values[shaken.name, p] for p in ("cosine", "sine", "frequency"))
    base = moving_base(problem, incumbent, frequency, np.hypot(cosine, sine), shaken.joints)
    if base is None or (len(np.unique(problem.machine.chain)) == 1 and base.numbers >= 3 * shaken.joints.sum()):
        return None
    gain, z = paired(base.squares, before)
    better, sure = paired(shaken.squares, base.squares)
    if gain < LEAST_GAIN or z < LEAST_Z or (better >= LEAST_GAIN and sure >= ALTERNATIVE_Z):
        return None
    return base


def _of_the_base(base: BaseMotion, tried: TriedEffect) -> str:
    """Return why a base motion explains the residual better than an effect, or an empty string."""
    gain, z = paired(tried.squares, base.squares)
    if gain >= LEAST_GAIN and z >= ALTERNATIVE_Z:
        return ""
    at = " and ".join(f"{f:.2f}" for f in base.frequencies)
    explains = "as much" if z > -ALTERNATIVE_Z else "more"
    return f"one motion of the base at {at} Hz explains {explains}, with {base.numbers} parameters"


def _astray(problem: Problem, incumbent: Fit, t: TriedEffect, tried: Sequence[TriedEffect]) -> bool:
    """Return whether an effect may have been fitted from a poor start."""
    most = t.gain == max(o.gain for o in tried)
    if most and _bent(incumbent):
        return True
    left = np.mean(problem.mean_squares(t.fitted.residual, False))
    return (
        CATALOGUE[t.name].structural
        and (t.gain < LEAST_GAIN or t.z < LEAST_Z or most)
        and bool(left > POORLY_EXPLAINED)
    )


def _bent(fitted: Fit) -> bool:
    """Return whether a baseline parameter is at an unphysical bound."""
    for free in fitted.free_parameters:
        value = fitted.point.values[free.key][max(free.joint, 0)]
        if CATALOGUE[free.key[0]].baseline and value != 0.0 and min(abs(value - b) for b in free.bounds) < 1e-9:
            return True
    return False


def _afresh(problem: Problem, point: Point, joints: BoolArray) -> Point:
    """Return a start with the model's own baseline parameters for these joints (J,).

    Without the effect that is tried they were bent to make up for it.
    """
    values = dict(point.values)
    for name, parameter in values:
        if CATALOGUE[name].baseline and CATALOGUE[name].scope != "machine":
            usual = neutral(name, parameter, problem.machine)
            values[name, parameter] = np.where(joints, usual, values[name, parameter])
    return Point(values)


def _pick(starts: Sequence[StartingPoint]) -> list[StartingPoint]:
    return [s for i, s in enumerate(starts) if (i < REFINED and s.gain > 0.004) or CATALOGUE[s.name].structural]


def whole_chains(problem: Problem, name: str, joints: BoolArray) -> BoolArray:
    """Return joints (J,) with an effect, extended to their chains if the effect is chain-shared."""
    chain = problem.machine.chain
    return np.isin(chain, chain[joints]) if CATALOGUE[name].chain_shared else joints


def on_its_joints(problem: Problem, best: TriedEffect, names: Sequence[str], joints: dict[str, BoolArray]) -> Fit:
    """Return the accepted fit with the effect only on the joints that show it."""
    spec = CATALOGUE[best.name]
    if spec.scope == "machine" or best.joints.all():
        return fit(problem, best.fitted.point, [*names, best.name], joints, most=2)
    values = dict(best.fitted.point.values)
    for p in spec.parameters:
        none = neutral(best.name, p.name, problem.machine)
        values[best.name, p.name] = np.where(best.joints, values[best.name, p.name], none)
    return fit(problem, Point(values), [*names, best.name], {**joints, best.name: best.joints}, most=3)


def further(problem: Problem, fitted: Fit, name: str, joints: BoolArray) -> BoolArray:
    """Return joints (J,) without an effect that others have, and with enough residual left."""
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
    """Return a fit with an effect on further joints, and its joints, if it explains most of their residual.

    A joint that has an effect may hide it behind numbers of its leg that were bent to make up for it, and another
    effect would be named in its place. So baseline parameters of these legs begin as the model has them.

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
    if not there.any() or share_taken(problem, narrow, fitted, there[problem.channel_joint]) < MOSTLY:
        return None
    return (fitted, joints[name] | there) if earns_its_keep(problem, fitted, narrow) else None
