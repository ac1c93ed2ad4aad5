"""A set of effects as an explanation of a log: its fit, the joints that have it, what is left without one of them, and
what of it stays in the end.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.machine import MachineModel
from mimic.dynamics.servo import neutral
from mimic.records import BoolArray, FloatArray
from mimic.sysid.baseline import corrected, errors_of, refine_steps
from mimic.sysid.evidence import (
    TriedEffect,
    cross_validated,
    distinguishable,
    earns_its_keep,
    hard_to_tell_apart,
    likelihood,
    paired,
    present,
    share_taken,
    stopped,
)
from mimic.sysid.least_squares import Fit, deviations, fit, fit_all, fitting, left_out, of_white_noise
from mimic.sysid.residuals import FreeParameter, Key, Point, Problem
from mimic.sysid.result import RULES, Candidate, Stage
from mimic.sysid.torque_regression import BaseMotion

MOST_AFRESH = 8
"""Most steps of a fit that begins with baseline parameters as the model has them."""

SHARED: dict[Key, Key] = {("joint_delay", "time"): ("delay", "time")}
"""Numbers of joints that are a baseline parameter of the machine where they are alike in all."""


AS_WITHOUT = "in the final fit its parameters are those of a machine without it"


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
            tried = steps[0].tried if steps else last
            candidates = [replace(t.candidate(root.problem, None), why=t.why or refused or AS_WITHOUT) for t in tried]
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


def _stage(h: Hypothesis, shown: Hypothesis) -> Stage:
    """Return the record of how the last effect of a set was found, with the errors of the set that is shown."""
    best, problem = h.found, h.problem
    assert best is not None
    others = [t for t in h.tried if t is not best and not t.why]
    alike = [t for t in others if not distinguishable(problem, best, t)] if best.timing else []
    alike = alike or [t for t in others if not best.timing and hard_to_tell_apart(problem, best, t)]
    return Stage(
        added=best.name,
        errors=errors_of(shown.problem, shown.fitted.residual),
        candidates=tuple(t.candidate(problem, best) for t in h.tried),
        alternatives=tuple(dict.fromkeys([*(t.name for t in alike), *h.rivals])),
    )


def afresh(problem: Problem, point: Point, joints: BoolArray) -> Point:
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


def where_it_is(h: Hypothesis, t: TriedEffect) -> Hypothesis:
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
    values = dict(afresh(problem, h.fitted.point, np.isin(chain, chain[more])).values)
    for p in CATALOGUE[name].parameters:
        row = values[name, p.name]
        values[name, p.name] = np.where(more, np.median(row[had]), row)
    wide = fit(problem, Point(values), h.names, {**h.joints, name: had | more}, most=MOST_AFRESH)
    there = present(problem, wide, name, more, deviations(wide, problem, left_out(wide, problem)[1]))
    if not there.any() or share_taken(problem, h.fitted, wide, there[problem.channel_joint]) < RULES.most:
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


MOST_PASSES, LARGEST_MOVE = 4, 2.0
"""Most passes of the last fit, each with derivatives of its own, and by how many deviations a number moves where
another is needed.
"""

Stop = tuple[FreeParameter, float]
"""A number that stops at a bound, and the bound."""


LEAST_ROUNDING = 0.25
"""What a coarse encoder rounds off, over what is left of its joint; less may be in the encoder, but is not what is
missing.
"""


def pruned(h: Hypothesis, tick: Callable[[str], None]) -> Hypothesis:
    """Return what stays of a set, fitted to the end."""
    for name in [n for n in h.added[:-1] if not CATALOGUE[n].read_off]:
        tick(f"checking that {CATALOGUE[name].title} is still needed")
        bare = best_without(h, name)
        if not earns_its_keep(h.problem, h.fitted, bare):
            h = replace(h, fitted=bare, names=tuple(n for n in h.names if n != name))
    h = _polished(_without_doubtful(h, tick), tick)
    while (fewer := _pruned_again(h, tick)) is not None:
        h = _polished(fewer, tick)
    return h


def _named(h: Hypothesis) -> list[str]:
    """Return the effects of a set beside the baseline's that are fitted."""
    return [n for n in h.added if n in h.names and not CATALOGUE[n].read_off]


def _polished(h: Hypothesis, tick: Callable[[str], None]) -> Hypothesis:
    """Return the set fitted again, with derivatives in fine steps."""
    tick("final fit")
    problem = h.problem
    if "kt_heat" in h.names:
        problem = corrected(problem.warmed_up(h.fitted.point), h.fitted.point)
    fitted = fit(problem, h.fitted.point, h.names, h.joints, most=1)
    for _ in range(MOST_PASSES):
        before = fitted
        problem, fitted = refine_steps(problem, fitted, every=True)
        moved = fitted.point.read(fitted.free_parameters) - before.point.read(fitted.free_parameters)
        if np.all(np.abs(moved) <= LARGEST_MOVE * of_white_noise(fitted, problem)):
            break  # near enough for the derivatives of where it began
    return replace(h, problem=problem, fitted=fitted)


def _pruned_again(h: Hypothesis, tick: Callable[[str], None]) -> Hypothesis | None:
    """Return the set without effects that the last fit makes doubtful; None if there are none.

    It may have moved a number onto a bound, or have found what an effect had made up for.
    """
    if any(_in_doubt(h, name, _stops(h)).any() for name in _named(h)):
        return _without_doubtful(h, tick)
    for name in _named(h):
        if (bare := as_good_without(h, name)) is not None:
            why = f"{CATALOGUE[name].title} was rejected: {AS_WITHOUT}"
            names = tuple(n for n in h.names if n != name)
            return replace(h, fitted=bare, names=names, rejections=(*h.rejections, why))
    return None


def _without_doubtful(h: Hypothesis, tick: Callable[[str], None]) -> Hypothesis:
    """Return the set without effects whose evidence is ambiguous.

    Far beyond its bound, any number of a chain puts the whole of its effects in doubt. A baseline parameter that stops
    at a bound that the log would have it cross puts in doubt what they are in this chain: there they are rejected,
    elsewhere they stay.
    """
    machine, rows = h.problem.machine, _stops(h)
    fewer: dict[str, BoolArray] = {}
    said: list[str] = []

    def reject(name: str, joints: BoolArray, why: str) -> None:
        where = ", ".join(np.array(machine.joints)[joints])
        said.append(f"{CATALOGUE[name].title} was rejected{f' in {where}' if where else ''}: {why}")

    def stops(joints: BoolArray) -> str:
        return _where_it_stops(next(r for r in (*rows[0], *rows[1]) if (joints & _chains([r], machine)).any()), machine)

    for name in _named(h):
        had = h.joints[name]
        doubted = _in_doubt(h, name, rows)
        if (doubted == had).all():
            reject(name, np.zeros_like(had), stops(had))
            fewer[name] = np.zeros_like(had)
            continue
        has = had & ~doubted
        if doubted.any():
            reject(name, doubted, stops(doubted))
        if (little := _negligible(h, name, has)).any():
            reject(name, little, "its contribution is negligible beside the remaining error of its chain")
            has = has & ~little
        if not (has == had).all():
            if (idle := has & ~_lacking(h)).any():
                reject(name, idle, "nothing was unexplained there without it")
            fewer[name] = has & _lacking(h)
    if not fewer:
        return h
    tick("rejecting ambiguous effects")
    gone = [n for n, has in fewer.items() if not has.any()]
    values = {k: row for k, row in h.fitted.point.values.items() if k[0] not in gone}
    for (name, parameter), row in values.items():
        if name in fewer:
            values[name, parameter] = np.where(fewer[name], row, neutral(name, parameter, machine))
    names, joints = tuple(n for n in h.names if n not in gone), {**h.joints, **fewer}
    problem, fitted = refine_steps(h.problem, fit(h.problem, Point(values), names, joints, most=3))
    said = [*h.rejections, *said]
    return replace(h, problem=problem, fitted=fitted, names=names, joints=joints, rejections=tuple(said))


def _stops(h: Hypothesis) -> tuple[list[Stop], list[Stop]]:
    """Return the numbers that stop far beyond their bound, and baseline ones that stop at one."""
    far = stopped(h.fitted, h.problem, RULES.beyond)
    bent = [row for row in stopped(h.fitted, h.problem) if CATALOGUE[row[0].key[0]].baseline and row[1] != 0.0]
    return far, bent


def _in_doubt(h: Hypothesis, name: str, rows: tuple[list[Stop], list[Stop]]) -> BoolArray:
    """Return the joints (J,) where parameters at their bounds make an effect doubtful."""
    had, machine = h.joints[name], h.problem.machine
    doubtful, elsewhere = _chains(rows[0], machine), ~_chains(rows[1], machine)
    if (had & doubtful).any() or not (had & elsewhere).any():
        return had
    return np.zeros_like(had) if CATALOGUE[name].scope == "machine" else had & ~elsewhere


def _negligible(h: Hypothesis, name: str, has: BoolArray) -> BoolArray:
    """Return the joints (J,) where an effect's contribution is negligible beside the rest of its chain."""
    negligible, spec = np.zeros_like(has), CATALOGUE[name]
    if spec.scope == "machine":
        return negligible
    chain, first = h.problem.machine.chain, h.path[0]
    before, after = (cross_validated(x.problem, x.fitted)[: len(has)] for x in (first, h))
    for c in np.unique(chain[has]):
        here, leg = has & (chain == c), chain == c
        takes, left = (before - after)[here].sum(), (after[leg] - 1.0).sum()
        if after[leg].max() > RULES.explained**2 and takes < RULES.negligible * left:
            negligible |= here
    return negligible


def _lacking(h: Hypothesis) -> BoolArray:
    """Return the joints (J,) of chains that the baseline parameters alone do not explain.

    Elsewhere a name may stand that was found for what is not there, and says nothing once it is rejected where it is.
    """
    machine, first = h.problem.machine, h.path[0]
    left = cross_validated(first.problem, first.fitted)[: len(machine.joints)] > RULES.explained**2
    return np.isin(machine.chain, machine.chain[left])


def _where_it_stops(row: Stop, machine: MachineModel) -> str:
    free, bound = row
    where = "" if free.joint < 0 else f" of {machine.joints[free.joint]}, in the same chain,"
    return f"{free.key[0]}.{free.key[1]}{where} stops at its bound {bound:g}"


def _chains(rows: Sequence[Stop], machine: MachineModel) -> BoolArray:
    """Return the joints (J,) of the chains where a number stopped."""
    there = np.zeros(len(machine.joints), dtype=bool)
    for free, _ in rows:
        there |= True if free.joint < 0 else machine.chain == machine.chain[free.joint]
    return there


def coarse_encoders(h: Hypothesis) -> BoolArray:
    """Return the joints (J,) with an encoder so coarse that it matters beside what is left."""
    problem = h.problem
    count = problem.joints
    left = np.sqrt(problem.mean_squares(h.fitted.residual, False)[:count]) * problem.noise[:count]
    return problem.encoder_steps / np.sqrt(12.0) > LEAST_ROUNDING * left


def as_read(h: Hypothesis, has: BoolArray) -> FloatArray:
    """Return the residual (T, C) with the rounding of encoders (J,), in chains where rounding lowers it.

    Numbers are fitted without them, and what they round off is noise: a servo hunts between two steps, in an order that
    no replay predicts for long, and derivatives of a replay that hunts are those of its steps.
    """
    problem = h.problem
    angle = np.where(has, problem.encoder_steps, 0.0)
    point = h.fitted.point.with_effect("encoder_step", problem.machine, {"angle": angle})
    both = (problem.in_steps_of_columns(point), h.fitted.residual)
    chains = np.unique(problem.channel_chain)
    costs = [[problem.mean_squares(r, False)[problem.channel_chain == c].sum() for c in chains] for r in both]
    less = [c for c, rounded, smooth in zip(chains, *costs, strict=True) if rounded < smooth]
    return np.where(np.isin(problem.channel_chain, less), *both)


def with_encoders(h: Hypothesis, stages: Sequence[Stage], has: BoolArray, residual: FloatArray) -> list[Stage]:
    """Return the stages with coarse encoders (J,) added, which leave a residual (T, C)."""
    problem, machine = h.problem, h.problem.machine
    before, after = (problem.block_squares(r)[problem.blocks.train] for r in (h.fitted.residual, residual))
    fell = problem.mean_squares(h.fitted.residual, False) - problem.mean_squares(residual, False)
    gain, z = paired(problem, after, before, has[problem.channel_joint])
    found = Candidate(
        name="encoder_step",
        gain=gain,
        z=z,
        improvement=float(np.sqrt(np.maximum(fell, 0.0)).max()),
        values={"angle": np.where(has, problem.encoder_steps, 0.0)},
        joints=tuple(np.array(machine.joints)[has]),
        accepted=True,
    )
    others = tuple(c for s in stages if not s.added for c in s.candidates)
    stage = Stage(added="encoder_step", errors=errors_of(problem, residual), candidates=(found, *others))
    return [*(s for s in stages if s.added), stage]
