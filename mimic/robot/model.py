"""The robot's MJCF with its parts named by their roles: what simulation, training and kinematics start from.

A description says what the MJCF calls its parts (`mimic.robot.parts.ModelNames`). `read_model` renames the
joints and the links to the roles of JOINTS, so that no other module needs the model's own names.
"""

from __future__ import annotations

import logging
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mimic.errors import AssetError
from mimic.records import JOINTS, LEGS
from mimic.robot.description import RobotDescription
from mimic.robot.leg_kinematics import all_toes
from mimic.robot.parts import ModelNames

log = logging.getLogger(__name__)

BASE = "base"
"""Name of the body that carries the legs."""
FLOOR = "floor"
"""Name of the ground."""

TOES = tuple(f"{leg}_toe" for leg in LEGS)
"""Site at the centre of each toe, in the order of LEGS."""

_AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 1.0, 0.0))
"""Axes of the abad, hip and knee joint."""


def read_model(description: RobotDescription, *, floor: bool = False, checked: bool = True) -> Any:
    """Return the robot as a MuJoCo specification (MjSpec) with canonical names.

    Joints and the links that they move are called as in JOINTS, the base BASE, the toe sites as in TOES. Collision
    shapes keep their names; one without a name is called ``body#n`` after its body and its place among the body's
    collision shapes. A missing free joint, missing toe sites, missing motors and a missing floor are added. Of an MJCF
    with other motors or names, actuators, sensors, keyframes, meshes, and what follows a body (lights, cameras) are
    left out, with a line in the log, and its legs come in the order of LEGS.

    Args:
        description: The robot.
        floor: Put it on a floor, named FLOOR.
        checked: Compare its toes and limits with the description's numbers, once for each description.

    Raises:
        AssetError: If the file is no MJCF, lacks a part that the description names, or is of another robot.
    """
    if checked:
        _check_numbers(description)
    names = description.names
    path = description.scene if floor and description.scene is not None else description.mjcf
    spec = _parsed(path)
    make_room(spec)
    own = [names.of_leg(name, leg) for leg in LEGS for name in names.joints] == list(JOINTS)
    if not (own and all(a.gaintype == mujoco.mjtGain.mjGAIN_DCMOTOR for a in spec.actuators)):
        leave_out(spec, path)
        _order_legs(spec, description)
    name_shapes(spec)
    _check_shapes(spec, names, path)
    base = _found(spec.body(names.base), "body", names.base, path)
    _rename_body(spec, base, BASE)
    if not any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in base.joints):
        base.add_freejoint(name=BASE)
        for key in list(spec.keys):  # they lack the numbers of the free joint
            spec.delete(key)
    _check_order(spec, description)
    for leg in LEGS:
        _name_leg(spec, description, leg)
    for joint in spec.joints:
        joint.name = joint.name.removeprefix(_MOVED)
    for body in spec.bodies:
        _rename_body(spec, body, body.name.removeprefix(_MOVED))
    if not spec.actuators:
        _add_motors(spec, description)
    if floor:
        _put_on_floor(spec, add=description.scene is None)
    return spec


def _check_shapes(spec: Any, names: ModelNames, path: Path) -> None:
    """Refuse a model without a collision shape that the description names.

    Raises:
        AssetError: With the shapes that it has.
    """
    shapes = {geom.name for geom in spec.geoms}
    named = [shape for role in names.patterns for shape in names.shapes(role)]
    missing = [shape for shape in named if shape not in shapes]
    if missing:
        raise AssetError(f"{path} has no shape {missing[0]!r}; it has {', '.join(sorted(shapes - {''}))}")


def _put_on_floor(spec: Any, *, add: bool) -> None:
    contacts_off = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    spec.option.disableflags &= ~contacts_off  # models of suspended robots lack contacts
    if add:
        spec.worldbody.add_geom(name=FLOOR, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 0.05], priority=1)


def _parsed(path: Path) -> Any:
    """Return a file as a MuJoCo specification (MjSpec).

    Raises:
        AssetError: If it is no MJCF.
    """
    try:
        return mujoco.MjSpec.from_file(str(path))
    except (ValueError, OSError) as reason:
        raise AssetError(f"{path} is not an MJCF that MuJoCo reads: {' '.join(str(reason).split())}") from None


_NO_SETTINGS = {"alt", "classname", "compiler", "frame", "id", "info", "name", "parent", "plugin", "signature"}
"""What an actuator or a shape has besides settings that a file may give a default of."""


def make_room(spec: Any) -> None:
    """Let parts be added to a specification to which nothing comes from its file.

    Defaults of actuators and shapes become MuJoCo's own, no actuator is disabled, and what actuators add to the inertia
    and the damping of joints becomes the joints'.
    """
    empty = mujoco.MjSpec()
    for plain, default in (
        (empty.add_actuator(), spec.default.actuator),
        (empty.worldbody.add_geom(), spec.default.geom),
    ):
        for name in dir(plain):
            if not name.startswith(("_", "set_")) and name not in _NO_SETTINGS:
                setattr(default, name, getattr(plain, name))
    spec.option.disableactuator = 0
    spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    of_joint = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    for actuator in spec.actuators:
        joint = spec.joint(actuator.target) if actuator.trntype in of_joint else None
        if joint is None or joint.type not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            continue
        reflected = actuator.gear[0] ** 2
        joint.armature += reflected * actuator.armature
        joint.damping = joint.damping + reflected * actuator.damping
        actuator.armature = 0.0
        actuator.damping = [0.0, 0.0, 0.0]


def is_visual(geom: Any) -> bool:
    """Return whether a shape of a specification is only looked at: it takes part in no contact."""
    return geom.contype == 0 and geom.conaffinity == 0


def remove_free_joint(spec: Any) -> None:
    """Fix the base of a specification to the world."""
    for joint in list(spec.joints):
        if joint.type == mujoco.mjtJoint.mjJNT_FREE:
            spec.delete(joint)


def _found(part: Any, kind: str, name: str, path: Any) -> Any:
    if part is None:
        raise AssetError(f"{path} has no {kind} {name!r}; correct [model] in robot.toml")
    return part


def name_shapes(spec: Any) -> None:
    """Give each collision shape without a name that of its body, or its number, and its place there."""
    for number, body in enumerate(spec.bodies):
        for place, geom in enumerate(geom for geom in body.geoms if not is_visual(geom)):
            if not geom.name:
                geom.name = f"{body.name or number}#{place}"


def leave_out(spec: Any, path: Path) -> None:
    """Remove what refers to names that change, or that mimic has of its own, and shapes whose files may be missing.

    Hinges about an axis that points backward, right or down are turned, so that their angles change sign.
    """
    meshes = [geom for geom in spec.geoms if geom.type == mujoco.mjtGeom.mjGEOM_MESH]
    parts = {
        "actuators": spec.actuators,
        "sensors": spec.sensors,
        "keyframes": spec.keys,
        "lights and cameras": [part for part in (*spec.lights, *spec.cameras) if part.targetbody],
        "shapes from meshes": meshes,
        "pictures": [texture for texture in spec.textures if texture.file],
    }
    for material in spec.materials if parts["pictures"] else []:
        material.textures = [""] * len(material.textures)
    _tell(path, ", ".join(f"{len(found)} {name}" for name, found in parts.items() if found))
    for part in [part for found in (*parts.values(), spec.meshes) for part in list(found)]:
        spec.delete(part)
    for joint in spec.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_HINGE and np.sum(joint.axis) < 0.0:
            _turn(joint)


def _turn(joint: Any) -> None:
    """Let a hinge turn the other way about its axis, with the same motion of the robot."""
    joint.axis = -joint.axis
    joint.range = -joint.range[::-1]
    joint.actfrcrange = -joint.actfrcrange[::-1]
    joint.ref = -joint.ref
    joint.springref = -joint.springref


def _order_legs(spec: Any, description: RobotDescription) -> None:
    """Put legs that the model has in another order into that of LEGS; parts of the legs that are excluded stay so."""
    names = description.names
    links = [names.of_leg(names.links[0], leg) for leg in LEGS]
    base = spec.body(names.base)
    if base is None or any(spec.body(link) is None for link in links) or spec.joint(JOINTS[0]) is not None:
        return  # said with the names of the parts
    if [body.name for body in base.bodies if body.name in links] == links:
        return
    excluded = [(pair.bodyname1, pair.bodyname2) for pair in spec.excludes]
    for pair in list(spec.excludes):
        spec.delete(pair)
    before = spec.copy()
    for link in links:
        spec.delete(spec.body(link))
    for link in links:
        base.add_frame().attach_body(before.body(link), _MOVED, "")
    for part in (*spec.bodies, *spec.joints, *spec.geoms, *spec.sites):
        part.name = part.name.removeprefix(_MOVED)
    for first, second in excluded:
        spec.add_exclude(bodyname1=first, bodyname2=second)


_MOVED = "moved/"
"""Before new names while old ones are there: a model may have the name of a role for another part."""


@cache
def _tell(path: Path, parts: str) -> None:
    if parts:
        log.info("%s: left out %s", path, parts)


APART = 1e-3
"""How far a toe of the MJCF may be from where the numbers of the description put it [m]: rounding, no more."""
BEYOND = 1e-3
"""How far the description's limits may go beyond the MJCF's [rad]: rounding, no more."""


@cache
def _check_numbers(description: RobotDescription) -> None:
    """Raise an AssetError where the numbers of a description are not those of its MJCF."""
    model = read_model(description, checked=False).compile()
    names = description.names
    for joint, low, high in zip(JOINTS, description.q_min, description.q_max, strict=True):
        own = model.joint(joint)
        limits = own.range
        if own.limited and (low < limits[0] - BEYOND or high > limits[1] + BEYOND):
            raise AssetError(
                f"{joint} turns from {limits[0]:.3f} to {limits[1]:.3f} rad in {description.mjcf}, from {low:.3f} to "
                f"{high:.3f} rad in its robot.toml: the numbers are of another robot, or must be corrected"
            )
    data = mujoco.MjData(model)
    base = model.body(BASE)
    for name, q in description.poses.items():
        data.qpos[model.jnt_qposadr[[model.joint(joint).id for joint in JOINTS]]] = q
        mujoco.mj_kinematics(model, data)
        turn = data.xmat[base.id].reshape(3, 3)
        found = (np.array([data.site(toe).xpos for toe in TOES]) - data.xpos[base.id]) @ turn
        away = np.linalg.norm(found - all_toes(q, description), axis=1)
        worst = int(np.argmax(away))
        if away[worst] > APART:
            raise AssetError(
                f"in pose {name!r} the {names.legs[worst]} toe of {description.mjcf} is {100 * away[worst]:.1f} cm "
                "from where the lengths in its robot.toml put it: they are of another robot, or must be corrected"
            )


def _check_order(spec: Any, description: RobotDescription) -> None:
    names = description.names
    expected = [names.of_leg(name, leg) for leg in LEGS for name in names.joints]
    found = [joint.name for joint in spec.joints if joint.type != mujoco.mjtJoint.mjJNT_FREE]
    if found != expected:
        raise AssetError(f"{description.mjcf} has joints {', '.join(found)}; robot.toml names {', '.join(expected)}")


def _rename_body(spec: Any, body: Any, name: str) -> None:
    for pair in spec.excludes:
        if pair.bodyname1 == body.name:
            pair.bodyname1 = name
        if pair.bodyname2 == body.name:
            pair.bodyname2 = name
    body.name = name


def _name_leg(spec: Any, description: RobotDescription, leg: str) -> None:
    names = description.names
    path = description.mjcf
    at = LEGS.index(leg)
    roles = JOINTS[3 * at : 3 * at + 3]
    joints = [spec.joint(names.of_leg(name, leg)) for name in names.joints]
    bodies = [names.of_leg(name, leg) for name in names.links]
    links = [_found(spec.body(name), "body", name, path) for name in bodies]
    for role, joint, link, axis in zip(roles, joints, links, _AXES, strict=True):
        if not np.allclose(joint.axis, axis) or np.any(joint.pos):
            raise AssetError(f"{path}: joint {joint.name!r} must turn about {axis} at the origin of its link")
        joint.name = _MOVED + role
        _rename_body(spec, link, _MOVED + role)
    toe = TOES[at]
    if names.toe_site:
        own = names.of_leg(names.toe_site, leg)
        _found(spec.site(own), "site", own, path).name = toe
    else:
        links[2].add_site(name=toe, pos=description.leg.toe, size=[description.toe_radius] * 3, group=4)


def _add_motors(spec: Any, description: RobotDescription) -> None:
    """Add motors with a position loop and the numbers of the description."""
    d = description
    constants = d.voltage / d.speed_max
    resistances = constants**2 / (d.torque_max / (d.speed_max - d.speed_flat))
    for name, constant, resistance, most, kp, kd in zip(
        JOINTS, constants, resistances, d.torque_max, d.kp, d.kd, strict=True
    ):
        motor = spec.add_actuator(name=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=name)
        motor.set_to_dcmotor(
            motorconst=[constant, constant],
            resistance=resistance,
            saturation=[most, 0.0, 0.0],
            controller=[kp, 0.0, kd, 0.0, 0.0, d.voltage],
            ctrlspec=1,  # a position
        )
