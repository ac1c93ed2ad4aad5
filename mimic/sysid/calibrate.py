"""Log + model -> what the model lacked, with evidence, and a better model."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from mimic.calibrate.checks import belongs as targets_belong
from mimic.calibrate.declared import fit_declared, problem_of
from mimic.calibrate.encoders import with_encoders
from mimic.calibrate.events import widening
from mimic.calibrate.evidence import stopped
from mimic.calibrate.fit import (
    Fit,
    deviations,
    fit,
    left_out,
    of_white_noise,
)
from mimic.calibrate.grow import grow, taken_back
from mimic.calibrate.point import Point
from mimic.calibrate.random_search import random_search
from mimic.calibrate.remainder import remainders
from mimic.calibrate.screen import predicted
from mimic.calibrate.settle import FINE, FINE_SEGMENT, compared, correct, settle
from mimic.calibrate.state import Progress, Search, errors_of
from mimic.calibrate.wording import experiments, not_together, of_base, of_declared, sentence, stopped_at, weak
from mimic.calibration import Calibration, Errors, Stage, Traces
from mimic.errors import CalibrationError
from mimic.machine_log import MachineLog
from mimic.robot.effect_set import EffectSet, EffectValues
from mimic.robot.effects import CATALOGUE, effect
from mimic.robot.machine import MachineModel, as_logged
from mimic.settings import CalibrateSettings

MOST_POLISHED, FAR = 4, 2.0
"""Most passes of the last fit, each with derivatives of its own, and by how many deviations a number moves where another is needed."""

UNRELATED = 0.5
"""Error over the spread of the positions from which on log and model have nothing to do with each other."""


def check_names(settings: CalibrateSettings) -> None:
    """Make sure that all effects that the settings name exist.

    Raises:
        ConfigError: If one does not.
    """
    for name in (*settings.declared, *settings.effects):
        effect(name)


def calibrate(
    log: MachineLog, model: MachineModel, settings: CalibrateSettings, progress: Progress | None = None
) -> Calibration:
    """Explain a log.

    Args:
        log: What a machine did.
        model: What it should have done; its base is held.
        settings: How.
        progress: Called with what is being done and the number of replays so far.

    Raises:
        CalibrationError: If log and model do not fit together in joints, the log cannot be used, or the model has a number that
            is not fitted so large.
        ConfigError: If the settings name an effect that does not exist.
    """
    began = time.monotonic()
    check_names(settings)
    report = progress or (lambda text, replays: None)
    log = log.of(model.joints)
    machine = as_logged(model, log.metadata, by_force=log.q_des is None)
    problem = problem_of(log, machine, settings)
    names = list(settings.declared)
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
        report("fitting the declared model", problem.replay.replays)
        fitted = fit_declared(problem, start, names, where)
    spread = np.nanstd(log.q, axis=0)
    joints = len(machine.joints)
    error = Errors.total(errors_of(problem, fitted.residual).train / np.maximum(spread, 1e-9))
    together, why = targets_belong(log)
    belongs = together and error < UNRELATED
    if settings.method == "least-squares" and belongs:
        report("comparing with fine steps", problem.replay.replays)
        fitted = compared(problem, fitted, names, where)
    state = Search(
        problem=problem,
        settings=settings,
        progress=report,
        joints=where,
        names=names,
        current=fitted,
        declared=problem.mean_squares(fitted.residual, True),
    )
    stages = [Stage(added="declared", errors=errors_of(problem, fitted.residual))]
    before = fitted
    final, left = fitted, fitted.residual
    if settings.method == "least-squares" and belongs:
        stages += grow(state)
        final = _polished(state)
        while (fewer := taken_back(state, final, stages[1:])) is not None:
            stages, final = [stages[0], *fewer], _polished(state)
        left = final.residual
        if settings.most_effects:
            stages, left = with_encoders(state, stages, final)
    stages[-1] = replace(stages[-1], errors=errors_of(problem, left))
    motion = predicted(problem, final)
    target = log.q_des if log.q_des is not None else np.zeros_like(log.q)
    rest = remainders(
        machine.joints,
        left[:, :joints],
        motion,
        target,
        problem.blocks.index,
        np.asarray(machine.drives.neighbour),
        None if state.base is None else state.base.residual[:, :joints],
    )
    effects = _effect_set(state, final)
    scale = problem.noise[:joints]
    if not belongs:
        said = not_together(why)
    elif settings.method == "random" or not settings.most_effects:
        said = of_declared(stages, rest, scale, machine.unit)
    else:
        said = sentence(stages, rest, scale, machine, effects)
    measured = problem.channels > joints
    traces = Traces(
        t=log.t - log.t[0],
        held_out=problem.blocks.held_out[np.maximum(problem.blocks.index, 0)] & (problem.blocks.index >= 0),
        q=log.q,
        dq=motion.dq,
        tau=motion.tau,
        before=before.residual[:, :joints] * scale,
        after=left[:, :joints] * scale,
        torque_before=before.residual[:, joints:] * problem.noise[joints:] if measured else None,
        torque_after=left[:, joints:] * problem.noise[joints:] if measured else None,
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
        belongs=belongs,
        experiments=(*experiments(stages), *of_base(state, scale, machine.unit)),
        warnings=(*state.withdrawn, *(stopped_at(*row, machine) for row in stopped(final, problem))),
        not_identifiable=weak(final, problem),
        traces=traces,
        replays=problem.replay.replays,
        seconds=time.monotonic() - began,
        metadata={"log": dict(log.metadata), "rate": log.rate, "duration": log.duration},
    )


def _check_bounds(start: Point, machine: MachineModel) -> None:
    """Refuse a model whose own numbers are none that can be fitted.

    Raises:
        CalibrationError: If one is outside its bounds.
    """
    for (name, parameter), row in start.values.items():
        spec = effect(name).parameter(parameter)
        for j in np.flatnonzero((row < spec.low) | (row > spec.high)):
            raise CalibrationError(
                f"the model has {name}.{parameter} {row[j]:g} {spec.unit} in {machine.joints[j]}; it can be {spec.low:g} to"
                f" {spec.high:g}: correct the model, or leave {name} out with --declared"
            )


def _polished(state: Search) -> Fit:
    state.tick("polishing")
    if "kt_heat" in state.names:
        state.problem.warm_up(state.current.point, FINE, FINE_SEGMENT)
        correct(state.problem, state.current.point)
    fitted = fit(state.problem, state.current.point, state.names, state.joints, most=1)
    for _ in range(MOST_POLISHED):
        before, fitted = fitted, settle(state.problem, fitted, every=True)
        moved = fitted.point.read(fitted.knobs) - before.point.read(fitted.knobs)
        if np.all(np.abs(moved) <= FAR * of_white_noise(fitted, state.problem)):
            break  # near enough for the derivatives of where it began
    return fitted


def _effect_set(state: Search, final: Fit) -> EffectSet:
    deviation = deviations(final, state.problem, left_out(final, state.problem)[1])
    if (late := state.problem.replay.late) is not None and "delay_jitter" in state.names:
        deviation = deviation * widening(state.problem, final, float(np.var(late)))
    spread = {(k.key, k.joint): d for k, d in zip(final.knobs, deviation, strict=True)}
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
                if np.isfinite(half).all():
                    intervals[p.name] = np.stack([np.maximum(low, p.low), np.minimum(high, p.high)], -1)
        joints = () if spec.scope == "machine" else tuple(state.problem.machine.joints[j] for j in index)
        effects.append(EffectValues(name=name, joints=joints, values=values, intervals=intervals, role="fitted"))
    if (has := state.joints.get("encoder_step")) is not None:
        joints = tuple(np.array(state.problem.machine.joints)[has])
        angle = {"angle": state.problem.encoder_steps[has]}
        effects.append(EffectValues(name="encoder_step", joints=joints, values=angle, intervals={}, role="fitted"))
    return EffectSet(tuple(effects))
