"""A pull on a front toe: how it is felt, and how a network that balances by the IMU stands against it.

A network that has learnt to stand upright takes a robot that leans against a pull for one that falls. It is shown the
orientation seen from the line along which gravity and the pull act together, so that it leans by itself. Where the pull
would turn a robot on a single foot, it is shown a heading that lets it turn into the pull, or against its moment.
Against a pull from behind the trunk is leant, too (mimic/robot/trunk.py).

Written once for NumPy and PyTorch: a robot is shown in training what it is shown in a run.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from mimic.geometry import heading_from_quat, turned_by
from mimic.records import FloatArray, RobotState
from mimic.robot.arm_torques import ArmTorques
from mimic.robot.description import RobotDescription
from mimic.robot.model import TOES
from mimic.robot.rigid_body import rigid_body_model

FRONT = 6
"""Joints of the front legs."""

STRETCHED = 0.02
"""Damping of the estimate [m]: a stretched leg says nothing about a force along it."""

MOVING = 0.5
"""… and for each N m that the motion of a joint takes [m/N m]: a robot that boxes then feels 1.5 N (95 %), else 12."""

SMOOTHING = 0.1
"""Time constant of what is felt [s]."""

BEGINS = 0.5
"""The front legs are driven for so long before a pull counts [s]: before, they may touch the ground."""

LEAST = 0.017
"""Pulls below this share of the robot's weight do not count …"""

FULL = 0.03
"""… and from this one on fully."""

MOST_LEAN = 0.17
"""Largest angle by which the robot leans [rad]."""

TURN_TO = 10.0
"""Turn toward a pull from the side, for a pull as large as the weight [rad]."""

TURN_AGAINST = 7.0
"""Turn against the moment of a pull from behind, for a moment of the weight times the height of its centre [rad]."""

MOST_TURN = 1.0
"""Largest turn [rad]."""

LEAN_FORWARD = 2.0
"""Lean of the trunk against a pull from behind, for a pull as large as the weight [rad]. The hind knees are almost
straight, so that a foot does not get far back; leant by 10 degrees, 23 of 24 robots withstand 7.5 N, upright 12."""


class PullBalance:
    """What a network is shown of a robot that is pulled."""

    def __init__(self, description: RobotDescription) -> None:
        model, _ = rigid_body_model(description)
        data = model.createData()
        q = pin.neutral(model)
        q[7:] = description.poses["upright"]
        self.weight = float(pin.computeTotalMass(model)) * float(np.linalg.norm(model.gravity.linear))
        """Of the robot [N]."""
        self.height = description.pose_height["upright"] + float(pin.centerOfMass(model, data, q)[0])
        """Of its centre of mass above the ground [m]."""

    def turn(self, force: Any, toes: Any, heading: Any, xp: Any) -> Any:
        """Return the rotation vector (..., 3), world axes [rad], from the orientation of a robot to the one shown.

        Args:
            force: On the left and the right front toe (..., 2, 3), world axes [N].
            toes: Middle of the hind toes -> front toes (..., 2, 3), world axes [m].
            heading: Of the robot (...,) [rad].
            xp: ``numpy`` or ``torch``.
        """
        pull, size, counts = self._felt(force, xp)
        lean = (force[..., :2] * toes[..., 2:]).sum(-2) / (self.weight * self.height)
        angle = xp.hypot(lean[..., 0], lean[..., 1])
        lean = lean * (counts * xp.clip(MOST_LEAN / (angle + 1e-9), 0.0, 1.0))[..., None]
        moment = (toes[..., 0] * force[..., 1] - toes[..., 1] * force[..., 0]).sum(-1) / (self.weight * self.height)
        ahead = self._ahead(pull, heading, xp)
        left = pull[..., 1] * xp.cos(heading) - pull[..., 0] * xp.sin(heading)
        behind = xp.clip(-ahead / (size + 1e-9), 0.0, 1.0)
        turn = (1.0 - behind) * TURN_TO * left - behind * TURN_AGAINST * moment
        turn = counts * xp.clip(turn, -MOST_TURN, MOST_TURN)
        return xp.stack([-lean[..., 1], lean[..., 0], -turn], -1)

    def lean(self, force: FloatArray, heading: float) -> float:
        """Return how far the trunk is to lean to its belly against a pull from behind [rad].

        Args:
            force: On the left and the right front toe (2, 3), world axes [N].
            heading: Of the robot [rad].
        """
        pull, _, counts = self._felt(force, np)
        return LEAN_FORWARD * float(counts * max(-self._ahead(pull, heading, np), 0.0))

    def _felt(self, force: Any, xp: Any) -> tuple[Any, Any, Any]:
        """Return the pull (..., 3) and its size, both as shares of the weight, and how far it counts, 0 to 1."""
        pull = force.sum(-2) / self.weight
        size = xp.hypot(pull[..., 0], pull[..., 1])
        return pull, size, xp.clip((size - LEAST) / (FULL - LEAST), 0.0, 1.0)

    @staticmethod
    def _ahead(pull: Any, heading: Any, xp: Any) -> Any:
        return pull[..., 0] * xp.cos(heading) + pull[..., 1] * xp.sin(heading)


class PullEstimator:
    """The force on each front toe, from the torques of its leg beyond what holds up and moves it."""

    def __init__(self, description: RobotDescription) -> None:
        self._model, _ = rigid_body_model(description)
        self._data = self._model.createData()
        self._frames = [self._model.getFrameId(name) for name in TOES]
        self._torques = ArmTorques(description)
        self._dt = description.dt
        self._excess = np.zeros(FRONT)
        self._motion = np.zeros(FRONT)
        self._dq: FloatArray | None = None
        self.toes = np.zeros((2, 3))
        """Middle of the hind toes -> front toes (2, 3), world axes [m], in the last state."""

    def force(self, state: RobotState) -> FloatArray:
        """Return the force on the left and the right front toe (2, 3), world axes [N], as if the robot were at rest."""
        return self._forces(state, self._at_rest(state) - state.tau[:FRONT], np.zeros(FRONT))

    def smoothed(self, state: RobotState) -> FloatArray:
        """Return the same for the states of one control step after another, smoothed, of a robot that moves."""
        dq = state.dq[:FRONT]
        ddq = np.zeros(FRONT) if self._dq is None else (dq - self._dq) / self._dt
        self._dq = dq
        needed = self._torques.of(state.q[:FRONT], dq, ddq, state.quat_WB)
        motion = np.abs(needed - self._at_rest(state))
        share = self._dt / (SMOOTHING + self._dt)
        excess = needed - state.tau[:FRONT]
        self._excess += share * np.nan_to_num(excess - self._excess)  # without an answer it stays as it was
        self._motion += share * (motion - self._motion)
        return self._forces(state, self._excess, self._motion)

    def _at_rest(self, state: RobotState) -> FloatArray:
        still = np.zeros(FRONT)
        return self._torques.of(state.q[:FRONT], still, still, state.quat_WB)

    def _forces(self, state: RobotState, excess: FloatArray, motion: FloatArray) -> FloatArray:
        """Return the forces (2, 3) that explain torques (6,) [N m], the less so the more torque the motion takes."""
        w, x, y, z = state.quat_WB
        pin.computeJointJacobians(self._model, self._data, np.concatenate([np.zeros(3), [x, y, z, w], state.q]))
        pin.updateFramePlacements(self._model, self._data)
        places = np.array([self._data.oMf[frame].translation for frame in self._frames])
        self.toes = places[:2] - places[2:].mean(axis=0)
        damping = STRETCHED + MOVING * motion
        forces = np.zeros((2, 3))
        for side, frame in enumerate(self._frames[:2]):
            jacobian = pin.getFrameJacobian(self._model, self._data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            own = slice(3 * side, 3 * side + 3)
            leg = jacobian[:3, 6:][:, own]
            forces[side] = leg @ np.linalg.solve(leg.T @ leg + np.diag(damping[own] ** 2), excess[own])
        return forces


class StandsAgainstPull:
    """Leans the trunk against pulls, and shows a network what it needs to stand, one control step after another."""

    def __init__(self, description: RobotDescription) -> None:
        self._estimator = PullEstimator(description)
        self._balance = PullBalance(description)
        self._waits = round(BEGINS / description.dt)
        self.lean = 0.0
        """Of the trunk to its belly against what pulls now [rad], besides what is asked of it."""

    def shown(self, state: RobotState) -> FloatArray:
        """Return the orientation (4,), wxyz, to show, for the newest state of a robot whose front legs are driven."""
        force = self._estimator.smoothed(state)
        if self._waits > 0:
            self._waits -= 1
            return state.quat_WB
        heading = heading_from_quat(state.quat_WB)
        self.lean = self._balance.lean(force, float(heading))
        return turned_by(state.quat_WB, self._balance.turn(force, self._estimator.toes, heading, np), np)
