"""The trunk lowered and leant while a network balances: what the network is shown, and what is added to its answer.

See mimic.robot.trunk. A command acts some control steps after it is sent; what is taken from the readings is the change
that acts now.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from mimic.geometry import without_pitch, without_pitch_rate
from mimic.policy.contract import FRONT
from mimic.records import FloatArray, JointCommand, RobotState
from mimic.robot.description import RobotDescription
from mimic.robot.trunk import TrunkPose, TrunkPoses

NOTHING = (0.0, 0.0)
"""Height [m] and pitch [rad] of a robot that stands by itself."""


class Trunk:
    """The trunk of a robot over a run, one control step after another."""

    def __init__(self, description: RobotDescription) -> None:
        """Begin as the robot stands by itself."""
        self._dt = description.dt
        self._numbers = description.trunk_numbers
        self._kept = round((description.delay + description.dt) / description.dt) + 2
        """Commands between the newest and the one before that which acts now, both included."""
        self._poses = None if self._numbers is None else TrunkPoses(description)
        self._asked: deque[tuple[float, float]] = deque([NOTHING] * 2)
        """Height and pitch of the newest commands, newest first."""

    @property
    def moves(self) -> bool:
        """Whether anything differs from how the robot stands by itself."""
        return self._poses is not None and any(asked != NOTHING for asked in self._asked)

    @property
    def now(self) -> tuple[float, float]:
        """Height [m] and pitch [rad] of the newest command."""
        return self._asked[0]

    def advance(self, height: float, pitch: float, lean: float = 0.0) -> int:
        """Let one control step pass, on the way to a height [m] and a pitch [rad], within range and speed of the robot.

        Args:
            height: Of the hind hips, as asked [m].
            pitch: Of the trunk, as asked [rad].
            lean: Added to the pitch as far as its range allows [rad].

        Returns:
            How many of the two that are asked were beyond the range.
        """
        numbers = self._numbers
        wanted = np.array([height, pitch])
        if numbers is None:
            return int(np.count_nonzero(wanted))
        low = np.array([numbers.height[0], numbers.pitch[0]])
        high = np.array([numbers.height[1], numbers.pitch[1]])
        inside = np.clip(wanted, low, high)
        most = self._dt * np.array([numbers.height_speed, numbers.pitch_speed])
        before = np.array(self._asked[0])
        goal = np.clip(inside + [0.0, lean], low, high)
        newest = before + np.clip(goal - before, -most, most)
        self._asked.appendleft((float(newest[0]), float(newest[1])))
        while len(self._asked) > self._kept:
            self._asked.pop()
        return int(np.count_nonzero(inside != wanted))

    def seen(self, state: RobotState) -> RobotState:
        """Return a state as it would be if the robot stood by itself."""
        if not self.moves:
            return state
        acting = self._pose(-2)
        before = self._pose(-1)
        _, pitch = self._asked[-2]
        _, pitch_before = self._asked[-1]
        q = state.q - _all_joints(acting.joints)
        dq = state.dq - _all_joints((acting.joints - before.joints) / self._dt)
        rate = (pitch - pitch_before) / self._dt
        return replace(
            state,
            q=q,
            dq=dq,
            quat_WB=without_pitch(state.quat_WB, pitch, np),
            omega_B=without_pitch_rate(state.omega_B, pitch, rate, np),
        )

    def added(self, command: JointCommand) -> JointCommand:
        """Return a command for the hind legs of a robot that stands by itself, with the newest change."""
        if not self.moves:
            return command
        newest = self._pose(0)
        rate = (newest.joints - self._pose(1).joints) / self._dt
        return replace(
            command,
            q_des=command.q_des + _all_joints(newest.joints),
            dq_des=command.dq_des + _all_joints(rate),
            tau_ff=command.tau_ff + _all_joints(newest.torque),
        )

    def _pose(self, age: int) -> TrunkPose:
        assert self._poses is not None
        return self._poses.of(*self._asked[age])


def _all_joints(hind: FloatArray) -> FloatArray:
    return np.concatenate([np.zeros(FRONT), hind])
