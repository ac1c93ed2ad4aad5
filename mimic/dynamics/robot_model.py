"""Description -> compiled MuJoCo model and its actuator law: one place for simulation, training and evaluation.

The actuator law is MuJoCo's own ``dcmotor`` in the MJCF: tau = kp (q_des - q) - kd dq, through a motor whose voltage
limit gives the torque-speed line, clipped at the peak torque. MuJoCo on a CPU and MuJoCo Warp on a GPU both run it,
and both integrate it implicitly. With calibrated effects a bare motor at each joint takes its place, which
`mimic.dynamics.law` drives.

A command takes effect after a delay that varies from robot to robot. It is applied on the way to the motors
(`command_in_effect`) and not by the native ``delay`` of the MJCF, so that it can be drawn anew for each episode.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import MISSING, dataclass, fields
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import brentq

from mimic.config.play import DESCRIBED_REBOUND, Randomisation
from mimic.dynamics.machine import add_load, add_motors
from mimic.records import JOINTS, LEGS, FloatArray
from mimic.robot.description import RobotDescription
from mimic.robot.model import BASE, FLOOR, is_visual, read_model

RESISTANCE = 0
"""Index of the resistance in the gain parameters of a dcmotor."""
MOTOR_CONSTANT = 1
"""Of the motor constant."""
GAIN_KP = 4
"""Of the position gain."""
GAIN_KD = 6
"""Of the velocity gain."""


def load_model(
    description: RobotDescription,
    *,
    floor: bool = True,
    visuals: bool = True,
    payloads: Mapping[str, float] | None = None,
    driven: bool = False,
) -> mujoco.MjModel:
    """Compile the robot.

    Args:
        description: The robot.
        floor: Put it on a floor.
        visuals: Keep the shapes that are only looked at.
        payloads: Mass [kg] that the toe of a leg carries, as a ball of the toe's size.
        driven: Instead of the servos put a bare motor at each joint, for a law that drives it.
    """
    return copy(_compiled(description, floor, visuals, tuple((payloads or {}).items()), driven))


@lru_cache(maxsize=8)  # a copy takes 0.6 ms, a compilation 20
def _compiled(
    description: RobotDescription, floor: bool, visuals: bool, payloads: tuple[tuple[str, float], ...], driven: bool
) -> mujoco.MjModel:
    spec = read_model(description, floor=floor)
    for actuator in spec.actuators:
        actuator.delay = 0.0
        actuator.nsample = 0
    if not visuals:
        for geom in list(spec.geoms):
            if is_visual(geom):
                spec.delete(geom)
    if driven:
        add_motors(spec, JOINTS)
    for leg, mass in payloads:
        inertia = 0.4 * mass * description.toe_radius**2
        load = spec.body(f"{leg}_knee").add_body(pos=description.leg.toe, explicitinertial=True)
        load.mass = mass
        load.ipos = [0.0, 0.0, 0.0]
        load.inertia = [inertia] * 3
    return spec.compile()


@dataclass(frozen=True, kw_only=True, eq=False)
class Variation:
    """One robot out of the randomised many; joint arrays are (12,), leg arrays (4,)."""

    dry_friction: FloatArray
    """Factor."""
    viscous_friction: FloatArray
    """Factor."""
    ground_friction: float
    restitution: float
    base_mass: float
    """Added to the trunk [kg]."""
    abad_mass: FloatArray
    """Added [kg]."""
    hip_mass: FloatArray
    """Added [kg]."""
    knee_mass: FloatArray
    """Added [kg]."""
    toe_mass: FloatArray
    """Added at the toes [kg]."""
    com: FloatArray
    """Shift of the trunk's centre of mass (3,) [m]."""
    kp: FloatArray
    """Factor."""
    kd: FloatArray
    """Factor."""
    delay_steps: int
    """Physics steps from a command to its effect."""
    start_q: FloatArray
    """Added to the start pose [rad]."""
    start_height: float
    """Added to the start height [m]."""
    heading: float
    """At the start [rad]."""
    torque: float = 1.0
    """Factor on the largest torque of all motors."""
    speed: float = 1.0
    """Factor on the speeds at which it falls and ends."""


_SHAPES = {
    "dry_friction": (12,),
    "viscous_friction": (12,),
    "abad_mass": (4,),
    "hip_mass": (4,),
    "knee_mass": (4,),
    "toe_mass": (4,),
    "com": (3,),
    "kp": (12,),
    "kd": (12,),
    "start_q": (12,),
}


def draw_variation(ranges: Randomisation, timestep: float, rng: np.random.Generator) -> Variation:
    """Return one robot drawn from the ranges."""
    values: dict[str, Any] = {}
    for f in fields(Variation):
        if f.default is not MISSING:
            continue
        low, high = getattr(ranges, "delay" if f.name == "delay_steps" else f.name)
        if f.name == "delay_steps":
            values[f.name] = int(rng.integers(round(low / timestep), round(high / timestep) + 1))
        elif f.name in _SHAPES:
            values[f.name] = rng.uniform(low, high, _SHAPES[f.name])
        else:
            values[f.name] = float(rng.uniform(low, high))
    return Variation(**values)


LEAST_REBOUND = 0.02
"""No contact is damped more than one that rebounds by this share."""


def rebound(damping: float) -> float:
    """Return the rebound speed over the impact speed of a contact with this damping ratio.

    A damped oscillator that lets go where its force is zero, as a contact cannot pull.
    Source: Schwager and Poeschel 2007, "Coefficient of restitution and linear-dashpot model revisited".
    """
    z = damping
    if z < 1.0:
        r = math.sqrt(1.0 - z * z)
        return math.exp(-z / r * math.atan2(2 * z * r, 2 * z * z - 1))
    r = math.sqrt(z * z - 1.0)
    return math.exp(-2.0 if r < 1e-6 else -z / r * math.log((z + r) / (z - r)))


def restitution_damping(restitution: float) -> float:
    """Return the damping ratio of a contact whose rebound speed is ``restitution`` times the impact speed."""
    wanted = max(restitution, LEAST_REBOUND)
    if wanted == DESCRIBED_REBOUND:
        return 1.0
    return 0.0 if wanted >= 1.0 else float(brentq(lambda z: rebound(z) - wanted, 0.0, 10.0))  # type: ignore[arg-type]


def bouncing(time: float, restitution: float) -> tuple[float, float]:
    """Return time constant [s] and damping ratio of a bouncing contact as stiff as one of ``time``."""
    damping = max(restitution_damping(restitution), 1e-3)
    return time / damping, damping


def vary_model(model: mujoco.MjModel, nominal: mujoco.MjModel, variation: Variation) -> None:
    """Write one variation into ``model``, starting from the numbers of ``nominal``; repeatable on the same model."""
    joints = slice(6, 18)
    model.dof_frictionloss[joints] = nominal.dof_frictionloss[joints] * variation.dry_friction
    model.dof_damping[joints] = nominal.dof_damping[joints] * variation.viscous_friction
    floor = model.geom(FLOOR).id
    model.geom_friction[floor, 0] = variation.ground_friction
    model.geom_solref[floor] = bouncing(nominal.geom_solref[floor, 0], variation.restitution)
    model.actuator_gainprm[:, GAIN_KP] = nominal.actuator_gainprm[:, GAIN_KP] * variation.kp
    model.actuator_gainprm[:, GAIN_KD] = nominal.actuator_gainprm[:, GAIN_KD] * variation.kd
    usual = nominal.actuator_gainprm
    model.actuator_gainprm[:, MOTOR_CONSTANT] = usual[:, MOTOR_CONSTANT] / variation.speed
    model.actuator_gainprm[:, RESISTANCE] = usual[:, RESISTANCE] / (variation.speed * variation.torque)
    model.actuator_forcerange[:] = nominal.actuator_forcerange * variation.torque
    added = np.zeros(model.nbody)
    base = model.body(BASE).id
    added[base] = variation.base_mass
    for i, leg in enumerate(LEGS):
        added[model.body(f"{leg}_abad").id] = variation.abad_mass[i]
        added[model.body(f"{leg}_hip").id] = variation.hip_mass[i]
        added[model.body(f"{leg}_knee").id] = variation.knee_mass[i] + variation.toe_mass[i]
    mass = nominal.body_mass + added
    ratio = np.where(nominal.body_mass > 0, mass / np.maximum(nominal.body_mass, 1e-9), 1.0)
    model.body_mass[:] = mass
    model.body_inertia[:] = nominal.body_inertia * ratio[:, None]
    model.body_iquat[:] = nominal.body_iquat
    model.body_ipos[:] = nominal.body_ipos
    model.body_ipos[base] += variation.com
    mujoco.mj_setConst(model, mujoco.MjData(model))


def carry(model: mujoco.MjModel, body: str, mass: float, position: FloatArray) -> None:
    """Add a point mass [kg] at a position (3,) [m] of a body, in ``model`` as it is."""
    if not mass:
        return
    add_load(model, model.body(body).id, mass, position)
    mujoco.mj_setConst(model, mujoco.MjData(model))


def command_in_effect(
    substep: int,
    decimation: int,
    delay_steps: Any,
    commands: Sequence[Any],
    where: Any,
    *,
    interpolate: bool,
) -> Any:
    """Return the command that acts during a physics step.

    Args:
        substep: Index of the physics step within the control step, from 0.
        decimation: Physics steps in a control step.
        delay_steps: Physics steps from a command to its effect; no more than one control step less than there are
            commands. Broadcasts with commands.
        commands: Of this control step and those before, newest first.
        where: ``np.where`` or ``torch.where``.
        interpolate: Move linearly from one command to the next, over a control step; needs one command more.
    """
    acting = commands[-1]
    for age in reversed(range(len(commands) - 1)):
        value = commands[age]
        if interpolate:
            steps = substep + 1 + age * decimation - delay_steps  # physics steps on the way, at the end of this one
            share = where(steps < decimation, steps / decimation, 1.0)
            value = commands[age + 1] + share * (value - commands[age + 1])
        acting = where(delay_steps - age * decimation <= substep, value, acting)
    return acting
