"""A compiled MuJoCo model as a Pinocchio model: kinematics, inertias, and the distances between shapes."""

from __future__ import annotations

from typing import Any

import coal
import mujoco
import numpy as np
import pinocchio as pin

from mimic.errors import AssetError
from mimic.records import JOINTS, LEGS, FloatArray
from mimic.robot.description import RobotDescription
from mimic.robot.model import BASE, TOES, read_model

_JOINTS = {"abad": pin.JointModelRX, "hip": pin.JointModelRY, "knee": pin.JointModelRY}


def rigid_body_model(description: RobotDescription) -> tuple[pin.Model, pin.GeometryModel]:
    """Return Pinocchio's model of a robot and its collision shapes.

    Joints are called as in JOINTS, after a free joint, and have the MJCF's armature, damping and dry friction; a frame
    of type OP_FRAME at each toe is called as in TOES.

    Raises:
        AssetError: If a shape is neither a box, a ball, a capsule nor a cylinder.
    """
    compiled = read_model(description).compile()
    model = pin.Model()
    at = {}
    at[compiled.body(BASE).id] = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), BASE)
    for leg in range(len(LEGS)):
        parent = at[compiled.body(BASE).id]
        for name in JOINTS[3 * leg : 3 * leg + 3]:
            body = compiled.body(name).id
            placement = _placement(compiled.body_pos[body], compiled.body_quat[body])
            parent = model.addJoint(parent, _JOINTS[name[3:]](), placement, name)
            dof = compiled.joint(name).dofadr[0]
            own = model.joints[parent].idx_v
            model.armature[own] = compiled.dof_armature[dof]
            model.damping[own] = compiled.dof_damping[dof]
            model.upperDryFrictionLimit[own] = compiled.dof_frictionloss[dof]
            at[body] = parent
    for body in range(1, compiled.nbody):
        joint, placement = _carrier(compiled, at, body)
        turn = _rotation(compiled.body_iquat[body])
        inertia = turn @ np.diag(compiled.body_inertia[body]) @ turn.T
        own = pin.Inertia(float(compiled.body_mass[body]), compiled.body_ipos[body].copy(), inertia)
        model.appendBodyToJoint(joint, own, placement)
    for name in TOES:
        site = compiled.site(name)
        joint, placement = _carrier(compiled, at, int(compiled.site_bodyid[site.id]))
        model.addFrame(pin.Frame(name, joint, placement * _placement(site.pos, site.quat), pin.FrameType.OP_FRAME))
    return model, _shapes(compiled, at, description)


def _shapes(compiled: mujoco.MjModel, at: dict[int, int], description: RobotDescription) -> pin.GeometryModel:
    geometry = pin.GeometryModel()
    for role in description.names.patterns:
        for name in description.names.shapes(role):
            geom = compiled.geom(name)
            joint, placement = _carrier(compiled, at, int(geom.bodyid[0]))
            placement = placement * _placement(geom.pos, geom.quat)
            geometry.addGeometryObject(pin.GeometryObject(name, joint, placement, _shape(geom, name)))
    return geometry


def _shape(geom: Any, name: str) -> Any:
    x, y, z = (float(v) for v in geom.size)
    shapes = {
        mujoco.mjtGeom.mjGEOM_BOX: (coal.Box, (2 * x, 2 * y, 2 * z)),
        mujoco.mjtGeom.mjGEOM_SPHERE: (coal.Sphere, (x,)),
        mujoco.mjtGeom.mjGEOM_CAPSULE: (coal.Capsule, (x, 2 * y)),
        mujoco.mjtGeom.mjGEOM_CYLINDER: (coal.Cylinder, (x, 2 * y)),
    }
    kind = mujoco.mjtGeom(int(geom.type[0]))
    if kind not in shapes:
        raise AssetError(
            f"shape {name!r} is neither a box, a ball, a capsule nor a cylinder; give the robot simpler shapes"
        )
    shape, sizes = shapes[kind]
    return shape(*sizes)


def _carrier(compiled: mujoco.MjModel, at: dict[int, int], body: int) -> tuple[int, pin.SE3]:
    """Return the joint that moves a body, and the body's placement in that joint's frame."""
    placement = pin.SE3.Identity()
    while body not in at:
        placement = _placement(compiled.body_pos[body], compiled.body_quat[body]) * placement
        body = int(compiled.body_parentid[body])
    return at[body], placement


def _placement(position: Any, quat: Any) -> pin.SE3:
    """Return the placement of a frame from its position (3,) [m] and its quaternion wxyz (4,)."""
    return pin.SE3(_rotation(quat), np.array(position, dtype=np.float64))


def _rotation(quat: Any) -> FloatArray:
    """Return the rotation matrix (3, 3) of a quaternion wxyz (4,)."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.array(quat, dtype=np.float64))
    return matrix.reshape(3, 3)
