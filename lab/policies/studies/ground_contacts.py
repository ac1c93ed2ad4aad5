"""Toes and the ground over a run: heights, speeds and what touches, from joint positions and the pose of the base."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from mimic.dynamics.robot_model import load_model
from mimic.records import LEGS, BoolArray, FloatArray, RunLog
from mimic.robot.description import RobotDescription
from mimic.robot.model import FLOOR, TOES

_LINKS = {"thigh": ("thigh",), "calf": ("shank", "knee"), "foot": ("toe",)}
"""Link by the paper's name -> roles of its collision shapes; the paper's 'hip' (abad) is left out."""


def ground_parts(description: RobotDescription) -> dict[str, tuple[str, ...]]:
    """Return the collision shapes of each link, by the names that the paper's code gives to links."""
    shapes = description.names.shapes
    legs = {f"{leg}_{part}": shapes(*roles, legs=(leg,)) for leg in LEGS for part, roles in _LINKS.items()}
    return {"base": shapes("trunk"), "head": shapes("head")} | legs


@dataclass(frozen=True, kw_only=True, eq=False)
class GroundFacts:
    """Where the toes are and what touches the ground, one row for each tick of a log; legs in the order of LEGS."""

    toe_height: FloatArray
    """Height of the centre of each toe above the ground (ticks, 4) [m]."""
    toe_velocity: FloatArray
    """Horizontal velocity of each toe, world axes (ticks, 4, 2) [m/s]."""
    toe_yaw_rate: FloatArray
    """Angular velocity of each lower leg about the vertical (ticks, 4) [rad/s]."""
    touching: dict[str, BoolArray]
    """Whether each of ground_parts touches the ground (ticks,)."""


def ground_facts(log: RunLog, description: RobotDescription) -> GroundFacts:
    """Return toes and contacts of a log on flat ground, by the kinematics and collision detection of MuJoCo.

    The log must hold the position of the base. A part touches where its shape reaches into the ground, as contacts
    with a force do; what happened between two ticks is not seen.
    """
    model = load_model(description, visuals=False)
    data = mujoco.MjData(model)
    floor = model.geom(FLOOR).id
    sites = [model.site(name).id for name in TOES]
    parts = ground_parts(description)
    part_of = {model.geom(name).id: part for part, names in parts.items() for name in names}
    ticks = len(log.t)
    position, motion = np.zeros((ticks, 4, 3)), np.zeros((ticks, 4, 6))
    touching = {part: np.zeros(ticks, dtype=bool) for part in parts}
    qpos = np.concatenate([log.p_WB, log.quat_WB, log.q], axis=1)
    qvel = np.concatenate([log.v_WB, log.omega_B, log.dq], axis=1)
    seen = np.zeros(6)
    for tick in range(ticks):
        data.qpos[:], data.qvel[:] = qpos[tick], qvel[tick]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_collision(model, data)
        for leg, site in enumerate(sites):
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site, seen, 0)
            position[tick, leg], motion[tick, leg] = data.site_xpos[site], seen
        for one, other in data.contact.geom:
            part = part_of.get(int(other if one == floor else one))
            if part is not None:
                touching[part][tick] = True
    return GroundFacts(
        toe_height=position[..., 2], toe_velocity=motion[..., 3:5], toe_yaw_rate=motion[..., 2], touching=touching
    )
