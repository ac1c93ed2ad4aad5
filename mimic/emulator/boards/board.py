"""The motion board of a stock CyberDog 2, emulated: the firmware's rules, cycle by cycle, on an emulated body.

Its owner advances the time, as with `mimic.emulator.robot`. Messages go in with the time of their arrival, and come out
with the time at which they were sent.

Source of the rules: MiRoboticsLab/cyberdog_locomotion, commit ad79bfd, fsm_state_motor_ctrl.cpp, leg_controller.cpp
and command_interface.cpp. How the motors report an error to it, and what it does then, is simplified: a motor with an
error gives no torque, and the others are damped.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mimic.emulator.boards.board_base import MESSAGE_FAULTS, NetworkBoard
from mimic.emulator.faults import MISWIRED
from mimic.emulator.motor import FREE, LEAST_TORQUE, Drive
from mimic.emulator.motor_mode import DAMPING, MotorCommands, MotorModeRules
from mimic.errors import FrameError
from mimic.geometry import rotation_from_quat, rpy_from_quat
from mimic.hardware.robot.board_wiring import PARTS
from mimic.hardware.stock.messages import (
    LEG_CONTROL_DATA,
    LOST,
    MOTOR_CTRL,
    MOTOR_CTRL_STATE,
    MOTOR_RUNNING,
    SPI_DATA,
    STATE_ESTIMATOR,
    TIMED_OUT,
)
from mimic.hardware.stock.wiring import BoardWiring
from mimic.records import JOINTS, LEGS, FloatArray

QUIET_EVERY = 10
"""Before the first command, one cycle in so many is published: 50 Hz."""

ENTERING = 2
"""Cycles from the first command to motor mode."""

STEP_STAMP = 1_700_000_000_000_000_000
"""Time stamp of the emulated robot's clock at time 0 [ns]."""

FAULTS = (
    "motor_dead",
    "motor_fault",
    "motor_hot",
    *MESSAGE_FAULTS,
    *MISWIRED,
    "imu_silent",
    "imu_frozen",
    "imu_tilted",
    "bus_off",
    "mode_refused",
)
"""Kinds of faults that the board has."""

FRAME = np.array([200.0, 10.0, 12.6, 30.0, 12.0])
"""Upper ends of the numbers in a motor's frame: kp, kd, q, dq and tau; a damaged message is not taken further. The
maker's ranges of kp, kd and tau; the others are not published."""

FRAME_LOW = FRAME * [0.0, 0.0, -1.0, -1.0, -1.0]
"""Their lower ends: a frame has no negative gains."""

_BODY = tuple(LEGS.index(leg) * len(PARTS) + part for leg in ("FR", "FL", "RR", "RL") for part in range(len(PARTS)))
"""Joint of the description at each place of the firmware's order."""

_ORDER = np.array(_BODY)

_SIGN = np.tile([1.0, -1.0, -1.0], len(LEGS))
"""Angle in the firmware over angle of the joint, in the firmware's order."""


class EmulatedBoard(NetworkBoard[BoardWiring]):
    """A stock robot from power-up on, lying or suspended."""

    name = "the stock board"
    hears = (MOTOR_CTRL.channel,)
    kinds = FAULTS

    late_ticks = 0
    """Cycles with error 0x01 so far."""
    applied = MotorCommands(*(np.zeros(12) for _ in range(5)))
    """The latest command to the motors, in the firmware's order and signs."""
    _command: Any = None
    _arrived = -math.inf
    _first = -1
    _rules: MotorModeRules | None = None

    # ------------------------------------------------------------------ the firmware

    def _cycle(self) -> None:
        self.body.advance(self.now)
        self._arrived_by_now(self._command_came)
        ready = self._rules is None and 0 <= self._first <= self.ticks - ENTERING
        if ready and not self._has("mode_refused"):
            low = self._d.q_min[_ORDER] * _SIGN
            high = self._d.q_max[_ORDER] * _SIGN
            self._rules = MotorModeRules(np.minimum(low, high), np.maximum(low, high))
            self.events.append((self.now, "motor mode"))
        q, dq = self._measured()
        if self._rules is not None:
            self._run(q, dq)
        self._speak(q, dq)

    def _command_came(self, _: str, data: bytes, at: float) -> None:
        try:
            self._command = MOTOR_CTRL.decode(data)
        except FrameError:
            return
        self._arrived = at
        if self._first < 0:
            self._first = self.ticks
            self._began()

    def _measured(self) -> tuple[FloatArray, FloatArray]:
        """Return angles and velocities of the joints (12,), as the firmware has them."""
        q, dq, _ = self.body.joints(self.now)
        return _SIGN * q[_ORDER], _SIGN * dq[_ORDER]

    def _run(self, q: FloatArray, dq: FloatArray) -> None:
        """One cycle of motor mode."""
        assert self._rules is not None
        before = self._rules.err_flag
        age = self.now - self._arrived
        self.applied = self._rules.cycle(self._command, age, q, dq)
        self.late_ticks += bool(self.err_flag & LOST)
        if (before ^ self.err_flag) & TIMED_OUT:
            self.events.append((self.now, f"error flag {self.err_flag:#04x}"))
        dead = self._joints_with("motor_dead")
        failed = self._joints_with("motor_fault")
        q_des, dq_des, kp, kd, tau = self.applied
        if failed:
            kp = np.zeros(12)
            kd = np.full(12, DAMPING)
            tau = np.zeros(12)
        numbers = np.nan_to_num(np.stack([kp, kd, _SIGN * q_des, _SIGN * dq_des, _SIGN * tau], axis=1))
        framed = np.clip(numbers, FRAME_LOW, FRAME).tolist()
        for place, joint in enumerate(_BODY):
            self._drive(joint, FREE if joint in dead or joint in failed else Drive(*framed[place]))

    @property
    def err_flag(self) -> int:
        """Error bits; 0 before motor mode."""
        return 0 if self._rules is None else self._rules.err_flag

    def driven(self) -> tuple[str, ...]:
        """Return the joints with stiffness or a torque of a command; soft joint limits do not count."""
        kp = self.applied.kp
        tau = self.applied.tau
        free = np.ones(12, dtype=bool) if self._rules is None else self._rules.limits == 0
        moved = (kp > 0.0) | (free & (np.abs(tau) > LEAST_TORQUE))
        return tuple(JOINTS[_BODY[place]] for place in np.flatnonzero(moved))

    def line(self) -> str:
        """Return a line of what has happened so far."""
        return (
            f"{self.commands} commands, error flag {self.err_flag:#04x}, {self.late_ticks} cycles with a late command"
        )

    def figures(self) -> dict[str, str]:
        """Return rows of a table of what has happened."""
        return {
            "commands": f"{self.commands}; {self.late_ticks} cycles of 2 ms with one older than 10 ms",
            "error flag": f"{self.err_flag:#04x} at the end",
        }

    # ------------------------------------------------------------------ what it says

    def _speak(self, q: FloatArray, dq: FloatArray) -> None:
        if self._first < 0 and self.ticks % QUIET_EVERY:
            return
        if self._rules is not None:
            interval = 1e3 * (self.now - self._arrived)
            state = MOTOR_CTRL_STATE.encode(err_flag=self.err_flag, ctrl_topic_interval=interval)
            self._publish(MOTOR_CTRL_STATE.channel, state)
        torque = _SIGN * self.torques[_ORDER]
        if self._first >= 0:
            self._publish(SPI_DATA.channel, self._spi_data(q, dq, torque))
        near = np.zeros(12, dtype=int) if self._rules is None else self._rules.limits
        limits = {f"q_{part}_limit": near.reshape(len(LEGS), len(PARTS))[:, i] for i, part in enumerate(PARTS)}
        self._publish(LEG_CONTROL_DATA.channel, LEG_CONTROL_DATA.encode(q=q, qd=dq, tau_est=torque, **limits))
        if not self._has("imu_silent"):
            self._publish(STATE_ESTIMATOR.channel, self._orientation())

    def _spi_data(self, q: FloatArray, dq: FloatArray, torque: FloatArray) -> bytes:
        failed = self._joints_with("motor_fault")
        dead = self._joints_with("motor_dead")
        flags = np.zeros(12, dtype=np.int64)
        for place, joint in enumerate(_BODY):
            running = self._rules is not None and joint not in failed and joint not in dead
            flags[place] = (MOTOR_RUNNING << 30 if running else 0) | int(failed.get(joint, 0.0))
        warm = self._warm()[_ORDER]
        values = {"q": q, "qd": dq, "tau": torque, "tmp": np.round(warm / self._wiring.temperature_unit)}
        by_leg = {
            f"{name}_{part}": value.reshape(len(LEGS), len(PARTS))[:, i]
            for name, value in values.items()
            for i, part in enumerate(PARTS)
        }
        return SPI_DATA.encode(flags=flags.astype(np.uint32).view(np.int32), spi_driver_status=0, **by_leg)

    def _orientation(self) -> bytes:
        stamp = STEP_STAMP + round(1e9 * self.now)
        quat, omega, _ = self.orientation(stamp)
        R = rotation_from_quat(quat)
        return STATE_ESTIMATOR.encode(
            rpy=rpy_from_quat(np.asarray(quat)),
            omegaBody=omega,
            omegaWorld=R @ omega,
            quat=quat,
            aBody=R.T @ np.array([0.0, 0.0, 9.81]),
            aWorld=(0.0, 0.0, 9.81),
            contactEstimate=(0.5, 0.5, 0.5, 0.5),
            timestamp=stamp,
        )
