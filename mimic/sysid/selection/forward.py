"""Forward selection: one effect at a time, while it pays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.law import STIFFEST
from mimic.records import BoolArray
from mimic.sysid.fit.least_squares import Fit, fit_all, fitting, left_out
from mimic.sysid.fit.point import Point
from mimic.sysid.fit.residuals import Problem
from mimic.sysid.fit.step_refinement import FINE, FINE_SEGMENT, correct, refine_steps, refined
from mimic.sysid.fit.uncertainty import deviations
from mimic.sysid.result import Stage
from mimic.sysid.selection.evidence import LEAST_IMPROVEMENT, TriedEffect, earns_its_keep, lasts, present
from mimic.sysid.selection.jitter import Timing
from mimic.sysid.selection.late_targets import fit_delay_per_command
from mimic.sysid.selection.pruning import on_a_bound, reject_doubtful, without_effects
from mimic.sysid.selection.screening import predicted
from mimic.sysid.selection.search import SHARED, StageResult, further, on_its_joints, search, whole_chains, wider
from mimic.sysid.state import CalibrationState, errors_of

MOST_FITTED = 3
"""Effects that are fitted to the end at a stage before nothing is named."""

AGAIN = 3
"""Rounds of finding when each target acted, once fine steps correct the coarse ones."""

AS_WITHOUT = "in the final fit its parameters are those of a machine without it"

SOFT = 0.1
"""Greatest compliance that the law gives all transmissions with play, times Kp: with stiffer drives it would be an
elasticity of its own.
"""


def forward_selection(state: CalibrationState) -> list[Stage]:
    """Add effects while they pay; return a stage for each, or one unnamed stage if none does."""
    stages: list[Stage] = []
    for _ in range(state.settings.most_effects):
        if _explained(state):
            break
        motion = predicted(state.problem, state.current)
        state.problem.warm_up(state.current.point, FINE, FINE_SEGMENT)
        found = search(
            state.problem,
            state.current,
            state.names,
            state.joints,
            motion,
            _candidates(state),
            state.tick,
            lambda fitted: refined(state.problem, fitted),
        )
        if found.best is None:
            state.base = found.base
            if stages:
                break
            stages.append(_nothing(state, found))
            break
        accepted, refused = _first_that_lasts(state, found)
        if accepted is None:
            if not stages:
                stages.append(_nothing(state, replace(found, tried=refused)))
            break
        found = replace(found, best=accepted[0], tried=refused)
        best = accepted[1]
        state.names.append(best.name)
        state.joints[best.name] = best.joints
        stages.append(
            Stage(
                added=best.name,
                errors=errors_of(state.problem, state.current.residual),
                candidates=tuple(t.candidate(state.problem, found.best) for t in found.tried),
                alternatives=tuple(n for n in found.alternatives if n != best.name),
            )
        )
    return reject_doubtful(state, _kept(state, stages))


def _candidates(state: CalibrationState) -> list[str]:
    allowed = state.settings.effects or tuple(n for n, e in CATALOGUE.items() if not e.by_request)
    machine = state.problem.machine
    out = set(state.names)
    if any(CATALOGUE[n].random for n in state.names):  # one law of late targets is enough
        out |= {n for n in allowed if CATALOGUE[n].random}
    if (np.asarray(machine.drives.neighbour) == np.arange(len(machine.joints))).all():
        out.add("coupling")  # to itself it is viscous friction
    if len(machine.joints) == 1:
        out.add("joint_delay")  # the delay of the machine
    if np.max(machine.drives.kp) * STIFFEST > SOFT:
        out |= {"backlash", "compliance"}
    return [n for n in allowed if n not in out and not CATALOGUE[n].baseline]


def _explained(state: CalibrationState) -> bool:
    """Return whether no remaining error is large enough to count."""
    squares = state.problem.mean_squares(state.current.residual, False)
    return bool(np.all(squares < 1.0 + LEAST_IMPROVEMENT**2))


def _first_that_lasts(
    state: CalibrationState, found: StageResult
) -> tuple[tuple[TriedEffect, TriedEffect] | None, tuple[TriedEffect, ...]]:
    """Return the first candidate that survives its final fit (as found, as fitted), and all tried."""
    problem, before, tried = state.problem, state.current, found.tried
    correction, weight = problem.correction, problem.weight
    for candidate in (found.best, *found.others)[:MOST_FITTED]:
        if candidate is None:
            break
        best = candidate if candidate.timing is None else _on_time(state, candidate, candidate.timing)
        correct(problem, best.fitted.point)
        problem.weigh(best.fitted.residual)
        best, state.current = _where_it_is(state, best)
        best, state.current = _elsewhere_too(state, best)
        why = "in the final fit it does not lower the held-out error"
        bare = None
        if lasts(problem, before, state.current, best):
            bare = _as_good_without(state, best.name, best.joints)
            if bare is None:
                return (candidate, best), tried
            why = AS_WITHOUT
        tried = tuple(replace(t, why=why) if t is candidate else t for t in tried)
        state.current, problem.correction, problem.weight = before, correction, weight
        if bare is not None:  # what it found was a better fit of the others
            problem.weigh(bare.residual)
            settled = refine_steps(problem, bare)
            if _squares(problem, settled) < _squares(problem, before):
                state.current = before = settled
                correction, weight = problem.correction, problem.weight
            else:
                problem.correction, problem.weight = correction, weight
    return None, tried


def _as_good_without(state: CalibrationState, name: str, joints: BoolArray) -> Fit | None:
    """Return a fit without an effect that is significant on no joint, if it is as good; else None."""
    problem, current = state.problem, state.current
    if CATALOGUE[name].random:
        return None
    deviation = deviations(current, problem, left_out(current, problem)[1])
    if present(problem, current, name, joints, deviation).any():
        return None
    rest = _best_without(state, name, [n for n in state.names if n != name])
    return None if earns_its_keep(problem, current, rest) else rest


def prune(state: CalibrationState, final: Fit, stages: list[Stage]) -> list[Stage] | None:
    """Return the stages without effects that the last fit makes doubtful; None if there are none.

    It may have moved a number onto a bound, or have found what an effect had made up for.
    """
    state.current = final
    if on_a_bound(state, final, stages):
        return reject_doubtful(state, stages)
    for name in [s.added for s in stages if s.added and not CATALOGUE[s.added].read_off]:
        bare = _as_good_without(state, name, state.joints[name])
        if bare is not None:
            state.rejections.append(f"{CATALOGUE[name].title} was rejected: {AS_WITHOUT}")
            return without_effects(state, stages, [name], bare, state.rejections[-1])
    return None


def _where_it_is(state: CalibrationState, best: TriedEffect) -> tuple[TriedEffect, Fit]:
    """Return the accepted effect on the joints where fine steps still show it, and that fit."""
    problem = state.problem
    best = replace(best, joints=whole_chains(problem, best.name, best.joints))
    settled = refine_steps(problem, on_its_joints(problem, best, state.names, state.joints))
    if (best.allowed & ~best.joints).any() and earns_its_keep(problem, best.fitted, settled):
        best = replace(best, joints=best.allowed)  # its numbers were not sure yet, but it is missed where they were not
        settled = refine_steps(problem, on_its_joints(problem, best, state.names, state.joints))
    deviation = deviations(settled, problem, left_out(settled, problem)[1])
    there = whole_chains(problem, best.name, present(problem, settled, best.name, best.joints, deviation))
    if not there.any() or (there == best.joints).all():
        return best, settled
    fewer = replace(best, fitted=settled, joints=there)
    correction = problem.correction
    narrow = refine_steps(problem, on_its_joints(problem, fewer, state.names, state.joints))
    if earns_its_keep(problem, settled, narrow):  # not sure of any one of these joints, but missed without all of them
        problem.correction = correction
        return best, settled
    return fewer, narrow


def _elsewhere_too(state: CalibrationState, best: TriedEffect) -> tuple[TriedEffect, Fit]:
    """Return the accepted effect on further joints if it explains their residual, and that fit."""
    problem, joints = state.problem, {**state.joints, best.name: best.joints}
    more = further(problem, state.current, best.name, best.joints)
    if not more.any():
        return best, state.current
    state.tick(f"trying {CATALOGUE[best.name].title} on other joints")
    found = wider(problem, state.current, best.name, [*state.names, best.name], joints, more)
    if found is None:
        return best, state.current
    best = replace(best, fitted=found[0], joints=whole_chains(problem, best.name, found[1]))
    correct(problem, best.fitted.point)
    return best, refine_steps(problem, on_its_joints(problem, best, state.names, state.joints))


def _on_time(state: CalibrationState, best: TriedEffect, timing: Timing) -> TriedEffect:
    """Fit the delay of each command in fine steps; return the effect with the parameters that go with it."""
    state.problem.replay.set_late(timing.late)
    correct(state.problem, best.fitted.point)
    state.tick("fitting the delay of each command")
    timing = replace(timing, point=best.fitted.point)
    timing, fitted = fit_delay_per_command(state.problem, timing, state.names, state.joints, AGAIN)
    state.intervals[timing.name] = timing.interval
    state.unsure["delay", "time"] = timing.unsure
    return replace(best, fitted=fitted, timing=timing)


def _nothing(state: CalibrationState, found: StageResult) -> Stage:
    return Stage(
        added="",
        errors=errors_of(state.problem, state.current.residual),
        candidates=tuple(t.candidate(state.problem, None) for t in found.tried),
    )


def _kept(state: CalibrationState, stages: list[Stage]) -> list[Stage]:
    """Drop effects that no longer pay beside later ones."""
    added = [s.added for s in stages if s.added]
    for name in [n for n in added[:-1] if not CATALOGUE[n].read_off]:
        state.tick(f"checking that {CATALOGUE[name].title} is still needed")
        rest = [n for n in state.names if n != name]
        without = _best_without(state, name, rest)
        if not earns_its_keep(state.problem, state.current, without):
            state.current, state.names = without, rest
            stages = [s for s in stages if s.added != name]
    return stages


def _best_without(state: CalibrationState, name: str, rest: list[str]) -> Fit:
    """Return the fit of the rest of the effects, from what they are now."""
    starts = _without(state.current.point, name)
    fits = fit_all(state.problem, [fitting(state.problem, p, rest, state.joints, most=3) for p in starts])
    return min(fits, key=lambda f: _squares(state.problem, f))


def _squares(problem: Problem, fitted: Fit) -> float:
    """Return the sum of squares in the fitted blocks."""
    return float(problem.block_squares(fitted.residual)[problem.blocks.train].sum())


def _without(point: Point, name: str) -> list[Point]:
    """Return the starts of fits without an effect.

    That number may be far off by now: while something large was not in the model yet, it was bent to make up for that,
    and the effect set it right.
    """
    bare = point.without(name)
    starts = [bare]
    for (name_of, parameter), shared in SHARED.items():
        if name_of == name and shared in bare.values:
            alike = bare.values[shared] + np.median(point.values[name_of, parameter])
            starts.append(Point({**bare.values, shared: alike}))
    return starts
