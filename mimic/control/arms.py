"""The front legs as arms: inverse kinematics with feed-forward.

A motor gives ``tau = tau_ff + kp (q_des - q) + kd (dq_des - dq)``. It follows a goal without lag where the command is
the goal that is wanted when it acts, ``ahead`` after it is sent:

    q_des = q(t + ahead)      dq_des = dq(t + ahead)      tau_ff = M ddq + g + friction (mimic.robot.arm_torques)

which is ``q_des = q + (kd dq + tau) / kp`` for a motor that takes positions only. The network moves the hind legs.

Source: Murray, Li, Sastry, "A Mathematical Introduction to Robotic Manipulation", 1994, section 4.5 (augmented PD).
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from mimic.frozen import frozen_arrays
from mimic.geometry import smoothstep
from mimic.policy.contract import AHEAD, FRONT, PolicyContract, arm_reference, lead_time
from mimic.records import FloatArray
from mimic.robot.description import RobotDescription
from mimic.robot.reach import Reach


@frozen_arrays
class ArmGoal:
    """Where the front legs should be when a command acts."""

    q: FloatArray
    """Positions (6,) [rad]."""
    dq: FloatArray
    """Velocities (6,) [rad/s]."""
    ddq: FloatArray
    """Accelerations (6,) [rad/s^2]."""
    seen: FloatArray
    """What a policy is told of them: `arm_reference` (49,)."""


def arm_joints(p_BE: FloatArray, reach: Reach, before: FloatArray) -> tuple[FloatArray, int]:
    """Return joints (T, 6) [rad] that bring the front toes to p_BE (T, 2, 3) [m], and how many rows are out of reach.

    Of two postures of a leg the one nearer to the row before is taken, or it would jump. A row out of reach gets the
    joints of the closest point within reach; one that is not a number keeps those of the row before, and the control
    loop damps the robot when it gets there.

    Args:
        p_BE: Base -> front toe, base axes [m].
        reach: The robot.
        before: Joints (6,) of the row before the first [rad].
    """
    p_BE = np.asarray(p_BE, dtype=np.float64)
    joints = np.empty((len(p_BE), FRONT))
    far = 0
    for row, toes in enumerate(p_BE):
        q = reach.inverse(toes, before)
        if np.isnan(q).any():
            far += 1
            q = reach.closest(toes, before).q if np.isfinite(toes).all() else before
        joints[row] = before = q
    return joints, far


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
        self._default_q = np.array(contract.default_q[:FRONT])
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
        t = row * self._dt + np.array([self._ahead, *AHEAD])
        moves = (t < last)[:, None]
        at = np.minimum(t, last)
        q = self._path(at)
        dq = self._path(at, 1) * moves
        ddq = self._path(at, 2) * moves
        seen = arm_reference(q[1:], dq[1:], np.ones(()), self._default_q, np)
        return ArmGoal(q=q[0], dq=dq[0], ddq=ddq[0], seen=seen)

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
        self._before: FloatArray = np.zeros(FRONT)
        self._default_q = np.array(contract.default_q[:FRONT])

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
        times = (len(AHEAD), 1)
        seen = arm_reference(np.tile(now, times), np.tile(dq, times), np.zeros(()), self._default_q, np)
        return ArmGoal(q=now + self._ahead * dq, dq=dq, ddq=np.zeros(FRONT), seen=seen)
