"""What the actuators of an MJCF do, as drives of its joints, and whether a machine moves as its file says."""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from mimic.dynamics.catalogue.kinds import UNLIMITED
from mimic.dynamics.law import Law
from mimic.errors import AssetError
from mimic.records import FloatArray

if TYPE_CHECKING:
    from mimic.dynamics.machine import MachineModel


@dataclass(frozen=True, kw_only=True, eq=False)
class Reference:
    """The model that a machine must move like; J joints, C inputs."""

    model: mujoco.MjModel
    of_target: FloatArray
    """Inputs for a target of 1 rad (C, J)."""
    of_force: FloatArray
    """Inputs for a torque of 1 N m (C, J)."""

    @classmethod
    def of(cls, model: mujoco.MjModel) -> Reference:
        """Return that of a model without contacts and delays; inputs are to be filled in."""
        own = copy(model)
        nothing = np.zeros((model.nu, model.njnt))
        own.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        own.actuator_history[:, 0] = 0
        own.actuator_actearly[:] = False
        return cls(model=own, of_target=nothing, of_force=nothing.copy())


OFF = 1
"""Group of the actuators that the reference does not have."""

AT_JOINT = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)


class FileDrives:
    """Drives of the hinges and slides of a file, which its actuators are; J joints.

    What a drive cannot do is told and taken out of the reference, in one place.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        """Read a compiled file."""
        self.reference = Reference.of(model)
        """The file without what was dropped."""
        self.kp = np.zeros(model.njnt)
        """(J,) [N m/rad]"""
        self.kd = np.zeros(model.njnt)
        """(J,) [N m s/rad]"""
        self._model = model
        self._told: dict[str, list[str]] = {}
        self._ranges: dict[int, dict[int, FloatArray]] = {}
        self._own = self.reference.model
        enabled = np.array([self._enabled(a) for a in range(model.nactuator)], dtype=bool)
        self._own.actuator_group[:] = np.where(enabled, 0, OFF)
        self._own.opt.disableactuator = 1 << OFF
        for a in np.flatnonzero(enabled):
            self._read(int(a))
        self.torque = np.array([self._limit(j) for j in range(model.njnt)])
        """Peak torque (J,) [N m]."""

    @property
    def dropped(self) -> tuple[str, ...]:
        """Parts that the drives leave out, each with the names or the number of those that have it."""
        counts = (("sensors", self._model.nsensor), ("plugins", self._model.nplugin))
        return (
            *(f"{part} of the actuators {', '.join(names)}" for part, names in self._told.items()),
            *(f"{count} {what}" for what, count in counts if count),
        )

    def _enabled(self, a: int) -> bool:
        option = self._model.opt
        group = int(self._model.actuator_group[a])
        if option.disableflags & mujoco.mjtDisableBit.mjDSBL_ACTUATION:
            return False
        return not (0 <= group <= 30 and option.disableactuator >> group & 1)

    def _drop(self, part: str, a: int) -> None:
        name = self._model.actuator(a).name
        if not name and int(self._model.actuator_trntype[a]) in AT_JOINT:
            name = self._model.joint(int(self._model.actuator_trnid[a, 0])).name
        self._told.setdefault(part, []).append(name or f"number {a}")

    def _read(self, a: int) -> None:
        """Add an actuator to the drive of its joint."""
        m = self._model
        reference = self._own
        strange = self._strange(a)
        if strange:
            self._drop(f"all forces ({strange})", a)
            reference.actuator_group[a] = OFF
            return
        if m.actuator_dyntype[a] != mujoco.mjtDyn.mjDYN_NONE:  # `_of_file` gives the activation its final value
            self._drop("activation dynamics (timeconst)", a)
        if m.actuator_delay[a] > 0:
            self._drop("delays", a)
        j = int(m.actuator_trnid[a, 0])
        u = int(m.actuator_ctrladr[a])
        gear = float(m.actuator_gear[m.actuator_outadr[a], 0])
        gain = float(m.actuator_gainprm[a, 0])
        affine = m.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_AFFINE
        constant, position, speed = m.actuator_biasprm[a, :3] if affine else np.zeros(3)
        if constant:
            self._drop("constant forces (biasprm)", a)
            reference.actuator_biasprm[a, 0] = 0.0
        if position and not np.isclose(gain, -position):
            self._drop("gains that are not those of the bias (gainprm)", a)
            reference.actuator_gainprm[a, 0] = gain = -position
        clamped = bool(m.actuator_ctrllimited[u]) and not m.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL
        if clamped and (position or speed):
            self._drop("ranges of targets (ctrlrange)", a)
            reference.actuator_ctrllimited[u] = clamped = False
        self.kp[j] -= position * gear**2
        self.kd[j] -= speed * gear**2
        if position:
            self.reference.of_target[u, j] = gear
        elif gain * gear and not self.reference.of_force[:, j].any():
            self.reference.of_force[u, j] = 1.0 / (gain * gear)
        own = m.actuator_forcerange[a] if m.actuator_forcelimited[a] else np.array([-UNLIMITED, UNLIMITED])
        asked = np.sort(gain * m.actuator_ctrlrange[u]) if clamped else own
        self._ranges.setdefault(j, {})[a] = np.sort(gear * np.clip(asked, *own))

    def _strange(self, a: int) -> str | None:
        """Return why an actuator is no drive of a joint, None if it is one."""
        m = self._model
        if int(m.actuator_trntype[a]) not in AT_JOINT:
            return "at no joint"
        if m.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_MUSCLE:
            return "of a muscle"
        if m.actuator_gaintype[a] != mujoco.mjtGain.mjGAIN_FIXED:
            return "their gains depend on the state"
        if int(m.actuator_biastype[a]) not in (mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE):
            return "not linear"
        return None

    def _limit(self, j: int) -> float:
        """Return the peak torque of a joint's drive, the same in both directions."""
        m = self._model
        reference = self._own
        ranges = self._ranges.get(j, {})
        own = np.abs(m.jnt_actfrcrange[j]).max() if m.jnt_actfrclimited[j] else UNLIMITED
        most = sum(float(np.abs(r).max()) for r in ranges.values())
        most = min(most or UNLIMITED, UNLIMITED)
        if all(np.abs(r).max() >= UNLIMITED for r in ranges.values()):
            return min(most, own)
        freed = []
        for a, (low, high) in ranges.items():
            if len(ranges) > 1:
                self._drop("force ranges beside others at a joint (their sum counts)", a)
            elif not np.isclose(low, -high):
                self._drop("force ranges that differ by direction (the larger counts)", a)
            else:
                continue
            freed.append(a)
        if freed:
            low, high = m.jnt_actfrcrange[j] if m.jnt_actfrclimited[j] else (-UNLIMITED, UNLIMITED)
            reference.actuator_forcelimited[freed] = False
            reference.actuator_ctrllimited[m.actuator_ctrladr[freed]] = False
            reference.jnt_actfrclimited[j] = True
            reference.jnt_actfrcrange[j] = max(low, -most), min(high, most)
        return min(most, own)


STATES = 6
"""States and targets at which accelerations are compared."""

SAME = 1e-6
"""Difference of accelerations over the largest of a state: numbers of a description have ten digits."""

NEAR = 0.03
"""Distance of targets from positions within the limits of torque [rad]."""
FAR = 1.0
"""Distance beyond them [rad]."""

SLOW = 3.0
"""Joint speed in two of three states [rad/s]."""
FAST = 30.0
"""In each third state [rad/s]. Never faster than a motor can turn a joint: there the law and MuJoCo's motors differ
(docs/architecture.md)."""


def refuse_other_machine(machine: MachineModel, reference: Reference, source: object, advice: str) -> None:
    """Refuse a machine that does not move as its file says.

    Args:
        machine: As it is replayed.
        reference: What the file says.
        source: What the file is called.
        advice: What to do if it is not the same.

    Raises:
        AssetError: If accelerations differ at one of a few states and targets, drawn at random.
    """
    for q, dq, target, force in _states(machine):
        pushed = np.where(reference.of_force.any(axis=0), force, 0.0)
        expected = _of_file(reference, q, dq, target, pushed)
        found = _of_machine(machine, q, dq, target, pushed)
        apart = np.abs(found - expected)
        if apart.max() <= SAME * (1.0 + np.abs(expected).max()):
            continue
        j = int(apart.argmax())
        unit = f"{machine.unit}/s^2"
        raise AssetError(
            f"{source}: mimic would accelerate joint {machine.joints[j]!r} by {found[j]:.4g} {unit} where the file says"
            f" {expected[j]:.4g}; {advice}"
        )


def touches(model: mujoco.MjModel, machine: MachineModel) -> bool:
    """Return whether shapes of a file touch in one of the states of `refuse_other_machine`."""
    data = mujoco.MjData(model)
    for q, *_ in _states(machine):
        data.qpos[:] = q
        mujoco.mj_fwdPosition(model, data)
        if data.ncon:
            return True
    return False


def _states(machine: MachineModel) -> Iterator[tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
    """Draw positions, velocities, targets and forces of all joints, each (J,), repeatably."""
    rng = np.random.default_rng(0)
    count = len(machine.joints)
    low = np.maximum(machine.low, -np.pi)
    high = np.minimum(machine.high, np.pi)
    for i in range(STATES):
        q = rng.uniform(low, np.maximum(low, high))
        dq = np.minimum((SLOW, FAST)[i % 3 == 2], machine.drives.speed) * rng.uniform(-1.0, 1.0, count)
        target = q + (NEAR, FAR)[i % 2] * rng.uniform(-1.0, 1.0, count)
        most = np.minimum(machine.drives.torque, 1.0 / NEAR)
        yield q, dq, target, (NEAR, 1.5)[i % 2] * most * rng.uniform(-1.0, 1.0, count)


def _of_file(reference: Reference, q: FloatArray, dq: FloatArray, target: FloatArray, force: FloatArray) -> FloatArray:
    """Return the accelerations of the file's model (J,)."""
    model = reference.model
    data = mujoco.MjData(model)
    data.ctrl[:] = reference.of_target @ target + reference.of_force @ force
    for a in np.flatnonzero(model.actuator_actnum):  # where activations are, inputs do not act by themselves
        data.act[model.actuator_actadr[a] + model.actuator_actnum[a] - 1] = data.ctrl[model.actuator_ctrladr[a]]
    return _acceleration(model, data, q, dq)


def _of_machine(
    machine: MachineModel, q: FloatArray, dq: FloatArray, target: FloatArray, force: FloatArray
) -> FloatArray:
    """Return the accelerations of a machine that a law without effects drives (J,)."""
    count = len(machine.joints)
    inputs = Law(machine.drives, {}, 0.0, (1, count), np).step(q[None], dq[None], target[None], 0.0, force[None])
    model = copy(machine.model)
    model.dof_armature[:] = inputs.inertia[0]
    model.dof_frictionloss[:] = inputs.friction[0]
    data = mujoco.MjData(model)
    data.ctrl[:] = inputs.torque[0]
    data.qfrc_applied[:] = inputs.applied[0]
    return _acceleration(model, data, q, dq)


def _acceleration(model: mujoco.MjModel, data: mujoco.MjData, q: FloatArray, dq: FloatArray) -> FloatArray:
    """Return the accelerations at a state, solved to the end."""
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.solver = mujoco.mjtSolver.mjSOL_NEWTON
    model.opt.iterations = 100
    model.opt.tolerance = 0.0
    model.opt.noslip_iterations = 0
    data.qpos[:] = q
    data.qvel[:] = dq
    mujoco.mj_forward(model, data)
    return np.array(data.qacc)
