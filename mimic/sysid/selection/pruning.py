"""Pruning: removes effects whose evidence is ambiguous."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.machine import MachineModel
from mimic.dynamics.servo import neutral
from mimic.records import BoolArray
from mimic.sysid.fit.least_squares import Fit, fit
from mimic.sysid.fit.point import FreeParameter, Point
from mimic.sysid.fit.step_refinement import refine_steps
from mimic.sysid.result import Stage
from mimic.sysid.selection.evidence import FAR_BEYOND, cross_validated, stopped
from mimic.sysid.selection.unexplained import EXPLAINED
from mimic.sysid.state import CalibrationState, errors_of

NEGLIGIBLE = 0.1
"""Least ratio of what a name takes to what is left in the same chain."""

Stops = tuple[list[tuple[FreeParameter, float]], list[tuple[FreeParameter, float]]]
"""Numbers that stop far beyond their bound, and baseline ones that stop at one; each with the bound."""


def reject_doubtful(state: CalibrationState, stages: list[Stage]) -> list[Stage]:
    """Remove effects whose evidence is ambiguous, together with everything found in the model.

    Far beyond its bound, any number of a chain puts the whole of its effects in doubt. A baseline parameter that stops
    at a bound that the log would have it cross puts in doubt what they are in this chain: there they are rejected,
    elsewhere they stay.
    """
    named = [s for s in stages if s.added and not CATALOGUE[s.added].read_off]
    machine, rows = state.problem.machine, _stops(state, state.current)

    def stops(joints: BoolArray) -> str:
        return _where_it_stops(next(r for r in (*rows[0], *rows[1]) if (joints & _chains([r], machine)).any()), machine)

    fewer: dict[str, BoolArray] = {}
    for name in (s.added for s in named):
        had = state.joints[name]
        doubted = _in_doubt(state, name, rows)
        if (doubted == had).all():
            state.rejections.append(f"{CATALOGUE[name].title} was rejected: {stops(had)}")
            fewer[name] = np.zeros_like(had)
            continue
        has = had & ~doubted
        if doubted.any():
            state.rejections.append(_rejected_there(name, doubted, stops(doubted), machine))
        if (negligible := _negligible(state, name, has)).any():
            why = "its contribution is negligible beside the remaining error of its chain"
            state.rejections.append(_rejected_there(name, negligible, why, machine))
            has = has & ~negligible
        if not (has == had).all():
            if (idle := _idle(state, has)).any():
                state.rejections.append(
                    _rejected_there(name, idle, "nothing was unexplained there without it", machine)
                )
            fewer[name] = has & ~idle
    if not fewer:
        return stages
    state.tick("rejecting ambiguous effects")
    gone = [s.added for s in named if s.added in fewer and not fewer[s.added].any()]
    rest = [n for n in state.names if n not in gone]
    point = state.current.point
    for name in gone:
        point = point.without(name)
    values = dict(point.values)
    for (name, parameter), row in point.values.items():
        if name in fewer:
            values[name, parameter] = np.where(fewer[name], row, neutral(name, parameter, machine))
    state.joints |= fewer
    fitted = refine_steps(state.problem, fit(state.problem, Point(values), rest, state.joints, most=3))
    return without_effects(state, stages, gone, fitted, state.rejections[0])


def without_effects(
    state: CalibrationState, stages: list[Stage], names: Sequence[str], fitted: Fit, why: str
) -> list[Stage]:
    """Return the stages without some effects, and set the state to a fit without them.

    Args:
        state: Of the calibration.
        stages: With the effects.
        names: Theirs.
        fitted: The fit.
        why: The reason that is reported where no other effect stays.
    """
    state.current, state.names = fitted, [n for n in state.names if n not in names]
    errors = errors_of(state.problem, fitted.residual)
    kept = [s for s in stages if s.added not in names]
    if any(s.added for s in kept):
        return [*kept[:-1], replace(kept[-1], errors=errors)]
    first = next(s for s in stages if s.added in names)
    tried = tuple(replace(c, accepted=False, why=why) if c.accepted else c for c in first.candidates)
    return [Stage(added="", errors=errors, candidates=tried)]


def on_a_bound(state: CalibrationState, fitted: Fit, stages: list[Stage]) -> bool:
    """Return whether a parameter at its bound makes a reported effect doubtful."""
    rows = _stops(state, fitted)
    named = [s.added for s in stages if s.added in state.names and not CATALOGUE[s.added].read_off]
    return any(_in_doubt(state, name, rows).any() for name in named)


def _stops(state: CalibrationState, fitted: Fit) -> Stops:
    """Return the parameters of a fit that are at their bounds."""
    far = stopped(fitted, state.problem, FAR_BEYOND)
    bent = [row for row in stopped(fitted, state.problem) if CATALOGUE[row[0].key[0]].baseline and row[1] != 0.0]
    return far, bent


def _in_doubt(state: CalibrationState, name: str, rows: Stops) -> BoolArray:
    """Return the joints (J,) where parameters at their bounds make an effect doubtful."""
    had, machine = state.joints[name], state.problem.machine
    doubtful, elsewhere = _chains(rows[0], machine), ~_chains(rows[1], machine)
    if (had & doubtful).any() or not (had & elsewhere).any():
        return had
    return np.zeros_like(had) if CATALOGUE[name].scope == "machine" else had & ~elsewhere


def _negligible(state: CalibrationState, name: str, has: BoolArray) -> BoolArray:
    """Return the joints (J,) where an effect's contribution is negligible beside the rest of its chain."""
    negligible, spec = np.zeros_like(has), CATALOGUE[name]
    if spec.scope == "machine":
        return negligible
    chain, before = state.problem.machine.chain, state.baseline[: len(has)]
    after = cross_validated(state.problem, state.current)[: len(has)]
    for c in np.unique(chain[has]):
        here, leg = has & (chain == c), chain == c
        takes, left = (before - after)[here].sum(), (after[leg] - 1.0).sum()
        if after[leg].max() > EXPLAINED**2 and takes < NEGLIGIBLE * left:
            negligible |= here
    return negligible


def _idle(state: CalibrationState, has: BoolArray) -> BoolArray:
    """Return the joints (J,) whose chain the baseline parameters already explain.

    A name may stand there that was found for what is elsewhere, and says nothing once it is rejected there.
    """
    machine = state.problem.machine
    left = state.baseline[: len(has)] > EXPLAINED**2
    return has & ~np.isin(machine.chain, machine.chain[left])


def _rejected_there(name: str, joints: BoolArray, why: str, machine: MachineModel) -> str:
    where = ", ".join(np.array(machine.joints)[joints])
    return f"{CATALOGUE[name].title} was rejected in {where}: {why}"


def _where_it_stops(row: tuple[FreeParameter, float], machine: MachineModel) -> str:
    free, bound = row
    where = "" if free.joint < 0 else f" of {machine.joints[free.joint]}, in the same chain,"
    return f"{free.key[0]}.{free.key[1]}{where} stops at its bound {bound:g}"


def _chains(rows: Sequence[tuple[FreeParameter, float]], machine: MachineModel) -> BoolArray:
    """Return the joints (J,) of the chains where a number stopped."""
    there = np.zeros(len(machine.joints), dtype=bool)
    for free, _ in rows:
        there |= True if free.joint < 0 else machine.chain == machine.chain[free.joint]
    return there
