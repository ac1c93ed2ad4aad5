"""The robot on its bus: a plant whose joints are twelve CyberGear motors."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from mimic.errors import MimicError, PlantError
from mimic.robot.description import RobotDescription
from mimic.robot.wiring import Wiring
from mimic.run.brake import damp, switch_off, told_off
from mimic.run.exchange import ALL, Exchange
from mimic.run.link import Link
from mimic.run.motor_messages import CAN_TIMEOUT, LIMIT_TORQUE, RUN_MODE, Enable, Mode, RunMode, Stop
from mimic.types import JOINTS, FloatArray, Health, JointCommand, RobotState, Tick

ANSWERS = 0.005
"""For so long at least answers are waited for, also where the step began late: twelve commands and answers take 3.4 ms [s]."""

TIMEOUT = 4000
"""What CAN_TIMEOUT is set to: 0.2 s if it counts 50 us as in the successor's firmware, 4 s if it counts milliseconds; nobody
has published which, nor that a public frame can set it."""


class Watcher(Protocol):
    """Something that damps the robot when this process cannot; see :mod:`mimic.run.guardian`."""

    def arm(self) -> None:
        """From now on the robot must be damped if no beat comes."""
        ...

    def beat(self) -> None:
        """Say that all is well."""
        ...

    def alive(self) -> bool:
        """Return whether it still watches; False also when it has taken over."""
        ...

    def disarm(self) -> None:
        """The motors are off; nothing needs to be watched."""
        ...

    def take_over(self) -> None:
        """Damp the robot now: this process cannot."""
        ...


def still(q: FloatArray) -> JointCommand:
    """Return the command that asks for nothing: no gains, no torque."""
    zeros = np.zeros(len(JOINTS))
    return JointCommand(q_des=np.nan_to_num(q), dq_des=zeros, kp=zeros, kd=zeros, tau_ff=zeros)


def set_timeout(exchange: Exchange) -> bool:
    """Ask the motors to stop by themselves without a host, and return whether all of them read back that they will."""
    return bool(np.all(np.abs(exchange.write(CAN_TIMEOUT, float(TIMEOUT)) - TIMEOUT) < 0.5))


class CanRobot:
    """Twelve motors and an IMU, in real time: a step lasts one control step of the link's clock.

    The state of a step holds what the motors answered in it; a joint that did not answer is NaN, and its age grows in the
    health. The base's position is not measured.
    """

    def __init__(
        self,
        link: Link,
        wiring: Wiring,
        description: RobotDescription,
        *,
        torque_limit: float | None = None,
        watcher: Watcher | None = None,
    ) -> None:
        """Take a robot; nothing is sent yet.

        Args:
            link: Its buses.
            wiring: What hangs where, with the offsets of this power-up.
            torque_limit: What each motor may give [N m]; by default its peak torque.
            watcher: Damps the robot when this process cannot.
        """
        self._description = description
        self.exchange = Exchange(link, wiring)
        self._link = link
        self._watcher = watcher
        self._torque_limit = description.torque_max if torque_limit is None else torque_limit
        self._on = self._closed = False
        self._missed = np.zeros(len(JOINTS), dtype=int)
        self._bits = self.exchange.bits.copy()
        self._began = self._ended = self._due = self._link.now()
        self.timeout_taken = False
        """Whether the motors stop by themselves when this computer is silent."""
        self.ending = "nothing was switched on"
        """How the robot was left, as a sentence without its full stop."""

    @property
    def description(self) -> RobotDescription:
        """The robot's numbers."""
        return self._description

    def start(self) -> RobotState:
        """Switch the motors on where they are, without gains, and return the state.

        Raises:
            PlantError: If a motor does not answer, or does not take its settings.
            BusError: If a bus fails.
        """
        host = self.exchange.wiring.host
        self._closed = False
        self._need(self.exchange.ask_feedback(lambda motor: Stop(motor=motor, host=host)))
        self.exchange.set(RUN_MODE, float(RunMode.OPERATION), "run_mode")  # only a motor that is off may change it
        self.exchange.set(LIMIT_TORQUE, self._torque_limit, "limit_torque")
        self.timeout_taken = set_timeout(self.exchange)
        if self._watcher is not None:
            self._watcher.arm()
        self._on = True
        self._need(self.exchange.ask_feedback(lambda motor: Enable(motor=motor, host=host)))
        off = [JOINTS[j] for j, f in enumerate(self.exchange.feedback) if f is not None and f.mode != Mode.RUN]
        if off:
            raise PlantError(f"{', '.join(off)} did not switch on; look for faults with: mimic robot check")
        self._missed[:] = 0
        self._began = self._ended = self._due = self._link.now()
        self._bits = self.exchange.bits.copy()
        q, _, _ = self.exchange.readings(-np.inf)
        return self.step(still(q)).state

    def _need(self, silent: list[int]) -> None:
        if silent:
            names = ", ".join(JOINTS[j] for j in silent)
            raise PlantError(f"no answer from {names}; is the power on? Look with: mimic robot scan")

    def step(self, command: JointCommand) -> Tick:
        """Send a command, collect the answers, and wait for the end of the control step.

        Raises:
            BusError: If a bus fails.
            PlantError: If the guardian has taken over.
        """
        link, exchange, dt = self._link, self.exchange, self._description.dt
        self.beat()
        exchange.drain()
        asked = link.now()
        compute = asked - self._ended
        sent = exchange.command(command)
        self._due += dt
        exchange.listen(max(self._due, asked + ANSWERS))
        now = link.now()
        late, self._ended = now - self._due, now
        if late > dt:
            self._due = now  # what was missed is not made up for
        self.count(asked)
        return Tick(state=self.state(asked, now), sent=sent, health=self.health(compute, late, now))

    def beat(self) -> None:
        """Tell the guardian that all is well."""
        if self._watcher is not None:
            self._watcher.beat()

    def count(self, since: float) -> None:
        """Count the steps without an answer, once a step, by who answered after a time [s]."""
        self._missed = np.where(self.exchange.came > since, 0, self._missed + 1)

    def state(self, since: float | FloatArray, now: float) -> RobotState:
        """Return what came after a time [s], or after one for each joint (12,), as it is now."""
        q, dq, tau = self.exchange.readings(since)
        reading = self.exchange.imu.reading(now)
        nothing = np.full(3, np.nan)
        return RobotState(
            t=now - self._began,
            q=q,
            dq=dq,
            tau=tau,
            quat_WB=reading.quat_WB,
            omega_B=reading.omega_B,
            p_WB=nothing,
            v_WB=nothing,
        )

    def health(self, compute: float, late: float, now: float) -> Health:
        """Return how far the readings can be trusted now."""
        exchange = self.exchange
        newest, imu = exchange.feedback, exchange.imu.reading(now)
        faults = [0 if f is None else int(f.faults) for f in newest]
        return Health(
            age=now - exchange.came,
            missed=self._missed.copy(),
            faults=np.bitwise_or(faults, exchange.faults).astype(np.int64),
            running=np.array([f is not None and f.mode == Mode.RUN for f in newest]),
            temperature=exchange.temperature(),
            imu_age=imu.age,
            imu_unchanged=imu.unchanged,
            imu_count=imu.count,
            imu_valid=imu.valid,
            compute=compute,
            late=max(late, 0.0),
            bus_errors=exchange.errors,
            guarded=self._watcher is None or self._watcher.alive(),
        )

    def load(self) -> FloatArray:
        """Return which share of its time each bus was busy since the start, by the frames seen here (buses,)."""
        seconds = max(self._link.now() - self._began, self._description.dt)
        return (self.exchange.bits - self._bits) / self.exchange.wiring.bitrate / seconds

    def close(self) -> None:
        """Damp the robot until it rests, then switch its motors off. Safe to call twice; raises nothing that it can help."""
        if self._closed or not self._on:
            return
        self._closed, self._on = True, False
        try:
            damp(self.exchange, self._description, self.beat)
            left = switch_off(self.exchange, self._description, self.beat)
            self.ending = told_off(left)
        except MimicError as reason:
            left, self.ending = list(ALL), f"the motors could not be stopped: {reason}"
        if self._watcher is not None:
            self._watcher.take_over() if left else self._watcher.disarm()
