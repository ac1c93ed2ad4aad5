"""Weights of the reward terms, and how they change during a training."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class RewardWeights:
    """Weight of each reward term, per control step; see mimic.train.rewards for the terms."""

    alive: float = 0.5
    height: float = 0.6
    upright: float = 1.0
    velocity: float = 5.0
    heading: float = 2.0
    toes: float = 6.0
    toes_fine: float = 3.0
    gait: float = 12.0
    drift: float = 0.0
    """Off: not shown to be good for anything (lab/results/training.md)."""
    slip: float = -4.0
    foot_shift: float = -8.0
    terminations: float = -4.0
    flight: float = -0.5
    low: float = -0.3
    action_rate: float = -0.012
    unrest: float = -0.5
    """Changes of the hind legs' action while the robot is asked to stand and does not topple."""
    shuffle: float = 0.0
    """Speed of hind toes on the ground meanwhile [m/s]. Off: tried once, in a training that went wrong."""
    torque: float = -2e-4
    heat: float = -0.015
    """Sum of the squares of all torques, which heats the windings."""
    overload: float = -0.01
    joint_velocity: float = -3e-4
    joint_speed: float = -0.02
    joint_acceleration: float = -1e-7
    limits: float = -6.0
    fall: float = -2.0


REGULARISERS = ("action_rate", "torque", "joint_velocity", "joint_acceleration")
"""Reward terms that grow during training, once the robot stands."""


REFINING_TERMS = (
    "drift",
    "unrest",
    "shuffle",
    "heat",
    "slip",
    "foot_shift",
    "terminations",
    "flight",
    "overload",
    "joint_speed",
)
"""Reward terms that hardly count before the robot stands. With all of them from the beginning a world loses more by
each step than by falling, and a policy learns to fall at once; that was tried."""


@dataclass(frozen=True, kw_only=True, slots=True)
class FinishFactors:
    """What the weights of a few reward terms are multiplied by at the end of a training."""

    velocity: float = 5.0
    heading: float = 2.5
    toes: float = 1.0
    toes_fine: float = 2.0
    slip: float = 7.0


@dataclass(frozen=True, kw_only=True, slots=True)
class SitDownWeights:
    """Weight of each reward term of sitting down, per control step; see mimic.train.sit_down for the terms."""

    height: float = 1.6
    level: float = 0.8
    roll: float = -1.0
    pose: float = 2.0
    pose_fine: float = 1.0
    still: float = 0.6
    sinking: float = -15.0
    fast: float = -2.0
    tumbling: float = -0.05
    jolt: float = -2.0
    landing: float = -5.0
    trunk: float = -1.0
    thighs: float = -0.2
    head_low: float = -4.0
    slip: float = -0.25
    beyond: float = -1.0
    action_rate: float = -0.008
    torque: float = -2e-4
    joint_velocity: float = -4e-4
    joint_speed: float = -0.02
    joint_acceleration: float = -1e-7
    limits: float = -2.0
    fail: float = -10.0
