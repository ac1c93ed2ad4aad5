"""Looking at a robot on CAN while people move it: its motors stay off, or only what others ask them is overheard."""

from __future__ import annotations

from typing import Any

import numpy as np

from mimic.hardware.can.driver import CanDriver
from mimic.hardware.can.frame import Link
from mimic.hardware.can.other_programs import holding, others
from mimic.hardware.can.wiring import Wiring
from mimic.hardware.motors.bus import ALL, MotorBus
from mimic.robot.description import RobotDescription

POLL = 0.05
"""How often the motors are asked [s]."""

SENDERS_SHOWN = 6
"""Identifiers of unknown senders that are named."""


class Watcher(CanDriver):
    """Looks at a robot. Motors answer only when asked, so it asks them with an order to stop, which they are.

    As soon as another program is heard it asks no more, and takes what the motors answer to that one.
    """

    def __init__(self, link: Link, wiring: Wiring, description: RobotDescription, *, asks: bool) -> None:
        """Listen for other programs first.

        Args:
            link: The buses.
            wiring: Which motor moves which joint.
            description: The robot.
            asks: Whether the motors may be asked at all.
        """
        super().__init__(link, wiring, description, dry_run=True)
        self.motor_bus = MotorBus(link, wiring, overhear=True)
        self.only_listens = "" if asks else "another program of this computer uses the bus"
        """Why the motors are not asked; empty where they are."""
        self.zeros = ""
        """What is to be said of the zeros."""
        self._before = self.now(), self.motor_bus.bits.copy()
        if asks:
            self.only_listens = others(self.motor_bus) or holding(self.motor_bus)

    def listen(self, until: float, wake: int | None = None) -> bool:
        """Ask the motors again and again until a time [s], and take what comes."""
        motor_bus = self.motor_bus
        while self.now() < until:
            motor_bus.drain()
            if not self.only_listens and motor_bus.foreign:
                self.only_listens = f"another program commands the motors ({motor_bus.foreign_text})"
            if not self.only_listens:
                self._stop(ALL)
            motor_bus.listen(min(self.now() + POLL, until))
        return False

    def counts(self) -> dict[str, int]:
        """Return how many orientations came so far."""
        return {"orientation": self.motor_bus.imu.reading(self.now()).count}

    def notes(self) -> list[str]:
        """Return what there is to say beside the readings, since the last call."""
        motor_bus = self.motor_bus
        (since, bits) = self._before
        self._before = (self.now(), motor_bus.bits.copy())
        load = (motor_bus.bits - bits) / motor_bus.wiring.bitrate / max(self.now() - since, 1e-3)
        names = motor_bus.link.names if len(load) > 1 else ("",)
        shares = ", ".join(f"{name} {share:.0%}".strip() for name, share in zip(names, load, strict=True))
        unknown = ", ".join(name for (_, name), _ in motor_bus.unknown.most_common(SENDERS_SHOWN))
        notes = [
            f"bus load {shares}; {int(self.report['running'].sum())} motors on",
            f"only listening: {self.only_listens}" * bool(self.only_listens),
            self.zeros,
            motor_bus.imu.reading(self.now()).problem or "",
            f"unknown senders: {unknown}" * bool(unknown),
            f"{motor_bus.errors} frames made no sense" * bool(motor_bus.errors),
        ]
        return [note for note in notes if note]


def newest(report: Any, since: float) -> Any:
    """Return a report with NaN for joints, and for an IMU, that said nothing after a time [s]."""
    report = report.copy()
    came = report["came"] if np.isfinite(report["came"]).any() else report["heard"]
    for name in ("q", "dq", "tau", "temperature"):
        report[name] = np.where(came > since, report[name], np.nan)
    for name in ("quat_WB", "omega_B"):
        report[name] = report[name] if report["imu_came"] > since else np.nan
    return report
