"""Calibration: what a model lacks to explain a log, with evidence, and a better model."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mimic.config.sysid import CalibrateSettings
from mimic.dynamics.catalogue import CATALOGUE, effect
from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.dynamics.machine import MachineModel, as_logged
from mimic.errors import CalibrationError
from mimic.io.joint_log import JointLog
from mimic.records import BoolArray
from mimic.sysid.fit.baseline import MOST_STEPS, fit_baseline, fit_sending_times, problem_of, step_of
from mimic.sysid.fit.by_log import errors_by_log, errors_of_unseen
from mimic.sysid.fit.least_squares import Fit, fit, fit_all, fitting, left_out
from mimic.sysid.fit.point import Point
from mimic.sysid.fit.random_search import random_search
from mimic.sysid.fit.residuals import Problem
from mimic.sysid.fit.step_refinement import FINE, FINE_SEGMENT, compared, correct, refine_steps
from mimic.sysid.fit.uncertainty import deviations, of_white_noise
from mimic.sysid.log.checks import targets_match_log
from mimic.sysid.log.pool import pool
from mimic.sysid.result import Calibration, Errors, LogErrors, Stage, Traces
from mimic.sysid.selection.encoders import with_encoders
from mimic.sysid.selection.evidence import cross_validated, stopped
from mimic.sysid.selection.forward import forward_selection, prune
from mimic.sysid.selection.jitter import widening
from mimic.sysid.selection.screening import predicted, starts_of
from mimic.sysid.selection.unexplained import unexplained_residuals
from mimic.sysid.state import CalibrationState, Progress, errors_of
from mimic.sysid.summary import experiments, no_match, of_base, of_baseline, sentence, stopped_at, weak

MOST_FINAL_PASSES, LARGEST_MOVE = 4, 2.0
"""Most passes of the last fit, each with derivatives of its own, and by how many deviations a number moves where
another is needed.
"""

UNRELATED = 0.5
"""Error over the spread of the positions from which on log and model have nothing to do with each other."""


def check_names(settings: CalibrateSettings) -> None:
    """Make sure that all effects that the settings name exist.

    Raises:
        ConfigError: If one does not.
    """
    for name in (*settings.baseline, *settings.effects):
        effect(name)


def calibrate(
    log: JointLog | Sequence[JointLog],
    model: MachineModel,
    settings: CalibrateSettings,
    progress: Progress | None = None,
    *,
    held_out: Sequence[JointLog] = (),
    names: Sequence[str] = (),
) -> Calibration:
    """Find what a model lacks to explain logs of a machine.

    Args:
        log: What the machine did, in one log or several.
        model: What it should have done; its base is held.
        settings: How.
        held_out: Further logs, which are only predicted.
        names: Of all logs, for messages and the result.
        progress: Called with what is being done and the number of replays so far.

    Raises:
        CalibrationError: If logs and model do not fit together in joints, a log cannot be used, logs contradict each
            other, or the model has a number that is not fitted so large.
        ConfigError: If the settings name an effect that does not exist.
    """
    began = time.monotonic()
    check_names(settings)
    report = progress or (lambda text, replays: None)
    logs = [one.of(model.joints) for one in ([log] if isinstance(log, JointLog) else log)]
    others = [one.of(model.joints) for one in held_out]
    called = tuple(names) or tuple(f"log {i + 1}" for i in range(len(logs) + len(others)))
    if others:
        pool([*logs, *others], model, 1.0, called)  # they may contradict each other
    together = pool(logs, model, step_of(logs, settings), called[: len(logs)])
    log = together.log
    machine = as_logged(model, log.metadata, by_force=log.q_des is None)
    problem = problem_of(together, machine, settings)
    names = list(settings.baseline)
    rough = [n for n in names if effect(n).structural and settings.method == "least-squares"]
    names = [n for n in names if n not in rough]
    start = Point.of(names, machine)
    _check_bounds(start, machine)
    moves = np.ptp(log.q, axis=0) > 0
    where = {} if moves.all() else {n: moves for n in names if effect(n).scope == "joint"}
    report("replaying", 0)
    first = problem.residuals([start])[0]
    problem.leave_out(~np.isfinite(first).all(-1))
    nominal = errors_of(problem, first)
    if settings.method == "random":
        report(f"{settings.samples} random samples", problem.replay.replays)
        fitted = random_search(problem, start, settings.samples, settings.seed, report)
    else:
        report("fitting the baseline model", problem.replay.replays)
        fitted = fit_sending_times(problem, fit_baseline(problem, start, names, where), names, where)
        for name in rough:
            fitted = _with_threshold(problem, fitted, name, names, where)
            names.append(name)
    spread = np.nanstd(log.q, axis=0)
    joints = len(machine.joints)
    error = Errors.total(errors_of(problem, fitted.residual).train / np.maximum(spread, 1e-9))
    together, why = targets_match_log(log)
    log_matches_model = together and error < UNRELATED
    if settings.method == "least-squares" and log_matches_model:
        if problem.weigh_logs(fitted.residual):
            report("fitting the baseline model with logs of equal weight", problem.replay.replays)
            fitted = fit(problem, fitted.point, names, where, most=MOST_STEPS)
        report("refining the step size", problem.replay.replays)
        fitted = compared(problem, fitted, names, where)
    state = CalibrationState(
        problem=problem,
        settings=settings,
        progress=report,
        joints=where,
        names=names,
        current=fitted,
        baseline=cross_validated(problem, fitted),
    )
    stages = [Stage(added="baseline", errors=errors_of(problem, fitted.residual))]
    before = fitted
    final, left = fitted, fitted.residual
    if settings.method == "least-squares" and log_matches_model:
        stages += forward_selection(state)
        final = _polished(state)
        while (fewer := prune(state, final, stages[1:])) is not None:
            stages, final = [stages[0], *fewer], _polished(state)
        left = final.residual
        if settings.most_effects:
            stages, left = with_encoders(state, stages, final)
    stages[-1] = replace(stages[-1], errors=errors_of(problem, left))
    motion = predicted(problem, final)
    shown, first = problem.in_floors(left), problem.in_floors(before.residual)
    target = log.q_des if log.q_des is not None else np.zeros_like(log.q)
    rest = unexplained_residuals(
        machine.joints,
        shown[:, :joints],
        motion,
        target,
        problem.blocks.index,
        np.asarray(machine.drives.neighbour),
        None if state.base is None else problem.in_floors(state.base.residual)[:, :joints],
    )
    effects = _effect_set(state, final)
    by_log: tuple[LogErrors, ...] = ()
    if len(logs) > 1 or others:
        report("predicting each log", problem.replay.replays)
        by_log = errors_by_log(problem, before, replace(final, residual=left), state.joints)
    if others:
        unseen = pool(others, model, step_of(others, settings), called[len(logs) :])
        by_log += errors_of_unseen(problem_of(unseen, machine, settings), before, final)
    scale = problem.noise[:joints]
    if not log_matches_model:
        said = no_match(why)
    elif settings.method == "random" or not settings.most_effects:
        said = of_baseline(stages, rest, scale, machine.unit)
    else:
        said = sentence(stages, rest, scale, machine, effects)
    measured = problem.channels > joints
    traces = Traces(
        t=log.t - log.t[0],
        held_out=problem.blocks.held_out[np.maximum(problem.blocks.index, 0)] & (problem.blocks.index >= 0),
        q=log.q,
        dq=motion.dq,
        tau=motion.tau,
        before=first[:, :joints] * scale,
        after=shown[:, :joints] * scale,
        torque_before=first[:, joints:] * problem.noise[joints:] if measured else None,
        torque_after=shown[:, joints:] * problem.noise[joints:] if measured else None,
    )
    return Calibration(
        joints=machine.joints,
        unit=machine.unit,
        noise=scale,
        nominal=nominal,
        stages=tuple(stages),
        effects=effects,
        unexplained=rest,
        sentence=said,
        log_matches_model=log_matches_model,
        experiments=(*experiments(stages), *of_base(state, scale, machine.unit)),
        warnings=(*state.rejections, *(stopped_at(*row, machine) for row in stopped(final, problem))),
        not_identifiable=weak(final, problem),
        traces=traces,
        logs=by_log,
        replays=problem.replay.replays,
        seconds=time.monotonic() - began,
        metadata={
            "log": dict(log.metadata),
            "rate": log.rate,
            "duration": log.duration,
            "sending_times": problem.replay.sending.how,
        },
    )


def _with_threshold(problem: Problem, fitted: Fit, name: str, names: Sequence[str], where: dict[str, BoolArray]) -> Fit:
    """Return the best fit with an effect that has no derivative where it is none, from all its starts."""
    starts = starts_of(name, fitted, problem, predicted(problem, fitted))
    fits = fit_all(problem, [fitting(problem, p, [*names, name], where, most=MOST_STEPS) for p in starts])
    return min(fits, key=lambda f: float(problem.mean_squares(f.residual, False).sum()))


def _check_bounds(start: Point, machine: MachineModel) -> None:
    """Refuse a model whose own numbers are none that can be fitted.

    Raises:
        CalibrationError: If one is outside its bounds.
    """
    for (name, parameter), row in start.values.items():
        spec = effect(name).parameter(parameter)
        for j in np.flatnonzero((row < spec.low) | (row > spec.high)):
            raise CalibrationError(
                f"the model has {name}.{parameter} {row[j]:g} {spec.unit} in {machine.joints[j]}; it can be"
                f" {spec.low:g} to {spec.high:g}: correct the model, or leave {name} out of --baseline"
            )


def _polished(state: CalibrationState) -> Fit:
    state.tick("final fit")
    if "kt_heat" in state.names:
        state.problem.warm_up(state.current.point, FINE, FINE_SEGMENT)
        correct(state.problem, state.current.point)
    fitted = fit(state.problem, state.current.point, state.names, state.joints, most=1)
    for _ in range(MOST_FINAL_PASSES):
        before, fitted = fitted, refine_steps(state.problem, fitted, every=True)
        moved = fitted.point.read(fitted.free_parameters) - before.point.read(fitted.free_parameters)
        if np.all(np.abs(moved) <= LARGEST_MOVE * of_white_noise(fitted, state.problem)):
            break  # near enough for the derivatives of where it began
    return fitted


def _effect_set(state: CalibrationState, final: Fit) -> EffectSet:
    deviation = deviations(final, state.problem, left_out(final, state.problem)[1])
    if (late := state.problem.replay.late) is not None and "delay_jitter" in state.names:
        deviation = deviation * widening(state.problem, final, float(np.var(late)))
    spread = {(k.key, k.joint): d for k, d in zip(final.free_parameters, deviation, strict=True)}
    effects = []
    for name in state.names:
        spec = CATALOGUE[name]
        mask = state.joints.get(name, np.ones(len(state.problem.machine.joints), dtype=bool))
        index = [-1] if spec.scope == "machine" else [int(j) for j in np.flatnonzero(mask)]
        if not index:
            continue
        values, intervals = {}, {}
        for p in spec.parameters:
            row = final.point.values[name, p.name]
            values[p.name] = np.array([row[max(j, 0)] for j in index])
            if name in state.intervals:
                intervals[p.name] = np.array([state.intervals[name]])
            elif not p.fixed and (name, p.name) not in state.problem.pinned:
                half = 1.96 * np.array([spread.get(((name, p.name), j), np.nan) for j in index])
                half = np.hypot(half, state.unsure.get((name, p.name), 0.0))
                low, high = values[p.name] - half, values[p.name] + half
                if (name, p.name) == ("delay", "time"):  # when targets were sent is not known better
                    times = state.problem.replay.sending
                    low, high = np.maximum(low - times.later, np.minimum(low, 0.0)), high + times.earlier
                if np.isfinite(half).all():
                    intervals[p.name] = np.stack([np.maximum(low, p.low), np.minimum(high, p.high)], -1)
        joints = () if spec.scope == "machine" else tuple(state.problem.machine.joints[j] for j in index)
        effects.append(EffectValues(name=name, joints=joints, values=values, intervals=intervals, role="fitted"))
    if (has := state.joints.get("encoder_step")) is not None:
        joints = tuple(np.array(state.problem.machine.joints)[has])
        angle = {"angle": state.problem.encoder_steps[has]}
        effects.append(EffectValues(name="encoder_step", joints=joints, values=angle, intervals={}, role="fitted"))
    return EffectSet(tuple(effects))
