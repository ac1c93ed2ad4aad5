"""Looking at a robot on CAN while people move it: its motors stay off, or only what others ask them is overheard."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mimic.hardware.can.other_programs import holding, others
from mimic.hardware.motors.bus import ALL, MotorBus
from mimic.hardware.motors.imu import ImuReading
from mimic.hardware.motors.interface import MotorMode
from mimic.records import FloatArray, IntArray

POLL = 0.05
"""How often the motors are asked [s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Look:
    """What motors and IMU say at one moment; NaN where nothing came."""

    t: float
    """Time of the link [s]."""
    q: FloatArray
    """Joint angles (12,) [rad]."""
    dq: FloatArray
    """[rad/s]"""
    tau: FloatArray
    """[N m]"""
    temperature: FloatArray
    """[degC]"""
    faults: IntArray
    """Fault bits (12,)."""
    running: int
    """Motors that are switched on."""
    imu: ImuReading
    load: FloatArray
    """Share of each bus's time that was used since the last look (buses,)."""


class Watcher:
    """Looks at a robot. Motors answer only when asked, so it asks them with an order to stop, which they are.

    As soon as another program is heard it asks no more, and takes what the motors answer to that one.
    """

    def __init__(self, motor_bus: MotorBus, *, asks: bool) -> None:
        """Listen for other programs first.

        Args:
            motor_bus: Made with ``overhear``.
            asks: Whether the motors may be asked at all.
        """
        self.motor_bus = motor_bus
        self.only_listens = "" if asks else "another program of this computer uses the bus"
        """Why the motors are not asked; empty where they are."""
        self._before = motor_bus.link.now(), motor_bus.bits.copy()
        if asks:
            self.only_listens = others(motor_bus) or holding(motor_bus)

    def look(self, seconds: float) -> Look:
        """Look for a while, and return the newest readings, none older than that or two polls."""
        motor_bus = self.motor_bus
        link = self.motor_bus.link
        begin = link.now()
        while link.now() < begin + seconds:
            motor_bus.drain()
            if not self.only_listens and motor_bus.foreign:
                self.only_listens = f"another program commands the motors ({motor_bus.foreign_text})"
            if not self.only_listens:
                for joint in ALL:
                    motor_bus.send(joint, motor_bus.motors.stop(motor_bus.id(joint)))
            motor_bus.listen(min(link.now() + POLL, begin + seconds))
        now = link.now()
        since = min(begin, now - 2 * POLL)
        q, dq, tau = motor_bus.readings(since)
        (t0, bits) = self._before
        self._before = (now, motor_bus.bits.copy())
        newest = [f if came > since else None for f, came in zip(motor_bus.feedback, motor_bus.came, strict=True)]
        return Look(
            t=now,
            q=q,
            dq=dq,
            tau=tau,
            temperature=np.array([np.nan if f is None else f.temperature for f in newest]),
            faults=np.array([0 if f is None else f.faults for f in newest]),
            running=sum(f is not None and f.mode == MotorMode.RUNNING for f in newest),
            imu=motor_bus.imu.reading(now),
            load=(motor_bus.bits - bits) / motor_bus.wiring.bitrate / max(now - t0, 1e-3),
        )
