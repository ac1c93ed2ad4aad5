"""What flows between the control loop and a robot, and the log of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any

import numpy as np

from mimic.frozen import frozen_arrays
from mimic.records.base import BoolArray, FloatArray, IntArray, Record, array


@frozen_arrays
class RobotState:
    """The robot at one instant; NaN where a quantity is not measured."""

    t: float
    """Time of the plant [s]."""
    q: FloatArray
    """Joint positions (12,) [rad]."""
    dq: FloatArray
    """Joint velocities (12,) [rad/s]."""
    tau: FloatArray
    """Joint torques (12,) [N m]."""
    quat_WB: FloatArray
    """Orientation of the base (4,), wxyz."""
    omega_B: FloatArray
    """Angular velocity of the base, base axes (3,) [rad/s]."""
    p_WB: FloatArray
    """Position of the base (3,) [m]; NaN on a robot that cannot measure it."""
    v_WB: FloatArray
    """Velocity of the base, world axes (3,) [m/s]; NaN on a robot that cannot measure it."""


@frozen_arrays
class JointCommand:
    """What the joints are asked for: tau = tau_ff + kp (q_des - q) + kd (dq_des - dq)."""

    q_des: FloatArray
    """Desired positions (12,) [rad]."""
    dq_des: FloatArray
    """Desired velocities (12,) [rad/s]."""
    kp: FloatArray
    """Position gains (12,) [N m/rad]."""
    kd: FloatArray
    """Velocity gains (12,) [N m s/rad]."""
    tau_ff: FloatArray
    """Feed-forward torques (12,) [N m]."""
    ramp: float = 0.0
    """Time in which q_des, dq_des and tau_ff move linearly from the previous command's to these [s]; 0: at once."""

    def position_target(self) -> FloatArray:
        """Return the target (12,) [rad] with which position and velocity gain alone give the same torque.

        ``q_des + (kd dq_des + tau_ff) / kp``; q_des where kp is 0.
        """
        ahead = self.kd * self.dq_des + self.tau_ff
        return self.q_des + np.divide(ahead, self.kp, out=np.zeros_like(ahead), where=self.kp > 0.0)


@frozen_arrays
class JointSamples(Record):
    """Joint readings faster than the control rate; the columns are those of a calibration log."""

    t: FloatArray = array()
    """Time of the plant [s]."""
    q: FloatArray = array("joint")
    """Positions [rad]."""
    dq: FloatArray = array("joint")
    """Velocities [rad/s]."""
    tau: FloatArray = array("joint")
    """Torques [N m]."""
    q_des: FloatArray = array("joint")
    """Position targets as they were sent, feed-forward included (`JointCommand.position_target`) [rad]."""


DOUBLED = 128
"""Fault bit that stands for two motors that answer as one."""


@frozen_arrays
class Health:
    """How far the readings of one control step can be trusted, and what a robot says about itself."""

    age: FloatArray
    """Age of each motor's newest answer (12,) [s]; infinite where none ever came."""
    missed: IntArray
    """Control steps in a row without an answer (12,)."""
    faults: IntArray
    """Fault bits of each motor's newest answer (12,); 0 where all is well."""
    running: BoolArray
    """Whether each motor said last that it is switched on (12,)."""
    temperature: FloatArray
    """Of each motor (12,) [degC]; NaN where not known."""
    imu_age: float
    """Age of the newest orientation [s]; infinite where none ever came."""
    imu_unchanged: float
    """Since anything that the IMU sends was last new [s]."""
    imu_count: int
    """Orientations received since the start."""
    imu_valid: bool | None
    """What the IMU says about its orientation; None where it says nothing."""
    compute: float
    """From the end of the step before to the sending of this one's command [s]."""
    late: float
    """How much later than planned the step ended [s]."""
    bus_errors: int
    """Error frames and frames that made no sense since the start."""
    sender_age: float = 0.0
    """Age of the newest report of the process that sends [s]; 0 where there is none."""
    err_flag: int = 0
    """Error bits of a motion board during the step; 0 where all is well or there is no board."""
    command_gap: float = 0.0
    """Longest time without a command that a motion board reported during the step [s]."""
    foreign: int = 0
    """Commands of other programs to this robot that were seen since the start."""
    voltage: float = float("nan")
    """Newest supply voltage that a motor reported [V]; NaN where none does."""
    round_trip: float = float("nan")
    """From the newest question with an answer of its own to that answer, or from one message of a board to the next
    [s]; NaN where neither is there."""


@frozen_arrays
class HealthLog(Record):
    """What a robot said about itself at each control tick, beside the RunLog of the same rows."""

    t: FloatArray = array()
    """Time of the plant [s]."""
    age: FloatArray = array("joint")
    """Age of each motor's newest answer [s]."""
    missed: FloatArray = array("joint")
    """Control steps in a row without an answer."""
    faults: FloatArray = array("joint")
    """Fault bits."""
    running: FloatArray = array("joint")
    """1 where the motor was switched on."""
    temperature: FloatArray = array("joint")
    """Of each motor [degC]."""
    imu_age: FloatArray = array()
    """Age of the newest orientation [s]."""
    imu_unchanged: FloatArray = array()
    """Since anything that the IMU sends was last new [s]."""
    imu_count: FloatArray = array()
    """Orientations received."""
    compute: FloatArray = array()
    """From the end of the step before to the sending of this one's command [s]."""
    late: FloatArray = array()
    """How much later than planned the step ended [s]."""
    bus_errors: FloatArray = array()
    """Error frames and frames that made no sense."""
    err_flag: FloatArray = array(optional=True)
    """Error bits of a motion board."""
    command_gap: FloatArray = array(optional=True)
    """Longest time without a command that a motion board reported [s]."""
    foreign: FloatArray = array(optional=True)
    """Commands of other programs."""
    voltage: FloatArray = array(optional=True)
    """Supply voltage of one motor after the other [V]."""
    round_trip: FloatArray = array(optional=True)
    """From a question to its answer [s]."""
    clamped: FloatArray = array()
    """Numbers of this tick's targets and command that were outside their limits."""
    mode: FloatArray = array()
    """What the supervisor had decided: 0 run, 1 sit down, 2 damp, 3 stopped."""


@frozen_arrays
class Tick:
    """One control step of a plant: the state after it, and the command that really went out."""

    state: RobotState
    sent: JointCommand
    health: Health
    """How far the readings can be trusted."""
    samples: JointSamples | None = None
    """Joint readings during the step, where the plant has them."""


PHASES = ("lie", "stand_up", "blend", "track", "hold", "sit_down", "damp")
"""Phases of a run; a log stores their index."""


@frozen_arrays
class RunLog(Record):
    """Every control tick of a run: the state at its start, and what was decided and sent from it."""

    t: FloatArray = array()
    """Time of the plant [s]."""
    t_host: FloatArray = array()
    """Monotonic clock of the computer [s]."""
    phase: IntArray = array(dtype=np.int64)
    """Index into PHASES."""
    q: FloatArray = array("joint")
    """Joint positions [rad]."""
    dq: FloatArray = array("joint")
    """Joint velocities [rad/s]."""
    tau: FloatArray = array("joint")
    """Joint torques [N m]."""
    quat_WB: FloatArray = array("wxyz")
    """Orientation of the base."""
    omega_B: FloatArray = array("xyz")
    """Angular velocity of the base, base axes [rad/s]."""
    p_WB: FloatArray = array("xyz")
    """Position of the base [m]; NaN where not measured."""
    v_WB: FloatArray = array("xyz")
    """Velocity of the base, world axes [m/s]; NaN where not measured."""
    p_BE: FloatArray = array("side", "xyz")
    """Base -> front toe by forward kinematics, base axes [m]."""
    v_des: FloatArray = array("xy")
    """Desired base velocity in the heading frame [m/s]."""
    heading_des: FloatArray = array()
    """Desired heading, world [rad]."""
    p_BE_des: FloatArray = array("side", "xyz")
    """Desired base -> front toe, base axes [m]."""
    trunk_des: FloatArray = array("height_pitch", optional=True)
    """Desired height of the hind hips [m] and forward lean [rad], from how the robot stands by itself."""
    observation: FloatArray = array("observation")
    """What the policy saw, NaN behind it where the other policy of the run sees more; NaN while no policy ran."""
    action: FloatArray = array("joint")
    """What the policy answered; NaN while no policy ran."""
    q_des: FloatArray = array("joint")
    """Commanded joint positions [rad]."""
    q_sent: FloatArray = array("joint")
    """Joint positions that really went out [rad]."""
    kp: FloatArray = array("joint")
    """Position gains that went out [N m/rad]."""
    kd: FloatArray = array("joint")
    """Velocity gains that went out [N m s/rad]."""
    metadata: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Plant, policy and settings, as plain data."""

    @property
    def aimed(self) -> BoolArray:
        """Return where the robot should stand and its toes should be somewhere: from blend to hold (ticks,)."""
        return (self.phase >= PHASES.index("blend")) & (self.phase <= PHASES.index("hold"))
