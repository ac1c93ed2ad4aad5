"""The least-squares problem of a log and a model, the fit of the baseline parameters, fits that converge on fine steps
and correct all coarse ones, and the errors of logs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mimic.config.sysid import CalibrateSettings
from mimic.dynamics.machine import MachineModel
from mimic.io.joint_log import JointLog
from mimic.records import BoolArray, FloatArray
from mimic.sysid.fit.least_squares import MOST_STEPS, Asking, Fit, fit, fit_all, fitting
from mimic.sysid.fit.problem import WIDE, Key, Point, Problem
from mimic.sysid.fit.replay import Replay, physics_step
from mimic.sysid.log.noise import coarse_steps, noise_floor
from mimic.sysid.log.pool import Part, Pool, enabled, make_blocks, pool, valid_samples
from mimic.sysid.result import Errors, LogErrors

Fitted = tuple[Fit, Sequence[str], Mapping[str, BoolArray]]
"""A fit, with the effects that it has and the joints that have each."""


def corrected_at(problem: Problem, points: Sequence[Point]) -> list[Problem]:
    """Return the problem, for each point, whose residuals are corrected by the error of coarse steps there."""
    errors = problem.in_fine_steps(points) - problem.uncorrected(points)
    return [problem.changed(correction=error) for error in errors]


def settled(problem: Problem, fits: Sequence[Fitted]) -> list[tuple[Problem, Fit]]:
    """Return fits along the derivatives that they have, each with the problem that is corrected by fine steps near it.

    Once more where numbers moved further than their derivatives were taken over.
    """
    made, left = [(problem, f) for f, _, _ in fits], list(range(len(fits)))
    for _ in range(2):
        near = corrected_at(problem, [made[i][1].point for i in left])
        asked = [
            fitting(own, made[i][1].point, *fits[i][1:], most=1, frozen=made[i][1], every=0)
            for i, own in zip(left, near, strict=True)
        ]
        again = []
        for i, own, after in zip(left, near, fit_all(problem, asked), strict=True):
            if moved(made[i][1], after):
                again.append(i)
            made[i] = own, after
        if not (left := again):
            break
    return made


def moved(before: Fit, after: Fit) -> bool:
    """Return whether a number of a fit moved further than its derivative was taken over."""
    size = np.array([k.step for k in after.free_parameters])
    by = after.point.read(after.free_parameters) - before.point.read(after.free_parameters)
    return not np.all(np.abs(by) <= WIDE * size)


def with_fine_derivatives(problem: Problem, fitted: Fit) -> Fit:
    """Return a fit with central differences in fine steps: in coarse ones that of a delay is off by half."""
    columns = tuple(problem.columns_in_fine_steps(fitted.point, fitted.free_parameters))
    return replace(fitted, columns=columns, sums=problem.sums(fitted.residual, columns, fitted.free_parameters))


def compared(
    problem: Problem, fitted: Fit, names: Sequence[str], where: Mapping[str, BoolArray]
) -> tuple[Problem, Fit]:
    """Return problem and baseline fit again, with coarse steps corrected by fine ones."""
    joints = problem.joints
    for _ in range(2):
        if (weighed := problem.weighed(fitted.residual)) is problem:
            break
        problem = weighed
        fitted = fit(problem, fitted.point, names, where, most=3)
    if problem.channels > joints:
        (problem,) = corrected_at(problem, [fitted.point])
        assert problem.correction is not None
        unsure = np.sqrt(np.nanmean(problem.correction[:, joints:] ** 2, axis=0)) * problem.noise[joints:] / 2
        noise = np.concatenate([problem.noise[:joints], np.maximum(problem.noise[joints:], unsure)])
        (problem,) = corrected_at(problem.changed(noise=noise), [fitted.point])
        fitted = fit(problem, fitted.point, names, where, most=3)
    return settled(problem, [(fitted, names, where)])[0]


def errors_of(problem: Problem, residual: FloatArray) -> Errors:
    """Return the errors of each joint [rad or m] of a residual (T, C) in noise floors."""
    joints = problem.joints
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
    rows = [_rows(problem, part) for part in problem.replay.parts]
    refits = [_without(problem, one, where, here) for here in rows for one in (before, final)]
    apart = fit_all(problem, refits) if len(rows) > 2 else []
    unseen = [
        _rms(problem, f.residual, here) for f, here in zip(apart, [r for r in rows for _ in range(2)], strict=False)
    ]
    return tuple(
        LogErrors(
            name=part.name,
            fitted=True,
            baseline=_rms(problem, before.residual, here),
            final=_rms(problem, final.residual, here),
            left_out_baseline=unseen[2 * i] if unseen else None,
            left_out_final=unseen[2 * i + 1] if unseen else None,
        )
        for i, (part, here) in enumerate(zip(problem.replay.parts, rows, strict=True))
    )


def errors_of_unseen(unseen: Problem, before: Fit, final: Fit) -> tuple[LogErrors, ...]:
    """Return the errors of logs that nothing was fitted to."""
    left = unseen.in_fine_steps([before.point, final.point])
    found = []
    for part in unseen.replay.parts:
        here = _rows(unseen, part)
        baseline, after = (_rms(unseen, residual, here) for residual in left)
        found.append(LogErrors(name=part.name, fitted=False, baseline=baseline, final=after))
    return tuple(found)


def _rows(problem: Problem, part: Part) -> BoolArray:
    """Return which rows (T,) are a log's."""
    here = np.zeros(len(problem.replay.log.t), dtype=bool)
    here[part.slice] = True
    return here


def _rms(problem: Problem, residual: FloatArray, rows: BoolArray) -> FloatArray:
    """Return the root mean square of the positions in some rows (J,), in the unit of the log."""
    joints = problem.joints
    inside = problem.in_floors(residual)[rows & (problem.blocks.index >= 0), :joints].astype(np.float64)
    return np.sqrt(np.nanmean(inside**2, axis=0)) * problem.noise[:joints]


def _without(problem: Problem, fitted: Fit, where: Mapping[str, BoolArray], rows: BoolArray) -> Asking:
    """Return a fit to all but some rows (T,)."""
    names = list(dict.fromkeys(name for name, _ in fitted.point.values))
    return fitting(problem.holding_out(rows), fitted.point, names, where, most=MOST_STEPS, frozen=fitted, every=0)


SAME_AS_VISCOUS: tuple[Key, ...] = (("gains", "kd"),)
"""Numbers that brake as viscous friction does; measured torque tells them from it, another Kd, or drives that are off.
"""


def problem_of(logs: JointLog | Pool, machine: MachineModel, settings: CalibrateSettings) -> Problem:
    """Return the problem of logs and a model, as they say (`mimic.dynamics.machine.as_logged`).

    Raises:
        CalibrationError: If the log cannot be replayed.
    """
    together = logs if isinstance(logs, Pool) else pool([logs], machine, step_of([logs], settings))
    log = together.log
    replay = Replay(
        machine,
        log,
        timestep=together.step,
        threads=settings.threads,
        torque=settings.torque,
        sending=together.sending[0],
        parts=together.parts,
    )
    noise = _of_moving(log.q[valid_samples(log)], _noise(log, replay, log.q, valid_samples(log)))
    steps = np.zeros_like(noise)
    if not settings.effects or "encoder_step" in settings.effects:
        steps, noise = coarse_steps(log.q[valid_samples(log)], noise)
    torque = None
    if log.tau is not None and replay.torque:
        torque = _of_moving(log.tau, _noise(log, replay, log.tau))
    rows = [part.slice for part in together.parts]
    blocks = make_blocks(log.t, replay.counts & valid_samples(log), logs=rows, enabled=enabled(log))
    problem = Problem(replay, noise, torque, blocks)
    problem.encoder_steps, problem.sending = steps, together.sending
    kd = np.stack([part.kd for part in together.parts])
    if torque is None and "viscous" in settings.baseline and np.all(kd == kd[0]) and enabled(log).all():
        problem.pinned |= frozenset(SAME_AS_VISCOUS)
    return problem


def _of_moving(readings: FloatArray, noise: FloatArray) -> FloatArray:
    """Return noise floors (J,); a constant channel (T, J) gets the largest floor of the others."""
    moves = (np.ptp(readings, axis=0) > 0) & (noise > 0)
    return np.where(moves, noise, noise[moves].max() if moves.any() else 1e-9)


def step_of(logs: Sequence[JointLog], settings: CalibrateSettings) -> float:
    """Return the physics step for logs [s]."""
    return settings.timestep or physics_step(max(log.rate for log in logs))


def _noise(log: JointLog, replay: Replay, x: FloatArray, known: BoolArray | None = None) -> FloatArray:
    """Return the noise floors of signals (T, J), over all logs (J,)."""
    known = np.ones(len(x), dtype=bool) if known is None else known
    floors = [noise_floor(x[rows], log.part(rows).rate, known[rows]) for rows in (p.slice for p in replay.parts)]
    return np.sqrt(np.mean(np.square(floors), axis=0))


def fit_sending_times(
    problem: Problem, fitted: Fit, names: Sequence[str], joints: Mapping[str, BoolArray]
) -> tuple[Problem, Fit]:
    """Return problem and fit with the sending times of targets that explain most, of all that the log allows.

    From rows alone it is open whether a steady clock sends targets beside rows that jitter, or whoever writes the rows
    sends them too. The motion tells: the probability of the logs where their drives follow the targets, the residual of
    each log of a size of its own.
    """
    for times in problem.sending[1:]:
        shift = float(np.mean(times.at - problem.replay.sending.at))
        values = dict(fitted.point.values)
        if ("delay", "time") in values:
            values["delay", "time"] = values["delay", "time"] - shift
        other = problem.sent_at(times)
        found = fit(other, Point(values), names, joints, most=3, frozen=fitted, every=0)
        if _left(other, found) < _left(problem, fitted):
            problem, fitted = other, found
    return problem, fitted


def _left(problem: Problem, fitted: Fit) -> float:
    counts = problem.blocks.fitted & enabled(problem.replay.log).all(axis=1)
    squares = np.mean(problem.in_floors(fitted.residual).astype(np.float64) ** 2, axis=1)
    parts = [squares[part.slice][counts[part.slice]] for part in problem.replay.parts]
    return float(sum(len(own) * np.log(np.mean(own)) for own in parts if len(own)))
