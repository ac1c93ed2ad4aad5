"""The robot's visual shapes, and the poses of its links at each tick."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from mimic.errors import AssetError
from mimic.geometry import rotation_from_quat
from mimic.records import FloatArray, RunLog
from mimic.robot.model import TOES

VISUAL_GROUP = 2
"""MuJoCo group of the visual geoms."""

TARGET_RADIUS = 0.03
"""Radius of a target, a little larger than the toe, so that a toe inside its target is visible [m]."""

_GEOM = mujoco.mjtGeom
_SPHERE = _GEOM.mjGEOM_SPHERE

KINDS = {
    _GEOM.mjGEOM_BOX: "box",
    _GEOM.mjGEOM_CAPSULE: "capsule",
    _GEOM.mjGEOM_ELLIPSOID: "ellipsoid",
    _GEOM.mjGEOM_CYLINDER: "cylinder",
    _SPHERE: "ellipsoid",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Shapes:
    """The shapes of one kind on one body, in the body's axes; lengths in metres."""

    body: str
    kind: str
    """box, capsule, ellipsoid or cylinder; a sphere is an ellipsoid."""
    position: FloatArray
    """Centres (N, 3)."""
    quat: FloatArray
    """Orientations (N, 4), wxyz."""
    size: FloatArray
    """Half lengths of box and ellipsoid; radius and half length (without the caps) of capsule and cylinder (N, 3)."""
    rgba: FloatArray
    """Colours (N, 4), 0 to 1."""


def visual_shapes(model: mujoco.MjModel) -> Iterator[Shapes]:
    """Yield the visual shapes of the robot, grouped by body and kind.

    Raises:
        AssetError: If a visual geom is of an unsupported kind, such as a mesh.
    """
    groups: dict[tuple[int, str], list[int]] = {}
    for geom in np.flatnonzero(model.geom_group == VISUAL_GROUP):
        kind = KINDS.get(mujoco.mjtGeom(model.geom_type[geom]))
        if kind is None:
            name = mujoco.mjtGeom(model.geom_type[geom]).name
            raise AssetError(f"visual geom {geom} is a {name}; supported are {', '.join(sorted(set(KINDS.values())))}")
        groups.setdefault((int(model.geom_bodyid[geom]), kind), []).append(int(geom))
    for (body, kind), geoms in groups.items():
        size = model.geom_size[geoms].copy()
        spheres = model.geom_type[geoms] == _SPHERE
        size[spheres] = size[spheres, :1]
        material = model.geom_matid[geoms]
        rgba = np.where(material[:, None] >= 0, model.mat_rgba[material], model.geom_rgba[geoms])
        yield Shapes(
            body=model.body(body).name,
            kind=kind,
            position=model.geom_pos[geoms].copy(),
            quat=model.geom_quat[geoms].copy(),
            size=size,
            rgba=rgba.astype(np.float64),
        )


def qpos_at_ticks(log: RunLog, model: mujoco.MjModel) -> FloatArray:
    """Return MuJoCo's positions at each tick (ticks, nq).

    If the log has no base position, the robot is placed at the origin with its lowest toe on the floor.
    """
    qpos = np.concatenate([log.p_WB, log.quat_WB, log.q], axis=1)
    unknown = np.flatnonzero(~np.isfinite(log.p_WB).all(axis=1))
    if len(unknown):
        data = mujoco.MjData(model)
        toes = [model.site(name).id for name in TOES]
        radius = float(model.site_size[toes[0], 0])
        for row in unknown:
            qpos[row, :3] = 0.0
            data.qpos[:] = qpos[row]
            mujoco.mj_kinematics(model, data)
            qpos[row, 2] = radius - data.site_xpos[toes, 2].min()
    return qpos


def body_poses(model: mujoco.MjModel, qpos: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return position (ticks, bodies, 3) [m] and orientation (ticks, bodies, 4), wxyz, of every body in the world."""
    data = mujoco.MjData(model)
    position = np.empty((len(qpos), model.nbody, 3))
    quat = np.empty((len(qpos), model.nbody, 4))
    for row, values in enumerate(qpos):
        data.qpos[:] = values
        mujoco.mj_kinematics(model, data)
        position[row] = data.xpos
        quat[row] = data.xquat
    return position, quat


def in_world(qpos: FloatArray, p_BE: FloatArray) -> FloatArray:
    """Transform points relative to the base, in base axes (ticks, N, 3), to the world frame (ticks, N, 3) [m]."""
    return qpos[:, None, :3] + np.einsum("tij,tnj->tni", rotation_from_quat(qpos[:, 3:7]), p_BE)
