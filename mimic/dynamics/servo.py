"""How the law of the drives enters the physics: one bare motor for each joint, and what is written once.

The same for the simulated robot and training worlds: an `EffectSet`
becomes parameters (`parameters_of`), these become a `mimic.dynamics.law.Law`, whose inputs a
`Servo` writes at every step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.effect_set import EffectSet, read_effects
from mimic.dynamics.law import OF_DRIVES, Parameters, StepInputs
from mimic.dynamics.machine import MachineModel, change_links
from mimic.errors import ConfigError
from mimic.records import FloatArray


@dataclass(kw_only=True, eq=False)
class Servo:
    """The fields that a law writes at every step: arrays of NumPy or tensors (N, J), written in place."""

    ctrl: Any
    applied: Any
    inertia: Any
    friction: Any
    needed: Any = 0.0
    """Torque that the links need against gravity and for their motion at this speed (N, J): only read [N m]."""

    def write(self, inputs: StepInputs) -> None:
        """Hand over the inputs of the next step."""
        self.ctrl[:] = inputs.torque
        self.inertia[:] = inputs.inertia
        self.friction[:] = inputs.friction
        self.applied[:] = inputs.applied


def static_model(model: mujoco.MjModel, machine: MachineModel, p: Parameters) -> None:
    """Write the effects that never change into a model whose last joints and links are the machine's."""
    dofs = slice(model.nv - len(machine.joints), None)
    if ("viscous", "coefficient") in p:
        model.dof_damping[dofs] = p["viscous", "coefficient"][0]
    if ("armature", "inertia") in p:
        model.dof_armature[dofs] = p["armature", "inertia"][0]
    there = [p[key][0] > 0 for key in (("backlash", "gap"), ("compliance", "compliance")) if key in p]
    if there:  # the rotor is a state of the law
        model.dof_armature[dofs] = np.where(np.any(there, axis=0), 0.0, model.dof_armature[dofs])
    bodies = [model.body(machine.model.body(b).name).id for b in machine.body]
    change_links(model, bodies, machine, *inertial_parts(machine, p))
    mujoco.mj_setConst(model, mujoco.MjData(model))


OF_LINKS = (("link_mass", "factor"), ("com_shift", "distance"), ("payload", "mass"))
"""What changes links: factors on masses, shifts of centres and masses at tips."""


def inertial_parts(machine: MachineModel, p: Parameters) -> list[FloatArray]:
    """Return the values of `OF_LINKS` (J,)."""
    return [p[key][0] if key in p else neutral(*key, machine) for key in OF_LINKS]


def neutral(name: str, parameter: str, machine: MachineModel) -> FloatArray:
    """Return the neutral value of a parameter for each joint (J,), or (1,) for the whole machine."""
    spec = CATALOGUE[name]
    value = spec.parameter(parameter).neutral
    if value != "model":
        return np.full(len(machine.joints) if spec.scope == "joint" else 1, float(value))
    if name == "motor" and machine.drives.volts is None:
        raise ConfigError(
            "effect 'motor' is of voltage drives, and the drives here control torque. If they control voltage, say so:"
            " --note drive=voltage, and the numbers that it asks for"
        )
    viscous = name == "viscous"
    own = machine.model.dof_damping if viscous else getattr(machine.drives, OF_DRIVES[name, parameter])
    return np.array(own, dtype=np.float64)


def parameters_of(effects: EffectSet, machine: MachineModel) -> dict[tuple[str, str], FloatArray]:
    """Return the applied effects as the law takes them: (1, J) for joints, (1, 1) for the whole machine.

    Raises:
        ConfigError: If an effect names a joint that the machine lacks.
    """
    found: dict[tuple[str, str], FloatArray] = {}
    for e in effects.applied:
        spec = CATALOGUE[e.name]
        lacking = [j for j in e.joints if j not in machine.joints]
        if lacking:
            raise ConfigError(
                f"effect {e.name!r} names joint {lacking[0]!r}; the model has {', '.join(machine.joints)}"
            )
        for parameter in spec.parameters:
            row = neutral(e.name, parameter.name, machine)
            index = [machine.joints.index(j) for j in e.joints] if e.joints else [0]
            if parameter.fixed and parameter.starts:
                row[index] = parameter.starts[0]
            if parameter.name in e.values:
                row[index] = e.values[parameter.name]
            found[e.name, parameter.name] = row[None]
    return found


STAND = ("base_tilt",)
"""Effects of the stand that a robot hangs in: on its feet it does not have them."""


def of_stand(effects: EffectSet) -> tuple[str, ...]:
    """Return the names of the applied effects that a hung robot has and one on its feet has not."""
    return tuple(e.name for e in effects.applied if e.name in STAND)


def read_standing(path: Path) -> EffectSet:
    """Read an effects.toml without the effects of the stand: of `of_stand`, whoever reads it should tell.

    Raises:
        ConfigError: If it is no such file, or a value does not fit the catalogue.
    """
    return EffectSet(tuple(e for e in read_effects(path) if e.name not in STAND))


def refuse_stand(effects: EffectSet) -> None:
    """Refuse effects that a robot on its feet cannot have.

    Raises:
        ConfigError: If there is one.
    """
    for name in of_stand(effects):
        raise ConfigError(f"effect {name!r} is of a stand, and this robot stands on its feet; leave it out")


def target_shift(p: Parameters, timestep: float) -> Any:
    """Return how many physics steps after it was sent a target acts, (N, 1) or (N, J), not whole numbers.

    Half a step comes on top of the delay: a position read at the start of a step is half a step old.
    """
    shift: Any = np.full((1, 1), 0.5)
    for key in (("delay", "time"), ("joint_delay", "time")):
        if key in p:
            shift = shift + p[key] / timestep
    return shift


def shares_in_effect(substep: int, decimation: int, shifts: Sequence[Any], xp: Any) -> list[Any]:
    """Return for which share of a physics step each target is in effect: of those that have arrived the newest.

    Args:
        substep: Index of the physics step within the control step, from 0.
        decimation: Physics steps in a control step.
        shifts: For each target, physics steps from when it was sent to its effect; arrays. Sent one control step apart,
            newest first; the last acts before any other.
        xp: ``numpy`` or ``torch``.
    """
    shares = []
    gone = xp.zeros_like(shifts[0])
    for age, shift in enumerate(shifts[:-1]):
        begun = xp.clip(substep + 1 + age * decimation - shift, 0.0, 1.0)
        shares.append(xp.clip(begun - gone, 0.0, None))
        gone = xp.maximum(gone, begun)
    return [*shares, 1.0 - gone]


def target_in_effect(shares: Sequence[Any], targets: Sequence[Any]) -> Any:
    """Return the mean over a physics step of targets that are in effect for these shares of it."""
    return sum(share * target for share, target in zip(shares, targets, strict=True))


def moving_targets(substep: int, decimation: int, shifts: Sequence[Any], targets: Sequence[Any], xp: Any) -> list[Any]:
    """Return where each target is at the end of a physics step, if targets move linearly from one to the next.

    Args:
        substep: Index of the physics step within the control step, from 0.
        decimation: Physics steps in a control step, over which a target moves from the one before it.
        shifts: As for `shares_in_effect`, with one target more than that needs.
        targets: Newest first; the last one stays.
        xp: ``numpy`` or ``torch``.
    """
    moved = []
    for age, (shift, target, before) in enumerate(zip(shifts, targets, targets[1:], strict=False)):
        way = xp.clip((substep + 1 + age * decimation - shift) / decimation, 0.0, 1.0)
        moved.append(before + way * (target - before))
    return [*moved, targets[-1]]
