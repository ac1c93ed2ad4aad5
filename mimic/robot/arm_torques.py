"""Torques that the front legs need for a motion with the base at rest: gravity, inertia and the friction of the joints.

Newton and Euler along one leg, all vectors in base axes, for NumPy and PyTorch. Source: Featherstone, "Rigid Body
Dynamics Algorithms", 2008, section 5.3. Checked against Pinocchio's RNEA.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mimic.geometry import world_axes_in_base
from mimic.records import JOINTS
from mimic.robot.description import RobotDescription
from mimic.robot.rigid_body import rigid_body_model

GRAVITY = 9.81
"""[m/s^2]"""

FRICTION_SPEED = 0.1
"""Joint speed at which half of the dry friction is asked for [rad/s], as in training (MdpSettings.friction_speed)."""

LEG = 3
"""Joints of a leg: abad about x, hip and knee about y."""

NEXT = (1, 2, 0)
"""Coordinate after each of x, y, z."""

LAST = (2, 0, 1)
"""Coordinate before each of x, y, z."""


class ArmTorques:
    """Torques of the front legs of a robot as described."""

    def __init__(self, description: RobotDescription, xp: Any = np, device: Any = None) -> None:
        """Take the numbers of a robot.

        Args:
            description: The robot.
            xp: ``numpy``, or ``torch`` with a device for many robots at once.
            device: Of the tensors.
        """
        model = rigid_body_model(description)[0]
        joints = [model.getJointId(name) for name in JOINTS[: 2 * LEG]]
        inertias = [model.inertias[j] for j in joints]
        dofs = [model.joints[j].idx_v for j in joints]
        self._xp = xp

        def kept(values: Any) -> Any:
            values = np.asarray(values, dtype=np.float64)
            return values if xp is np else xp.as_tensor(values, dtype=xp.float32, device=device)

        def of_legs(values: Any) -> Any:
            values = np.asarray(values)
            return kept(values.reshape(2, LEG, *values.shape[1:]))

        self._place = of_legs([model.jointPlacements[j].translation for j in joints])
        """Joint -> next joint, (2, 3, 3) [m]."""
        self._mass = of_legs([body.mass for body in inertias])
        self._lever = of_legs([body.lever for body in inertias])
        self._inertia = of_legs([body.inertia for body in inertias])
        self._armature = kept(model.armature[dofs])
        self._damping = kept(model.damping[dofs])
        self._dry = kept(model.upperDryFrictionLimit[dofs])

    def of(self, q: Any, dq: Any, ddq: Any, quat_WB: Any) -> Any:
        """Return torques (..., 6) [N m].

        Args:
            q: Joint positions of the front legs (..., 6) [rad].
            dq: Their velocities (..., 6) [rad/s].
            ddq: Their accelerations (..., 6) [rad/s^2].
            quat_WB: Orientation of the base (..., 4), wxyz.
        """
        xp = self._xp
        down, _ = world_axes_in_base(*(quat_WB[..., i] for i in range(4)))
        upward = -GRAVITY * xp.stack([*down], -1)[..., None, :]  # a base that stands still is held against gravity
        a, b, c = (value.reshape(*value.shape[:-1], 2, LEG) for value in (q, dq, ddq))
        torque = self._held(a, b, c, upward)
        torque = torque.reshape(*torque.shape[:-2], 2 * LEG)
        rubs = self._damping * dq + self._dry * dq / (abs(dq) + FRICTION_SPEED)
        return torque + self._armature * ddq + rubs

    def _held(self, q: Any, dq: Any, ddq: Any, upward: Any) -> Any:
        """Return the torques (..., 2, 3) that move the links and carry their weight."""
        xp = self._xp
        turns = self._turns(q)
        axes = [turns[0][..., :, 0], turns[1][..., :, 1], turns[2][..., :, 1]]
        spin = xp.zeros_like(axes[0])
        twist = xp.zeros_like(axes[0])
        move = upward + spin
        place = xp.zeros_like(axes[0])
        places = []
        centres = []
        forces = []
        moments = []
        for k, axis in enumerate(axes):
            if k:
                arm = _times(turns[k - 1], self._place[:, k])
                move = move + _carried(arm, spin, twist)
                place = place + arm
            rate = dq[..., k, None]
            twist = twist + axis * ddq[..., k, None] + rate * cross(spin, axis)
            spin = spin + rate * axis
            lever = _times(turns[k], self._lever[:, k])
            inertia = turns[k] @ self._inertia[:, k] @ xp.swapaxes(turns[k], -1, -2)
            momentum = _times(inertia, spin)
            places.append(place)
            centres.append(place + lever)
            forces.append(self._mass[:, k, None] * (move + _carried(lever, spin, twist)))
            moments.append(_times(inertia, twist) + cross(spin, momentum))
        torques = []
        for k, axis in enumerate(axes):
            moment = sum(moments[i] + cross(centres[i] - places[k], forces[i]) for i in range(k, LEG))
            torques.append((axis * moment).sum(-1))
        return xp.stack(torques, -1)

    def _turns(self, q: Any) -> list[Any]:
        """Return the axes of each link in base axes, three of (..., 2, 3, 3)."""
        xp = self._xp
        zero = xp.zeros_like(q[..., 0])
        one = xp.ones_like(q[..., 0])
        c = xp.cos(q[..., 0])
        s = xp.sin(q[..., 0])
        abad = _matrix([one, zero, zero, zero, c, -s, zero, s, c], xp)
        turns = [abad]
        for angle in (q[..., 1], q[..., 1] + q[..., 2]):
            c = xp.cos(angle)
            s = xp.sin(angle)
            turns.append(abad @ _matrix([c, zero, s, zero, one, zero, -s, zero, c], xp))
        return turns


def _matrix(entries: list[Any], xp: Any) -> Any:
    flat = xp.stack(entries, -1)
    return flat.reshape(*flat.shape[:-1], 3, 3)


def _times(matrix: Any, vector: Any) -> Any:
    return (matrix * vector[..., None, :]).sum(-1)


def _carried(arm: Any, spin: Any, twist: Any) -> Any:
    """Return the acceleration that turning gives to a point at the end of an arm."""
    return cross(twist, arm) + cross(spin, cross(spin, arm))


def cross(a: Any, b: Any) -> Any:
    """Return a x b (..., 3); of a few vectors, NumPy's own takes six times as long."""
    if not isinstance(a, np.ndarray):
        return a.cross(b, dim=-1)
    return a.take(NEXT, -1) * b.take(LAST, -1) - a.take(LAST, -1) * b.take(NEXT, -1)
