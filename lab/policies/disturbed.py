"""A simulated robot that is disturbed besides its variation: slope, pull, payload, sensor noise, dropped commands; and
other solvers of its physics.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import mujoco
import numpy as np

from mimic.config.ranges import Limited, within
from mimic.evaluation.episode import OF_EPISODES, Job
from mimic.geometry import heading_from_quat
from mimic.records import LEGS, SIDES, FloatArray, RobotState
from mimic.robot.description import RobotDescription
from mimic.robot.model import TOES
from mimic.simulation.plant import SimulatedPlant, plant_options


@dataclass(frozen=True, kw_only=True, slots=True)
class Disturbance(Limited):
    """Disturbances of a simulated robot besides its variation; none by default."""

    toe: Literal["left", "right"] = "left"
    """Front toe that carries and is dragged."""
    toe_payload: float = within(0.0, 0.0, 5.0, "kg")
    """Mass at that toe [kg]."""
    drag: float = within(0.0, 0.0, 100.0, "N")
    """Horizontal force on that toe [N]."""
    drag_way: Literal["any", "sideways", "forward", "backward", "left", "right"] = "any"
    """Its direction: drawn for each start, or as the belly faces when it begins; sideways is left or right."""
    drag_ramp: float = within(0.0, 0.0, 60.0, "s")
    """Time in which it grows to that [s]."""
    drag_from: float = 4.0
    """When the force begins [s]."""
    drag_seconds: float = 3.0
    """How long it lasts [s]."""
    push_way: Literal["any", "fore-aft", "sideways"] = "any"
    """Direction of pushes (Randomisation.push): drawn, or seen from where the belly faces."""
    slope: float = within(0.0, 0.0, 30.0, "deg")
    """Inclination of the ground, falling in a direction drawn for each start [deg]."""
    imu_tilt: float = within(0.0, 0.0, 30.0, "deg")
    """Mounting error of the IMU [deg]."""
    imu_axis: Literal["any", "pitch"] = "any"
    """Its axis: drawn for each start, or the base's y axis, either way around."""
    noise_q: float = within(0.0, 0.0, 1.0, "rad")
    """Half width of the noise on measured joint positions, drawn at each control step [rad]."""
    noise_imu: float = within(0.0, 0.0, 1.0, "rad")
    """Half width of the noise on the measured orientation about each axis, drawn at each control step [rad]."""
    noise_gyro: float = within(0.0, 0.0, 10.0, "rad/s")
    """… on the measured angular velocity [rad/s]."""
    noise_dq: float = within(0.0, 0.0, 10.0, "rad/s")
    """… on measured joint velocities [rad/s]."""
    lost_share: float = within(0.0, 0.0, 1.0)
    """Probability that a command is dropped; the one before stays in effect."""


NO_DISTURBANCE = Disturbance()
"""No disturbance."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Solver(Limited):
    """Integration of the physics; the defaults are those of the robot description."""

    timestep: float = within(0.0025, 1e-4, 0.02, "s")
    """Physics step [s]; the control step must be a multiple of it."""
    integrator: Literal["implicitfast", "implicit", "Euler"] = "implicitfast"
    cone: Literal["elliptic", "pyramidal"] = "elliptic"
    """Shape of the friction cones."""
    impratio: float = within(100.0, 0.1, 100.0)
    """How much stiffer contacts are against sliding than against sinking; at 1, MuJoCo's default, a loaded foot creeps.
    MuJoCo Menagerie's models of legged robots have 100."""


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
        """Drag the toe during one physics step; forces add up."""
        if not self._disturbance.drag:
            return
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


class DisturbedPlant(SimulatedPlant):
    """A `SimulatedPlant` with a disturbance, and another solver."""

    def __init__(
        self,
        description: RobotDescription,
        *,
        disturbance: Disturbance = NO_DISTURBANCE,
        solver: Solver | None = None,
        **options: Any,
    ) -> None:
        """Make a robot; further options are those of a `SimulatedPlant`."""
        self._disturbance = disturbance
        if solver is not None:
            options["timestep"] = solver.timestep
        super().__init__(description, payloads=payloads(disturbance), **options)
        if solver is not None:
            option = self.model.opt
            option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{solver.integrator.upper()}")
            option.cone = getattr(mujoco.mjtCone, f"mjCONE_{solver.cone.upper()}")
            option.impratio = solver.impratio

    def restart(self, seed: int) -> None:
        """Draw another robot from the same ranges."""
        super().restart(seed)
        self.disturber = Disturber(self._disturbance, self.model, seed)

    def _place(self, qpos: FloatArray) -> None:
        self.disturber.place(qpos)

    def _state(self) -> RobotState:
        return self.disturber.sensed(super()._state())

    def _drive(self, substep: int) -> None:
        self.data.qfrc_applied[:] = 0.0
        super()._drive(substep)
        self.disturber.pull(self.data)

    def _push_angle(self) -> float:
        return self.disturber.push_angle(super()._push_angle(), float(heading_from_quat(self.data.qpos[3:7])))

    def _dropped(self) -> bool:
        return self.disturber.command_dropped() or super()._dropped()


@dataclass(frozen=True, kw_only=True)
class DisturbedJob(Job):
    """One episode of a disturbed robot."""

    disturbance: Disturbance = NO_DISTURBANCE

    def plant(self, description: RobotDescription, **options: Any) -> DisturbedPlant:
        """Return the robot, with further options of a `DisturbedPlant`."""
        given: dict[str, Any] = {**OF_EPISODES, **plant_options(self.robot), **options}
        return DisturbedPlant(description, ranges=self.ranges, seed=self.seed, disturbance=self.disturbance, **given)
