"""Commands of a robot that only stands, and the ground under one that stands on a slope."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from mimic.control.loop import RunResult
from mimic.evaluation.episode import TIMING
from mimic.policy.runtime import Policy
from mimic.records import CommandTrack, FloatArray


def standing_track(policy: Policy, seconds: float) -> CommandTrack:
    """Return commands that ask for nothing but neutral toes, for a run of this length with TIMING [s]."""
    dt = policy.contract.dt
    ticks = round((seconds - TIMING.stand_up - TIMING.blend) / dt)
    neutral = np.array(policy.contract.neutral_toes).reshape(2, 3)
    return CommandTrack(
        t=np.arange(ticks) * dt,
        v=np.zeros((ticks, 2)),
        heading=np.zeros(ticks),
        p_BE=np.broadcast_to(neutral, (ticks, 2, 3)).copy(),
    )


def on_level_ground(result: RunResult, slope_quat: FloatArray) -> RunResult:
    """Return a run on a slope with the height of the base above the ground under it."""
    normal = np.zeros(3)
    mujoco.mju_rotVecQuat(normal, np.array([0.0, 0.0, 1.0]), slope_quat)
    p_WB = result.log.p_WB.copy()
    p_WB[:, 2] += (p_WB[:, 0] * normal[0] + p_WB[:, 1] * normal[1]) / normal[2]
    return replace(result, log=replace(result.log, p_WB=p_WB))
