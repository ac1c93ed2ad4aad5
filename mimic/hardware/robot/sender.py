"""The only way to a motor: newest target in, commands out, and damping where no target comes.

    control loop --Order--> Sender --> Driver (CAN, motion board) --> motors
                 <--REPORT--

The sender puts targets on a line between two orders, and checks each of them itself. It damps when it is told to, when
no order has come for ORDER_TIMEOUT, when one is not as it should be, and when anything fails; then until the robot
rests and its motors are off. Once it damps it never drives again. It has no clock and no process of its own:
`mimic.hardware.robot.process` runs it beside the control loop.
"""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import replace
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np

from mimic.errors import FrameError, MimicError
from mimic.frozen import frozen_arrays
from mimic.hardware.robot.driver import Driver
from mimic.records import JointCommand
from mimic.robot.description import RobotDescription

ORDER_TIMEOUT = 0.1
"""Five control steps without an order [s]; the loop itself damps when one step is that late."""

REPORT_PERIOD = 0.0025
"""Longest time between two reports of a robot that is not sent to all the time [s]."""

KEEPS_MOVING = 1.5
"""Control steps from the begin of an order for which joints are asked to move; within one more, none is any more. A
motor overshoots a target by kd dq_des / kp: a fast arm by 1 rad."""

ORDER_STEP = 2.5
"""Targets of two orders in a row differ by at most this [rad]; those of the shipped policy by up to 1.83."""

GAIN_TOLERANCE = 1e-6
"""A gain may be this share beyond its limit, for rounding."""

_MOMENT = 1e-6
"""Times that differ by less are the same [s]."""

GIVE_UP = 30.0
"""Time before giving up on an unreachable robot [s]."""


class State(IntEnum):
    """What the sender sends."""

    LISTEN = 0
    """Nothing."""
    DRIVE = 1
    """The newest target."""
    DAMP = 2
    """Damping, until the robot rests; then ENDING."""
    ENDING = 3
    """Switching off; then DONE."""
    DONE = 4
    """Nothing any more."""


@frozen_arrays
class Order:
    """What the control loop wants of the joints."""

    command: JointCommand
    begin: float
    """When its control step was planned to begin [s]; the parts of an interpolated command keep to it."""


def why_lost(reason: str) -> str:
    """Return why a sender takes no more orders, as a sentence without its full stop.

    Args:
        reason: Why it took over; empty where nothing says so.
    """
    took_over = f"the process that sends damped the robot: {reason}"
    return took_over if reason else "the process that sends to the robot has ended"


class Sender:
    """Decides what is sent, from orders, readings and time."""

    def __init__(self, driver: Driver, description: RobotDescription) -> None:
        """Begin in LISTEN."""
        self.driver = driver
        self._limits = description.safety
        self._description = description
        self.state = State.LISTEN
        self.reason = ""
        """Why it took over from the control loop, as a sentence without its full stop; empty where it did not."""
        self.ending = ""
        """How the robot was left, as a sentence without its full stop; once DONE."""
        self.failure = ""
        """What was raised first that nobody expected, and where; empty where nothing was."""
        self._fails_since = np.inf
        self._order: Order | None = None
        self._from: JointCommand | None = None
        self._ordered = self._due = np.inf
        self._since = self._reached = self._rested = self._reported = 0.0
        self._rests = False
        self._pause = driver.period if driver.repeats else 0.5 * description.dt  # an answer in each control step

    # ------------------------------------------------------------------ orders

    def start(self, *, suspended: bool = False) -> None:
        """Switch the motors on without gains.

        Raises:
            MimicError: If something stands against it; what was switched on is damped then.
        """
        try:
            self.driver.start(suspended=suspended)
        except Exception as reason:
            self.ending = self.driver.abandon()
            if self.ending:
                self.state = State.DONE
            else:
                self.damp("")
            if not isinstance(reason, MimicError):
                self.failure = _place(reason)
            raise
        self.state = State.DRIVE  # without gains the motors may wait for an order

    def order(self, order: Order) -> None:
        """Take an order; one that is not as it should be damps the robot, and one that is too old counts as none."""
        if self.state != State.DRIVE:
            return  # a robot that is damped is not driven again
        now = self.driver.now()
        c = order.command
        if abs(now - order.begin) > ORDER_TIMEOUT:
            return
        against = self._against(c)
        if against:
            self.damp(against)
            return
        self._from = c if self._order is None or c.ramp <= 0.0 else self._part(now)
        self._order = order
        self._ordered = now
        self._due = now

    def _against(self, c: JointCommand) -> str:
        """Return what stands against a command: its numbers, its gains or its step; empty where nothing does."""
        d = self._description
        if not np.isfinite([c.q_des, c.dq_des, c.kp, c.kd, c.tau_ff]).all():
            return "a command holds numbers that are not finite"
        for name, gain, most in (("Kp", c.kp, d.kp_max), ("Kd", c.kd, d.kd_max)):
            if gain.min() < 0.0 or gain.max() > most * (1.0 + GAIN_TOLERANCE):
                return f"an order has {name} from {gain.min():g} to {gain.max():g}; expected 0 to {most:g}"
        if self._order is None:
            return ""
        driven = (c.kp > 0.0) & (self._order.command.kp > 0.0)
        step = float(np.max(np.abs(c.q_des - self._order.command.q_des), where=driven, initial=0.0))
        if step > ORDER_STEP:
            return f"an order moves a target by {step:.2f} rad at once; at most {ORDER_STEP:g} rad"
        return ""

    def finish(self) -> None:
        """Damp the robot until it rests, and switch it off; this is not taken back."""
        if self.state == State.LISTEN:
            self.state = State.DONE
            self.ending = "nothing was switched on"
        elif self.state == State.DRIVE:
            self.damp("")

    def closed(self) -> None:
        """Take note that no more orders can come."""
        if self.state == State.DRIVE:
            self.damp("the process that drives the robot has ended")
        else:
            self.finish()

    def damp(self, reason: str) -> None:
        """Take over for a reason: damp from now on."""
        self.state = State.DAMP
        self.reason = reason
        self._since = self._reached = self._rested = self._due = self.driver.now()

    def fail(self, reason: Exception) -> None:
        """Damp the robot after something was raised that nobody expected, whatever else does not work."""
        now = self.driver.now()
        self.failure = self.failure or _place(reason)
        self._fails_since = min(self._fails_since, now)
        if self.state < State.DAMP:
            self.damp(f"it failed: {self.failure}")
        with suppress(Exception):
            self.driver.damp()
        try:
            self.driver.listen(now + self.driver.period)
        except Exception:
            time.sleep(self.driver.period)
        if self.fails_for > self._limits.damp_seconds:
            self.state = State.DONE
            self.ending = f"damping was sent, but how the robot was left is not known ({self.failure}): cut the power"

    @property
    def fails_for(self) -> float:
        """For how long nothing could be sent without an exception [s]."""
        return max(self.driver.now() - self._fails_since, 0.0)

    # ------------------------------------------------------------------ time

    def cycle(self, until: float, wake: int | None = None) -> Any:
        """Send what is due, listen until a time [s] or until more is due, and return a report if it is time for one.

        What is raised meanwhile damps the robot.

        Args:
            until: On the driver's clock.
            wake: Descriptor; also return when something is to be read from it.
        """
        try:
            return self._cycle(until, wake)
        except Exception as reason:
            self.fail(reason)
            return None

    def _cycle(self, until: float, wake: int | None) -> Any:
        driver = self.driver
        self._send(driver.now())
        report_at = self._reported + (self._pause if driver.repeats else REPORT_PERIOD)
        complete = driver.listen(min(until, self._due, report_at), wake)
        now = driver.now()
        if not complete and now < report_at - _MOMENT:
            return None
        self._reported = now
        report = driver.report.copy()
        report["t"] = now
        report["state"] = self.state
        return report

    def run(self) -> str:
        """Damp the robot to the end, and return how it was left."""
        if self.state < State.DAMP:
            self.damp("")
        while self.state != State.DONE:
            self.cycle(self.driver.now() + 1.0)
        return self.ending

    def _send(self, now: float) -> None:
        if self.state == State.DRIVE and now - self._ordered > ORDER_TIMEOUT:
            self.damp(f"no order for {now - self._ordered:.2f} s")
        if now < self._due - _MOMENT:
            return
        if self.state == State.DRIVE:
            self._drive(now)
        elif self.state == State.DAMP:
            self._due = now + self._pause
            self._settle(now)  # by the answers to the last damping
            self.driver.damp()
        else:
            self._due = now + self._pause
            ending = self.driver.end(since=self._since, rested=self._rests)
            if ending is not None:
                self.state = State.DONE
                self.ending = ending
                self._due = np.inf
        self._fails_since = np.inf

    def _drive(self, now: float) -> None:
        order = self._order
        driver = self.driver
        assert order is not None
        try:
            driver.drive(self._part(now))
        except FrameError as reason:
            self.damp(str(reason))
            return
        self._due = order.begin + self._slot_end(now)
        if not driver.repeats and self._due > order.begin + order.command.ramp - 0.5 * driver.period:
            self._due = self._due_late(self._due)

    def _part(self, now: float) -> JointCommand:
        """Return the command of a message that holds for one period."""
        order = self._order
        assert order is not None
        command = order.command
        begin = self._from
        moves = min(max(1.0 + KEEPS_MOVING - self._slot_end(now) / self._description.dt, 0.0), 1.0)
        if moves < 1.0:
            return replace(command, dq_des=moves * command.dq_des)
        if command.ramp <= 0.0 or begin is None:
            return command
        share = min(max(self._slot_end(now) / command.ramp, 0.0), 1.0)
        numbers = "q_des", "dq_des", "tau_ff"
        return replace(command, **{n: (1.0 - share) * getattr(begin, n) + share * getattr(command, n) for n in numbers})

    def _due_late(self, due: float) -> float:
        """Return when a motor that keeps its command needs another part, once all parts of the order are out [s]."""
        order = self._order
        dt = self._description.dt
        assert order is not None
        fades = order.begin + KEEPS_MOVING * dt
        moves = order.command.dq_des.any() and due < fades + dt - 0.5 * self.driver.period
        return max(due, fades) if moves else np.inf

    def _slot_end(self, now: float) -> float:
        """Return when the period in which a time is ends, from the begin of the order's step on [s]."""
        assert self._order is not None
        period = self.driver.period
        return (np.floor((now - self._order.begin + _MOMENT) / period) + 1.0) * period

    def _settle(self, now: float) -> None:
        """End the damping once the robot rests, or after the longest time for it."""
        limits = self._limits
        lost = self.driver.lost
        self._reached = now if lost else self._reached
        if not self.driver.speed() < limits.rest_speed:
            self._rested = now
        self._rests = now - self._rested >= limits.rest_seconds
        given_up = lost and now - self._since >= GIVE_UP
        if self._rests or given_up or now - self._reached >= limits.damp_seconds:
            self.state = State.ENDING
            self._since = now


def _place(reason: Exception) -> str:
    """Return what was raised and where, in one line."""
    traced = reason.__traceback__
    while traced is not None and traced.tb_next is not None:
        traced = traced.tb_next
    where = "" if traced is None else f" ({Path(traced.tb_frame.f_code.co_filename).name}:{traced.tb_lineno})"
    text = " ".join(str(reason).split())
    return f"{type(reason).__name__}: {text}{where}"
