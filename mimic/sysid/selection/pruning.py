"""What is left of a set of effects in the end: what pays beside the others, what no bound puts in doubt, coarse
encoders.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.machine import MachineModel
from mimic.dynamics.servo import neutral
from mimic.records import BoolArray, FloatArray
from mimic.sysid.baseline import FINE, FINE_SEGMENT, corrected, errors_of, refine_steps
from mimic.sysid.evidence import cross_validated, earns_its_keep, paired, stopped
from mimic.sysid.least_squares import fit, of_white_noise
from mimic.sysid.residuals import FreeParameter, Point
from mimic.sysid.result import Candidate, Stage
from mimic.sysid.selection.hypotheses import AS_WITHOUT, Hypothesis, as_good_without, best_without
from mimic.sysid.thresholds import RULES

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
        problem = corrected(problem.warmed_up(h.fitted.point, FINE, FINE_SEGMENT), h.fitted.point)
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
    count = len(problem.machine.joints)
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
    both = (problem.in_steps_of_columns(point, FINE, FINE_SEGMENT), h.fitted.residual)
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
