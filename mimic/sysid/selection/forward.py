"""The model grows by one effect at a time, as long as that pays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mimic.calibrate.diagnose import SHARED, Found, further, pruned, search, whole_chains, wider
from mimic.calibrate.events import Timing
from mimic.calibrate.evidence import LEAST_IMPROVEMENT, Tried, earns_its_keep, lasts, present
from mimic.calibrate.fit import Fit, deviations, fit_all, fitting, left_out
from mimic.calibrate.late import arrivals
from mimic.calibrate.point import Point
from mimic.calibrate.problem import Problem
from mimic.calibrate.screen import predicted
from mimic.calibrate.settle import FINE, FINE_SEGMENT, correct, refined, settle
from mimic.calibrate.state import Search, errors_of
from mimic.calibrate.withdraw import on_a_bound, only_what_is_sure, take_back
from mimic.calibration import Stage
from mimic.robot.effects import CATALOGUE
from mimic.robot.law import STIFFEST
from mimic.types import BoolArray

MOST_FITTED = 3
"""Effects that are fitted to the end at a stage before nothing is named."""

AGAIN = 3
"""Rounds of finding when each target acted, once fine steps correct the coarse ones."""

AS_WITHOUT = "fitted to the end its numbers are those of a machine without it"

SOFT = 0.1
"""Greatest compliance that the law gives all transmissions with play, times Kp: with stiffer drives it would be an elasticity of its own."""


def grow(state: Search) -> list[Stage]:
    """Add the effects that pay, and return a stage for each; one without a name where none does."""
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
                rivals=tuple(n for n in found.rivals if n != best.name),
            )
        )
    return only_what_is_sure(state, _kept(state, stages))


def _candidates(state: Search) -> list[str]:
    allowed = state.settings.effects or tuple(CATALOGUE)
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
    return [n for n in allowed if n not in out and not CATALOGUE[n].declared]


def _explained(state: Search) -> bool:
    """Nothing that could still be found would be large enough to count."""
    squares = state.problem.mean_squares(state.current.residual, False)
    return bool(np.all(squares < 1.0 + LEAST_IMPROVEMENT**2))


def _first_that_lasts(state: Search, found: Found) -> tuple[tuple[Tried, Tried] | None, tuple[Tried, ...]]:
    """Return the first of the effects found that pays when it is fitted to the end, as it was found and as it is then, with
    the search at that fit; and all that were tried, those that did not with the reason."""
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
        why = "fitted to the end it leaves no less on blocks that were held out"
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
            settled = settle(problem, bare)
            if _squares(problem, settled) < _squares(problem, before):
                state.current = before = settled
                correction, weight = problem.correction, problem.weight
            else:
                problem.correction, problem.weight = correction, weight
    return None, tried


def _as_good_without(state: Search, name: str, joints: BoolArray) -> Fit | None:
    """Return the fit without an effect of these joints (J,) that is nowhere sure to be there, if that is as good; else None."""
    problem, current = state.problem, state.current
    if CATALOGUE[name].random:
        return None
    deviation = deviations(current, problem, left_out(current, problem)[1])
    if present(problem, current, name, joints, deviation).any():
        return None
    rest = _best_without(state, name, [n for n in state.names if n != name])
    return None if earns_its_keep(problem, current, rest) else rest


def taken_back(state: Search, final: Fit, stages: list[Stage]) -> list[Stage] | None:
    """Return the stages without names that the last fit puts in doubt, and leave the state at a fit without them; None, and the
    state at the last fit, if it does none.

    It may have moved a number onto a bound, or have found what an effect had made up for.
    """
    state.current = final
    if on_a_bound(state, final, stages):
        return only_what_is_sure(state, stages)
    for name in [s.added for s in stages if s.added and not CATALOGUE[s.added].read_off]:
        bare = _as_good_without(state, name, state.joints[name])
        if bare is not None:
            state.withdrawn.append(f"{CATALOGUE[name].title} explains something, but is not named: {AS_WITHOUT}")
            return take_back(state, stages, [name], bare, state.withdrawn[-1])
    return None


def _where_it_is(state: Search, best: Tried) -> tuple[Tried, Fit]:
    """Return the accepted effect on the joints where fine steps still show it, and the fit with it there."""
    problem = state.problem
    best = replace(best, joints=whole_chains(problem, best.name, best.joints))
    settled = settle(problem, pruned(problem, best, state.names, state.joints))
    if (best.allowed & ~best.joints).any() and earns_its_keep(problem, best.fitted, settled):
        best = replace(best, joints=best.allowed)  # its numbers were not sure yet, but it is missed where they were not
        settled = settle(problem, pruned(problem, best, state.names, state.joints))
    deviation = deviations(settled, problem, left_out(settled, problem)[1])
    there = whole_chains(problem, best.name, present(problem, settled, best.name, best.joints, deviation))
    if not there.any() or (there == best.joints).all():
        return best, settled
    fewer = replace(best, fitted=settled, joints=there)
    correction = problem.correction
    narrow = settle(problem, pruned(problem, fewer, state.names, state.joints))
    if earns_its_keep(problem, settled, narrow):  # not sure of any one of these joints, but missed without all of them
        problem.correction = correction
        return best, settled
    return fewer, narrow


def _elsewhere_too(state: Search, best: Tried) -> tuple[Tried, Fit]:
    """Return the accepted effect on further joints, if it explains what is left there, and the fit with it there."""
    problem, joints = state.problem, {**state.joints, best.name: best.joints}
    more = further(problem, state.current, best.name, best.joints)
    if not more.any():
        return best, state.current
    state.tick(f"{CATALOGUE[best.name].title} elsewhere too")
    found = wider(problem, state.current, best.name, [*state.names, best.name], joints, more)
    if found is None:
        return best, state.current
    best = replace(best, fitted=found[0], joints=whole_chains(problem, best.name, found[1]))
    correct(problem, best.fitted.point)
    return best, settle(problem, pruned(problem, best, state.names, state.joints))


def _on_time(state: Search, best: Tried, timing: Timing) -> Tried:
    """Let each target act when it did, as fine steps show it, and return the effect with the numbers that go with that."""
    state.problem.replay.set_late(timing.late)
    correct(state.problem, best.fitted.point)
    state.tick("when each target acted")
    timing = replace(timing, point=best.fitted.point)
    timing, fitted = arrivals(state.problem, timing, state.names, state.joints, AGAIN)
    state.intervals[timing.name] = timing.interval
    state.unsure["delay", "time"] = timing.unsure
    return replace(best, fitted=fitted, timing=timing)


def _nothing(state: Search, found: Found) -> Stage:
    return Stage(
        added="",
        errors=errors_of(state.problem, state.current.residual),
        candidates=tuple(t.candidate(state.problem, None) for t in found.tried),
    )


def _kept(state: Search, stages: list[Stage]) -> list[Stage]:
    """Drop effects that no longer pay beside those found after them."""
    added = [s.added for s in stages if s.added]
    for name in [n for n in added[:-1] if not CATALOGUE[n].read_off]:
        state.tick(f"is {CATALOGUE[name].title} still needed")
        rest = [n for n in state.names if n != name]
        without = _best_without(state, name, rest)
        if not earns_its_keep(state.problem, state.current, without):
            state.current, state.names = without, rest
            stages = [s for s in stages if s.added != name]
    return stages


def _best_without(state: Search, name: str, rest: list[str]) -> Fit:
    """Return the fit of the rest of the effects, from what they are now."""
    starts = _without(state.current.point, name)
    fits = fit_all(state.problem, [fitting(state.problem, p, rest, state.joints, most=3) for p in starts])
    return min(fits, key=lambda f: _squares(state.problem, f))


def _squares(problem: Problem, fitted: Fit) -> float:
    """Return the sum of squares in the fitted blocks."""
    return float(problem.block_squares(fitted.residual)[problem.blocks.train].sum())


def _without(point: Point, name: str) -> list[Point]:
    """Return where fits without an effect begin: at what the others are, and with what it was alike in all joints put
    into the declared number that all joints share.

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
