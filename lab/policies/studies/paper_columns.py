"""The figures of the paper's Table III from the log of an episode: terms, terminations, columns.

Definitions follow the public code (c2_standdance_env.py, c2_standdance_config.py) where the text leaves them open.
Step k (from 1) compares the state after k control steps with the commands of that step, so a log of n + 1 ticks holds
n steps.

The paper is ambiguous in some places. What is computed here:

* **The columns are sums over the episode divided by 1000 steps**, whether or not it lasted that long. The paper says
  mean per step; only this reading fits its figures: 0.389 for the height term of weight 0.5 over 826.68 steps would
  else mean 78 % of the full height, and in three of the four rows height / steps is 93 or 94 %.
* **The episode reward is the sum of all weighted terms times the control step**, which is what the training library
  of the paper logs; the five columns alone would give 26.8 for the 30.53 of the paper. Here it holds the five columns,
  ``upright`` and the penalties in WEIGHTS, but not foot clearance (-300), which belongs to the paper's own gait clock.
* **Slip counts all four toes** whose centre is lower than 3 cm, with the turning of the lower leg about the vertical.
* Contacts between parts of the robot end an episode in the paper; here only the ground does.
* An episode is evaluated with three sets of terminations (TERMINATIONS): contacts alone, contacts and joint limits, and
  both with those of the first 30 steps (hind toe above 6 cm, a joint that moves more than 0.3 rad in a step).
* The heading is the yaw of the left axis less 90 degrees; the paper's is that of the belly, the same when upright.

Source: Li et al. 2024, section III, Table III; IrisLi17/legged_stand_dance, commit 5515c10.
"""

from __future__ import annotations

import numpy as np

from lab.policies.studies.ground_contacts import GroundFacts
from mimic.evaluation.paper_reward import TRACKING_WEIGHTS, in_heading_frame, tracking
from mimic.records import LEGS, BoolArray, FloatArray, RunLog
from mimic.robot.description import RobotDescription

STEPS = 1000
"""Control steps of an episode."""

GRACE_STEPS = 30
"""Only from here on contacts end an episode."""

LIMIT_MARGIN = np.deg2rad(5.0)
"""A joint nearer to its limit than this ends an episode, from the fourth step on [rad]."""

WEIGHTS = {
    **TRACKING_WEIGHTS,
    "slip": -0.4,
    "collision": -2.0,
    "rear_air": -0.5,
    "action_rate": -0.03,
    "target_distance": -1.0,
    "joint_velocity": -1e-4,
    "joint_acceleration": -2.5e-7,
    "joint_limits": -10.0,
    "torque": -0.01,
    "foot_shift": -50.0,
}
"""Weight of each term."""

COLUMNS = ("velocity", "heading", "toes", "height", "slip")
"""Terms that Table III shows."""

PAPER = {
    "velocity": (0.221, 0.022),
    "heading": (0.173, 0.009),
    "toes": (0.679, 0.010),
    "height": (0.389, 0.005),
    "slip": (-0.122, 0.005),
    "episode_reward": (30.53, 0.58),
    "steps": (826.68, 12.01),
}
"""Mean and standard deviation over three training seeds in the paper's Table III, first row."""

ACTION_UNIT = 0.25
"""Radians per unit of the paper's action, for its action rate."""

CONTACT_TERMINATIONS = {
    "base": ("base",),
    "head": ("head",),
    "front_leg": tuple(f"{leg}_{part}" for leg in LEGS[:2] for part in ("thigh", "calf", "foot")),
    "hind_thigh": tuple(f"{leg}_thigh" for leg in LEGS[2:]),
}
"""Parts whose contact with the ground ends an episode, by the kind that is reported."""

COLLIDING = tuple(part for parts in CONTACT_TERMINATIONS.values() for part in parts) + tuple(
    f"{leg}_calf" for leg in LEGS[2:]
)
"""Parts whose contact with the ground is penalised."""

TERMINATIONS = {
    "contacts": tuple(CONTACT_TERMINATIONS),
    "contacts and joint limits": (*CONTACT_TERMINATIONS, "joint_limit"),
    "all of the paper's": (*CONTACT_TERMINATIONS, "joint_limit", "early_foot", "early_joint"),
}
"""Kinds of termination that end an episode, for each set."""

EARLY_FOOT_HEIGHT, EARLY_JOINT_STEP = 0.06, 0.3
"""Highest hind toe [m] and largest joint motion in a step [rad] that the paper allows in the first 30 steps."""


def terms(log: RunLog, ground: GroundFacts, description: RobotDescription) -> dict[str, FloatArray]:
    """Return each unweighted term of WEIGHTS for each step (ticks - 1,)."""
    step = np.arange(1, len(log.t))
    early = step <= GRACE_STEPS
    q, dq = log.q[1:], log.dq[1:]
    tracked = tracking(
        p_WB=log.p_WB[1:],
        v_WB=log.v_WB[1:],
        quat_WB=log.quat_WB[1:],
        p_BE=log.p_BE[1:],
        v_des=log.v_des[:-1],
        heading_des=log.heading_des[:-1],
        p_BE_des=log.p_BE_des[:-1],
        step=step,
        description=description,
    )
    planted = ground.toe_height[1:] < 0.03
    sliding = np.square(ground.toe_velocity[1:]).sum(-1) + np.square(ground.toe_yaw_rate[1:] / np.pi)
    touching = {part: rows[1:] for part, rows in ground.touching.items()}
    feet = np.stack([touching[f"{leg}_foot"] for leg in LEGS[2:]], -1)
    calves = np.stack([touching[f"{leg}_calf"] for leg in LEGS[2:]], -1)
    middle, half = (description.q_max + description.q_min) / 2, (description.q_max - description.q_min) / 2
    change = np.diff(log.q_des, axis=0, prepend=log.q_des[:1])[:-1] / ACTION_UNIT
    acceleration = np.diff(log.dq, axis=0) / description.dt
    return {
        **tracked,
        "slip": (planted * sliding).sum(-1),
        "collision": np.sum([touching[part] for part in COLLIDING], axis=0) * ~early,
        "rear_air": ~feet.any(-1) + (calves & ~feet).sum(-1),
        "action_rate": np.square(change).sum(-1),
        "target_distance": np.square(log.q_des[:-1] - q).sum(-1) * early,
        "joint_velocity": np.square(dq).sum(-1),
        "joint_acceleration": np.square(acceleration).sum(-1),
        "joint_limits": np.maximum(np.abs(q - middle) - 0.95 * half, 0.0).sum(-1),
        "torque": np.maximum(np.abs(log.tau[1:]) - 0.5 * description.torque_max, 0.0).sum(-1),
        "foot_shift": foot_shift(log, ground, description) * (step < GRACE_STEPS),
    }


def velocity_error(log: RunLog) -> FloatArray:
    """Return measured - desired base velocity in the heading frame for each step (ticks - 1, 2) [m/s]."""
    return in_heading_frame(log.v_WB[1:], log.quat_WB[1:]) - log.v_des[:-1]


def foot_shift(log: RunLog, ground: GroundFacts, description: RobotDescription) -> FloatArray:
    """Return the mean distance of the hind toes from where they started (ticks - 1,) [m].

    Toes have moved by the integral of their horizontal velocity; the paper's front-toe part, which holds only until
    the front legs leave the ground, is left out.
    """
    path = np.cumsum(ground.toe_velocity[1:, 2:] * description.dt, axis=0)
    up = ground.toe_height[1:, 2:, None] - description.toe_radius
    return np.linalg.norm(np.concatenate([path, up], -1), axis=-1).mean(-1)


def near_limits(q: FloatArray, description: RobotDescription) -> BoolArray:
    """Return which joints (..., 12) are within LIMIT_MARGIN of a limit."""
    return (q < description.q_min + LIMIT_MARGIN) | (q > description.q_max - LIMIT_MARGIN)


def terminations(log: RunLog, ground: GroundFacts, description: RobotDescription) -> dict[str, BoolArray]:
    """Return for each kind of termination whether it holds at each step (ticks - 1,)."""
    step = np.arange(1, len(log.t))
    q = log.q[1:]
    near = near_limits(q, description)
    moved = np.abs(np.diff(log.q, axis=0)).max(-1)
    lifted = ground.toe_height[1:, 2:].max(-1)
    early = (step > 3) & (step <= GRACE_STEPS)
    touched = {
        kind: np.any([ground.touching[part][1:] for part in parts], axis=0) & (step > GRACE_STEPS)
        for kind, parts in CONTACT_TERMINATIONS.items()
    }
    return touched | {
        "joint_limit": near.any(-1) & (step > 3),
        "early_foot": (lifted > EARLY_FOOT_HEIGHT) & early,
        "early_joint": (moved > EARLY_JOINT_STEP) & early,
    }
