"""Disturbances of a simulated robot: slope, pull, payload, sensor noise, dropped commands."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from mimic.config.play import Disturbance
from mimic.geometry import heading_from_quat
from mimic.records import LEGS, SIDES, FloatArray, RobotState
from mimic.robot.model import TOES


def _quat_about(axis: FloatArray, angle: float) -> FloatArray:
    quat = np.zeros(4)
    mujoco.mju_axisAngle2Quat(quat, axis / np.linalg.norm(axis), angle)
    return quat


def _multiply(one: FloatArray, other: FloatArray) -> FloatArray:
    product = np.zeros(4)
    mujoco.mju_mulQuat(product, one, other)
    return product


class Disturber:
    """Applies one disturbance to one simulated robot; its directions and noise are those of its seed."""

    def __init__(self, disturbance: Disturbance, model: mujoco.MjModel, seed: int) -> None:
        """Draw the directions and tilt the floor of ``model``.

        Args:
            disturbance: Kind and size of each disturbance.
            model: Of the robot on its floor.
            seed: Of the directions and the noise; independent of the robot's variation for the same seed.
        """
        self._disturbance = disturbance
        self._model = model
        self._rng = rng = np.random.default_rng([seed, 7])
        slope, drag = rng.uniform(-np.pi, np.pi, 2)
        mount = rng.normal(size=3)
        self._site = model.site(TOES[SIDES.index(disturbance.toe)]).id
        self._body = model.site_bodyid[self._site]
        self._force = disturbance.drag * np.array([np.cos(drag), np.sin(drag), 0.0])
        turns = {"left": 0.5, "right": -0.5, "forward": 0.0, "backward": 1.0, "sideways": 0.5 if drag > 0 else -0.5}
        self._turn = np.pi * turns.get(disturbance.drag_way, 0.0)
        self._begun = False
        self.slope_quat = _quat_about(np.array([np.cos(slope), np.sin(slope), 0.0]), np.deg2rad(disturbance.slope))
        """Rotation from level to inclined ground, wxyz."""
        if disturbance.imu_axis == "pitch":
            mount = np.array([0.0, np.sign(mount[1]), 0.0])
        self._mount = _quat_about(mount, np.deg2rad(disturbance.imu_tilt))
        floor = model.geom("floor").id
        model.geom_quat[floor] = self.slope_quat
        model.geom_sameframe[floor] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE  # or its quaternion would not be read

    def place(self, qpos: FloatArray) -> None:
        """Put a robot that lies on level ground onto the inclined one; changes qpos in place."""
        if self._disturbance.slope:
            position = np.zeros(3)
            mujoco.mju_rotVecQuat(position, qpos[:3].copy(), self.slope_quat)
            qpos[:3] = position
            qpos[3:7] = _multiply(self.slope_quat, qpos[3:7].copy())

    def command_dropped(self) -> bool:
        """Return whether the command of this control step is dropped."""
        return self._disturbance.lost_share > 0 and bool(self._rng.uniform() < self._disturbance.lost_share)

    def pull(self, data: mujoco.MjData) -> None:
        """Drag the toe during one physics step, or let go of it."""
        if not self._disturbance.drag:
            return
        data.qfrc_applied[:] = 0.0
        d = self._disturbance
        since = data.time - self._disturbance.drag_from
        if 0.0 <= since < d.drag_seconds:
            if d.drag_way != "any" and not self._begun:
                way = float(heading_from_quat(data.qpos[3:7])) + self._turn
                self._force = d.drag * np.array([np.cos(way), np.sin(way), 0.0])
            self._begun = True
            force = self._force * (min(since / d.drag_ramp, 1.0) if d.drag_ramp else 1.0)
            point = data.site_xpos[self._site]
            none = np.zeros(3)
            mujoco.mj_applyFT(self._model, data, force, none, point, self._body, data.qfrc_applied)

    def push_angle(self, angle: float, heading: float) -> float:
        """Return the world direction of a push [rad], from one that is drawn within pi and the robot's heading."""
        if self._disturbance.push_way == "any":
            return angle
        sideways = self._disturbance.push_way == "sideways"
        return heading + (np.pi / 2 if sideways else 0.0) + (np.pi if angle > 0 else 0.0)

    def sensed(self, state: RobotState) -> RobotState:
        """Return the state as the robot's sensors show it."""
        d = self._disturbance
        quat = state.quat_WB
        q = state.q
        omega = state.omega_B
        dq = state.dq
        if d.imu_tilt:
            quat = _multiply(quat, self._mount)
            turned = np.zeros(3)
            mujoco.mju_rotVecQuat(turned, omega, self._mount * [1, -1, -1, -1])
            omega = turned
        if d.noise_imu:
            turn = self._rng.uniform(-d.noise_imu, d.noise_imu, 3)
            quat = _multiply(quat, _quat_about(turn, float(np.linalg.norm(turn))))
        if d.noise_q:
            q = q + self._rng.uniform(-d.noise_q, d.noise_q, len(q))
        if d.noise_gyro:
            omega = omega + self._rng.uniform(-d.noise_gyro, d.noise_gyro, 3)
        if d.noise_dq:
            dq = dq + self._rng.uniform(-d.noise_dq, d.noise_dq, len(dq))
        return replace(state, q=q, dq=dq, quat_WB=quat, omega_B=omega)


def payloads(disturbance: Disturbance) -> dict[str, float]:
    """Return the mass that each leg's toe carries [kg]."""
    carried = {LEGS[SIDES.index(disturbance.toe)]: disturbance.toe_payload}
    return carried if disturbance.toe_payload else {}
