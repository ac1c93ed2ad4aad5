"""The newest readings of a board, from its messages.

Readings count from when their messages came: the robot's own clock may be set at any time, and is not used.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mimic.errors import FrameError
from mimic.hardware.robot.driver import NEVER, no_report
from mimic.hardware.stock.messages import (
    LEG_CONTROL_DATA,
    MOTOR_CTRL_STATE,
    MOTOR_ERRORS,
    MOTOR_RUNNING,
    SPI_DATA,
    STATE_ESTIMATOR,
    TYPES,
)
from mimic.hardware.stock.wiring import PARTS, BoardWiring
from mimic.records import JOINTS, LEGS, FloatArray

NO_ERR_FLAG = -1
"""err_flag before the first motor_ctrl_state."""


class Readings:
    """Takes the messages of a board."""

    def __init__(self, wiring: BoardWiring) -> None:
        self._wiring = wiring
        self.report: Any = no_report()
        """Newest readings; a scalar of REPORT."""
        self.report["err_flag"] = NO_ERR_FLAG
        self.joints = 0
        """Messages with joint angles so far."""
        self.commanded = NEVER
        """When the board last spoke of the commands that it gets [s]."""

    def take(self, channel: str, data: bytes, t: float) -> None:
        """Take a message that arrived at time t [s].

        One that cannot be read, or has numbers outside of the wiring's ranges, is left out and counted.
        """
        report = self.report
        try:
            message = TYPES[channel].decode(data)
        except FrameError:
            report["errors"] += 1
            return
        report["heard"] = t
        if channel == SPI_DATA.channel:
            self._motors(message, t)
        elif channel == LEG_CONTROL_DATA.channel:
            self._joints(message, t)
        elif channel == STATE_ESTIMATOR.channel:
            self._imu(message, t)
        elif channel == MOTOR_CTRL_STATE.channel:
            self._commands(message, t)

    def _commands(self, message: Any, t: float) -> None:
        report, interval = self.report, float(message["ctrl_topic_interval"])
        if not np.isfinite(interval):
            report["errors"] += 1
            return
        report["err_flag"], self.commanded = int(message["err_flag"]) & 0xFFFF, t
        report["gap"] = 1e-3 * interval

    def _motors(self, message: Any, t: float) -> None:
        wiring, report = self._wiring, self.report

        def by_leg(name: str) -> Any:
            return np.stack([message[f"{name}_{part}"] for part in PARTS], axis=1).reshape(len(JOINTS))

        q, dq, tau = wiring.angles(by_leg("q")), wiring.joints(by_leg("qd")), wiring.joints(by_leg("tau"))
        temperature = wiring.temperature_unit * by_leg("tmp").astype(np.float64)[wiring.index]
        coldest, warmest = wiring.readings.temperature
        possible = self._possible(q, dq) and np.all(np.abs(tau) <= wiring.readings.torque)
        if not (possible and temperature.min() >= coldest and temperature.max() <= warmest):
            report["errors"] += 1
            return
        report["q"], report["dq"], report["tau"] = q, dq, tau
        flags = message["flags"].astype(np.int64)[wiring.index] & 0xFFFFFFFF
        report["faults"], report["running"] = flags & MOTOR_ERRORS, flags >> 30 == MOTOR_RUNNING
        report["temperature"], report["came"] = temperature, t
        report["readings"] += 1

    def _joints(self, message: Any, t: float) -> None:
        wiring, report = self._wiring, self.report
        self.joints += 1
        if report["readings"]:
            return
        q, dq = wiring.angles(message["q"]), wiring.joints(message["qd"])
        if not self._possible(q, dq):
            report["errors"] += 1
            return
        report["q"], report["dq"] = q, dq

    def _possible(self, q: FloatArray, dq: FloatArray) -> bool:
        """Return whether joints can have these angles (12,) [rad] and velocities (12,) [rad/s]; false for NaN."""
        ranges = self._wiring.readings
        return bool(np.all(np.abs(q) <= ranges.angle) and np.all(np.abs(dq) <= ranges.velocity))

    def _imu(self, message: Any, t: float) -> None:
        report = self.report
        quat = message["quat"].astype(np.float64)[self._wiring.quat]
        omega = message["omegaBody"].astype(np.float64)
        length = float(np.linalg.norm(quat))
        if not (np.all(np.abs(omega) <= self._wiring.readings.turn_rate) and abs(length - 1.0) < 0.05):
            report["errors"] += 1
            return
        quat = quat / length
        if not (np.array_equal(quat, report["quat_WB"]) and np.array_equal(omega, report["omega_B"])):
            report["imu_changed"] = t
        report["quat_WB"], report["omega_B"] = quat, omega
        report["imu_came"] = t
        report["imu_count"] += 1


assert len(JOINTS) == len(LEGS) * len(PARTS)
