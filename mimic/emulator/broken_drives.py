"""What a motor of the emulated robot does with its commands where its drive, its joint or its encoder is broken."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mimic.emulator.body import EmulatedBody
from mimic.emulator.motor import Drive
from mimic.hardware.can.wiring import Wiring

KINDS = ("motor_weak", "motor_runaway", "joint_jammed", "encoder_frozen")
"""Faults of drives; see `mimic.emulator.faults`."""

Value = Callable[[str, int], float | None]
"""Returns the value of a fault of a joint that is there now, or None."""


class BrokenDrives:
    """The faults of all drives."""

    def __init__(self, wiring: Wiring, body: EmulatedBody, value: Value) -> None:
        self._wiring = wiring
        self._body = body
        self._value = value
        self.stuck: dict[int, float] = {}
        """Joints whose encoder is frozen -> the angle that it reads [rad]."""

    def update(self, i: int, t: float) -> None:
        """Let faults of a joint begin and end at time t [s]."""
        if self._value("encoder_frozen", i) is None:
            self.stuck.pop(i, None)
        elif i not in self.stuck:
            self.stuck[i] = self._body.joint(i, t)[0]
        self._body.jam(i, self._value("joint_jammed", i) or 0.0)

    def drive(self, i: int, drive: Drive, *, running: bool) -> Drive:
        """Return what a motor does instead of what it is told, in its own sign and zero."""
        runaway = self._value("motor_runaway", i)
        weak = self._value("motor_weak", i)
        if runaway is not None and running:
            return Drive(tau=runaway, limit=abs(runaway))
        if i in self.stuck:
            sign = float(self._wiring.sign[i])
            offset = float(self._wiring.offset[i])
            tau = drive.tau + drive.kp * (drive.q - sign * (self.stuck[i] - offset)) + drive.kd * drive.dq
            drive = Drive(tau=float(np.clip(tau, -drive.limit, drive.limit)), limit=drive.limit)
        return drive if weak is None else drive._replace(limit=weak * drive.limit)
