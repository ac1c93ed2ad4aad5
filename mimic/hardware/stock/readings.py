"""The newest readings of a board, from its messages.

Readings count from when their messages came: the robot's own clock may be set at any time, and is not used.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mimic.errors import FrameError
from mimic.hardware.robot.board import BoardReadings
from mimic.hardware.robot.board_wiring import PARTS
from mimic.hardware.robot.driver import NEVER
from mimic.hardware.stock.messages import (
    LEG_CONTROL_DATA,
    MOTOR_CTRL_STATE,
    MOTOR_ERRORS,
    MOTOR_RUNNING,
    SPI_DATA,
    STATE_ESTIMATOR,
    TYPES,
)
from mimic.hardware.stock.wiring import BoardWiring
from mimic.records import JOINTS


class Readings(BoardReadings):
    """Takes the messages of a board."""

    def __init__(self, wiring: BoardWiring) -> None:
        super().__init__(wiring)
        self._unit = wiring.temperature_unit
        self._index = wiring.index
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
            self._joints(message)
        elif channel == STATE_ESTIMATOR.channel:
            quat = message["quat"].astype(np.float64)
            omega = message["omegaBody"].astype(np.float64)
            self.take_orientation(quat, omega, t)
        elif channel == MOTOR_CTRL_STATE.channel:
            self._commands(message, t)

    def _commands(self, message: Any, t: float) -> None:
        report = self.report
        interval = float(message["ctrl_topic_interval"])
        if not np.isfinite(interval):
            report["errors"] += 1
            return
        report["err_flag"] = int(message["err_flag"]) & 0xFFFF
        self.commanded = t
        report["gap"] = 1e-3 * interval

    def _motors(self, message: Any, t: float) -> None:
        wiring = self._wiring
        report = self.report

        def by_leg(name: str) -> Any:
            return np.stack([message[f"{name}_{part}"] for part in PARTS], axis=1).reshape(len(JOINTS))

        q = wiring.angles(by_leg("q"))
        dq = wiring.joints(by_leg("qd"))
        tau = wiring.joints(by_leg("tau"))
        temperature = self._unit * by_leg("tmp").astype(np.float64)[self._index]
        if self.take_motors(q, dq, tau, temperature, t):
            flags = message["flags"].astype(np.int64)[self._index] & 0xFFFFFFFF
            report["faults"] = flags & MOTOR_ERRORS
            report["running"] = flags >> 30 == MOTOR_RUNNING

    def _joints(self, message: Any) -> None:
        self.joints += 1
        if not self.report["readings"]:
            self.take_joints(self._wiring.angles(message["q"]), self._wiring.joints(message["qd"]))
