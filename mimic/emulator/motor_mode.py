"""Motor mode of the stock robot's firmware: what it makes of a command in one cycle. Pure: no network, no body.

All arrays are (12,) in the firmware's order, FR FL RR RL, each abad, hip, knee, and in its signs.

Source: MiRoboticsLab/cyberdog_locomotion, commit ad79bfd, fsm_state_motor_ctrl.cpp and leg_controller.cpp.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mimic.hardware.stock.messages import CUT, LOST, TIMED_OUT
from mimic.records import FloatArray

LEG_COUNT = 4

LATE = 0.010
"""Age of the newest command above which the firmware reports it as late [s]."""
SILENT = 0.500
"""Age above which it is reported as lost [s]."""

RECONNECT = 5000
"""Counts in error 0x02 before it can be cleared; four in each cycle, one for each leg."""

DAMPING = 4.0
"""Velocity gain while commands are lost [N m s/rad]."""

CUTS = np.tile(np.deg2rad([8.0, 10.0, 12.0]), LEG_COUNT)
"""Largest distance of a desired position from the measured one [rad]."""

INSIDE = 0.04
"""Desired positions are held this far inside the joint limits [rad]."""

SOFT = 0.05
"""Within this of a limit [rad], a torque outward gives way to a spring."""
SOFT_KP = 20.0
"""Stiffness of that spring [N m/rad]."""

SOFT_TORQUE = np.tile([0.0, 0.0, 1.0], LEG_COUNT)
"""… if it is greater than this [N m]."""

ZERO = 0.001
"""Gains and torques up to this count as zero."""


class MotorCommands(NamedTuple):
    """Commands of all motors: tau + kp (q_des - q) + kd (dq_des - dq)."""

    q_des: FloatArray
    dq_des: FloatArray
    kp: FloatArray
    kd: FloatArray
    tau: FloatArray


class MotorModeRules:
    """Error bits and counters, from cycle to cycle."""

    def __init__(self, low: FloatArray, high: FloatArray) -> None:
        """Enter motor mode.

        Args:
            low: Lower joint limits (12,) [rad].
            high: Upper ones.
        """
        self._low = low
        self._high = high
        self._reconnect = 0
        self.err_flag = TIMED_OUT
        """As in motor_ctrl_state."""
        self.limits = np.zeros(3 * LEG_COUNT, dtype=int)
        """-1 or 1 where a joint is near its lower or upper limit (12,)."""

    def clear(self) -> int:
        """Leave error 0x02 now, and return how many cycles it has lasted, the present one included."""
        cycles = self._reconnect // LEG_COUNT + 1
        self._reconnect = 0
        self.err_flag = self.err_flag & ~TIMED_OUT
        return cycles

    def cycle(self, message: Any, age: float, q: FloatArray, dq: FloatArray) -> MotorCommands:
        """Return the command to the motors.

        Args:
            message: Newest motor_ctrl.
            age: Of it [s].
            q: Measured angles (12,) [rad].
            dq: Measured velocities (12,) [rad/s].
        """
        q_des, dq_des, kp, kd, tau = (
            message[name].astype(np.float64) for name in ("q_des", "qd_des", "kp_des", "kd_des", "tau_des")
        )
        zero = not (np.abs(np.concatenate([kp, kd, tau])) > ZERO).any()
        if age > LATE:
            dq_des = dq_des * LATE / age
            tau = tau * LATE / age
            self.err_flag |= LOST | (TIMED_OUT if age > SILENT else 0)
        else:
            self.err_flag &= ~LOST
        for leg in range(LEG_COUNT):
            if not self.err_flag & TIMED_OUT:
                self._reconnect = 0
                continue
            of_leg = slice(3 * leg, 3 * leg + 3)
            self._reconnect += 1
            for values in (q_des, dq_des, kp, kd, tau):
                values[of_leg] = 0.0
            if self._reconnect < RECONNECT:
                kd[of_leg] = DAMPING
            elif zero and age < SILENT:
                self.err_flag &= ~TIMED_OUT
        away = np.clip(q_des, self._low + INSIDE, self._high - INSIDE) - q
        self.err_flag &= ~CUT
        for place, bit in ((9, 0x4), (10, 0x8), (11, 0x10)):  # set and cleared leg by leg: the last one counts
            if abs(away[place]) > CUTS[place]:
                self.err_flag |= bit
        return self._soften(q, dq, MotorCommands(q + np.clip(away, -CUTS, CUTS), dq_des, kp, kd, tau))

    def _soften(self, q: FloatArray, dq: FloatArray, command: MotorCommands) -> MotorCommands:
        """Return commands with the soft joint limits applied."""
        q_des, dq_des, kp, kd, tau = command
        estimate = tau + kp * (q_des - q) + kd * (dq_des - dq)
        low = q < self._low + SOFT
        high = q > self._high - SOFT
        self.limits = high.astype(int) - low.astype(int)
        for near, bound, pushed in (
            (low, self._low + SOFT, estimate < -SOFT_TORQUE),
            (high, self._high - SOFT, estimate > SOFT_TORQUE),
        ):
            soft = near & pushed
            tau = np.where(soft, SOFT_KP * (bound - q), tau)
            kp = np.where(soft, 0.0, kp)
            kd = np.where(soft, 0.0, kd)
        return MotorCommands(q_des, dq_des, kp, kd, tau)
