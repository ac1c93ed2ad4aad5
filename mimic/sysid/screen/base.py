"""Is it the base that moves? One motion of the base against a force of its own in each joint.

A base that swings shakes all joints at its few frequencies, each as strongly as the masses behind it and its pose
demand. That pattern has six numbers for each phase of a frequency, however many joints there are; forces in the joints
have as many as they like. No effect of the catalogue moves the base: where its motion explains no less of the torque
than forces do, the rest is not explained, and the report says so.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from mimic.dynamics.machine import MachineModel
from mimic.records import BoolArray, FloatArray
from mimic.sysid.screen.regression import Torques, behind
from mimic.sysid.thresholds import RULES

AXES = 6
"""Accelerations along x, y, z and about x, y, z of the base."""

POSES_HZ = 50.0
"""How often the pattern is computed; the legs hardly move in between [Hz]."""

MOST_FREQUENCIES = 3
"""Most frequencies that a base is taken to swing at."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BaseMotion:
    """A motion of the base as an explanation."""

    frequencies: tuple[float, ...]
    """[Hz]"""
    numbers: int
    """How many it has."""
    share: FloatArray
    """Of the squares of the torque that is left, what it removes in blocks that were left out (J,)."""
    blocks: FloatArray
    """Log of the error in each left-out block, of each joint (B, J)."""

    def instead_of(self, blocks: FloatArray | None) -> str:
        """Return why this explains the torque no worse than an effect, or an empty string.

        Args:
            blocks: What the effect leaves, as `blocks` says it; None where torques cannot judge it.
        """
        if blocks is None or behind(blocks, self.blocks) >= RULES.apart:
            return ""
        at = " and ".join(f"{f:.2f}" for f in self.frequencies)
        explains = "more" if behind(self.blocks, blocks) >= RULES.apart else "as much"
        return f"one motion of the base at {at} Hz explains {explains}, with {self.numbers} parameters"


def base_torques(machine: MachineModel, q: FloatArray, factor: FloatArray) -> FloatArray:
    """Return the torque on each joint of a unit acceleration of the base along and about its axes (T, J, 6).

    In [N m] for [m/s^2] and [rad/s^2], in a frame that moves with the base; slow enough that the legs' own speed does
    not matter.

    Args:
        machine: The model, its base at the origin.
        q: Positions (T, J) [rad].
        factor: Of the mass of each joint's link (J,).
    """
    model, data = machine.model, mujoco.MjData(machine.model)
    scale = np.ones(model.nbody)
    scale[machine.body] = factor
    linear, turning = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    out = np.zeros((len(q), model.nv, AXES))
    for row, pose in zip(out, q, strict=True):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        for b in range(1, model.nbody):
            if not model.body_mass[b]:
                continue
            mujoco.mj_jacBodyCom(model, data, linear, turning, b)
            axes = data.ximat[b].reshape(3, 3)
            inertia = scale[b] * axes @ np.diag(model.body_inertia[b]) @ axes.T
            x, y, z = data.xipos[b]
            across = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])  # of alpha x r
            mass = scale[b] * model.body_mass[b]
            row[:, :3] -= mass * linear.T
            row[:, 3:] -= mass * linear.T @ across + turning.T @ inertia
    return out


def shared_frequencies(
    frequency: FloatArray, size: FloatArray, there: BoolArray, resolution: float
) -> tuple[float, ...]:
    """Return the frequencies that two joints or more share, that of most joints first.

    Args:
        frequency: Of the force in each joint (J,) [Hz].
        size: How strong it is (J,).
        there: Joints that have one (J,).
        resolution: Frequencies closer than this are one [Hz].
    """
    left, found = there.copy(), []
    while left.any():
        near = [left & (np.abs(frequency - f) < resolution) for f in frequency]
        best = max(np.flatnonzero(left), key=lambda j: (int(near[j].sum()), float(size[j])))
        if near[best].sum() < 2:
            break
        found.append(float(np.average(frequency[near[best]], weights=size[near[best]] ** 2)))
        left &= ~near[best]
    return tuple(found[:MOST_FREQUENCIES])


def moving_base(torques: Torques, frequency: FloatArray, size: FloatArray, there: BoolArray) -> BaseMotion | None:
    """Return the motion of the base that explains the torques at least as well as forces in the joints, or None.

    Of one log: two have nothing to do with each other in their phases.

    Args:
        torques: Of the log.
        frequency: Of a periodic force fitted to each joint (J,) [Hz].
        size: How strong it is (J,) [N m].
        there: Joints that have one (J,).
    """
    if len(torques.motions) > 1 or there.sum() < 2:
        return None
    motion = torques.motions[0]
    shared = np.array(shared_frequencies(frequency, size, there, 1.0 / motion.t[-1]))
    numbers = (2 * AXES + 1) * len(shared)
    lone = len(np.unique(motion.machine.chain)) == 1
    if not len(shared) or (lone and numbers >= 3 * there.sum()):
        return None
    at = np.arange(0.0, motion.t[-1] + 1.0 / POSES_HZ, 1.0 / POSES_HZ)
    q = np.stack([np.interp(at, motion.t, column) for column in motion.q.T], -1)
    poses = base_torques(motion.machine, q, np.ones(len(there)))
    pattern = np.stack([np.interp(motion.t, at, c) for c in poses.reshape(len(at), -1).T], -1)
    angle = 2 * np.pi * motion.t[:, None] * shared
    waves = np.concatenate([np.cos(angle), np.sin(angle)], -1)
    swung = np.einsum("tja,tw->tjaw", pattern.reshape(len(motion.t), -1, AXES), waves)
    each = np.einsum("jk,tw->tjkw", np.eye(len(there)), waves)
    search = torques.regression
    base, forces = (search.explained_by(motion.filtered(x.reshape(*x.shape[:2], -1))) for x in (swung, each))
    none = search.score(()).blocks
    if behind(base, none) < RULES.z or behind(forces, base) >= RULES.apart:
        return None
    share = 1.0 - np.exp(2.0 * (np.nanmean(base, axis=0) - np.nanmean(none, axis=0)))
    return BaseMotion(frequencies=tuple(sorted(shared.tolist())), numbers=numbers, share=share, blocks=base)
