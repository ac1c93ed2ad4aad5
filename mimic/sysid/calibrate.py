"""Calibration: what a model lacks to explain a log, with evidence, and a better model."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from mimic.config.sysid import CalibrateSettings
from mimic.dynamics.catalogue import CATALOGUE, effect
from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.dynamics.machine import UNLIMITED, MachineModel, as_logged
from mimic.dynamics.servo import neutral
from mimic.errors import CalibrationError
from mimic.io.joint_log import JointLog
from mimic.records import BoolArray
from mimic.sysid.fit.baseline import (
    compared,
    errors_by_log,
    errors_of,
    errors_of_unseen,
    fit_sending_times,
    problem_of,
    step_of,
)
from mimic.sysid.fit.least_squares import MOST_STEPS, Fit, correlations, deviations, fit, fit_all, fitting
from mimic.sysid.fit.problem import FreeParameter, Point, Problem
from mimic.sysid.log.checks import targets_match_log
from mimic.sysid.log.pool import pool
from mimic.sysid.result import RULES, Calibration, Errors, LogErrors, Traces
from mimic.sysid.select.encoders import as_read, coarse_encoders, with_encoders
from mimic.sysid.select.models import FittedModel, Selection
from mimic.sysid.select.starts import predicted, starts_of
from mimic.sysid.unexplained import (
    experiments,
    next_logs,
    no_match,
    of_baseline,
    sentence,
    stopped_at,
    unexplained_residuals,
)

OF_VOLTAGE_DRIVES = ("coulomb", "viscous", "delay", "motor", "armature")
"""Their baseline parameters: motor constants scale all torques, so that masses must be known, and behind the gear of a
hobby servo the rotor is most of the inertia."""

Progress = Callable[[str, int], None]
"""Called with what is being done and the number of replays so far."""


def check_names(settings: CalibrateSettings) -> None:
    """Make sure that all effects that the settings name exist.

    Raises:
        ConfigError: If one does not.
    """
    for name in (*settings.baseline, *settings.effects):
        effect(name)


# All systems are small, and threads of a BLAS that wait for each other on a busy computer made a banded one of 550
# unknowns take seconds instead of a tenth of a millisecond.
@threadpool_limits.wrap(limits=1, user_api="blas")
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
    report, began = progress or (lambda text, replays: None), time.monotonic()
    check_names(settings)
    logs = [one.of(model.joints) for one in ([log] if isinstance(log, JointLog) else log)]
    others = [one.of(model.joints) for one in held_out]
    called = tuple(names) or tuple(f"log {i + 1}" for i in range(len(logs) + len(others)))
    if others:
        pool([*logs, *others], model, 1.0, called)  # they may contradict each other
    together = pool(logs, model, step_of(logs, settings), called[: len(logs)])
    log = together.log
    machine = as_logged(model, log.metadata, by_force=log.q_des is None)
    if machine.drives.volts is not None and settings.baseline == CalibrateSettings().baseline:
        settings = replace(settings, baseline=OF_VOLTAGE_DRIVES)
    elif machine.drives.volts is not None and "motor" not in settings.baseline:
        settings = replace(settings, baseline=(*settings.baseline, "motor"))
    problem = problem_of(together, machine, settings)
    start = Point.of(settings.baseline, machine)
    _check_bounds(start, machine)
    report("replaying", 0)
    first = problem.residuals([start])[0]
    problem = problem.without(~np.isfinite(first).all(-1))
    nominal = errors_of(problem, first)

    steps = itertools.count(1)

    def tick(text: str) -> None:
        step = next(steps)  # nobody knows how many effects will be found
        done = step / (step + max(settings.most_effects, 1))
        report(f"{text} (about {100 * done:.0f} % done)", problem.replay.replays)

    before = _baseline(problem, settings, tick)
    problem = before.problem
    spread = np.nanstd(log.q, axis=0)
    spread = np.maximum(spread, problem.noise[: len(spread)])
    error = Errors.total(errors_of(problem, before.fitted.residual).train / spread)
    follows, why = targets_match_log(log)
    log_matches_model = follows and error < RULES.most
    final, stages = before, before.stages(())[:1]
    residual, coarse = before.fitted.residual, np.zeros(len(machine.joints), dtype=bool)
    if log_matches_model:
        before = final = _refined(before, tick)
        stages, residual = before.stages(())[:1], before.fitted.residual
        if settings.most_effects:
            final, last = Selection(settings=settings, tick=tick).run(before)
            final = _no_worse(final, before)
            before = before if final.added else final
            stages, residual = final.stages(last), final.fitted.residual
            if (coarse := coarse_encoders(final)).any():
                tick("adding encoder rounding")
                residual = as_read(final, coarse)
                stages = with_encoders(final, stages, coarse, residual)
    unseen: tuple[LogErrors, ...] = ()
    if len(logs) > 1 or others:
        tick("predicting each log")
        if others:
            apart = pool(others, model, step_of(others, settings), called[len(logs) :])
            unseen = errors_of_unseen(problem_of(apart, machine, settings), before.fitted, final.fitted)
        done = replace(final.fitted, residual=residual)
        unseen = (*errors_by_log(final.problem, before.fitted, done, final.joints), *unseen)
    problem = final.problem
    joints = len(machine.joints)
    scale, motion = problem.noise[:joints], predicted(problem, final.fitted)
    shown, first = problem.in_floors(residual), before.problem.in_floors(before.fitted.residual)
    rest = unexplained_residuals(
        machine.joints,
        shown[:, :joints],
        motion,
        log.q_des if log.q_des is not None else np.zeros_like(log.q),
        problem.blocks.index,
        np.asarray(machine.drives.neighbour),
    )
    effects = _effect_set(final, coarse)
    if not log_matches_model:
        said = no_match(why)
    elif not settings.most_effects:
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
        target=log.q_des,
        log=None if len(logs) == 1 else np.repeat(np.arange(len(logs)), [p.rows for p in together.parts]),
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
        experiments=(*experiments(stages), *next_logs(rest)) if log_matches_model else (),
        warnings=(*final.notes, *(stopped_at(*row, machine) for row in _at_bounds(final))),
        correlations=correlations(final.fitted, problem),
        traces=traces,
        logs=unseen,
        replays=problem.replay.replays,
        seconds=time.monotonic() - began,
        metadata={
            "log": dict(log.metadata),
            "rate": log.rate,
            "duration": log.duration,
            "sending_times": problem.replay.sending.how,
        },
    )


def _no_worse(final: FittedModel, before: FittedModel) -> FittedModel:
    """Return the final model, or the baseline where that predicts the held-out blocks better."""
    left = [
        float(np.mean(m.problem.mean_squares(m.problem.in_floors(m.fitted.residual), True))) for m in (before, final)
    ]
    if final is before or not left[1] > left[0]:
        return final
    titles = " and ".join(CATALOGUE[n].title for n in final.added)
    note = f"{titles} made the prediction of held-out blocks worse, so that the baseline stays"
    return replace(before, notes=(*final.notes, *([note] if titles else [])))


def _at_bounds(h: FittedModel) -> list[tuple[FreeParameter, float]]:
    """Return the numbers that are at a bound which does not mean none, and the bound."""
    found = []
    for free in h.fitted.free_parameters:
        j, p = max(free.joint, 0), free.parameter
        value = h.fitted.point.values[free.key][j]
        if value in (p.low, p.high) and value not in (neutral(*free.key, h.problem.machine)[j], 0.0, UNLIMITED):
            found.append((free, value))
    return found


def _baseline(problem: Problem, settings: CalibrateSettings, tick: Callable[[str], None]) -> FittedModel:
    """Return the baseline parameters, fitted in coarse steps."""
    machine = problem.machine
    moves = np.ptp(problem.replay.log.q, axis=0) > 0
    where = {} if moves.all() else {n: moves for n in settings.baseline if effect(n).scope == "joint"}
    tick("fitting the baseline model")
    names = [n for n in settings.baseline if not effect(n).structural]
    fitted = fit(problem, Point.of(names, machine), names, where, most=MOST_STEPS)
    if problem.poorly_explained(fitted.residual):
        short = fit(problem.in_short_segments(), fitted.point, names, where, most=MOST_STEPS)
        again = fit(problem, short.point, names, where, most=MOST_STEPS)
        fitted = min(fitted, again, key=lambda f: float(problem.mean_squares(f.residual, False).sum()))
    problem, fitted = fit_sending_times(problem, fitted, names, where)
    for name in settings.baseline:
        if name not in names:
            fitted = _with_threshold(problem, fitted, name, names, where)
            names.append(name)
    return FittedModel(problem=problem, fitted=fitted, names=tuple(names), joints=where)


def _refined(h: FittedModel, tick: Callable[[str], None]) -> FittedModel:
    """Return the baseline parameters fitted in fine steps, to logs of equal weight."""
    problem, fitted = h.problem.with_equal_logs(h.fitted.residual), h.fitted
    if problem is not h.problem:
        tick("fitting the baseline model with logs of equal weight")
        fitted = fit(problem, fitted.point, h.names, h.joints, most=MOST_STEPS)
    tick("refining the step size")
    problem, fitted = compared(problem, fitted, h.names, h.joints)
    return replace(h, problem=problem, fitted=fitted)


def _with_threshold(problem: Problem, fitted: Fit, name: str, names: Sequence[str], where: dict[str, BoolArray]) -> Fit:
    """Return the best fit with an effect that has no derivative where it is none, from all its starts."""
    starts = starts_of(name, fitted, problem, predicted(problem, fitted))
    short = problem.in_short_segments()
    fits = fit_all(short, [fitting(short, p, [*names, name], where, most=MOST_STEPS) for p in starts])
    best = min(fits, key=lambda f: float(short.mean_squares(f.residual, False).sum()))
    return fit(problem, best.point, [*names, name], where, most=MOST_STEPS)


def _check_bounds(start: Point, machine: MachineModel) -> None:
    """Refuse a model whose own numbers are none that can be fitted.

    Raises:
        CalibrationError: If one is outside its bounds.
    """
    for (name, parameter), row in start.values.items():
        spec = effect(name).parameter(parameter)
        if effect(name).structural:
            continue  # it begins at its own starts, and a limit that the model lacks is no number of its own
        for j in np.flatnonzero((row < spec.low) | (row > spec.high)):
            raise CalibrationError(
                f"the model has {name}.{parameter} {row[j]:g} {spec.unit} in {machine.joints[j]}; it can be"
                f" {spec.low:g} to {spec.high:g}: correct the model, or leave {name} out of --baseline"
            )


def _effect_set(h: FittedModel, coarse: BoolArray) -> EffectSet:
    """Return everything that was fitted, with intervals, and the encoders (J,) that are coarse."""
    problem, final = h.problem, h.fitted
    deviation = deviations(final, problem, h.left_out[1])
    spread = {(k.key, k.joint): d for k, d in zip(final.free_parameters, deviation, strict=True)}
    effects = []
    for name in h.names:
        spec = CATALOGUE[name]
        mask = h.joints.get(name, np.ones(problem.joints, dtype=bool))
        index = [-1] if spec.scope == "machine" else [int(j) for j in np.flatnonzero(mask)]
        if not index:
            continue
        values, intervals = {}, {}
        for p in spec.parameters:
            row = final.point.values[name, p.name]
            values[p.name] = np.array([row[max(j, 0)] for j in index])
            if name in h.intervals:
                intervals[p.name] = np.array([h.intervals[name]])
            elif not p.fixed and (name, p.name) not in problem.pinned:
                half = 1.96 * np.array([spread.get(((name, p.name), j), np.nan) for j in index])
                at = p.turned(values[p.name])
                low, high = at - half, at + half
                if (name, p.name) == ("delay", "time"):  # when targets were sent is not known better
                    times = problem.replay.sending
                    low, high = np.maximum(low - times.later, np.minimum(low, 0.0)), high + times.earlier
                if np.isfinite(half).all():
                    intervals[p.name] = np.sort(p.turned(np.clip(np.stack([low, high], -1), *p.bounds)), axis=-1)
        joints = () if spec.scope == "machine" else tuple(problem.machine.joints[j] for j in index)
        effects.append(EffectValues(name=name, joints=joints, values=values, intervals=intervals, role="fitted"))
    if coarse.any():
        joints = tuple(np.array(problem.machine.joints)[coarse])
        angle = {"angle": problem.encoder_steps[coarse]}
        effects.append(EffectValues(name="encoder_step", joints=joints, values=angle, intervals={}, role="fitted"))
    return EffectSet(tuple(effects))
