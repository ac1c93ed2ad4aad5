"""What a model predicts of a log without fitting anything; logs of a robot with chosen effects."""

from __future__ import annotations

import numpy as np

from mimic.config.sysid import LogSettings
from mimic.dynamics.effect_set import EffectSet
from mimic.dynamics.machine import MachineModel, drive_notes
from mimic.dynamics.servo import parameters_of
from mimic.io.joint_log import JointLog
from mimic.records import BoolArray, FloatArray
from mimic.sysid.engine.data import BEFORE, data_of
from mimic.sysid.engine.laws import DELAY, ROW
from mimic.sysid.engine.likelihood import FOLLOWING
from mimic.sysid.engine.model import STEP, blank_table, setting_of
from mimic.sysid.engine.predictor import predict as passed
from mimic.sysid.log.timing import AT_ROW, SENT

APART = 1e-9
"""Least time between two readings of a simulated log [s]."""


def predict(log: JointLog, machine: MachineModel, effects: EffectSet, *, whole: bool = False) -> FloatArray:
    """Return measured - predicted positions (T, J) [rad or m], NaN where nothing is predicted or the sample is masked.

    Targets of a jittering delay act as late as they do on the average; lost commands are single events, which cannot be
    predicted.

    Args:
        log: Readings of the machine's joints, in its order.
        machine: The model, as the log says (`mimic.dynamics.machine.as_logged`).
        effects: What it has.
        whole: Predict the log in one piece from its first reading; else to the end of each block of 1.5 s, from where
            the readings before it say that the machine is.

    Raises:
        ConfigError: If an effect names a joint that the machine lacks.
    """
    data = data_of([log], machine)
    table = table_of(data.machine, effects)
    table[DELAY] += table[ROW["delay_jitter", "spread"]] / 2.0
    counts = data.counts
    gains = np.zeros((1, 2, 2, data.joints, 3))
    if whole:
        counts = np.isfinite(data.record.y)
        record = data.record._replace(lead=np.zeros_like(data.record.lead), settled=np.ones_like(data.record.settled))
    else:
        record = data.record
        setting = setting_of(data)
        gains = setting.gains.of(FOLLOWING * setting.gains.torque, data)
    made = passed(data.tree, record, table, gains, STEP / 2.0)
    return np.where(counts, data.record.y - made[0], np.nan)


def table_of(machine: MachineModel, effects: EffectSet) -> FloatArray:
    """Return the numbers of a machine with these effects (S, J).

    Raises:
        ConfigError: If one names a joint that the machine lacks.
    """
    table = blank_table(machine)
    for key, row in parameters_of(effects, machine).items():
        table[ROW[key]] = row[0]
    return table


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
    table = table_of(machine, effects)
    spread = float(table[ROW["delay_jitter", "spread"], 0])
    share = float(table[ROW["lost_commands", "share"], 0])
    last = np.searchsorted(t, np.arange(round(t[-1] * settings.rate_hz) + 1) / settings.rate_hz + APART, side="right")
    rows = np.maximum(last - 1, 0)
    times = np.arange(len(rows)) / settings.rate_hz
    kept = rng.random(len(t)) >= share
    kept[0] = True
    late = t + spread * rng.random(len(t))
    late[0] = t[0]
    read = np.clip(times + settings.jitter * rng.standard_normal(len(times)), 0.0, times[-1])
    read[0] = 0.0
    order = np.argsort(read, kind="stable")
    made = np.zeros((3, len(read), len(machine.joints)))
    clock = np.maximum.accumulate(read[order]) + APART * np.arange(len(read))
    made[:, order] = _played(machine, clock, late, q_des, kept, table, settings.timestep)
    q = made[0] + settings.noise * rng.standard_normal(made[0].shape)
    tau = made[2] + settings.torque_noise * rng.standard_normal(made[0].shape)
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


def _played(
    machine: MachineModel,
    clock: FloatArray,
    late: FloatArray,
    q_des: FloatArray,
    kept: BoolArray,
    table: FloatArray,
    timestep: float,
) -> FloatArray:
    """Return readings, unknown torques and torques of the motors (3, T, J) at times (T,) from rest at position zero.

    Targets (K, J) arrive late (K,) [s] if they are kept (K,); one that the next overtakes is lost.
    """
    order = np.argsort(np.where(kept, late, np.inf), kind="stable")[: int(kept.sum())]
    order = order[order == np.maximum.accumulate(order)]
    sent = late[order]
    sent[0] -= BEFORE
    still = np.zeros((len(clock), len(machine.joints)))
    data = data_of([JointLog(joints=machine.joints, t=clock, q=still, q_des=still)], machine)
    record = data.record._replace(
        t=clock,
        settled=np.ones_like(data.record.settled),
        lead=np.zeros_like(data.record.lead),
        sent=sent,
        goal=np.ascontiguousarray(q_des[order]),
    )
    return passed(data.tree, record, table, np.zeros((1, 2, 2, data.joints, 3)), timestep)
