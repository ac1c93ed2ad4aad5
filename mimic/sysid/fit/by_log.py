"""Errors in the unit of the log: of all, and of each of several logs, also by what the others say alone."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mimic.records import BoolArray, FloatArray
from mimic.sysid.fit.step_refinement import in_fine_steps
from mimic.sysid.least_squares import Fit, fit
from mimic.sysid.residuals import Problem
from mimic.sysid.result import Errors, LogErrors

LEAST_LOGS = 3
"""Fewest logs of which each is left out once."""

REFITS = 4
"""Most steps of a fit without one of the logs."""


def errors_of(problem: Problem, residual: FloatArray) -> Errors:
    """Return the errors of each joint [rad or m] of a residual (T, C) in noise floors."""
    joints = len(problem.machine.joints)
    scale, residual = problem.noise[:joints], problem.in_floors(residual)
    train, held = (np.sqrt(problem.mean_squares(residual, side)[:joints]) * scale for side in (False, True))
    return Errors(train=train, held_out=held)


def errors_by_log(problem: Problem, before: Fit, final: Fit, where: Mapping[str, BoolArray]) -> tuple[LogErrors, ...]:
    """Return the errors of each fitted log; of three or more also under a fit to the others.

    Args:
        problem: All logs, and their model.
        before: The fit of the baseline parameters.
        final: That of everything.
        where: Joints that have an effect.
    """
    parts, found = problem.replay.parts, []
    alone = len(parts) >= LEAST_LOGS
    for part in parts:
        here = np.zeros(len(problem.replay.log.t), dtype=bool)
        here[part.slice] = True
        unseen = [
            _rms(problem, _without(problem, one, where, here), here) if alone else None for one in (before, final)
        ]
        found.append(
            LogErrors(
                name=part.name,
                fitted=True,
                baseline=_rms(problem, before.residual, here),
                final=_rms(problem, final.residual, here),
                left_out_baseline=unseen[0],
                left_out_final=unseen[1],
            )
        )
    return tuple(found)


def errors_of_unseen(unseen: Problem, before: Fit, final: Fit) -> tuple[LogErrors, ...]:
    """Return the errors of logs that nothing was fitted to."""
    left = [in_fine_steps(unseen, one.point) for one in (before, final)]
    found = []
    for part in unseen.replay.parts:
        here = np.zeros(len(unseen.replay.log.t), dtype=bool)
        here[part.slice] = True
        baseline, after = (_rms(unseen, residual, here) for residual in left)
        found.append(LogErrors(name=part.name, fitted=False, baseline=baseline, final=after))
    return tuple(found)


def _rms(problem: Problem, residual: FloatArray, rows: BoolArray) -> FloatArray:
    """Return the root mean square of the positions in some rows (J,), in the unit of the log."""
    joints = len(problem.machine.joints)
    inside = problem.in_floors(residual)[rows & (problem.blocks.index >= 0), :joints].astype(np.float64)
    return np.sqrt(np.nanmean(inside**2, axis=0)) * problem.noise[:joints]


def _without(problem: Problem, fitted: Fit, where: Mapping[str, BoolArray], rows: BoolArray) -> FloatArray:
    """Return the residual (T, C) of a fit to all but some rows."""
    names = list(dict.fromkeys(name for name, _ in fitted.point.values))
    return fit(problem.holding_out(rows), fitted.point, names, where, most=REFITS).residual
