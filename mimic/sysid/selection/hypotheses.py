"""Which set of effects explains a log: a beam over sets, each judged on blocks that its fit has not seen.

The sets of one size are extended by the effects that the torques of the log ask for, quickly refitted, and the most
likely ones fitted to the end in fine steps. The best of those are the sets of the next size.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from mimic.config.sysid import CalibrateSettings
from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.law import STIFFEST
from mimic.dynamics.servo import neutral
from mimic.records import BoolArray, FloatArray
from mimic.sysid.fit.by_log import errors_of
from mimic.sysid.fit.least_squares import Fit, fit, fit_all, fitting, left_out
from mimic.sysid.fit.point import Key, Point
from mimic.sysid.fit.residuals import Problem
from mimic.sysid.fit.step_refinement import FINE, FINE_SEGMENT, corrected, refine_steps, refined
from mimic.sysid.fit.uncertainty import deviations
from mimic.sysid.result import Stage
from mimic.sysid.screen.base import BaseMotion, moving_base
from mimic.sysid.screen.regression import Torques, asked_for
from mimic.sysid.selection.evidence import (
    TriedEffect,
    cross_validated,
    earns_its_keep,
    evaluate,
    hard_to_tell_apart,
    likelihood,
    pays,
    present,
    share_taken,
)
from mimic.sysid.selection.jitter import Timing
from mimic.sysid.selection.late_targets import distinguishable, fit_delay_per_command, late_targets
from mimic.sysid.selection.starts import StartingPoint, predicted, starting_points
from mimic.sysid.thresholds import RULES

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

AGAIN = 3
"""Rounds of finding when each target acted, once fine steps correct the coarse ones."""

AS_WITHOUT = "in the final fit its parameters are those of a machine without it"

SOFT = 0.1
"""Greatest compliance that the law gives all transmissions with play, times Kp: with stiffer drives it would be an
elasticity of its own.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Hypothesis:
    """A set of effects, fitted to a log."""

    problem: Problem
    """Its replays are corrected at this fit."""
    fitted: Fit
    names: tuple[str, ...]
    """All effects, those of the baseline first."""
    joints: Mapping[str, BoolArray]
    """Joints that have each (J,); all where it is not there."""
    parent: Hypothesis | None = None
    """The set that lacks the last effect; None for the baseline."""
    found: TriedEffect | None = None
    """The last effect."""
    tried: tuple[TriedEffect, ...] = ()
    """All that were tried beside it, best first."""
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Of the numbers that are read off the lateness of the targets."""
    unsure: Mapping[Key, float] = field(default_factory=dict)
    """Half of the 95 % interval of numbers that goes with these."""
    rejections: tuple[str, ...] = ()
    """Why effects that were found are not named."""
    rivals: tuple[str, ...] = ()
    """Effects of other sets of this size that the log cannot tell from this one."""
    base: BaseMotion | None = None
    """A motion of the base, where that is what explains the rest."""

    @cached_property
    def left_out(self) -> tuple[FloatArray, FloatArray]:
        """Squares of each fitted block judged without itself (B_train, C), and how the numbers move (B_train, P)."""
        return left_out(self.fitted, self.problem)

    @property
    def squares(self) -> FloatArray:
        """Squares of each fitted block, judged without itself (B_train, C)."""
        return self.left_out[0]

    def stages(self, last: Sequence[TriedEffect]) -> list[Stage]:
        """Return the models on the way, each with what was tried to get there.

        Args:
            last: What was tried where nothing was added.
        """
        root, *steps = self.path
        made = [Stage(added="baseline", errors=errors_of(root.problem, root.fitted.residual))]
        kept = [h for h in steps if h.found is not None and h.found.name in self.names]
        made += [_stage(h, self if h is kept[-1] else h) for h in kept]
        if not kept:
            refused = self.rejections[0] if steps and self.rejections else ""
            candidates = [t.candidate(root.problem, None) for t in (steps[0].tried if steps else last)]
            candidates = [c if c.why else replace(c, why=refused or AS_WITHOUT) for c in candidates]
            errors = errors_of(self.problem, self.fitted.residual)
            made.append(Stage(added="", errors=errors, candidates=tuple(candidates)))
        return made

    @property
    def added(self) -> tuple[str, ...]:
        """Effects beside the baseline's, in the order in which they were found."""
        return tuple(h.found.name for h in self.path if h.found is not None)

    @property
    def path(self) -> tuple[Hypothesis, ...]:
        """The baseline, and each set on the way to this one."""
        return (self,) if self.parent is None else (*self.parent.path, self)

    @property
    def explained(self) -> bool:
        """Whether no remaining error is large enough to count."""
        return bool(np.all(self.problem.mean_squares(self.fitted.residual, False) < 1.0 + RULES.improvement**2))

    @property
    def likelihood(self) -> float:
        """Logarithm of the probability of blocks that were left out, less the price of each number."""
        return likelihood(self.problem, self.squares, len(self.fitted.free_parameters))


@dataclass(frozen=True, kw_only=True, eq=False)
class Search:
    """What a search for effects needs beside the log."""

    settings: CalibrateSettings
    tick: Callable[[str], None]
    """Called with what is being done."""
    torques: Sequence[Torques]
    """Of the log, see `mimic.sysid.screen.regression.torques_of`."""

    def run(self, baseline: Hypothesis) -> tuple[Hypothesis, tuple[TriedEffect, ...]]:
        """Return the best set, and what was tried last where nothing was added to it."""
        if not self.settings.most_effects or baseline.explained:
            return baseline, ()
        warm = baseline.problem.warmed_up(baseline.fitted.point, FINE, FINE_SEGMENT)
        best, last = replace(baseline, problem=warm), ()
        beam = [best]
        for _ in range(self.settings.most_effects):
            grown, last, base = self.extended(best)
            for other in beam[1:]:
                grown += [h for h in self.extended(other)[0] if pays(h.squares, best.squares)]
            if not grown:
                return replace(best, base=base), last
            grown.sort(key=lambda h: -h.likelihood)
            beam = list(_distinct(grown))[: RULES.beam]
            alike = [h for h in beam[1:] if not pays(beam[0].squares, h.squares, RULES.apart)]
            others = {n for h in alike for n in h.added} - set(beam[0].added)
            best = beam[0] = replace(beam[0], rivals=tuple(sorted(others)))
            if best.explained:
                break
        return best, ()

    def extended(self, parent: Hypothesis) -> tuple[list[Hypothesis], tuple[TriedEffect, ...], BaseMotion | None]:
        """Return the best sets with one effect more, all that were tried, and a motion of the base if that is it."""
        names = self.candidates(parent)
        late = self._late(parent, [n for n in names if CATALOGUE[n].random])
        if late and not late[0].why:  # first, since the rest is then judged without their noise
            settled = self._settled(parent, late[0], late)
            if settled is not None:
                return [settled], late, None
        names = [n for n in names if not CATALOGUE[n].read_off]
        self.tick("comparing torques")
        wanted, seen = asked_for(self.torques, names, parent.added)
        first = [n for n in names if n in wanted]
        tried: list[TriedEffect] = []
        for some in (first, [n for n in names if n not in first and CATALOGUE[n].structural]):
            tried += self._tried(parent, some) if some else []
            if any(not t.why for t in tried):
                break
        tried.sort(key=lambda t: -t.gain)
        base = self._base(next((t for t in tried if t.name == "periodic_force"), None))
        if base is not None:
            tried = [t if t.why else replace(t, why=base.instead_of(seen.get(t.name))) for t in tried]
        tried += late
        sets: list[Hypothesis] = []
        for t in [t for t in tried if not t.why and t not in late]:
            settled = self._settled(parent, t, tried)
            if settled is None:
                continue
            sets.append(settled)
            if len(sets) == RULES.beam or settled.explained:
                break
        return sets, tuple(tried), base

    def _base(self, shaken: TriedEffect | None) -> BaseMotion | None:
        """Return the motion of the base that explains periodic forces in the joints as well, or None."""
        if shaken is None or not self.torques or shaken.gain < RULES.gain or shaken.z < RULES.z:
            return None
        self.tick("testing for a moving base")
        cosine, sine, frequency = (shaken.fitted.point.values[shaken.name, p] for p in ("cosine", "sine", "frequency"))
        return moving_base(self.torques[0], frequency, np.hypot(cosine, sine), shaken.joints)

    def candidates(self, parent: Hypothesis) -> list[str]:
        """Return the effects that may be added to a set."""
        allowed = self.settings.effects or tuple(n for n, e in CATALOGUE.items() if not e.by_request)
        machine, out = parent.problem.machine, set(parent.names)
        if any(CATALOGUE[n].random for n in parent.names):  # one law of late targets is enough
            out |= {n for n in allowed if CATALOGUE[n].random}
        if (np.asarray(machine.drives.neighbour) == np.arange(len(machine.joints))).all():
            out.add("coupling")  # to itself it is viscous friction
        if len(machine.joints) == 1:
            out.add("joint_delay")  # the delay of the machine
        if np.max(machine.drives.kp) * STIFFEST > SOFT:
            out |= {"backlash", "compliance"}
        return [n for n in allowed if n not in out and not CATALOGUE[n].baseline]

    def _late(self, parent: Hypothesis, names: Sequence[str]) -> tuple[TriedEffect, ...]:
        if not names:
            return ()
        self.tick("searching for delayed commands")
        return late_targets(parent.problem, parent.fitted, parent.squares, parent.names, parent.joints, names)

    def _tried(self, parent: Hypothesis, names: Sequence[str]) -> list[TriedEffect]:
        """Return effects beside a set, the strongest of them fitted to the end."""
        problem, fitted = parent.problem, parent.fitted
        self.tick(f"refitting {len(names)} effects")
        starts = starting_points(problem, fitted, names, predicted(problem, fitted))
        places = {s.name: s.joints for s in starts}

        def refitted(of: Sequence[tuple[str, Point]], most: int, frozen: Fit | None = None) -> list[Fit]:
            asked = [
                fitting(
                    problem,
                    point,
                    [*parent.names, name],
                    {**parent.joints, name: places[name]},
                    most=most,
                    frozen=frozen,
                )
                for name, point in of
            ]
            return fit_all(problem, asked)

        def judged(name: str, found: Fit) -> TriedEffect:
            return evaluate(problem, fitted, parent.squares, name, found, places[name])

        quick = refitted([(s.name, s.point) for s in starts], 2, fitted)
        for i, (s, f) in enumerate(zip(starts, quick, strict=True)):
            if (apart := _apart_from_shared(f, s)) is not None:
                point, places[s.name] = apart
                quick[i] = refitted([(s.name, point)], 3)[0]
        tried = [judged(s.name, f) for s, f in zip(starts, quick, strict=True)]
        hard = [t for t in tried if _astray(problem, fitted, t, tried)]
        everywhere = np.ones(len(problem.machine.joints), dtype=bool)
        begins = {s.name: _afresh(problem, s.point, everywhere) for s in starts}
        for t, f in zip(hard, refitted([(t.name, begins[t.name]) for t in hard], 6), strict=True):
            again = judged(t.name, f)
            if again.gain > t.gain:
                tried[tried.index(t)] = again
        strong = sorted((t for t in tried if t.gain >= RULES.gain and t.z >= RULES.z), key=lambda t: -t.gain)
        strong = [t for t in strong if not pays(strong[0].squares, t.squares, RULES.hopeless)][: RULES.finished]
        if strong:
            self.tick(f"comparing {', '.join(CATALOGUE[t.name].title for t in strong)}")
        for t, f in zip(strong, refitted([(t.name, t.fitted.point) for t in strong], 4), strict=True):
            tried[tried.index(t)] = judged(t.name, refined(problem, f))
        return tried

    def _settled(self, parent: Hypothesis, t: TriedEffect, tried: Sequence[TriedEffect]) -> Hypothesis | None:
        """Return a set with an effect fitted to the end on the joints that have it, or None where it does not last."""
        h = replace(parent, parent=parent, found=t, tried=tuple(tried), names=(*parent.names, t.name))
        if t.timing is None:
            problem = corrected(h.problem, t.fitted.point).weighed(t.fitted.residual)
            h = replace(h, problem=problem, fitted=t.fitted, joints={**h.joints, t.name: t.joints})
        else:
            h = self._on_time(h, t.timing)
        h = elsewhere_too(_where_it_is(h, t), self.tick)
        if not CATALOGUE[t.name].read_off:
            channels = h.joints[t.name][h.problem.channel_joint]
            left, had = (cross_validated(x.problem, x.fitted)[channels].sum() for x in (h, parent))
            if not left < had or as_good_without(h, t.name) is not None:
                return None
        return h

    def _on_time(self, h: Hypothesis, timing: Timing) -> Hypothesis:
        """Return the set with the delay of each command fitted in fine steps, and the numbers that go with it."""
        self.tick("fitting the delay of each command")
        problem = corrected(h.problem.changed(replay=h.problem.replay.with_late(timing.late)), timing.point)
        problem, timing, fitted = fit_delay_per_command(problem, timing, h.names, h.joints, AGAIN)
        return replace(
            h,
            problem=problem,
            fitted=fitted,
            intervals={**h.intervals, timing.name: timing.interval},
            unsure={**h.unsure, ("delay", "time"): timing.unsure},
        )


def _stage(h: Hypothesis, shown: Hypothesis) -> Stage:
    """Return the record of how the last effect of a set was found, with the errors of the set that is shown."""
    best, problem = h.found, h.problem
    assert best is not None
    others = [t for t in h.tried if t is not best and not t.why]
    alike = [t for t in others if not distinguishable(best, t)] if best.timing else []
    alike = alike or [t for t in others if not best.timing and hard_to_tell_apart(problem, best, t)]
    return Stage(
        added=best.name,
        errors=errors_of(shown.problem, shown.fitted.residual),
        candidates=tuple(t.candidate(problem, best) for t in h.tried),
        alternatives=tuple(dict.fromkeys([*(t.name for t in alike), *h.rivals])),
    )


def _distinct(sets: Sequence[Hypothesis]) -> Iterator[Hypothesis]:
    """Yield the first of several sets with the same effects."""
    seen: set[frozenset[str]] = set()
    for h in sets:
        if frozenset(h.names) not in seen:
            seen.add(frozenset(h.names))
            yield h


def _apart_from_shared(fitted: Fit, start: StartingPoint) -> tuple[Point, BoolArray] | None:
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


def _astray(problem: Problem, incumbent: Fit, t: TriedEffect, tried: Sequence[TriedEffect]) -> bool:
    """Return whether an effect may have been fitted from a poor start."""
    most = t.gain == max(o.gain for o in tried)
    if most and _bent(incumbent):
        return True
    left = np.mean(problem.mean_squares(t.fitted.residual, False))
    weak = t.gain < RULES.gain or t.z < RULES.z
    return CATALOGUE[t.name].structural and (weak or most) and bool(left > POORLY_EXPLAINED)


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


def whole_chains(problem: Problem, name: str, joints: BoolArray) -> BoolArray:
    """Return joints (J,) with an effect, extended to their chains if the effect is chain-shared."""
    chain = problem.machine.chain
    return np.isin(chain, chain[joints]) if CATALOGUE[name].chain_shared else joints


def _on_joints(h: Hypothesis, joints: BoolArray) -> Hypothesis:
    """Return the set with its last effect only on some joints (J,), fitted in fine steps."""
    name, most = h.names[-1], 2
    point, where = h.fitted.point, dict(h.joints)
    if CATALOGUE[name].scope == "joint":
        values, where[name] = dict(point.values), joints
        for p in CATALOGUE[name].parameters:
            none = neutral(name, p.name, h.problem.machine)
            values[name, p.name] = np.where(joints, values[name, p.name], none)
        point, most = Point(values), 2 if joints.all() else 3
    problem, fitted = refine_steps(h.problem, fit(h.problem, point, h.names, where, most=most))
    return replace(h, problem=problem, fitted=fitted, joints=where)


def _where_it_is(h: Hypothesis, t: TriedEffect) -> Hypothesis:
    """Return the set with its last effect on the joints where fine steps still show it."""
    name, joints = t.name, whole_chains(h.problem, t.name, t.joints)
    if (joints == t.allowed).all() and t.timing is None:
        problem, fitted = refine_steps(h.problem, h.fitted)
        settled = replace(h, problem=problem, fitted=fitted, joints={**h.joints, name: joints})
    else:
        settled = _on_joints(h, joints)
    if (t.allowed & ~joints).any() and earns_its_keep(h.problem, t.fitted, settled.fitted):
        joints = t.allowed  # its numbers were not sure yet, but it is missed where they were not
        settled = _on_joints(h, joints)
    deviation = deviations(settled.fitted, settled.problem, settled.left_out[1])
    there = whole_chains(h.problem, name, present(settled.problem, settled.fitted, name, joints, deviation))
    if not there.any() or (there == joints).all():
        return settled
    narrow = _on_joints(settled, there)
    # not sure of any one of these joints, but missed without all of them
    return settled if earns_its_keep(settled.problem, settled.fitted, narrow.fitted) else narrow


def elsewhere_too(h: Hypothesis, tick: Callable[[str], None]) -> Hypothesis:
    """Return the set with its last effect on further joints if it explains most of their residual there.

    A joint that has an effect may hide it behind numbers of its leg that were bent to make up for it, and another
    effect would be named in its place. So baseline parameters of these legs begin as the model has them.
    """
    name, more = h.names[-1], further(h)
    if not more.any():
        return h
    tick(f"trying {CATALOGUE[name].title} on other joints")
    problem, had = h.problem, h.joints[name]
    chain = problem.machine.chain
    values = dict(_afresh(problem, h.fitted.point, np.isin(chain, chain[more])).values)
    for p in CATALOGUE[name].parameters:
        row = values[name, p.name]
        values[name, p.name] = np.where(more, np.median(row[had]), row)
    wide = fit(problem, Point(values), h.names, {**h.joints, name: had | more}, most=MOST_AFRESH)
    there = present(problem, wide, name, more, deviations(wide, problem, left_out(wide, problem)[1]))
    if not there.any() or share_taken(problem, h.fitted, wide, there[problem.channel_joint]) < MOSTLY:
        return h
    if not earns_its_keep(problem, wide, h.fitted):
        return h
    h = replace(h, problem=corrected(problem, wide.point), fitted=wide)
    return _on_joints(h, whole_chains(problem, name, had | there))


def further(h: Hypothesis) -> BoolArray:
    """Return joints (J,) without the last effect of a set, which others have, and with enough residual left."""
    name, machine = h.names[-1], h.problem.machine
    left = h.problem.mean_squares(h.fitted.residual, False)[: len(machine.joints)] > 1.0 + RULES.improvement**2
    spec = CATALOGUE[name]
    if spec.scope == "machine" or spec.read_off:
        return np.zeros(len(left), dtype=bool)
    return left & ~h.joints[name] & (machine.last if spec.tip else np.ones(len(left), dtype=bool))


def best_without(h: Hypothesis, name: str) -> Fit:
    """Return the fit of a set without one of its effects, from what the others are now.

    A number that stands for all joints may be far off by now: while something large was not in the model yet, it was
    bent to make up for that, and the effect set it right.
    """
    starts, rest = [h.fitted.point.without(name)], [n for n in h.names if n != name]
    for (of, parameter), shared in SHARED.items():
        if of == name and shared in starts[0].values:
            alike = starts[0].values[shared] + np.median(h.fitted.point.values[of, parameter])
            starts.append(Point({**starts[0].values, shared: alike}))
    fits = fit_all(h.problem, [fitting(h.problem, p, rest, h.joints, most=3) for p in starts])
    return min(fits, key=lambda f: float(h.problem.block_squares(f.residual)[h.problem.blocks.train].sum()))


def as_good_without(h: Hypothesis, name: str) -> Fit | None:
    """Return a fit without an effect that is significant on no joint, if it is as good; else None."""
    if CATALOGUE[name].random:
        return None
    deviation = deviations(h.fitted, h.problem, h.left_out[1])
    if present(h.problem, h.fitted, name, h.joints[name], deviation).any():
        return None
    rest = best_without(h, name)
    return None if earns_its_keep(h.problem, h.fitted, rest) else rest
