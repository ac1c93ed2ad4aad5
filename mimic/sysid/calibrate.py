"""Calibration: what a model lacks to explain a log, with evidence, and a better model."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import binomtest
from threadpoolctl import threadpool_limits

from mimic.config.sysid import CalibrateSettings
from mimic.dynamics.catalogue import effect
from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.dynamics.machine import UNLIMITED, MachineModel
from mimic.dynamics.servo import neutral
from mimic.errors import CalibrationError
from mimic.io.joint_log import JointLog
from mimic.jobs.local import cores
from mimic.records import BoolArray, FloatArray
from mimic.sysid.engine.arrivals import ARRIVALS
from mimic.sysid.engine.data import Data, data_of
from mimic.sysid.engine.effects import dependences, effects_of, motion_of
from mimic.sysid.engine.model import Model, setting_of
from mimic.sysid.engine.predictor import compiled
from mimic.sysid.engine.screen import applicable, wanted
from mimic.sysid.engine.search import (
    Hunt,
    Outcome,
    Scored,
    baseline,
    by_log,
    fitted_baseline,
    named,
    search,
    spread,
)
from mimic.sysid.log.checks import targets_match_log
from mimic.sysid.log.noise import MOST
from mimic.sysid.log.pool import SHORTEST, lasts, pool
from mimic.sysid.next_motion import NextMotion, next_motion
from mimic.sysid.result import (
    Alternative,
    Calibration,
    Correlations,
    Errors,
    Found,
    LogErrors,
    Stage,
    Traces,
    UnexplainedResidual,
)
from mimic.sysid.sentences import fall, next_logs, no_match, sentence

OF_VOLTAGE_DRIVES = ("coulomb", "viscous", "delay", "motor", "armature")
"""Their baseline parameters: motor constants scale all torques, so that masses must be known, and behind the gear of a
hobby servo the rotor is most of the inertia."""

ROUNDING = 0.25
"""Share of what is left of a joint that its encoder must round off to be called coarse."""

Progress = Callable[[str, int], None]
"""Called with what is being done and the number of passes over the logs so far."""


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
        progress: Called with what is being done and the number of passes over the logs so far.

    Raises:
        CalibrationError: If logs and model do not fit together in joints, a log cannot be used, logs contradict each
            other, or the model has a number that is not fitted so large.
        ConfigError: If the settings name an effect that does not exist.
    """
    began = time.monotonic()
    check_names(settings)
    logs = [one.of(model.joints) for one in ([log] if isinstance(log, JointLog) else log)]
    others = [one.of(model.joints) for one in held_out]
    called = tuple(names) or tuple(f"log {i + 1}" for i in range(len(logs) + len(others)))
    if not lasts(*logs):
        raise CalibrationError(
            f"what is logged lasts {sum(one.duration for one in logs):.2f} s by the column t (in seconds);"
            f" {SHORTEST:g} s are needed, 120 s are good"
        )
    if others:
        pool([*logs, *others], model, called)  # they may contradict each other
    data = data_of(logs, model, called[: len(logs)])
    plain, given = _baseline_names(data, settings)
    _check_bounds(plain, data.machine)
    setting = setting_of(data, settings.threads or cores())

    def say(text: str) -> None:
        if progress is not None:
            progress(text, setting.passes.count)

    say("fitting the baseline" if compiled() else "compiling the engine, once, and fitting the baseline")
    start = baseline(setting, plain)
    null = fitted_baseline(start, given)
    matches, why = _matches(null.model, logs)
    hunt = Hunt(
        effects=_looked_for(settings, applicable(setting, (*plain, *given))),
        most=settings.most_effects if matches else 0,
        arrivals=_looked_for(settings, tuple(ARRIVALS)),
        say=say,
    )
    outcome = search(null, hunt)
    say("predicting each log")
    coarse = _coarse(outcome, settings, hunt.most)
    found = _found(outcome, coarse)
    joints = data.machine.joints
    alternatives = tuple(Alternative(effects=named(tied.effects, tied), behind=by) for tied, by in outcome.ties)
    further = _next_motion(outcome, logs) if matches else None
    nominal = spread(start.evaluated())
    before = _errors(outcome.null)
    after = _errors(outcome.best)
    motion = motion_of(outcome.best.model)
    rest = tuple(
        UnexplainedResidual(joint=joint, ratio=float(ratio), torque=float(torque), depends_on=on)
        for joint, ratio, torque, on in zip(
            joints,
            after.held_out / outcome.noise,
            np.sqrt(np.mean(motion.unknown**2, axis=0)),
            dependences(outcome.best.model, motion),
            strict=True,
        )
    )
    said = fall(before.held_out, after.held_out, outcome.noise, data.machine.unit)
    return Calibration(
        joints=joints,
        unit=data.machine.unit,
        noise=outcome.noise,
        nominal=Errors(train=nominal, held_out=nominal),
        baseline=before,
        final=after,
        found=found,
        alternatives=alternatives,
        tried=_stages(hunt),
        explained=outcome.explained,
        effects=_effects(outcome, coarse),
        unexplained=rest,
        sentence=sentence(found, alternatives, rest, said, joints, hunt.most > 0, outcome.explained)
        if matches
        else no_match(why),
        log_matches_model=matches,
        experiments=next_logs(found, alternatives, rest, further) if matches else (),
        next_motion=further,
        warnings=_warnings(outcome.best.model),
        correlations=_correlations(outcome.best.model),
        traces=_traces(outcome, motion.speed, motion.torque),
        logs=_by_log(outcome, others, model, called[len(logs) :]),
        passes=setting.passes.count,
        seconds=time.monotonic() - began,
        metadata={
            "log": dict(data.log.metadata),
            "rate": data.log.rate,
            "duration": data.log.duration,
            "sending_times": outcome.best.model.data.times.how,
        },
    )


def _matches(model: Model, logs: Sequence[JointLog]) -> tuple[bool, str]:
    """Return whether a baseline tells most of the logs, and why not; what follows what, long ones tell."""
    data = model.data
    long = np.array([lasts(one) for one in logs])[data.record.log]
    follows, why = targets_match_log(data.log.part(long)) if long.any() else (True, "")
    size = np.maximum(np.nanstd(data.record.y, axis=0), data.noise)
    return follows and Errors.total(spread(model) / size) < MOST, why


def _baseline_names(data: Data, settings: CalibrateSettings) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the effects of the baseline: those with a derivative where they are none, and those with a threshold."""
    names = settings.baseline
    if data.machine.drives.volts is not None:
        names = OF_VOLTAGE_DRIVES if names == CalibrateSettings().baseline else tuple(dict.fromkeys((*names, "motor")))
    rough = [name for name in names if effect(name).structural]
    for name in names:
        rough += [name for p in wanted(name) if name not in rough and (p.starts or p.spectral)]
    return tuple(n for n in names if n not in rough), tuple(dict.fromkeys(rough))


def _looked_for(settings: CalibrateSettings, able: Sequence[str]) -> tuple[str, ...]:
    return tuple(n for n in able if not settings.effects or n in settings.effects)


def _check_bounds(names: Sequence[str], machine: MachineModel) -> None:
    """Refuse a model whose own numbers are none that can be fitted.

    Raises:
        CalibrationError: If one is outside its bounds.
    """
    for name in names:
        for p in wanted(name):
            row = neutral(name, p.name, machine)
            for j in np.flatnonzero((row < p.low) | (row > p.high)):
                raise CalibrationError(
                    f"the model has {name}.{p.name} {row[j]:g} {p.unit} in {machine.joints[j]}; it can be {p.low:g} to"
                    f" {p.high:g}: correct the model, or leave {name} out of --baseline"
                )


def _errors(one: Scored) -> Errors:
    return Errors(train=spread(one.model), held_out=spread(one.model, one.left_out))


def _coarse(outcome: Outcome, settings: CalibrateSettings, most: int) -> BoolArray:
    """Return the joints (J,) with an encoder so coarse that it matters beside what is left."""
    model = outcome.best.model
    asked = most > 0 and (not settings.effects or "encoder_step" in settings.effects)
    left = spread(model, outcome.best.left_out)
    return (model.data.encoder_steps / np.sqrt(12.0) > ROUNDING * left) & asked


def _found(outcome: Outcome, coarse: BoolArray) -> tuple[Found, ...]:
    """Return the effects found; of coarse encoders (J,) last."""
    model = outcome.best.model
    joints = model.data.machine.joints

    def beyond(one: Scored) -> float:
        return max(Errors.total(spread(model, one.left_out)) ** 2 - Errors.total(outcome.noise) ** 2, 1e-30)

    found = []
    for part in outcome.parts:
        removed = beyond(part.without) - beyond(outcome.best)
        ((_, where),) = named(((part.name, part.joints),), model)
        share = float(np.clip(removed / beyond(outcome.null), 0.0, 1.0))
        found.append(Found(name=part.name, joints=where, evidence=part.evidence, share=share))
    if coarse.any():
        where = tuple(np.array(joints)[coarse].tolist())
        found.append(Found(name="encoder_step", joints=where, evidence=0.0, share=0.0))
    return tuple(found)


def _next_motion(outcome: Outcome, logs: Sequence[JointLog]) -> NextMotion | None:
    """Return the motion that tells what was found from the explanation that is nearest to it, if there is one."""
    if not outcome.ties or any(log.q_des is None for log in logs):
        return None
    model = outcome.best.model
    rival = min(outcome.ties, key=lambda tie: tie[1])[0]
    return next_motion(model.data.machine, logs, outcome.noise, effects_of(model), effects_of(rival))


def _stages(hunt: Hunt) -> tuple[Stage, ...]:
    """Return what was tried beside each set of effects."""
    stages = []
    for beside, own in sorted(hunt.tried.items(), key=lambda item: len(item[0])):
        candidates = tuple(sorted(own.values(), key=lambda one: (not one.fitted, -one.gain)))
        stages.append(Stage(beside=tuple(name for name, _ in beside), candidates=candidates))
    return tuple(stages)


def _effects(outcome: Outcome, coarse: BoolArray) -> EffectSet:
    """Return all numbers fitted, with intervals, and the encoders (J,) that are coarse."""
    data = outcome.best.model.data
    effects = []
    for one in effects_of(outcome.best.model):
        if one.name == "delay" and "time" in one.intervals:  # when targets were sent is not known better
            one = replace(one, values={"time": one.values["time"] - data.times.spread / 2.0})
            low, high = one.intervals["time"].T - data.times.spread / 2.0
            low = np.maximum(low - data.times.later, np.minimum(low, 0.0))
            one = replace(one, intervals={"time": np.stack([low, high + data.times.earlier], -1)})
        effects.append(one)
    if lost := data.times.lost:
        count = lost + len(data.times.at)
        values = {"share": np.array([lost / count])}
        intervals = {"share": np.array([binomtest(lost, count).proportion_ci()])}
        effects.append(EffectValues(name="lost_commands", joints=(), values=values, intervals=intervals, role="fitted"))
    if data.times.spread:
        values = {"spread": np.array([data.times.spread])}
        effects.append(EffectValues(name="delay_jitter", joints=(), values=values, intervals={}, role="fitted"))
    if coarse.any():
        joints = tuple(np.array(data.machine.joints)[coarse].tolist())
        values = {"angle": data.encoder_steps[coarse]}
        effects.append(EffectValues(name="encoder_step", joints=joints, values=values, intervals={}, role="fitted"))
    return EffectSet(tuple(effects))


def _warnings(model: Model) -> tuple[str, ...]:
    """Return what the user should know of the numbers: those at an end that does not mean none."""
    lines = []
    joints = model.data.machine.joints
    for f in model.free:
        p = f.parameter
        value = float(model.table[f.cell])
        none = float(model.setting.blank[f.cell])
        if value in (p.low, p.high) and value not in (none, 0.0, UNLIMITED):
            end = "largest" if value == p.high else "smallest"
            lines.append(
                f"{_called(f.key, f.joint, joints)} is at its {end}, {value:g}: the log does not say more of it"
            )
    if model.data.log.tau is not None:
        lines.append("the measured torque is compared with that of the motors (report.html), and not fitted")
    return tuple(lines)


def _called(key: tuple[str, str], joint: int, joints: Sequence[str]) -> str:
    return ".".join(key) + (f" of {joints[joint]}" if joint >= 0 else "")


def _correlations(model: Model) -> Correlations:
    spreads = model.covariance()
    size = np.sqrt(np.maximum(np.diag(spreads), 1e-300))
    names = tuple(_called(f.key, f.joint, model.data.machine.joints) for f in model.free)
    return Correlations(names=names, matrix=spreads / np.outer(size, size))


def _traces(outcome: Outcome, speed: FloatArray, torque: FloatArray) -> Traces:
    data = outcome.best.model.data
    torques: dict[str, FloatArray] = {}
    if data.log.tau is not None:
        for name, one in (("torque_before", outcome.null), ("torque_after", outcome.best)):
            given = one.model.setting.passes.whole([one.model.table], one.model.gains)[0][2]
            torques[name] = np.where(data.counts, data.log.tau - given, np.nan)
    return Traces(
        t=data.record.t,
        q=data.log.q,
        dq=speed,
        tau=torque,
        before=np.where(data.counts, outcome.null.left_out, np.nan),
        after=np.where(data.counts, outcome.best.left_out, np.nan),
        target=data.log.q_des,
        log=None if data.logs == 1 else data.record.log,
        **torques,
    )


def _by_log(
    outcome: Outcome, others: Sequence[JointLog], model: MachineModel, names: Sequence[str]
) -> tuple[LogErrors, ...]:
    """Return the errors of each log, of several: those fitted first, then those held out whole."""
    ends = (outcome.null.model, outcome.best.model)
    data = ends[1].data
    if data.logs == 1 and not others:
        return ()
    sides = [by_log(one) for one in ends]
    if data.apart.any():
        sides += [by_log(one, one.left_out(one.data.apart)) for one in ends]
    found = [LogErrors(name, True, *rows) for name, *rows in zip(data.names, *sides, strict=True)]
    if others:
        unseen = data_of(others, model, names)
        alike = [times for times in unseen.sending if times.how == data.times.how]
        unseen = unseen.sent_at(alike[0]) if alike else unseen
        old, new = (by_log(one.over(unseen)) for one in ends)
        found += [LogErrors(name, False, *rows) for name, *rows in zip(unseen.names, old, new, strict=True)]
    return tuple(found)
