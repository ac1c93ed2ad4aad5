"""What a model predicts of a log without fitting anything; logs of a robot with chosen effects."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mimic.config.sysid import LogSettings
from mimic.dynamics.effect_set import EffectSet
from mimic.dynamics.machine import MachineModel, drive_notes
from mimic.dynamics.servo import parameters_of
from mimic.io.joint_log import JointLog
from mimic.records import BoolArray, FloatArray
from mimic.sysid.fit.problem import FINE
from mimic.sysid.fit.replay import SEGMENT, Replay, on_steps, physics_step
from mimic.sysid.log.pool import valid_samples
from mimic.sysid.log.timing import AT_ROW, SENT, sending_times


def predict(
    log: JointLog, machine: MachineModel, effects: EffectSet, *, whole: bool = False, threads: int = 0
) -> FloatArray:
    """Return measured - predicted positions (T, J) [rad or m], NaN where nothing is predicted or the sample is masked.

    They are extrapolated to steps of length zero, from replays in two step sizes. Targets of a jittering
    delay act as late as they do on the average; lost commands are single events, which cannot be predicted.

    Args:
        log: Readings of the machine's joints, in its order.
        machine: The model, as the log says (`mimic.dynamics.machine.as_logged`).
        effects: What it has.
        whole: Replay the log in one piece from its first reading; else in pieces that each begin with a measured
            position.
        threads: Threads; 0 takes one for each core.

    Raises:
        ConfigError: If an effect names a joint that the machine lacks.
    """
    p = parameters_of(effects, machine)
    spread = float(p.pop(("delay_jitter", "spread"), np.zeros((1, 1)))[0, 0])
    p.pop(("lost_commands", "share"), None)
    p = p or {("delay", "time"): np.zeros((1, 1))}
    pieces: dict[str, Any] = {"segment": math.inf, "lead_in": 0.0} if whole else {"segment": SEGMENT[1]}
    made = []
    for times in (FINE, 2 * FINE):
        step = physics_step(log.rate) / times
        replay = Replay(machine, log, timestep=step, threads=threads, sending=sending_times(log)[0], **pieces)
        if spread:
            replay = replay.with_late(np.full(len(replay.sent), spread / 2))
        if ("kt_heat", "time") in p and not whole:
            replay = replay.with_heat(np.sqrt(replay.mean_square_torque(p)))
        made.append(replay.run(p, 1).residual[0].astype(np.float64))
    residual = 2.0 * made[1] - made[0]
    return np.where(valid_samples(log)[:, None], residual, np.nan)


def simulate_log(
    machine: MachineModel, t: FloatArray, q_des: FloatArray, effects: EffectSet, settings: LogSettings
) -> JointLog:
    """Return what a machine with these effects would log.

    Args:
        machine: The model.
        t: Times at which targets are sent (T,) [s].
        q_des: Targets (T, J) [rad].
        effects: What the machine has.
        settings: Noise, resolution, rate, losses.

    Returns:
        The log: q and q_des at the rate of the settings, tau as the motors give it.
    """
    rng = np.random.default_rng(settings.seed)
    p = parameters_of(effects, machine)
    spread = float(p.pop(("delay_jitter", "spread"), np.zeros((1, 1)))[0, 0])
    share = float(p.pop(("lost_commands", "share"), np.zeros((1, 1)))[0, 0])
    sent = on_steps(t * settings.rate_hz)
    number = np.arange(int(sent[-1]) + 1)
    times, rows = number / settings.rate_hz, np.maximum(np.searchsorted(sent, number, side="right") - 1, 0)
    kept = rng.random(len(t)) >= share
    kept[0] = True
    late = t + spread * rng.random(len(t))
    late[0] = t[0]
    fine = np.arange(int(on_steps(t[-1] / settings.timestep)) + 1) * settings.timestep
    nothing = np.zeros((len(fine), len(machine.joints)))
    command = JointLog(joints=machine.joints, t=fine, q=nothing, tau=nothing, q_des=_arrived(fine, late, q_des, kept))
    replay = Replay(machine, command, timestep=settings.timestep, segment=math.inf, lead_in=0.0, threads=1, torque=True)
    made = replay.run(p or {("delay", "time"): np.zeros((1, 1))}, 1)
    q, tau = -made.residual[0].astype(np.float64), -made.torque_residual[0].astype(np.float64)  # type: ignore[index]
    read = times + settings.jitter * rng.standard_normal(len(times))
    read = np.clip(read, 0.0, fine[-1])
    q = np.stack([np.interp(read, fine, column) for column in q.T], -1)
    total = np.concatenate([np.zeros((1, tau.shape[1])), np.cumsum(tau[1:], axis=0)]) * settings.timestep
    before = np.maximum(read - 1.0 / settings.rate_hz, 0.0)
    between = np.maximum(read - before, settings.timestep)[:, None]
    tau = np.stack([np.interp(read, fine, c) - np.interp(before, fine, c) for c in total.T], -1) / between
    tau = tau + settings.torque_noise * rng.standard_normal(tau.shape)
    q = q + settings.noise * rng.standard_normal(q.shape)
    if settings.resolution > 0:
        q = settings.resolution * np.round(q / settings.resolution)
    there = rng.random(len(times)) >= settings.lost_samples
    there[0] = True
    return JointLog(
        joints=machine.joints,
        t=times[there],
        q=q[there],
        q_des=q_des[rows][there],
        tau=tau[there],
        metadata={**drive_notes(machine), "simulated": True, SENT: AT_ROW},
    )


def _arrived(fine: FloatArray, late: FloatArray, q_des: FloatArray, kept: BoolArray) -> FloatArray:
    """Return the target in effect at each fine time: the newest that was not lost and has arrived.

    Arrivals are put on the nearest fine time: on the next one, all would be half a step late on the average.
    """
    arrival = np.round((late - fine[0]) / (fine[1] - fine[0])).astype(int)
    there, newest = np.flatnonzero(kept & (arrival < len(fine))), np.zeros(len(fine), dtype=int)
    np.maximum.at(newest, arrival[there], there)
    return q_des[np.maximum.accumulate(newest)]
