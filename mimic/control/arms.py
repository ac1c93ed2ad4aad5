"""The front legs as arms: inverse kinematics with feed-forward.

A motor gives ``tau = tau_ff + kp (q_des - q) + kd (dq_des - dq)``. It follows a goal without lag where the command is
the goal that is wanted when it acts, ``ahead`` after it is sent:

    q_des = q(t + ahead)      dq_des = dq(t + ahead)      tau_ff = M ddq + g + friction, by Pinocchio's RNEA

which is ``q_des = q + (kd dq + tau) / kp`` for a motor that takes positions only. The network moves the hind legs.

Source: Murray, Li, Sastry, "A Mathematical Introduction to Robotic Manipulation", 1994, section 4.5 (augmented PD).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from mimic.geometry import smoothstep
from mimic.policy.contract import PolicyContract
from mimic.records import FloatArray
from mimic.robot.description import RobotDescription
from mimic.robot.goals import leg_joints
from mimic.robot.reach import Reach
from mimic.robot.rigid_body import rigid_body_model

FRONT = 6
"""Joints of the front legs: the first six."""

FRICTION_SPEED = 0.1
"""Joint speed at which half of the dry friction is asked for [rad/s], as in training (MdpSettings.friction_speed)."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ArmGoal:
    """Where the front legs should be when a command acts."""

    q: FloatArray
    """Positions (6,) [rad]."""
    dq: FloatArray
    """Velocities (6,) [rad/s]."""
    ddq: FloatArray
    """Accelerations (6,) [rad/s^2]."""


def lead_time(contract: PolicyContract) -> float:
    """Return the time from sending a command to when the joints should be where it says [s]."""
    in_effect = contract.dt if contract.interpolate else 0.5 * contract.dt
    return contract.delay + in_effect


def arm_joints(p_BE: FloatArray, reach: Reach, before: FloatArray) -> tuple[FloatArray, int]:
    """Return joints (T, 6) [rad] that bring the front toes to p_BE (T, 2, 3) [m], and how many rows are out of reach.

    Such a row gets the joints of the closest point within reach.

    Args:
        p_BE: Base -> front toe, base axes [m].
        reach: The robot.
        before: Joints (6,) of the row before the first [rad].
    """
    q, excess = leg_joints(np.asarray(p_BE, dtype=np.float64), reach.description)
    joints = q.reshape(-1, FRONT)
    far = np.flatnonzero(excess.any(axis=-1))
    for row in far:
        start = joints[row - 1] if row else before
        joints[row] = reach.closest(p_BE[row], start).q
    return joints, len(far)


class StoredArms:
    """Front legs whose motion is known to its end: blended from where they are, then goal after goal."""

    def __init__(self, p_BE: FloatArray, blend: int, contract: PolicyContract, description: RobotDescription) -> None:
        """Prepare a motion.

        Args:
            p_BE: Base -> front toe at each control step (T, 2, 3), base axes [m].
            blend: Control steps from the measured joints to the first goal.
            contract: Of the policy; it has the control step and the delay.
            description: The robot.
        """
        self._dt = contract.dt
        self._ahead = lead_time(contract)
        self._reach = Reach(description)
        upright = description.poses["upright"][:FRONT]
        self._goals, self.out_of_reach = arm_joints(p_BE, self._reach, upright)
        """Joints at each control step (T, 6) [rad], and how many of them had to be moved into reach."""
        self._blend = blend
        self._path: CubicSpline | None = None

    def at(self, row: int, q: FloatArray) -> ArmGoal:
        """Return the goal of a control step.

        Args:
            row: Counted from the first goal; negative while blending.
            q: Measured joints (12,) [rad]; those of the first call are where the blend begins.
        """
        if self._path is None:
            self._path = self._spline(q[:FRONT])
        last = float(self._path.x[-1])
        t = row * self._dt + self._ahead
        moves = t < last
        at = min(t, last)
        zeros = np.zeros(FRONT)
        return ArmGoal(
            q=self._path(at),
            dq=self._path(at, 1) if moves else zeros,
            ddq=self._path(at, 2) if moves else zeros,
        )

    def _spline(self, begin: FloatArray) -> CubicSpline:
        rows = np.concatenate([blended(begin, self._goals[0], self._blend, self._reach), self._goals])
        t = self._dt * (np.arange(len(rows)) - self._blend)
        held = t[-1] + self._dt  # at rest at the end
        return CubicSpline([*t, held], np.concatenate([rows, rows[-1:]]), bc_type="clamped")


def blended(begin: FloatArray, end: FloatArray, count: int, reach: Reach) -> FloatArray:
    """Return joints (count, 6) on the way from one pose to another (6,) [rad], clear of the body and of each other.

    A row in which shapes would come too close is moved to the closest one that is clear.
    """
    share = smoothstep(np.arange(count)[:, None] / count)
    rows = begin + share * (end - begin)
    for row in rows[1:]:
        if not reach.is_clear(row):
            row[:] = reach.closest(reach.toes(row), row).q
    return rows


class LiveArms:
    """Front legs that follow toes whose future is not known: velocities are differences, and goals are extrapolated."""

    def __init__(self, blend: int, contract: PolicyContract, description: RobotDescription) -> None:
        """Prepare to follow.

        Args:
            blend: Control steps from the measured joints to the toes that are asked for.
            contract: Of the policy; it has the control step and the delay.
            description: The robot.
        """
        self._dt = contract.dt
        self._ahead = lead_time(contract)
        self._blend = blend
        self._reach = Reach(description)
        self._begin: FloatArray | None = None
        self._before = np.zeros(FRONT)

    def at(self, row: int, q: FloatArray, p_BE: FloatArray) -> ArmGoal:
        """Return the goal of a control step.

        Args:
            row: Counted from the end of the blend; negative while blending.
            q: Measured joints (12,) [rad]; those of the first call are where the blend begins.
            p_BE: Base -> front toe that is asked for now (2, 3), base axes [m].
        """
        if self._begin is None:
            self._begin = q[:FRONT].copy()
            self._before = self._begin
        (wanted,), _ = arm_joints(p_BE[None], self._reach, self._before)
        share = smoothstep(min((row + 1 + self._blend) / self._blend, 1.0))
        now = self._begin + share * (wanted - self._begin)
        dq = (now - self._before) / self._dt
        self._before = now
        return ArmGoal(q=now + self._ahead * dq, dq=dq, ddq=np.zeros(FRONT))


class ArmTorques:
    """Torques that front legs need for a motion, with the base at rest."""

    def __init__(self, description: RobotDescription) -> None:
        self._model = _model(description)
        self._data = self._model.createData()

    def of(self, goal: ArmGoal, q: FloatArray, quat_WB: FloatArray) -> FloatArray:
        """Return torques (6,) [N m]: gravity, inertia, and the friction of the joints.

        Args:
            goal: Motion of the front legs.
            q: Measured joints (12,) [rad].
            quat_WB: Orientation of the base (4,), wxyz.
        """
        w, x, y, z = quat_WB
        position = np.concatenate([np.zeros(3), [x, y, z, w], goal.q, q[FRONT:]])
        velocity = np.zeros(self._model.nv)
        velocity[6 : 6 + FRONT] = goal.dq
        acceleration = np.zeros(self._model.nv)
        acceleration[6 : 6 + FRONT] = goal.ddq
        torque = pin.rnea(self._model, self._data, position, velocity, acceleration)[6 : 6 + FRONT]
        dry = self._model.upperDryFrictionLimit[6 : 6 + FRONT]
        viscous = self._model.damping[6 : 6 + FRONT]
        return torque + viscous * goal.dq + dry * goal.dq / (np.abs(goal.dq) + FRICTION_SPEED)


@cache
def _model(description: RobotDescription) -> pin.Model:
    return rigid_body_model(description)[0]
