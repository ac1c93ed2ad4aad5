"""What a model predicts of a log, without fitting anything."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mimic.dynamics.effect_set import EffectSet
from mimic.dynamics.machine import MachineModel
from mimic.dynamics.servo import parameters_of
from mimic.io.joint_log import JointLog
from mimic.records import FloatArray
from mimic.sysid.fit.step_refinement import FINE
from mimic.sysid.logs import valid_samples
from mimic.sysid.replay.cpu import Replay
from mimic.sysid.replay.records import physics_step
from mimic.sysid.timing import sending_times


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
        threads: Of MuJoCo; 0 takes one for each core.

    Raises:
        ConfigError: If an effect names a joint that the machine lacks.
    """
    p = parameters_of(effects, machine)
    spread = float(p.pop(("delay_jitter", "spread"), np.zeros((1, 1)))[0, 0])
    p.pop(("lost_commands", "share"), None)
    p = p or {("delay", "time"): np.zeros((1, 1))}
    pieces: dict[str, Any] = {"segment": math.inf, "lead_in": 0.0} if whole else {}
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
