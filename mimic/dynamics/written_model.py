"""Found effects for other programs: an MJCF that has them, and actuator settings of mjlab and Isaac Lab.

Source: MuJoCo's XML reference; mjlab, ``BuiltinPositionActuatorCfg`` and ``DelayedActuatorCfg``; Isaac Lab,
``DelayedPDActuatorCfg`` and ``DCMotorCfg``.
"""

from __future__ import annotations

from copy import copy
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mimic.dynamics.catalogue.kinds import UNLIMITED
from mimic.dynamics.effect_set import EffectSet
from mimic.dynamics.machine import MachineModel, change_links, make_room, tilted_gravity
from mimic.dynamics.servo import OF_LINKS, inertial_parts, parameters_of
from mimic.errors import AssetError
from mimic.io.store import written_whole
from mimic.records import FloatArray

HELD = frozenset(
    ("coulomb", "viscous", "link_mass", "delay", "armature", "gains", "spring", "base_tilt", "payload", "com_shift")
)
"""Effects that an MJCF with position actuators can have; of a torque-speed line it has the largest torque."""

LIMIT = "torque_speed"


def not_written(effects: EffectSet) -> tuple[str, ...]:
    """Return the names of the effects that neither the MJCF nor the settings hold, whole or in part."""
    return tuple(effect.name for effect in effects.applied if effect.name not in HELD)


def joint_settings(machine: MachineModel, effects: EffectSet) -> dict[str, FloatArray]:
    """Return the numbers (J,) of each joint in SI units.

    kp, kd, torque, speed, friction, damping, armature, delay; stiffness and moment at zero of its springs, those of the
    model and the effect together.
    """
    p = parameters_of(effects, machine)
    drives = machine.drives
    count = len(machine.joints)
    own_stiffness = machine.model.jnt_stiffness.reshape(count, -1)[:, 0]

    def number(effect: str, parameter: str, otherwise: Any) -> FloatArray:
        value = p[effect, parameter][0] if (effect, parameter) in p else otherwise
        return np.broadcast_to(np.asarray(value, dtype=np.float64), (count,)).copy()

    return {
        "kp": drives.kp * number("gains", "kp", 1.0),
        "kd": drives.kd * number("gains", "kd", 1.0),
        "torque": number(LIMIT, "torque", drives.torque),
        "speed": number(LIMIT, "speed", drives.speed),
        "friction": number("coulomb", "level", drives.friction),
        "damping": number("viscous", "coefficient", machine.model.dof_damping),
        "armature": number("armature", "inertia", drives.armature),
        "delay": number("delay", "time", 0.0).clip(min=0.0),
        "stiffness": own_stiffness + number("spring", "stiffness", 0.0),
        "moment": own_stiffness * machine.model.qpos_spring + number("spring", "moment", 0.0),
    }


def write_mjcf(source: Path, machine: MachineModel, effects: EffectSet, out: Path) -> None:
    """Write the MJCF of a machine with its effects and a position actuator for each joint.

    Args:
        source: The machine's own MJCF.
        machine: As it was read, with the gains of the log.
        effects: What it has; those of `not_written` are left out.
        out: The file.

    Raises:
        AssetError: If MuJoCo cannot write or compile it.
    """
    spec: Any = mujoco.MjSpec.from_file(str(source))
    make_room(spec)
    spec.meshdir = str((source.parent / spec.meshdir).resolve())
    spec.texturedir = str((source.parent / spec.texturedir).resolve())
    numbers = joint_settings(machine, effects)
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for j, name in enumerate(machine.joints):
        own = {key: float(values[j]) for key, values in numbers.items()}
        joint = spec.joint(name)
        joint.frictionloss = own["friction"]
        joint.damping[0] = own["damping"]
        joint.armature = own["armature"]
        if own["stiffness"]:
            joint.stiffness[0] = own["stiffness"]
            joint.springref = own["moment"] / own["stiffness"]
        actuator = spec.add_actuator(name=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=name)
        actuator.set_to_position(kp=own["kp"], kv=own["kd"])
        if own["torque"] < UNLIMITED:
            actuator.forcerange = [-own["torque"], own["torque"]]
            actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        if own["delay"] > 0.0:
            actuator.delay = own["delay"]
            actuator.nsample = int(np.ceil(own["delay"] / spec.option.timestep)) + 1
    p = parameters_of(effects, machine)
    if any(key in p for key in OF_LINKS):
        _write_inertias(spec, machine, p)
    if ("base_tilt", "roll") in p:
        roll, pitch = (float(p["base_tilt", axis][0, 0]) for axis in ("roll", "pitch"))
        spec.option.gravity = tilted_gravity(roll, pitch, spec.option.gravity)
    try:
        spec.compile()
        text = spec.to_xml()
    except (ValueError, mujoco.FatalError) as reason:
        raise AssetError(f"{source} cannot be written with effects: {' '.join(str(reason).split())}") from None
    with written_whole(out) as part:
        part.write_text(text, encoding="utf-8")


def _write_inertias(spec: Any, machine: MachineModel, p: dict[tuple[str, str], FloatArray]) -> None:
    made = copy(machine.model)
    change_links(made, machine.body, machine, *inertial_parts(machine, p))
    for b in machine.body:
        body = spec.body(machine.model.body(b).name)
        body.explicitinertial = True
        body.mass = made.body_mass[b]
        body.ipos = made.body_ipos[b]
        body.inertia = made.body_inertia[b]
        body.iquat = made.body_iquat[b]
        body.fullinertia = np.full(6, np.nan)


def actuator_settings(machine: MachineModel, effects: EffectSet) -> dict[str, Any]:
    """Return the actuator settings of each joint under the names of mjlab and of Isaac Lab; delays in seconds."""
    numbers = joint_settings(machine, effects)
    mjlab: dict[str, Any] = {}
    isaac: dict[str, Any] = {}
    for j, name in enumerate(machine.joints):
        own = {key: float(values[j]) for key, values in numbers.items()}
        most = own["torque"] if own["torque"] < UNLIMITED else None
        fastest = own["speed"] if own["speed"] < UNLIMITED else None
        gains = {"stiffness": own["kp"], "damping": own["kd"], "effort_limit": most, "armature": own["armature"]}
        mjlab[name] = {**gains, "frictionloss": own["friction"], "delay": own["delay"]}
        isaac[name] = {
            **gains,
            "velocity_limit": fastest,
            "friction": own["friction"],
            "viscous_friction": own["damping"],
            "delay": own["delay"],
        }
    return {"mjlab": mjlab, "isaac_lab": isaac, "not_written": list(not_written(effects))}
