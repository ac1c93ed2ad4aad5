"""Motors of the simulated robot with calibrated effects: the drive law in place of the native actuators."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from mimic.dynamics.effect_set import EffectSet
from mimic.dynamics.law import Law
from mimic.dynamics.machine import SOLREF_STEPS, hung_robot
from mimic.dynamics.robot_model import Variation
from mimic.dynamics.servo import (
    Servo,
    moving_targets,
    parameters_of,
    refuse_stand,
    shares_in_effect,
    static_model,
    target_in_effect,
    target_shift,
)
from mimic.records import FloatArray, JointCommand
from mimic.robot.description import RobotDescription


class LawMotors:
    """Twelve drives with their effects, from the command to the force at the joint.

    Values of the effects, such as friction or the delay, replace those of the variation; gains are multiplied.
    """

    def __init__(self, description: RobotDescription, effects: EffectSet) -> None:
        """Take the effects.

        Args:
            description: The robot, at the physics step of the simulation.
            effects: What its motors, links and encoders have.

        Raises:
            ConfigError: If an effect names an unknown joint, or is one of the stand of a hung robot.
        """
        refuse_stand(effects)
        self._d = description
        self._machine = hung_robot(description)
        self._p = parameters_of(effects, self._machine)
        none = np.zeros((1, 1))
        self._spread = float(self._p.pop(("delay_jitter", "spread"), none)[0, 0]) / description.timestep
        self._dropped_share = float(self._p.pop(("lost_commands", "share"), none)[0, 0])
        self.tau = np.zeros(12)
        """Torque of each motor at the start of the last physics step (12,) [N m]."""

    def fit(self, model: mujoco.MjModel, data: mujoco.MjData, variation: Variation, seed: int) -> None:
        """Fit the motors to one robot; ``model`` has its variation already."""
        h = self._d.timestep
        static_model(model, self._machine, self._p)
        model.dof_solref[6:] = [SOLREF_STEPS * h, 1.0]
        parameters = {("coulomb", "level"): self._machine.drives.friction * variation.dry_friction[None]} | self._p
        self._law = Law(self._machine.drives, parameters, h, (1, 12), np)
        self._kp = variation.kp
        self._kd = variation.kd
        self._applied = np.zeros((1, 12))
        self._servo = Servo(
            ctrl=data.ctrl[None],
            applied=self._applied,
            inertia=model.dof_armature[None, 6:],
            friction=model.dof_frictionloss[None, 6:],
            needed=data.qfrc_bias[None, 6:],
        )
        self._law.needed = self._servo.needed
        shift = target_shift(self._p, h) + (0 if ("delay", "time") in self._p else variation.delay_steps)
        self._shift = np.maximum(np.broadcast_to(shift, (1, 12))[0], 0.0)
        self._rng = np.random.default_rng([seed, 13])

    def start(self, q: FloatArray, dq: FloatArray) -> None:
        """Begin a run at link positions and velocities (12,), with these positions as targets."""
        self._law.begin(q[None], dq[None])
        self._law.set_gains(self._d.kp * self._kp, self._d.kd * self._kd)
        self.tau = np.zeros(12)
        kept = max(math.ceil((self._shift.max() + self._spread) / self._d.decimation), 1) + 2  # one to move from
        self._moving = False
        self._targets = [self.reading(q)] * kept
        self._shifts = [self._shift] * kept

    def command_dropped(self) -> bool:
        """Return whether the command of this control step is dropped."""
        return self._dropped_share > 0 and bool(self._rng.random() < self._dropped_share)

    def send(self, command: JointCommand) -> None:
        """Queue the command of a control step, which acts after its delay."""
        jitter = self._spread * self._rng.random() if self._spread else 0.0
        self._moving = command.ramp > 0.0
        self._targets = [command.q_des, *self._targets[:-1]]
        self._shifts = [self._shift + jitter, *self._shifts[:-1]]
        self._law.set_gains(command.kp * self._kp, command.kd * self._kd)

    def drive(self, substep: int, data: mujoco.MjData) -> FloatArray:
        """Set the motors for the next physics step; return the torque on the joints beyond theirs (12,) [N m]."""
        decimation = self._d.decimation
        targets = self._targets
        shares = shares_in_effect(substep, decimation, self._shifts, np)
        if self._moving:
            targets = moving_targets(substep, decimation, self._shifts, targets, np)
        target = target_in_effect(shares, targets)
        inputs = self._law.step(data.qpos[None, 7:], data.qvel[None, 6:], target[None], data.time)
        self._servo.write(inputs)
        self.tau = np.array(inputs.tau[0])
        return self._applied[0]

    def settle(self, data: mujoco.MjData) -> None:
        """Advance lags and rotors to the end of the last physics step."""
        self._law.settle(data.qvel[None, 6:])

    def reading(self, q: FloatArray) -> FloatArray:
        """Return what the encoders read at link positions (12,)."""
        return np.array(self._law.reading(q[None])[0])
