"""A machine with its base held: any MJCF, or the robot hung up, as joints with motors that a law drives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from mimic.dynamics.actuators import FileDrives, Reference, refuse_other_machine, touches
from mimic.dynamics.catalogue.kinds import UNLIMITED
from mimic.dynamics.law import Drives
from mimic.errors import AssetError, ConfigError
from mimic.records import JOINTS, FloatArray, IntArray
from mimic.robot.description import RobotDescription
from mimic.robot.model import make_room, read_model, remove_free_joint

GRAVITY = 9.81
"""[m/s^2]"""

SOLREF_STEPS = 2.0
"""Time constant of dry friction, in physics steps: MuJoCo's least. Longer ones let a joint creep that should stick."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MachineModel:
    """A compiled machine and what calibration needs to know of it. Joint arrays are (J,)."""

    model: mujoco.MjModel
    """One motor for each joint, in the order of ``joints``; no contacts, no limits but the joints'."""
    joints: tuple[str, ...]
    drives: Drives
    chain: IntArray
    """Which chain (leg) a joint belongs to; chains do not influence each other while the base is held."""
    place: IntArray
    """Place of a joint in its chain, from the base."""
    body: IntArray
    """Link that a joint moves."""
    toward: FloatArray
    """Unit vector along each link, from its joint to its end, link axes (J, 3)."""
    tip: FloatArray
    """End of each link, link axes (J, 3) [m]."""
    low: FloatArray
    """Lower joint limits; -inf where none."""
    high: FloatArray
    """Upper joint limits; inf where none."""
    unit: str
    """Unit of the positions: rad, or m where all joints slide."""
    dropped: tuple[str, ...] = ()
    """Parts of the file that a replay leaves out."""

    @property
    def last(self) -> Any:
        """True for the last joint of each chain (J,)."""
        return np.array([self.place[i] == self.place[self.chain == c].max() for i, c in enumerate(self.chain)])


def hung_robot(description: RobotDescription) -> MachineModel:
    """Return the robot hung up by its trunk: base fixed, belly down, in the air.

    Raises:
        AssetError: If it moves otherwise than with the motors of its model.
    """
    spec = read_model(description)
    remove_free_joint(spec)
    d = description
    for key in list(spec.keys):  # they have numbers of the free joint
        spec.delete(key)
    native = Reference.of(spec.compile())
    native.of_target[:] = np.eye(len(JOINTS))
    machine = _machine(spec, d.mjcf, kp=d.kp, kd=d.kd, torque=d.torque_max, flat=d.speed_flat, speed=d.speed_max)
    refuse_other_machine(machine, native, d.mjcf, "make its motors those of robot.toml, or take them out of the file")
    return machine


def read_machine(path: Path, gains: Mapping[str, Any] | None = None) -> MachineModel:
    """Read any MJCF whose base is held.

    Args:
        path: MJCF with hinge and slide joints only.
        gains: ``kp`` and ``kd``, a number each or one for each joint by name; without, those of the model's position
            actuators; without these, joints are driven by force alone.

    Raises:
        AssetError: If the file cannot be compiled, a joint is free or a ball, joints are tied to each other, or
            the machine does not move as the file says for a reason that mimic does not know.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        original = spec.compile()
    except (ValueError, OSError) as reason:
        raise AssetError(f"{path} is not an MJCF that MuJoCo compiles: {' '.join(str(reason).split())}") from None
    single = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    for j in range(original.njnt):
        if int(original.jnt_type[j]) not in single:
            raise AssetError(
                f"{path}: joint {original.joint(j).name!r} is free or a ball; "
                "give a model whose base is held, with hinge and slide joints only"
            )
    if not original.njnt:
        raise AssetError(f"{path} has no joints")
    tied = [n for n, count in (("equality", original.neq), ("tendon", original.ntendon)) if count]
    if tied:
        raise AssetError(f"{path} has elements of {' and '.join(tied)}, which replays do not model; remove them")
    drives = FileDrives(original)
    far = np.full(original.njnt, UNLIMITED)
    make_room(spec)
    machine = _machine(spec, path, kp=drives.kp, kd=drives.kd, torque=drives.torque, flat=far, speed=2 * far)
    advice = "it holds something that mimic does not know; take out what is no link, joint, or actuator of a joint"
    refuse_other_machine(machine, drives.reference, path, advice)
    contacts = ("contacts",) if touches(original, machine) else ()
    return with_gains(replace(machine, dropped=(*drives.dropped, *contacts)), gains or {})


def as_logged(machine: MachineModel, notes: Mapping[str, Any], by_force: bool = False) -> MachineModel:
    """Return the machine with what the notes of a log say of it: gains, and gravity in base axes [m/s^2].

    Args:
        machine: The model.
        notes: ``kp``, ``kd`` and ``gravity`` (see docs/manual/log-format.md).
        by_force: Only forces were asked for, and no targets: drives have no gains then.
    """
    machine = with_gains(machine, {"kp": 0.0, "kd": 0.0} if by_force else notes)
    if "gravity" not in notes:
        return machine
    model = copy(machine.model)
    model.opt.gravity[:] = notes["gravity"]
    return replace(machine, model=model)


def with_gains(machine: MachineModel, gains: Mapping[str, Any]) -> MachineModel:
    """Return the machine with the gains that a log was made with (see `read_machine`)."""
    if gains.get("drive") == "voltage":
        return _voltage_drives(machine, gains)
    rows = {}
    for key in ("kp", "kd"):
        given = gains.get(key)
        own = np.asarray(getattr(machine.drives, key))
        if isinstance(given, Mapping):
            rows[key] = np.array([given.get(name, v) for name, v in zip(machine.joints, own, strict=True)], dtype=float)
        elif given is not None:
            rows[key] = np.broadcast_to(np.asarray(given, dtype=float), own.shape).copy()
    return replace(machine, drives=replace(machine.drives, **rows)) if rows else machine


VOLTAGE_DRIVE = {"gain": "duty for each radian", "voltage": "V", "kt": "N m/A", "resistance": "ohm"}
"""What the notes of a log say of a voltage drive, and in which unit; one supply for all joints."""


def _voltage_drives(machine: MachineModel, notes: Mapping[str, Any]) -> MachineModel:
    """Return the machine with voltage drives; see `mimic.dynamics.law.Drives`.

    Raises:
        ConfigError: If the notes lack a number.
    """
    rows = {}
    for key, unit in VOLTAGE_DRIVE.items():
        given = notes.get(key)
        values = [given.get(j) for j in machine.joints] if isinstance(given, Mapping) else [given] * len(machine.joints)
        good = [isinstance(v, int | float) and not isinstance(v, bool) and 0.0 < v < 1e9 for v in values]
        if not all(good):
            raise ConfigError(
                f"a voltage drive needs {', '.join(VOLTAGE_DRIVE)} in the notes of the log; {key} is {given!r},"
                f" expected a number above 0 [{unit}]"
            )
        rows[key] = np.array(values, dtype=float)
    stall = rows["voltage"] * rows["kt"] / rows["resistance"]
    drives = replace(
        machine.drives,
        kp=rows["gain"] * stall,
        kd=rows["kt"] ** 2 / rows["resistance"],
        volts=rows["voltage"],
        kt=rows["kt"],
        resistance=rows["resistance"],
    )
    return replace(machine, drives=drives)


def drive_notes(machine: MachineModel) -> dict[str, Any]:
    """Return what the notes of a log say of the drives."""
    d = machine.drives

    def by_joint(values: Any) -> dict[str, float]:
        return dict(zip(machine.joints, map(float, values), strict=True))

    if d.volts is None:
        return {"kp": by_joint(d.kp), "kd": by_joint(d.kd)}
    rows = {"kt": d.kt, "resistance": d.resistance, "gain": d.kp * d.resistance / d.kt / d.volts}
    return {"drive": "voltage", "voltage": float(d.volts[0]), **{k: by_joint(values) for k, values in rows.items()}}


def _machine(spec: Any, path: Path, **numbers: FloatArray) -> MachineModel:
    """Return the compiled machine of a file; numbers are those of `Drives` that the model does not have."""
    weighed = all(body.explicitinertial for body in spec.bodies if body.name != "world")
    if weighed and not (spec.compiler.inertiafromgeom == 1 or spec.option.density or spec.option.viscosity):
        shapes = (spec.pairs, spec.excludes, spec.geoms)  # they weigh and touch nothing
    else:
        shapes = ()
    for group in (spec.keys, spec.sensors, spec.equalities, spec.tendons, spec.tuples, *shapes):
        for item in list(group):
            spec.delete(item)
    names = [joint.name for joint in spec.joints]
    if len(set(names)) < len(names) or "" in names:
        raise AssetError("every joint of the model needs a name of its own")
    add_motors(spec, names)
    for body in spec.bodies:
        body.simple = 0  # effects move its centre of mass
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    try:
        model = spec.compile()
    except ValueError as reason:
        raise AssetError(f"{path} does not compile without its actuators: {' '.join(str(reason).split())}") from None
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_ISLAND)
    joints = tuple(model.joint(j).name for j in range(model.njnt))
    body = np.array(model.jnt_bodyid)
    chain = model.dof_treeid.astype(np.int64)
    place = np.array([int(np.sum(chain[:i] == c)) for i, c in enumerate(chain)])
    tip, toward = _ends(model, body)
    limited = model.jnt_limited.astype(bool)
    slides = model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
    drives = Drives(
        **numbers,
        friction=np.array(model.dof_frictionloss),
        armature=np.array(model.dof_armature),
        neighbour=_neighbours(chain),
    )
    return MachineModel(
        model=model,
        joints=joints,
        drives=drives,
        chain=chain,
        place=place,
        body=body,
        toward=toward,
        tip=tip,
        low=np.where(limited, model.jnt_range[:, 0], -np.inf),
        high=np.where(limited, model.jnt_range[:, 1], np.inf),
        unit="m" if slides.all() else "rad",
    )


def add_motors(spec: Any, joints: Sequence[str]) -> None:
    """Replace the actuators of a model by one motor for each joint, whose torque a law gives."""
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for name in joints:
        spec.add_actuator(name=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=name)


def _neighbours(chain: IntArray) -> IntArray:
    rows = []
    for i, c in enumerate(chain):
        mates = [j for j in range(len(chain)) if chain[j] == c]
        at = mates.index(i)
        rows.append(mates[at + 1] if at + 1 < len(mates) else mates[max(at - 1, 0)])
    return np.array(rows)


def _ends(model: mujoco.MjModel, body: IntArray) -> tuple[FloatArray, FloatArray]:
    """End of each link: the next joint's body, else the farthest site, else twice the way to the centre of mass."""
    tips = []
    for b in body:
        children = [int(c) for c in body if int(model.body_parentid[c]) == int(b)]
        sites = model.site_pos[model.site_bodyid == b]
        if children:
            tip = model.body_pos[children[0]]
        elif len(sites):
            tip = sites[np.argmax(np.linalg.norm(sites, axis=1))]
        else:
            tip = 2 * model.body_ipos[b]
        tips.append(np.array(tip))
    tip = np.array(tips)
    length = np.linalg.norm(tip, axis=1, keepdims=True)
    toward = np.where(length > 1e-9, tip / np.maximum(length, 1e-9), np.array([0.0, 0.0, -1.0]))
    return tip, toward


def change_links(
    model: mujoco.MjModel,
    bodies: Sequence[int] | IntArray,
    machine: MachineModel,
    factor: FloatArray,
    shift: FloatArray,
    payload: FloatArray,
) -> None:
    """Scale links of a model, shift their centres of mass and load their tips.

    Args:
        model: It has the links.
        bodies: Link that each joint moves (J,).
        machine: Where they point, and where they end.
        factor: On masses and inertias (J,).
        shift: Of centres of mass toward the ends of the links (J,) [m].
        payload: At the tips (J,) [kg].
    """
    for j, b in enumerate(bodies):
        model.body_mass[b] *= factor[j]
        model.body_inertia[b] *= factor[j]
        model.body_ipos[b] += shift[j] * machine.toward[j]
        if payload[j]:
            add_load(model, int(b), float(payload[j]), machine.tip[j])


def add_load(model: mujoco.MjModel, b: int, load: float, at: FloatArray) -> None:
    """Add a point mass [kg] at a place (3,) [m] of one body: new centre, parallel axes, new principal axes."""
    own = float(model.body_mass[b])
    frame = np.zeros(9)
    mujoco.mju_quat2Mat(frame, model.body_iquat[b])
    turn = frame.reshape(3, 3)
    inertia = turn @ np.diag(model.body_inertia[b]) @ turn.T
    away = at - model.body_ipos[b]
    inertia += own * load / (own + load) * (away @ away * np.eye(3) - np.outer(away, away))
    model.body_inertia[b], axes = np.linalg.eigh(inertia)
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    mujoco.mju_mat2Quat(model.body_iquat[b], axes.reshape(9))
    model.body_mass[b] = own + load
    model.body_ipos[b] += away * load / (own + load)


def tilted_gravity(
    roll: float, pitch: float, gravity: Sequence[float] | FloatArray = (0.0, 0.0, -GRAVITY)
) -> FloatArray:
    """Return gravity (3,) in the axes of a base turned by roll about x, then pitch about y [rad]."""
    return Rotation.from_euler("xy", [roll, pitch]).apply(gravity, inverse=True)
