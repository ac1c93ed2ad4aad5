"""Names are taken back where something else may stand behind them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mimic.calibrate.evidence import FAR_BEYOND, stopped
from mimic.calibrate.fit import Fit, fit
from mimic.calibrate.point import Knob, Point
from mimic.calibrate.remainder import EXPLAINED
from mimic.calibrate.settle import settle
from mimic.calibrate.state import Search, errors_of
from mimic.calibration import Stage
from mimic.robot.effects import CATALOGUE
from mimic.robot.machine import MachineModel
from mimic.robot.servo import neutral
from mimic.types import BoolArray

MOST_OF_IT = 0.75
"""Share of what noise does not explain that names take where they act, if more is left than could count; with less, what is there
may be something else."""

CRUMB = 0.1
"""Least ratio of what a name takes to what is left in the same chain."""

Stops = tuple[list[tuple[Knob, float]], list[tuple[Knob, float]]]
"""Numbers that stop far beyond their bound, and declared ones that stop at one; each with the bound."""


def only_what_is_sure(state: Search, stages: list[Stage]) -> list[Stage]:
    """Withdraw effects where something else may stand behind the name, with all that was found in the model.

    Far beyond its bound, any number of a chain puts the whole of its effects in doubt. A declared number that stops at a bound
    that the log would have it cross puts in doubt what they are in this chain: there they are withdrawn, elsewhere they stay. So
    are they where most of what is there is left.
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
            state.withdrawn.append(f"{CATALOGUE[name].title} explains something, but is not named: {stops(had)}")
            fewer[name] = np.zeros_like(had)
            continue
        has = had & ~doubted
        if doubted.any():
            state.withdrawn.append(_withdrawn(name, doubted, stops(doubted), machine))
        partly, share = _in_part(state, name, has)
        if partly.any():
            why = f"{100 * (1 - share):.0f} % of what noise does not explain is left there"
            state.withdrawn.append(_withdrawn(name, partly, why, machine))
            has = has & ~partly
        if (crumbs := _crumbs(state, name, has)).any():
            why = "much more than it takes is left in the same chain"
            state.withdrawn.append(_withdrawn(name, crumbs, why, machine))
            has = has & ~crumbs
        if not (has == had).all():
            if (idle := _idle(state, has)).any():
                state.withdrawn.append(_withdrawn(name, idle, "nothing was left there without it", machine))
            fewer[name] = has & ~idle
    if not fewer:
        return stages
    state.tick("withdrawing what is not sure")
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
    fitted = settle(state.problem, fit(state.problem, Point(values), rest, state.joints, most=3))
    return take_back(state, stages, gone, fitted, state.withdrawn[0])


def take_back(state: Search, stages: list[Stage], names: Sequence[str], fitted: Fit, why: str) -> list[Stage]:
    """Return the stages without some effects, and leave the state at a fit without them.

    Args:
        state: Of the calibration.
        stages: With the effects.
        names: Theirs.
        fitted: The fit.
        why: What is told of them where no other effect stays.
    """
    state.current, state.names = fitted, [n for n in state.names if n not in names]
    errors = errors_of(state.problem, fitted.residual)
    kept = [s for s in stages if s.added not in names]
    if any(s.added for s in kept):
        return [*kept[:-1], replace(kept[-1], errors=errors)]
    first = next(s for s in stages if s.added in names)
    tried = tuple(replace(c, accepted=False, why=why) if c.accepted else c for c in first.candidates)
    return [Stage(added="", errors=errors, candidates=tried)]


def on_a_bound(state: Search, fitted: Fit, stages: list[Stage]) -> bool:
    """Return whether an effect is named where a number of a fit stops at a bound that puts it in doubt."""
    rows = _stops(state, fitted)
    named = [s.added for s in stages if s.added in state.names and not CATALOGUE[s.added].read_off]
    return any(_in_doubt(state, name, rows).any() for name in named)


def _stops(state: Search, fitted: Fit) -> Stops:
    """Return the numbers of a fit that stop."""
    far = stopped(fitted, state.problem, FAR_BEYOND)
    bent = [row for row in stopped(fitted, state.problem) if CATALOGUE[row[0].key[0]].declared and row[1] != 0.0]
    return far, bent


def _in_doubt(state: Search, name: str, rows: Stops) -> BoolArray:
    """Return the joints (J,) where such numbers put an effect in doubt."""
    had, machine = state.joints[name], state.problem.machine
    doubtful, elsewhere = _chains(rows[0], machine), ~_chains(rows[1], machine)
    if (had & doubtful).any() or not (had & elsewhere).any():
        return had
    return np.zeros_like(had) if CATALOGUE[name].scope == "machine" else had & ~elsewhere


def _in_part(state: Search, name: str, has: BoolArray) -> tuple[BoolArray, float]:
    """Return the joints (J,) with an effect in whose chain most of what it should explain is left, and the least share taken.

    An effect that others stand in for takes a part of the residual, and the right name nearly all. Measured on 136 hidden
    machines (docs/calibration.md): wrong names took 38 to 73 %, right ones beside which something was left 86 % and more.
    """
    partly, least, spec = np.zeros_like(has), 1.0, CATALOGUE[name]
    chain = state.problem.machine.chain
    before = state.declared[: len(has)]
    after = state.problem.mean_squares(state.current.residual, True)[: len(has)]
    for here in [has] if spec.scope == "machine" else [has & (chain == c) for c in np.unique(chain[has])]:
        share = 1.0 - float((after[here] - 1.0).sum() / max((before[here] - 1.0).sum(), 1e-9))
        if share < MOST_OF_IT and after[here].max() > EXPLAINED**2:
            partly |= here
            least = min(least, share)
    return partly, least


def _crumbs(state: Search, name: str, has: BoolArray) -> BoolArray:
    """Return the joints (J,) with an effect that takes little beside what is left in their chain: the model is wrong there."""
    crumbs, spec = np.zeros_like(has), CATALOGUE[name]
    if spec.scope == "machine":
        return crumbs
    chain, before = state.problem.machine.chain, state.declared[: len(has)]
    after = state.problem.mean_squares(state.current.residual, True)[: len(has)]
    for c in np.unique(chain[has]):
        here, leg = has & (chain == c), chain == c
        takes, left = (before - after)[here].sum(), (after[leg] - 1.0).sum()
        if after[leg].max() > EXPLAINED**2 and takes < CRUMB * left:
            crumbs |= here
    return crumbs


def _idle(state: Search, has: BoolArray) -> BoolArray:
    """Return the joints (J,) in whose chain the declared numbers left nothing that an effect could explain.

    A name may stand there that was found for what is elsewhere, and says nothing once it is withdrawn there.
    """
    machine = state.problem.machine
    left = state.declared[: len(has)] > EXPLAINED**2
    return has & ~np.isin(machine.chain, machine.chain[left])


def _withdrawn(name: str, joints: BoolArray, why: str, machine: MachineModel) -> str:
    where = ", ".join(np.array(machine.joints)[joints])
    return f"{CATALOGUE[name].title} explains something in {where}, but is not named there: {why}"


def _where_it_stops(row: tuple[Knob, float], machine: MachineModel) -> str:
    knob, bound = row
    where = "" if knob.joint < 0 else f" of {machine.joints[knob.joint]}, in the same chain,"
    return f"{knob.key[0]}.{knob.key[1]}{where} stops at its bound {bound:g}"


def _chains(rows: Sequence[tuple[Knob, float]], machine: MachineModel) -> BoolArray:
    """Return the joints (J,) of the chains where a number stopped."""
    there = np.zeros(len(machine.joints), dtype=bool)
    for knob, _ in rows:
        there |= True if knob.joint < 0 else machine.chain == machine.chain[knob.joint]
    return there
