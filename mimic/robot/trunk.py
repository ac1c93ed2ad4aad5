"""A trunk that is lowered and leant over feet that stay where they are, by inverse kinematics of the hind legs.

The centre of mass stays above the same point of the ground, so that a network that balances the robot as it usually
stands balances it there too: it is shown the joints and the orientation without the change, and the change is added to
what it answers, with the torque that the weight then needs more than before:

    seen    q - dq(height, pitch), orientation x pitch^-1      sent    q_des + dq(height, pitch), tau(height, pitch)

Height is that of the hind hips. Both count from how the robot stands by itself: lower is negative, leaning to the belly
is positive.
Source of the torque: the transpose of a leg's Jacobian times half the weight (Murray, Li, Sastry, "A Mathematical
Introduction to Robotic Manipulation", 1994, section 3.4.2).
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mimic.errors import AssetError
from mimic.records import JOINTS, FloatArray
from mimic.robot.arm_torques import GRAVITY
from mimic.robot.description import RobotDescription, TrunkNumbers
from mimic.robot.leg_kinematics import all_legs
from mimic.robot.model import TOES
from mimic.robot.rigid_body import rigid_body_model

HIND = 6
"""Joints of the hind legs: the last six."""

ROUNDS = 5
"""In which the trunk is moved until its centre of mass is where it was; the last moves no joint by 1 mrad."""

HEIGHT_STEP = 0.01
"""Between two rows of the table [m]; in the middle between them the height is off by less than 0.5 mm."""

PITCH_STEP = 0.05
"""Between two columns of it [rad]."""


class TrunkPose(NamedTuple):
    """What a height and a pitch of the trunk ask for."""

    joints: Any
    """What the hind legs change by (..., 6) [rad]."""
    torque: Any
    """What they carry more (..., 6) [N m]."""
    base: Any
    """How far the base moves forward and up (..., 2) [m]."""


class TrunkPoses:
    """Hind legs for each height and pitch of the trunk, between rows of a table."""

    def __init__(self, description: RobotDescription, xp: Any = np, device: Any = None) -> None:
        """Work out the table of a robot.

        Args:
            description: The robot.
            xp: ``numpy``, or ``torch`` with a device for many robots at once.
            device: Of the tensors.

        Raises:
            AssetError: If the description has no [trunk], or its legs do not get there.
        """
        heights, pitches, table = _table(description)
        self._xp = xp
        self._table = table if xp is np else xp.as_tensor(table, dtype=xp.float32, device=device)
        self._from = (float(heights[0]), float(pitches[0]))
        self._step = (float(heights[1] - heights[0]), float(pitches[1] - pitches[0]))
        self._last = (len(heights) - 1, len(pitches) - 1)

    def of(self, height: Any, pitch: Any) -> TrunkPose:
        """Return the pose of the hind legs.

        Args:
            height: Of the hind hips above how it stands by itself (...,) [m]; within the range of the robot.
            pitch: Forward lean beyond how it stands by itself (...,) [rad]; within the range of the robot.
        """
        row, below = self._place(height, 0)
        column, left = self._place(pitch, 1)
        table = self._table
        lower = table[row, column] * (1 - left) + table[row, column + 1] * left
        upper = table[row + 1, column] * (1 - left) + table[row + 1, column + 1] * left
        found = lower * (1 - below) + upper * below
        return TrunkPose(found[..., :HIND], found[..., HIND : 2 * HIND], found[..., 2 * HIND :])

    def _place(self, value: Any, axis: int) -> tuple[Any, Any]:
        """Return the entry of an axis before a value, and how far it is on the way to the next (..., 1)."""
        xp = self._xp
        at = (xp.asarray(value) - self._from[axis]) / self._step[axis]
        entry = xp.clip(xp.floor(at), 0, self._last[axis] - 1)
        share = xp.clip(at - entry, 0.0, 1.0)[..., None]
        return (entry.astype(np.int64) if xp is np else entry.long()), share


def _steps(ends: FloatArray, step: float) -> FloatArray:
    """Return values from one end to the other, at most a step apart."""
    return np.linspace(ends[0], ends[1], int(np.ceil(np.ptp(ends) / step)) + 1)


@cache
def _table(description: RobotDescription) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return heights (H,) [m], pitches (P,) [rad], and what they ask for (H, P, 14) as in TrunkPose."""
    numbers = description.trunk_numbers
    if numbers is None:
        raise AssetError(f"{description.name} has no [trunk] in its robot.toml: it cannot crouch or lean")
    heights = _steps(numbers.height, HEIGHT_STEP)
    pitches = _steps(numbers.pitch, PITCH_STEP)
    statics = _Statics(description, numbers)
    table = np.empty((len(heights), len(pitches), 2 * HIND + 2))
    for row, height in enumerate(heights):
        for column, pitch in enumerate(pitches):
            table[row, column] = statics.at(float(height), float(pitch))
    return heights, pitches, table


class _Statics:
    """A robot at rest on its hind toes."""

    def __init__(self, description: RobotDescription, numbers: TrunkNumbers) -> None:
        self._description = description
        self._model = rigid_body_model(description)[0]
        self._data = self._model.createData()
        joints = [self._model.joints[self._model.getJointId(name)] for name in JOINTS]
        self._at_q = np.array([joint.idx_q for joint in joints])
        self._hind = np.array([joint.idx_v for joint in joints])[HIND:]
        self._weight = GRAVITY * sum(inertia.mass for inertia in self._model.inertias)
        self._frames = [self._model.getFrameId(name, pin.FrameType.OP_FRAME) for name in TOES[2:]]
        self._legs = all_legs(description)[2:]
        right = numbers.stance * [-1.0, 1.0, 1.0]
        self._q = np.concatenate([description.poses["upright"][:HIND], numbers.stance, right])
        self._turn = pin.utils.rotate("y", numbers.lean - 0.5 * np.pi)
        self._hips = np.mean([leg.origin for leg in self._legs], axis=0)
        hind = self._q[HIND:].reshape(2, 3)
        self._feet = np.array([self._turn @ leg.forward(q) for leg, q in zip(self._legs, hind, strict=True)])
        self._com = self._turn @ self._centre(self._q)
        self._torque = self._carried(self._q, self._turn)

    def at(self, height: float, pitch: float) -> FloatArray:
        """Return changes of joints (6,) [rad], of torques (6,) [N m] and of the base, forward and up (2,) [m]."""
        turn = self._turn @ pin.utils.rotate("y", pitch)
        base = np.array([0.0, 0.0, height + ((self._turn - turn) @ self._hips)[2]])
        q = self._q.copy()
        for _ in range(ROUNDS):
            q[HIND:] = np.concatenate([self._leg(k, turn.T @ (self._feet[k] - base), q, height, pitch) for k in (0, 1)])
            base[0] += self._com[0] - (base + turn @ self._centre(q))[0]
        return np.concatenate([q[HIND:] - self._q[HIND:], self._carried(q, turn) - self._torque, base[[0, 2]]])

    def _leg(self, index: int, toe: FloatArray, q: FloatArray, height: float, pitch: float) -> FloatArray:
        """Return joints (3,) of a hind leg that put its toe (3,) there, base axes [m], near to those of q (12,)."""
        own = slice(HIND + 3 * index, HIND + 3 * index + 3)
        postures = self._legs[index].inverse(toe)
        away = np.nan_to_num(np.abs(postures - q[own]).sum(axis=-1), nan=np.inf)
        near = postures[int(np.argmin(away))]
        if not ((near >= self._description.q_min[own]) & (near <= self._description.q_max[own])).all():
            where = f"{100 * height:.0f} cm, {np.rad2deg(pitch):.0f} deg"
            raise AssetError(f"the hind legs of {self._description.name} do not reach [trunk] {where}; expected less")
        return near

    def _centre(self, q: FloatArray) -> FloatArray:
        return pin.centerOfMass(self._model, self._data, self._full(q)).copy()

    def _full(self, q: FloatArray) -> FloatArray:
        full = pin.neutral(self._model)
        full[self._at_q] = q
        return full

    def _carried(self, q: FloatArray, turn: FloatArray) -> FloatArray:
        """Return the torques (6,) [N m] with which the hind legs carry the robot, half of it each."""
        self._model.gravity.linear = turn.T @ np.array([0.0, 0.0, -GRAVITY])
        full = self._full(q)
        torque = pin.computeGeneralizedGravity(self._model, self._data, full)
        force = turn.T @ np.array([0.0, 0.0, 0.5 * self._weight])
        for toe in self._frames:
            jacobian = pin.computeFrameJacobian(self._model, self._data, full, toe, pin.LOCAL_WORLD_ALIGNED)
            torque = torque - jacobian[:3].T @ force
        return torque[self._hind]
