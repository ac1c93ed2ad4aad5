"""The newest readings of a board, from its messages; and the report of them that goes from process to process."""

from __future__ import annotations

from typing import Any

import numpy as np

from mimic.errors import FrameError
from mimic.hardware.stock.messages import (
    LEG_CONTROL_DATA,
    MOTOR_CTRL_STATE,
    SPI_DATA,
    STATE_ESTIMATOR,
    TYPES,
)
from mimic.hardware.stock.wiring import PARTS, BoardWiring
from mimic.records import JOINTS, LEGS, FloatArray

NEVER = -np.inf

CLOCK_DRIFT = 1e-3
"""The clocks of robot and computer may run apart by this share; a delay that lasts is forgotten at this rate."""

NO_ERR_FLAG = -1
"""err_flag before the first motor_ctrl_state."""

REPORT = np.dtype(
    [
        ("t", "f8"),
        ("state", "i8"),
        ("sent", "i8"),
        ("heard", "f8"),
        ("q", "f8", 12),
        ("dq", "f8", 12),
        ("tau", "f8", 12),
        ("joints_came", "f8"),
        ("flags", "i8", 12),
        ("temperature", "f8", 12),
        ("motors_came", "f8"),
        ("quat_WB", "f8", 4),
        ("omega_B", "f8", 3),
        ("imu_came", "f8"),
        ("imu_changed", "f8"),
        ("imu_count", "i8"),
        ("err_flag", "i8"),
        ("err_came", "f8"),
        ("gap", "f8"),
        ("joints_count", "i8"),
        ("motors_count", "i8"),
        ("foreign", "i8"),
        ("malformed", "i8"),
    ]
)
"""What the process at the board reports: readings in joint order and sign, when each came on the monotonic clock [s]
(NEVER: not yet), and counts since its start. ``gap`` is the board's ctrl_topic_interval [s]."""


class Readings:
    """Takes the messages of a board."""

    def __init__(self, wiring: BoardWiring) -> None:
        self._wiring = wiring
        self.report: Any = np.zeros((), REPORT)
        """Newest readings; a scalar of REPORT."""
        for name in ("heard", "joints_came", "motors_came", "imu_came", "imu_changed", "err_came"):
            self.report[name] = NEVER
        for name in ("q", "dq", "tau", "temperature", "quat_WB", "omega_B"):
            self.report[name] = np.nan
        self.report["err_flag"] = NO_ERR_FLAG
        self._offset, self._stamp = np.inf, 0.0
        self._offset_t = 0.0

    def take(self, channel: str, data: bytes, t: float) -> None:
        """Take a message that arrived at time t [s].

        One that cannot be read, or has numbers outside of the wiring's ranges, is left out and counted.
        """
        report = self.report
        try:
            message = TYPES[channel].decode(data)
        except FrameError:
            report["malformed"] += 1
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
            report["malformed"] += 1
            return
        report["err_flag"], report["err_came"] = int(message["err_flag"]) & 0xFFFF, t
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
            report["malformed"] += 1
            return
        report["q"], report["dq"], report["tau"] = q, dq, tau
        report["flags"] = message["flags"].astype(np.int64)[wiring.index] & 0xFFFFFFFF
        report["temperature"] = temperature
        report["motors_came"] = report["joints_came"] = t
        report["motors_count"] += 1

    def _joints(self, message: Any, t: float) -> None:
        wiring, report = self._wiring, self.report
        report["joints_count"] += 1
        if report["motors_came"] > NEVER:
            return
        q, dq = wiring.angles(message["q"]), wiring.joints(message["qd"])
        if not self._possible(q, dq):
            report["malformed"] += 1
            return
        report["q"], report["dq"], report["joints_came"] = q, dq, t

    def _possible(self, q: FloatArray, dq: FloatArray) -> bool:
        """Return whether joints can have these angles (12,) [rad] and velocities (12,) [rad/s]; false for NaN."""
        ranges = self._wiring.readings
        return bool(np.all(np.abs(q) <= ranges.angle) and np.all(np.abs(dq) <= ranges.velocity))

    def _imu(self, message: Any, t: float) -> None:
        report, stamp = self.report, 1e-9 * float(message["timestamp"])
        if stamp < self._stamp:  # the robot's clock was set
            self._offset = np.inf
        quat = message["quat"].astype(np.float64)[self._wiring.quat]
        omega = message["omegaBody"].astype(np.float64)
        length = float(np.linalg.norm(quat))
        if not (np.all(np.abs(omega) <= self._wiring.readings.turn_rate) and abs(length - 1.0) < 0.05):
            report["malformed"] += 1
            return
        self._stamp = stamp
        self._offset = min(t - stamp, self._offset + CLOCK_DRIFT * (t - self._offset_t))
        self._offset_t = t
        quat = quat / length
        if not (np.array_equal(quat, report["quat_WB"]) and np.array_equal(omega, report["omega_B"])):
            report["imu_changed"] = t
        report["quat_WB"], report["omega_B"] = quat, omega
        report["imu_came"] = min(stamp + self._offset, t)
        report["imu_count"] += 1


assert len(JOINTS) == len(LEGS) * len(PARTS)
