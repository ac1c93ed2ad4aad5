"""What a model foretells of a log that it was not fitted to."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mimic.calibrate.replay import Replay, physics_step
from mimic.calibrate.settle import FINE
from mimic.calibrate.unread import read
from mimic.machine_log import MachineLog
from mimic.robot.effect_set import EffectSet
from mimic.robot.machine import MachineModel
from mimic.robot.servo import parameters_of
from mimic.types import FloatArray


def foretell(
    log: MachineLog, machine: MachineModel, effects: EffectSet, *, whole: bool = False, threads: int = 0
) -> FloatArray:
    """Return measured - predicted positions (T, J) [rad or m], NaN where nothing is foretold or was read.

    They are those that steps without length would leave, from replays in two lengths of steps. Targets of a jittering delay act as late
    as they do on the average; lost commands are single events, which nothing foretells.

    Args:
        log: Readings of the machine's joints, in its order.
        machine: The model, as the log says (:func:`~mimic.robot.machine.as_logged`).
        effects: What it has.
        whole: Replay the log in one piece from its first reading; else in pieces that each begin with a measured position.
        threads: Of MuJoCo; 0 takes one for each core.

    Raises:
        ConfigError: If an effect names a joint that the machine lacks.
    """
    p = parameters_of(effects, machine)
    spread = float(p.pop(("delay_jitter", "spread"), np.zeros((1, 1)))[0, 0])
    p.pop(("lost_commands", "share"), None)
    p = p or {("delay", "time"): np.zeros((1, 1))}
    pieces: dict[str, Any] = {"segment": math.inf, "settle": 0.0} if whole else {}
    made = []
    for times in (FINE, 2 * FINE):
        replay = Replay(machine, log, timestep=physics_step(log.rate) / times, threads=threads, **pieces)
        if spread:
            replay.set_late(np.full(len(replay.sent), spread / 2))
        if ("kt_heat", "time") in p and not whole:
            replay.set_heat(np.sqrt(replay.mean_square_torque(p)))
        made.append(replay.run(p, 1).residual[0].astype(np.float64))
    residual = 2.0 * made[1] - made[0]
    return np.where(read(log)[:, None], residual, np.nan)
