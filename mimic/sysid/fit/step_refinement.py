"""Step-size refinement: fits that converge on fine steps and correct all coarse ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mimic.dynamics.catalogue import CATALOGUE
from mimic.records import BoolArray, FloatArray
from mimic.sysid.least_squares import Asking, Fit, answered, best_of_chains, chain_costs, fit, solve
from mimic.sysid.residuals import Point, Problem

FINE = 5
"""A fine replay has this many times more steps."""

FINE_SEGMENT = 1.0
"""Length of its segments [s]; they are few, so that short ones are faster."""

MANY_SEGMENT = 3.0
"""That of the many for central differences [s]: less time is spent on settling."""

MOST_CORRECTIONS = 8
"""Most steps of a fit from fine replays."""

MOST_EXTRAPOLATIONS = 3
"""Most times that it finds anew what steps without length would change."""

ENOUGH = 1.0
"""Standard deviations of all numbers together by which a step of such a fit still moves when it is the last."""

LEAST_FALL = 5e-5
"""Share by which the sum of squares falls in a step that is worth another."""


def in_fine_steps(problem: Problem, point: Point) -> FloatArray:
    """Return the residual (T, C) of a replay in fine steps."""
    return problem.in_fine_steps(point, FINE, FINE_SEGMENT)


def corrected(problem: Problem, point: Point) -> Problem:
    """Return the problem whose residuals are corrected by the error of coarse steps at this point."""
    return problem.changed(correction=in_fine_steps(problem, point) - problem.uncorrected([point])[0])


def compared(
    problem: Problem, fitted: Fit, names: Sequence[str], where: Mapping[str, BoolArray]
) -> tuple[Problem, Fit]:
    """Return problem and baseline fit again, with coarse steps corrected by fine ones."""
    joints = len(problem.machine.joints)
    for _ in range(2):
        if (weighed := problem.weighed(fitted.residual)) is problem:
            break
        problem = weighed
        fitted = fit(problem, fitted.point, names, where, most=3)
    if problem.channels > joints:
        problem = corrected(problem, fitted.point)
        assert problem.correction is not None
        unsure = np.sqrt(np.nanmean(problem.correction[:, joints:] ** 2, axis=0)) * problem.noise[joints:] / 2
        problem = corrected(problem.with_torque_noise(unsure), fitted.point)
        fitted = fit(problem, fitted.point, names, where, most=3)
    return refine_steps(problem, fitted)


def refine_steps(problem: Problem, fitted: Fit, every: bool = False) -> tuple[Problem, Fit]:
    """Return the fit converged in fine steps, and the problem whose coarse replays are corrected by the difference.

    Derivatives with respect to times are those of fine replays: in coarse steps that of the delay is off by half, the
    others by a few hundredths, and steps were too short and what they did not reach seemed sure.
    """
    timed = [k for k in fitted.free_parameters if every or CATALOGUE[k.key[0]].parameter(k.key[1]).unit == "s"]
    segment = MANY_SEGMENT if every else FINE_SEGMENT
    fine = problem.columns_in_fine_steps(fitted.point, timed, FINE, segment, every)
    known = {(k.key, k.joint): column for k, column in zip(timed, fine, strict=True)}
    columns = [known.get((k.key, k.joint), own) for k, own in zip(fitted.free_parameters, fitted.columns, strict=True)]
    settled = _converged(problem, replace(fitted, columns=tuple(columns)))
    return problem.changed(correction=settled.residual - problem.uncorrected([settled.point])[0]), settled


def refined(problem: Problem, fits: Sequence[Fit]) -> list[Fit]:
    """Return fits after a step from the residuals of fine replays, which they share."""

    def replayed(points: Sequence[Point]) -> FloatArray:
        return problem.all_in_fine_steps(points, FINE, FINE_SEGMENT)

    if not fits:
        return []
    begun = zip(fits, replayed([one.point for one in fits]), strict=True)
    stepping = [_stepping(problem, replace(one, residual=residual), 1) for one, residual in begun]
    return [_summed(problem, one) for one in answered(replayed, stepping)]


def _converged(problem: Problem, fitted: Fit) -> Fit:
    """Return the fit converged on the residuals of fine replays.

    What an extrapolation to steps without length changes is taken for the same on the way, and found anew where they
    settle.
    """
    fitted = replace(fitted, residual=in_fine_steps(problem, fitted.point))
    for again in range(MOST_EXTRAPOLATIONS):
        beyond = fitted.residual - problem.in_steps_of_columns(fitted.point, FINE, FINE_SEGMENT)
        stepping = _stepping(problem, fitted, MOST_CORRECTIONS, _enough(problem, fitted) if again else 0.0)
        (there,) = answered(
            lambda points, beyond=beyond: np.stack(
                [problem.in_steps_of_columns(point, FINE, FINE_SEGMENT) + beyond for point in points]
            ),
            [stepping],
        )
        if there.point.is_at(fitted.point):
            break
        there = replace(there, residual=in_fine_steps(problem, there.point))
        if not _cost(problem, there) < _cost(problem, fitted):
            break
        fitted = there
    return _summed(problem, fitted)


def _summed(problem: Problem, fitted: Fit) -> Fit:
    return replace(fitted, sums=problem.sums(fitted.residual, fitted.columns, fitted.free_parameters))


def _stepping(problem: Problem, fitted: Fit, most: int, worth: float = 0.0) -> Asking:
    """Ask for replays on the way along the derivatives of a fit, and return where it leads, with its sums as they were.

    Args:
        problem: Log and model.
        fitted: Where to begin.
        most: Most steps.
        worth: Fall of the sum of squares that a linear model must promise for the first of them.
    """
    train = problem.blocks.train
    point, residual = fitted.point, fitted.residual
    costs = chain_costs(problem, point, residual, fitted.free_parameters)
    cost = float(problem.weight @ costs)
    enough = _enough(problem, fitted)
    for _ in range(most):
        sums = problem.sums(residual, fitted.columns, fitted.free_parameters)
        hessian, gradient = sums.weighed_over(train)
        step = solve(sums, train, fitted.free_parameters, point.read(fitted.free_parameters), 0.0)
        promised = float(step @ (2.0 * gradient - hessian @ step))
        if promised < worth:
            break
        moved = point.moved(fitted.free_parameters, step)
        after = (yield [moved])[0]
        now = chain_costs(problem, moved, after, fitted.free_parameters)
        part = best_of_chains(problem, fitted.free_parameters, [np.zeros_like(step), step], [costs, now])
        if part is not None and np.any(costs < now - enough):  # the step is too long for some chains: they wait
            moved = point.moved(fitted.free_parameters, part)
            after = (yield [moved])[0]
            now = chain_costs(problem, moved, after, fitted.free_parameters)
        before, least = cost, float(problem.weight @ now)
        if not least < cost:
            break
        point, residual, costs, cost = moved, after, now, least
        if max(promised, before - cost) < enough:
            break
    return replace(fitted, point=point, residual=residual)


def _cost(problem: Problem, fitted: Fit) -> float:
    return float(problem.weight @ chain_costs(problem, fitted.point, fitted.residual, fitted.free_parameters))


def _enough(problem: Problem, fitted: Fit) -> float:
    """Return the fall of the sum of squares in a step that is worth another."""
    readings = max(int(np.isin(problem.blocks.index, problem.blocks.train).sum()) * problem.channels, 1)
    cost = _cost(problem, fitted)
    return max(ENOUGH**2 * max(cost / readings, 1.0), LEAST_FALL * cost)
