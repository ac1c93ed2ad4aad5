"""Terms of the paper's reward that need no contacts: how well a robot follows its commands, and how upright it stands.

Source: Li et al. 2024, section III; IrisLi17/legged_stand_dance, commit 5515c10 (c2_standdance_env.py).
"""

from __future__ import annotations

import numpy as np

from mimic.geometry import heading_from_quat, wrap_angle
from mimic.metrics import uprightness
from mimic.records import FloatArray, IntArray
from mimic.robot.description import RobotDescription

TRACKING_WEIGHTS = {"velocity": 0.6, "heading": 0.25, "toes": 1.0, "height": 0.5, "upright": 1.0}
"""Weight of each term of `tracking`."""

STAND_STEPS = 50
"""Only from here on toes are tracked."""

STANDING_HEIGHT = 0.42
"""Base height from which on the paper's robot stands [m]."""


def _ramp(value: FloatArray, low: float, high: float) -> FloatArray:
    return np.clip((value - low) / (high - low), 0.0, 1.0)


def tracking(
    *,
    p_WB: FloatArray,
    v_WB: FloatArray,
    quat_WB: FloatArray,
    p_BE: FloatArray,
    v_des: FloatArray,
    heading_des: FloatArray,
    p_BE_des: FloatArray,
    step: IntArray,
    description: RobotDescription,
) -> dict[str, FloatArray]:
    """Return the unweighted terms that need no contacts (...,): velocity, heading, toes, height, upright.

    Args:
        p_WB: Position of the base (..., 3) [m].
        v_WB: Its velocity, world axes (..., 3) [m/s].
        quat_WB: Its orientation (..., 4), wxyz.
        p_BE: Base -> front toe (..., 2, 3) [m].
        v_des: Velocity asked for in the heading frame (..., 2) [m/s].
        heading_des: Heading asked for, world (...,) [rad].
        p_BE_des: Toes asked for (..., 2, 3) [m].
        step: Control steps since the policy began (...,).
        description: The robot.
    """
    z = p_WB[..., 2] * (STANDING_HEIGHT / description.training.rise_to)  # as if it were as large as a CyberDog 2
    up = uprightness(quat_WB, description)
    standing = _ramp(z, 0.25, 0.35) * (up > 0.9)
    velocity = in_heading_frame(v_WB, quat_WB) - v_des
    turn = wrap_angle(heading_des - heading_from_quat(quat_WB))
    toes = np.square(p_BE - p_BE_des).sum((-1, -2))
    toes_count = (z > 0.37) & (up > 0.2) & (step > STAND_STEPS)
    return {
        "velocity": np.exp(-np.square(velocity).sum(-1) / 0.05) * standing,
        "heading": np.exp(-np.square(turn / np.pi) / 0.05) * standing,
        "toes": np.exp(-toes / 0.02) * toes_count,
        "height": _ramp(z, 0.15, STANDING_HEIGHT),
        "upright": np.square((1 + up) / 2),
    }


def in_heading_frame(v_WB: FloatArray, quat_WB: FloatArray) -> FloatArray:
    """Return the velocity of the base forward and left (..., 2) [m/s]."""
    heading = heading_from_quat(quat_WB)
    cosine = np.cos(heading)
    sine = np.sin(heading)
    vx = v_WB[..., 0]
    vy = v_WB[..., 1]
    return np.stack([cosine * vx + sine * vy, cosine * vy - sine * vx], -1)
