"""A sender in this process, on an emulated robot in the robot's own time: for rehearsals that repeat."""

from __future__ import annotations

from typing import Any

from mimic.hardware.can.driver import CanDriver
from mimic.hardware.can.frame import Link
from mimic.hardware.can.wiring import Wiring
from mimic.hardware.robot.checks import Check, CheckOptions
from mimic.hardware.robot.driver import Driver
from mimic.hardware.robot.plant import Robot
from mimic.hardware.robot.sender import Order, Sender, State, why_lost
from mimic.robot.description import RobotDescription

LONGEST_ENDING = 60.0
"""A sender has ended by then [s]."""


class EmulatedSenderLink:
    """A `mimic.hardware.robot.process.SenderProcess` without a process: waiting advances the emulated robot."""

    def __init__(self, driver: Driver, description: RobotDescription) -> None:
        """Connect a sender to the driver of an emulated robot."""
        self.sender = Sender(driver, description)
        self.halted = False
        """Whether the sender's process stands still or is gone: it sends and reports nothing."""
        self._description = description
        self._ended = False
        self._orders: list[Order] = []
        self._reports: list[Any] = []

    @property
    def driver(self) -> Driver:
        """The sender's driver."""
        return self.sender.driver

    @property
    def problem(self) -> str:
        """Why the sender takes no orders any more; empty while it does."""
        return why_lost(self.sender.reason) if self.sender.state >= State.DAMP else ""

    def now(self) -> float:
        """Return the robot's time [s]."""
        return self.driver.now()

    def checks(self, options: CheckOptions) -> list[Check]:
        """Check a robot that nobody drives; nothing moves."""
        return self.driver.checks(options)

    def start(self, *, suspended: bool = False) -> None:
        """Switch the motors on without gains."""
        self.sender.start(suspended=suspended)

    def order(self, order: Order) -> None:
        """Give an order."""
        if self.halted:
            self._orders.append(order)
        else:
            self.sender.order(order)

    def wait(self, until: float) -> list[Any]:
        """Let robot and sender go on until a time [s], and return the sender's reports."""
        while self.now() < until - 1e-9:
            if self.halted:
                self.driver.listen(until)
                continue
            while self._orders:  # they waited
                self.sender.order(self._orders.pop(0))
            report = self.sender.cycle(until)
            if report is not None:
                self._reports.append(report)
        reports = self._reports
        self._reports = []
        return reports

    def damp(self) -> None:
        """Have the robot damped, by one message."""
        self.sender.finish()

    @property
    def left(self) -> bool:
        """Whether the robot was left, or the sender was ended."""
        return self._ended or self.sender.state == State.DONE

    def end(self) -> None:
        """End the sender."""
        self._ended = True

    def finish(self) -> str:
        """Damp the robot until it rests, and return how it was left."""
        if self.sender.state == State.LISTEN:
            return "nothing was switched on"
        if self._ended:  # whoever is left damps
            self.sender = Sender(self.driver, self._description)
            return self.sender.run()
        end = self.now() + LONGEST_ENDING
        self.sender.finish()
        while self.sender.state != State.DONE and self.now() < end:
            self.sender.cycle(end)
        return self.sender.ending

    def close(self) -> None:
        """There is no process to end."""


def robot_on_can(link: Link, wiring: Wiring, description: RobotDescription, **options: Any) -> Robot:
    """Return the plant of an emulated robot on CAN; options are those of CanDriver."""
    return Robot(EmulatedSenderLink(CanDriver(link, wiring, description, **options), description), description)
