"""A plant in MuJoCo."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mimic.config.play import NOMINAL, EffectsSettings, Randomisation
from mimic.dynamics.effect_set import EffectSet
from mimic.dynamics.lying import sink
from mimic.dynamics.machine import hung_robot
from mimic.dynamics.robot_model import (
    GAIN_KD,
    GAIN_KP,
    Variation,
    command_in_effect,
    draw_variation,
    load_model,
    vary_model,
)
from mimic.dynamics.servo import parameters_of, read_standing
from mimic.errors import PlantError
from mimic.records import JOINTS, FloatArray, Health, JointCommand, JointSamples, RobotState, Tick
from mimic.robot.description import RobotDescription, load_description, with_timestep
from mimic.simulation.motors import LawMotors

PhysicsObserver = Callable[[mujoco.MjModel, mujoco.MjData], None]
"""Called after each physics step; must change nothing."""


PUSH_PHASE = 0.25
"""Pushes come this much later at most, at random [s]: a gait of 4 Hz is met at any of its phases."""


def _healthy(step: int) -> Health:
    """Return the health of a simulated robot after a number of control steps: fresh readings, no faults.

    Its motors have no thermometer; the supervisor's thermal model follows their torques.
    """
    motors = len(JOINTS)
    return Health(
        age=np.zeros(motors),
        missed=np.zeros(motors, dtype=np.int64),
        faults=np.zeros(motors, dtype=np.int64),
        running=np.ones(motors, dtype=np.bool_),
        temperature=np.full(motors, np.nan),
        imu_age=0.0,
        imu_unchanged=0.0,
        imu_count=step,
        imu_valid=None,
        compute=0.0,
        late=0.0,
        bus_errors=0,
    )


class SimulatedPlant:
    """The robot in MuJoCo at full solver iterations, one variation of it at a time.

    Repeatable: the same ranges and seed give the same robot, the same pushes and the same motion on one machine.
    """

    def __init__(
        self,
        description: RobotDescription,
        *,
        ranges: Randomisation = NOMINAL,
        seed: int = 0,
        samples: bool = True,
        payloads: Mapping[str, float] | None = None,
        timestep: float | None = None,
        effects: EffectSet | None = None,
        observer: PhysicsObserver | None = None,
        begin: float = 0.0,
    ) -> None:
        """Make a robot.

        Args:
            ranges: What varies; the default is the robot as described.
            seed: Draws the variation, the start and the pushes.
            samples: Also record the joints at each physics step.
            payloads: Mass that the toe of a leg carries [kg].
            timestep: Physics step [s]; by default that of the description, with effects that of EffectsSettings.
            effects: Of a calibration; the drive law with them then replaces the native motors.
            observer: Called after each physics step.
            begin: Time at which it lies without power [s]; pushes and pulls are later than 0.

        Raises:
            ConfigError: If the control step is no multiple of the physics step, or the effects are not of this robot.
        """
        if effects is not None and timestep is None:
            timestep = EffectsSettings().timestep
        self._description = description if timestep is None else with_timestep(description, timestep)
        self._motors = None if effects is None else LawMotors(self._description, effects)
        kind = {"visuals": False, "payloads": payloads, "driven": effects is not None}
        self._nominal = load_model(description, **kind)
        self.model = load_model(description, **kind)
        self.model.opt.timestep = self._description.timestep
        self.data = mujoco.MjData(self.model)
        self._samples = samples
        self._observer = observer
        self._ranges = ranges
        self._begin = begin
        self.restart(seed)

    @property
    def description(self) -> RobotDescription:
        """The robot's numbers."""
        return self._description

    def watch(self, observer: PhysicsObserver) -> None:
        """Call a function after each physics step, instead of any before."""
        self._observer = observer

    def restart(self, seed: int) -> None:
        """Draw another robot from the same ranges."""
        self._rng = np.random.default_rng(seed)
        self._phases = np.random.default_rng([seed, 29])
        self.variation: Variation = draw_variation(self._ranges, self._description.timestep, self._rng)
        vary_model(self.model, self._nominal, self.variation)
        self._base_gains = self.model.actuator_gainprm[:, [GAIN_KP, GAIN_KD]].copy()
        self._gains_kp = self._gains_kd = np.full(12, np.nan)
        if self._motors is not None:
            self._motors.fit(self.model, self.data, self.variation, seed)

    def start(self) -> RobotState:
        """Let the robot sink from its folded legs onto the ground, as without power, and return its state."""
        d = self._description
        v = self.variation
        qpos = np.zeros(19)
        qpos[2] = d.pose_height["lie"] + 0.005 + v.start_height
        qpos[3:7] = np.cos(v.heading / 2), 0.0, 0.0, np.sin(v.heading / 2)
        qpos[7:] = np.clip(d.poses["lie"] + v.start_q, d.q_min + 0.01, d.q_max - 0.01)
        self._place(qpos)
        data = mujoco.MjData(self.model)
        data.qpos[:] = qpos
        sink(self.model, data)
        return self.start_at(data.qpos, data.qvel, t=self._begin)

    def start_at(self, qpos: FloatArray, qvel: FloatArray, *, t: float = 0.0) -> RobotState:
        """Put the robot into a state, with its joints as targets, and return it.

        Args:
            qpos: Base position and orientation, then joints (19,), as in MuJoCo.
            qvel: Base velocity, world axes, and angular velocity, base axes, then joints (18,).
            t: Time of it [s].
        """
        data = self.data
        mujoco.mj_resetData(self.model, data)
        data.qpos[:] = qpos
        data.qvel[:] = qvel
        data.time = t
        if self._motors is None:
            data.ctrl[:] = qpos[7:]
        mujoco.mj_forward(self.model, data)
        reach = -(-self.variation.delay_steps // self._description.decimation)
        self._steps = 0
        self._commands = [qpos[7:].copy()] * max(reach + 2, 3)
        self._ramps = False
        self._next_push = self._ranges.push_interval + self._phases.uniform(0.0, PUSH_PHASE)
        if self._motors is not None:
            self._motors.start(data.qpos[7:], data.qvel[6:])
            self._commands = [self._motors.reading(data.qpos[7:])] * 3
        return self._state()

    def _state(self) -> RobotState:
        data = self.data
        q, tau = self._joints()
        return RobotState(
            t=data.time,
            q=q,
            dq=data.qvel[6:].copy(),
            tau=tau,
            quat_WB=data.qpos[3:7].copy(),
            omega_B=data.qvel[3:6].copy(),
            p_WB=data.qpos[:3].copy(),
            v_WB=data.qvel[:3].copy(),
        )

    def _joints(self) -> tuple[FloatArray, FloatArray]:
        """Return positions as the encoders read them, and torques as the motors give them (12,)."""
        if self._motors is not None:
            return self._motors.reading(self.data.qpos[7:]), self._motors.tau
        return self.data.qpos[7:].copy(), self.data.actuator_force.copy()

    def _drive(self, substep: int) -> None:
        """Set the motors for the next physics step."""
        data = self.data
        if self._motors is not None:
            data.qfrc_applied[6:] = self._motors.drive(substep, data)
            return
        delay = self.variation.delay_steps
        decimation = self._description.decimation
        data.ctrl[:] = command_in_effect(substep, decimation, delay, self._commands, np.where, interpolate=self._ramps)

    def _set_gains(self, command: JointCommand) -> None:
        if not (np.array_equal(command.kp, self._gains_kp) and np.array_equal(command.kd, self._gains_kd)):
            self._gains_kp = command.kp
            self._gains_kd = command.kd
            gains = self.model.actuator_gainprm
            gains[:, GAIN_KP] = self._base_gains[:, 0] * command.kp / self._description.kp
            gains[:, GAIN_KD] = self._base_gains[:, 1] * command.kd / self._description.kd

    def _push(self) -> None:
        if self._ranges.push[1] > 0 and self.data.time >= self._next_push:
            angle = self._push_angle()
            speed = self._rng.uniform(*self._ranges.push)
            self.data.qvel[:2] += speed * np.cos(angle), speed * np.sin(angle)
            self._next_push += self._ranges.push_interval + self._phases.uniform(0.0, PUSH_PHASE)

    def step(self, command: JointCommand) -> Tick:
        """Send a command and let one control step pass.

        Raises:
            PlantError: If the command or the simulation is not finite.
        """
        if not np.isfinite([command.q_des, command.dq_des, command.tau_ff]).all():
            raise PlantError(f"the command holds numbers that are not finite: {command}")
        if command.ramp and not np.isclose(command.ramp, self._description.dt):
            raise PlantError(
                f"this simulated robot interpolates commands over {self._description.dt:g} s; the command asked for "
                f"{command.ramp:g} s"
            )
        self._ramps = command.ramp > 0.0
        zeros = np.zeros(12)
        command = dataclasses.replace(command, q_des=command.position_target(), dq_des=zeros, tau_ff=zeros)
        if self._dropped():
            command = dataclasses.replace(command, q_des=self._commands[0])
        if self._motors is None:
            self._set_gains(command)
        else:
            self._motors.send(command)
        self._push()
        model = self.model
        data = self.data
        decimation = self._description.decimation
        self._commands = [command.q_des, *self._commands[:-1]]
        rows: list[tuple[float, FloatArray, FloatArray, FloatArray, FloatArray]] = []
        for k in range(decimation):
            self._drive(k)
            mujoco.mj_step(model, data)
            if self._motors is not None:
                self._motors.settle(data)
            if self._observer is not None:
                self._observer(model, data)
            if self._samples:
                q, tau = self._joints()
                rows.append((data.time, q, data.qvel[6:].copy(), tau, command.q_des))
        if not np.all(np.isfinite(data.qpos)):
            raise PlantError(
                f"the simulation is no longer finite at {data.time:.2f} s; this is a bug, please report it"
            )
        samples = None
        if self._samples:
            t, q, dq, tau, q_des = (np.array(column) for column in zip(*rows, strict=True))
            samples = JointSamples(t=t, q=q, dq=dq, tau=tau, q_des=q_des)
        self._steps += 1
        return Tick(state=self._state(), health=_healthy(self._steps), sent=command, samples=samples)

    # ------------------------------------------------------------------ what disturbs it, for who adds to it

    def _place(self, qpos: FloatArray) -> None:
        """Put a robot that lies on level ground onto another one; changes qpos in place."""

    def _push_angle(self) -> float:
        """Draw the world direction of a push [rad]."""
        return self._rng.uniform(-np.pi, np.pi)

    def _dropped(self) -> bool:
        """Return whether the command of this control step is dropped."""
        return self._motors is not None and self._motors.command_dropped()

    def damp(self) -> bool:
        """Return True: the commands of the loop damp it."""
        return True

    def close(self) -> None:
        """Do nothing; a simulated robot has nothing to release."""


@cache
def plant_options(robot: EffectsSettings) -> dict[str, Any]:
    """Return the keyword arguments that make a SimulatedPlant this robot; effects are read once in each process.

    Raises:
        ConfigError: If the effects cannot be read or name a joint that the robot lacks, or the control step is no
            multiple of the physics step.
    """
    if robot.effects is None:
        return {}
    description = with_timestep(load_description(robot.robot_model), robot.timestep)
    effects = read_standing(Path(robot.effects))
    parameters_of(effects, hung_robot(description))
    return {"effects": effects, "timestep": robot.timestep}
