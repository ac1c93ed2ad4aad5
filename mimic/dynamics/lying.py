"""Where a robot without power lies: its model sinks onto the ground until it rests."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np

from mimic.dynamics.robot_model import load_model
from mimic.records import FloatArray
from mimic.robot.description import RobotDescription

SINKS_WITHIN = 4.0
"""A robot that has not come to rest by then is as good as at rest [s]; both shipped ones are within 3."""

RESTS = 0.05
"""The speed of each joint and of the base of a robot that rests [rad/s, m/s], …"""

RESTS_FOR = 0.2
"""… for this long [s]: dry friction may hold a leg for a moment."""


SLIDES = 0.4
"""Feet slide at this friction at most while it sinks: where they stick, whoever lays it down moves them apart."""


def sink(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Let a robot sink from where it is, its motors without power; it then rests, and the time is what it was.

    A motor without power turns with the friction, damping and inertia that the model has at its joint.
    """
    began = data.time
    still = 0.0
    flags = model.opt.disableflags
    friction = model.geom_friction.copy()
    model.geom_friction[:, 0] = np.minimum(friction[:, 0], SLIDES)
    model.opt.disableflags = flags | mujoco.mjtDisableBit.mjDSBL_ACTUATION
    data.qvel[:] = 0.0
    while still < RESTS_FOR and data.time - began < SINKS_WITHIN:
        mujoco.mj_step(model, data)
        still = still + model.opt.timestep if np.abs(data.qvel).max() < RESTS else 0.0
    model.opt.disableflags = flags
    model.geom_friction[:] = friction
    data.qvel[:] = 0.0
    data.time = began
    mujoco.mj_forward(model, data)


@cache
def sunk_pose(description: RobotDescription) -> FloatArray:
    """Return where the joints of a robot are that sank from its folded legs (12,) [rad]."""
    model = load_model(description, visuals=False)
    data = mujoco.MjData(model)
    data.qpos[:7] = 0.0, 0.0, description.pose_height["lie"], 1.0, 0.0, 0.0, 0.0
    data.qpos[-12:] = description.poses["lie"]
    mujoco.mj_forward(model, data)
    sink(model, data)
    return np.array(data.qpos[-12:])
