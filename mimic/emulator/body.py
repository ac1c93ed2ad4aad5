"""The body that emulated motors move: the robot in MuJoCo, lying or suspended, driven joint by joint at any time.

The same law of the drives as in simulation and calibration (`mimic.dynamics.law`), with the same effects. Unlike a
simulated plant it has no control step: each motor gets its command when its own frame arrives.
"""

from __future__ import annotations

import math
from collections import deque

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from mimic.dynamics.effect_set import EffectSet
from mimic.dynamics.law import Law
from mimic.dynamics.lying import sink
from mimic.dynamics.machine import SOLREF_STEPS, hung_robot, tilted_gravity
from mimic.dynamics.robot_model import load_model
from mimic.dynamics.servo import Servo, parameters_of, refuse_stand, static_model
from mimic.dynamics.thermal import AMBIENT, MotorHeat
from mimic.emulator.motor import FREE, HOT, Drive
from mimic.errors import PlantError
from mimic.records import FloatArray, IntArray
from mimic.robot.description import RobotDescription, with_timestep


class EmulatedBody:
    """Twelve joints and a trunk, from time 0 on. Held still by somebody until `release`."""

    def __init__(
        self,
        description: RobotDescription,
        *,
        effects: EffectSet | None = None,
        suspended: bool = False,
        folded: bool = False,
        timestep: float = 0.0025,
        placement: float = 0.0,
        seed: int = 0,
    ) -> None:
        """Put the robot down; it sinks from its folded legs, as without power.

        Args:
            description: The robot.
            effects: What its drives, links and encoders have besides.
            suspended: Hang it up by its trunk instead, its feet free.
            folded: Somebody keeps its legs folded.
            timestep: Of the physics [s].
            placement: Joints are placed as far as this from the folded pose, before it sinks [rad].
            seed: Draws the placement, late and lost commands.

        Raises:
            ConfigError: If the effects are not of this robot, or of a stand and it does not hang.
        """
        effects = EffectSet(()) if effects is None else effects
        if not suspended:
            refuse_stand(effects)
        self.description = d = with_timestep(description, timestep)
        machine = hung_robot(d)
        p = parameters_of(effects, machine)
        none = np.zeros((1, 1))
        self._spread, self._lost = (
            float(p.pop(key, none)[0, 0]) for key in (("delay_jitter", "spread"), ("lost_commands", "share"))
        )
        delays = [np.broadcast_to(p.pop(key, none)[0], 12) for key in (("delay", "time"), ("joint_delay", "time"))]
        self._delay = delays[0] + delays[1]
        self.model = machine.model if suspended else load_model(d, visuals=False, driven=True)
        model = self.model
        model.opt.timestep = timestep
        model.dof_solref[-12:] = [SOLREF_STEPS * timestep, 1.0]
        static_model(model, machine, p)
        self._quat = np.array([1.0, 0.0, 0.0, 0.0])
        if suspended and ("base_tilt", "roll") in p:
            roll = float(p["base_tilt", "roll"][0, 0])
            pitch = float(p["base_tilt", "pitch"][0, 0])
            model.opt.gravity[:] = tilted_gravity(roll, pitch)
            self._quat = Rotation.from_euler("xy", [roll, pitch]).as_quat(scalar_first=True)
        self.data = mujoco.MjData(model)
        self._rng = np.random.default_rng([seed, 17])
        self._order: IntArray = np.arange(12)
        self._sign: FloatArray = np.ones(12)
        self._about: FloatArray = np.zeros(12)
        self._place(placement, suspended)
        if not (suspended or folded):
            sink(model, self.data)
        self._law = Law(machine.drives, p, timestep, (1, 12), np)
        self._applied = np.zeros((1, 12))
        self._servo = Servo(
            ctrl=self.data.ctrl[None],
            applied=self._applied,
            inertia=model.dof_armature[None, -12:],
            friction=model.dof_frictionloss[None, -12:],
            needed=self.data.qfrc_bias[None, -12:],
        )
        self._law.needed = self._servo.needed
        self._law.begin(self.data.qpos[None, -12:], self.data.qvel[None, -12:])
        self.held = True
        """Somebody holds trunk and legs where they are."""
        self.steps = 0
        """Physics steps so far."""
        self._drives = [FREE] * 12
        self._coming: list[deque[tuple[float, Drive]]] = [deque() for _ in range(12)]
        self._numbers = np.zeros((6, 12))
        self._changed = True
        self._mixed = np.zeros(12, dtype=bool)
        """Motors whose command changed during the last step."""
        self._tau = np.zeros(12)
        self._jam = np.zeros(12)
        """Additional dry friction of each joint [N m]."""
        self._heat = MotorHeat(d, np.full(12, AMBIENT))
        self._rise: FloatArray = np.zeros(12)
        self._readings: tuple[FloatArray, FloatArray, FloatArray] | None = None

    def _place(self, placement: float, suspended: bool) -> None:
        d = self.description
        data = self.data
        q = d.poses["lie"] + self._rng.uniform(-placement, placement, 12)
        data.qpos[-12:] = np.clip(q, d.q_min + 0.01, d.q_max - 0.01)
        if not suspended:
            data.qpos[:7] = 0.0, 0.0, d.pose_height["lie"] + 0.005, 1.0, 0.0, 0.0, 0.0
        mujoco.mj_forward(self.model, data)

    @property
    def time(self) -> float:
        """Up to where the physics has been computed [s]."""
        return self.steps * self.description.timestep

    def release(self) -> None:
        """Let go of the robot."""
        self.held = False

    def miswire(self, order: IntArray, sign: FloatArray, about: FloatArray) -> None:
        """Let others take joints for what they are not.

        Args:
            order: Which joint each is really (12,).
            sign: 1, or -1 where its readings and commands have the wrong sign (12,).
            about: Angle at which both would agree (12,) [rad].
        """
        self._order = order
        self._sign = sign
        self._about = about
        self._readings = None

    def drive(self, joint: int, drive: Drive, t: float) -> None:
        """Let a motor do something from time t [s] on, later by what the effects delay it.

        Args:
            joint: Index of the joint, as others take it.
            drive: In the joint's sign and zero, as its encoder reads.
            t: When the command arrived [s].
        """
        if self._lost and drive.kp and self._rng.random() < self._lost:
            return
        late = self._spread * self._rng.random() if self._spread else 0.0
        taken = joint
        sign = float(self._sign[taken])
        joint = int(self._order[taken])
        q = self._about[joint] + sign * (drive.q - self._about[taken])
        drive = drive._replace(q=float(q), dq=sign * drive.dq, tau=sign * drive.tau)
        self._coming[joint].append((t + float(self._delay[joint]) + late, drive))

    def jam(self, joint: int, friction: float) -> None:
        """Let a joint turn only against an additional dry friction [N m]; 0 frees it."""
        self._jam[self._order[joint]] = friction

    # ------------------------------------------------------------------ time

    def advance(self, t: float) -> None:
        """Compute the physics up to the last step that ends by time t [s].

        Raises:
            PlantError: If the robot is no longer finite.
        """
        h = self.description.timestep
        while (self.steps + 1) * h <= t + 1e-9:
            if not self.held:
                self._step(h)
            self.steps += 1
            self._readings = None

    def _step(self, h: float) -> None:
        data = self.data
        now = self.time
        self._take_commands(now, now + h)
        if self._changed:
            kp, kd, _, dq, tau, limit = self._numbers
            self._law.set_gains(kp, kd)
            self._law.limit_torque(limit[None])
            self._force = tau + kd * dq
            self._changed = False
        inputs = self._law.step(
            data.qpos[None, -12:], data.qvel[None, -12:], self._numbers[None, 2], now, self._force[None]
        )
        self._servo.write(inputs)
        jammed = bool(self._jam.any())
        if jammed:
            self.model.dof_frictionloss[-12:] += self._jam
        data.qfrc_applied[-12:] = self._applied[0]
        mujoco.mj_step(self.model, data)
        if jammed:
            self.model.dof_frictionloss[-12:] -= self._jam
        self._law.settle(data.qvel[None, -12:])
        self._tau = np.array(inputs.tau[0])
        self._rise = self._heat.add(self._tau, h)
        if not math.isfinite(data.qpos.sum()):
            raise PlantError(
                f"the emulated robot is no longer finite at {self.time:.2f} s; this is a bug, please report it"
            )

    def _take_commands(self, begin: float, end: float) -> None:
        """Apply the commands that arrive until the end of a step, each for its share of the step."""
        for joint, coming in enumerate(self._coming):
            if not self._mixed[joint] and not (coming and coming[0][0] < end):
                continue
            at = begin
            q = 0.0
            dq = 0.0
            tau = 0.0
            while coming and coming[0][0] < end:
                t, drive = coming.popleft()
                was = self._drives[joint]
                if (drive.kp, drive.kd, drive.limit) == (was.kp, was.kd, was.limit):
                    share = (max(t, begin) - at) / (end - begin)
                    q = q + share * was.q
                    dq = dq + share * was.dq
                    tau = tau + share * was.tau
                    at = max(t, begin)
                else:  # a mean of gains is none of them
                    at = begin
                    q = 0.0
                    dq = 0.0
                    tau = 0.0
                self._drives[joint] = drive
            new = self._drives[joint]
            share = (end - at) / (end - begin)
            q = q + share * new.q
            dq = dq + share * new.dq
            tau = tau + share * new.tau
            self._numbers[:, joint] = new.kp, new.kd, q, dq, tau, new.limit
            self._mixed[joint] = at > begin
            self._changed = True

    # ------------------------------------------------------------------ what is measured

    def joint(self, joint: int, t: float) -> tuple[float, float, float]:
        """Return position as the encoder reads it [rad], velocity [rad/s] and torque [N m] of a joint at time t [s]."""
        if self._readings is None:
            q = np.array(self._law.reading(self.data.qpos[None, -12:])[0])
            q = self._about + self._sign * (q - self._about)[self._order]
            dq, tau = (self._sign * values[self._order] for values in (self.data.qvel[-12:], self._tau))
            self._readings = q, dq, tau
        q, dq, tau = self._readings
        return float(q[joint] + dq[joint] * (t - self.time)), float(dq[joint]), float(tau[joint])

    def joints(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what `joint` returns, for all joints (12,)."""
        self.joint(0, t)
        assert self._readings is not None
        q, dq, tau = self._readings
        return q + dq * (t - self.time), dq.copy(), tau.copy()

    def temperature(self, joint: int) -> float:
        """Return the temperature of a motor [degC]; it reaches its fault when the winding model reaches its limit."""
        return AMBIENT + (HOT - AMBIENT) * float(self._rise[self._order[joint]])

    def base(self) -> tuple[FloatArray, FloatArray]:
        """Return the trunk's orientation, wxyz, and its angular velocity in base axes [rad/s]."""
        if self.model.nq == 12:
            return self._quat, np.zeros(3)
        return self.data.qpos[3:7].copy(), self.data.qvel[3:6].copy()
