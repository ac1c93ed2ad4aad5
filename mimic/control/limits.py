"""Targets and commands are clamped to what the robot can do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mimic.records import FloatArray, JointCommand
from mimic.robot.description import RobotDescription
from mimic.robot.leg_kinematics import front_legs


def clamp_desired(
    v_des: FloatArray, p_BE_des: FloatArray, description: RobotDescription
) -> tuple[FloatArray, FloatArray, int]:
    """Return velocity (2,) and toes (2, 3) inside their limits, and how many of them were clamped.

    A toe beyond the length of its leg is clamped towards the hip axis; the finer limits are those of the retargeting.
    """
    v = np.clip(v_des, -description.commands.velocity, description.commands.velocity)
    clamped = int(np.count_nonzero(v != v_des))
    toes = np.array(p_BE_des, dtype=np.float64)
    for side, leg in enumerate(front_legs(description)):
        hip = leg.origin + np.array([0.0, leg.offset, 0.0])
        longest = float(np.hypot(leg.thigh + np.hypot(leg.toe[0], leg.toe[2]), 2 * abs(leg.offset)))
        away = float(np.linalg.norm(toes[side] - hip))
        if away > longest:
            toes[side] = hip + (toes[side] - hip) * longest / away
            clamped += 1
    return v, toes, clamped


def clamp_command(command: JointCommand, description: RobotDescription) -> tuple[JointCommand, int]:
    """Return the command inside joint limits and the motors' gains, and how many numbers were clamped."""
    inside = {
        "q_des": np.clip(command.q_des, description.q_min, description.q_max),
        "kp": np.clip(command.kp, 0.0, description.kp_max),
        "kd": np.clip(command.kd, 0.0, description.kd_max),
        "tau_ff": np.clip(command.tau_ff, -description.torque_max, description.torque_max),
    }
    clamped = sum(int(np.count_nonzero(value != getattr(command, name))) for name, value in inside.items())
    return (replace(command, **inside) if clamped else command), clamped
