"""Targets and commands brought inside what a robot may be asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mimic.robot.description import RobotDescription
from mimic.robot.leg import front_legs
from mimic.types import FloatArray, JointCommand

SPEED = 0.3
"""Fastest walk that a policy was trained for, forward and to the side [m/s]."""


def toes_within(
    v_des: FloatArray, p_BE_des: FloatArray, description: RobotDescription
) -> tuple[FloatArray, FloatArray, int]:
    """Return velocity (2,) and toes (2, 3) inside training and the legs' length, and how many of them were moved.

    A toe beyond the length of its leg is drawn to the hip axis; where it may go within that is the retargeting's to say.
    """
    v = np.clip(v_des, -SPEED, SPEED)
    moved = int(np.count_nonzero(v != v_des))
    toes = np.array(p_BE_des, dtype=np.float64)
    for side, leg in enumerate(front_legs(description)):
        hip = leg.origin + np.array([0.0, leg.offset, 0.0])
        most = float(np.hypot(leg.thigh + np.hypot(leg.toe[0], leg.toe[2]), 2 * abs(leg.offset)))
        away = float(np.linalg.norm(toes[side] - hip))
        if away > most:
            toes[side] = hip + (toes[side] - hip) * most / away
            moved += 1
    return v, toes, moved


def command_within(command: JointCommand, description: RobotDescription) -> tuple[JointCommand, int]:
    """Return the command inside joint limits and gains that motors take, and how many numbers were moved."""
    most = float(description.raw["motor"]["kd_most"])
    inside = {
        "q_des": np.clip(command.q_des, description.q_min, description.q_max),
        "kp": np.clip(command.kp, 0.0, float(description.raw["motor"]["kp_most"])),
        "kd": np.clip(command.kd, 0.0, most),
        "tau_ff": np.clip(command.tau_ff, -description.torque_max, description.torque_max),
    }
    moved = sum(int(np.count_nonzero(value != getattr(command, name))) for name, value in inside.items())
    return (replace(command, **inside) if moved else command), moved
