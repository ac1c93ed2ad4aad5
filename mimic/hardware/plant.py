"""The robot on its buses: a plant whose joints are twelve motors of any maker."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Protocol

import numpy as np

from mimic.errors import BusError, MimicError, PlantError
from mimic.hardware.can.link import Link
from mimic.hardware.motor import MotorMode, Register
from mimic.hardware.motor_bus import ALL, MotorBus
from mimic.hardware.shutdown import damp, shutdown_report, switch_off
from mimic.hardware.step_budget import PARTS, SPARE, step_budget
from mimic.hardware.wiring import Wiring
from mimic.records import JOINTS, FloatArray, Health, JointCommand, RobotState, Tick
from mimic.robot.description import RobotDescription

OUTAGE = 0.1
"""A bus that fails for longer than this ends the run [s]. The motors go on with their last commands meanwhile."""

ASK_EVERY = 5
"""Control steps between two questions for a supply voltage, whose answers also show how long answers take."""


class Watchdog(Protocol):
    """Damps the robot when this process cannot; see `mimic.hardware.watchdog`."""

    def arm(self) -> None:
        """Start watching: from now on the robot is damped when no beat comes."""
        ...

    def beat(self) -> None:
        """Report that this process is alive."""
        ...

    def alive(self) -> bool:
        """Return whether it is still watching; False also once it has taken over."""
        ...

    def disarm(self) -> None:
        """Stop watching: the motors are off."""
        ...

    def take_over(self) -> str:
        """Damp the robot now, because this process cannot; return how the robot was left, or nothing if unknown."""
        ...


def idle_command(q: FloatArray) -> JointCommand:
    """Return the command without gains and without torque."""
    zeros = np.zeros(len(JOINTS))
    return JointCommand(q_des=np.nan_to_num(q), dq_des=zeros, kp=zeros, kd=zeros, tau_ff=zeros)


def set_host_timeout(motor_bus: MotorBus) -> bool:
    """Ask the motors to stop by themselves when no host sends anything; return whether all of them read it back."""
    value = motor_bus.motors.facts.host_timeout
    return bool(np.all(np.abs(motor_bus.write(Register.HOST_TIMEOUT, value) - value) < 0.5))


class CanRobot:
    """Twelve motors and an IMU in real time: a step lasts one control step of the link's clock.

    The state holds what the motors answered during the step. A joint that did not answer is NaN, and its age grows in
    the health. The position of the base is not measured.
    """

    def __init__(
        self,
        link: Link,
        wiring: Wiring,
        description: RobotDescription,
        *,
        torque_limit: float | None = None,
        watchdog: Watchdog | None = None,
        outage: float = OUTAGE,
    ) -> None:
        """Prepare the plant; nothing is sent yet.

        Args:
            link: The buses of the robot.
            wiring: Which motor moves which joint, with the offsets of this power-up.
            torque_limit: Largest torque of each motor [N m]; by default its peak torque.
            watchdog: Damps the robot when this process cannot.
            outage: How long a bus may fail before the run ends [s].
        """
        self._description = description
        self._outage = outage
        self._failing: float | None = None
        self._failed, self._outages = False, 0
        self._steps = 0
        self.motor_bus = MotorBus(link, wiring)
        self._link = link
        self._budget = step_budget(wiring, description.dt, PARTS)
        self._watchdog = watchdog
        self._torque_limit = description.torque_max if torque_limit is None else torque_limit
        self._on = self._closed = False
        self._before: FloatArray | None = None
        self._missed = np.zeros(len(JOINTS), dtype=int)
        self._bits = self.motor_bus.bits.copy()
        self._began = self._ended = self._due = self._link.now()
        self.timeout_taken = False
        """Whether the motors stop by themselves when this computer sends nothing."""
        self.ending = "nothing was switched on"
        """How the robot was left, as a sentence without a full stop."""

    @property
    def description(self) -> RobotDescription:
        """The description of the robot."""
        return self._description

    def start(self) -> RobotState:
        """Switch the motors on where they are, without gains, and return the state.

        Raises:
            PlantError: If a motor does not answer, or does not accept its settings.
            BusError: If a bus fails.
        """
        motor_bus = self.motor_bus
        self._closed, self._before = False, None
        self._need(motor_bus.stop())
        if Register.CONTROL_MODE in motor_bus.motors.facts.registers:  # only a motor that is off may change it
            motor_bus.set(Register.CONTROL_MODE, motor_bus.motors.facts.impedance_mode)
        motor_bus.set(Register.TORQUE_LIMIT, self._torque_limit)
        self.timeout_taken = set_host_timeout(motor_bus)
        if self._watchdog is not None:
            self._watchdog.arm()
        self._on = True
        self._need(motor_bus.enable())
        off = [JOINTS[j] for j, f in enumerate(motor_bus.feedback) if f is not None and f.mode != MotorMode.RUNNING]
        if off:
            raise PlantError(f"{', '.join(off)} did not switch on; to see why, run: mimic robot check")
        self._missed[:] = 0
        self._began = self._ended = self._due = self._link.now()
        self._bits = self.motor_bus.bits.copy()
        q, _, _ = self.motor_bus.readings(-np.inf)
        return self.step(idle_command(q)).state

    def _need(self, silent: list[int]) -> None:
        if silent:
            names = ", ".join(JOINTS[j] for j in silent)
            raise PlantError(f"no answer from {names}; is the power on? Run: mimic robot scan")

    def step(self, command: JointCommand) -> Tick:
        """Send a command, collect the answers, and wait for the end of the control step.

        Raises:
            BusError: If a bus fails for longer than it may.
        """
        link, motor_bus, dt = self._link, self.motor_bus, self._description.dt
        self.beat()
        self._failed = False
        with self._tolerated():
            motor_bus.drain()
        asked = link.now()
        compute = asked - self._ended
        self._due += dt
        unsent = np.full(len(JOINTS), np.nan)
        sent = replace(command, q_des=unsent, kp=unsent, kd=unsent)
        with self._tolerated():
            sent = self._send(command, asked)
            self._ask()
        until = max(self._due, asked + self._budget.answers + SPARE)  # after a late start the first answers, no more
        with self._tolerated():
            motor_bus.listen(until)
        self._failing = self._failing if self._failed else None
        self._outages += self._failed
        link.sleep(max(until - link.now(), 0.0))
        now = link.now()
        late, self._ended = now - self._due, now
        if late > dt:
            self._due = now  # missed time is not caught up
        self.count(asked)
        return Tick(state=self.state(asked, now), sent=sent, health=self.health(compute, late, now))

    def _ask(self) -> None:
        """Ask one motor after the other for its supply voltage; where it has none to tell, for its position."""
        turn, rest = divmod(self._steps, ASK_EVERY)
        self._steps += 1
        if rest == 0:
            joint = turn // 2 % len(JOINTS)
            register = (Register.SUPPLY_VOLTAGE, Register.POSITION)[turn % 2]
            self.motor_bus.ask_round_trip(joint, register)

    @contextmanager
    def _tolerated(self) -> Iterator[None]:
        """Go on when a bus fails, but not for long.

        Raises:
            BusError: If it has failed for longer than it may.
        """
        try:
            yield
        except BusError:
            self._failed = True
            now = self._link.now()
            self._failing = now if self._failing is None else self._failing
            if now - self._failing >= self._outage:
                raise

    def _send(self, command: JointCommand, asked: float) -> JointCommand:
        """Send a command, in several parts where it is interpolated; return what was sent last."""
        before, self._before = self._before, command.q_des
        if command.ramp <= 0.0 or before is None:
            return self.motor_bus.command(command)
        sent, parts, slot = command, self._budget.parts, self._budget.slot
        begin = self._due - self._budget.dt
        for part in range(min(max(int((asked - begin) / slot), 0), parts - 1), parts):  # not those whose time is over
            self.motor_bus.listen(begin + part * slot)
            q_des = before + (part + 1) / parts * (command.q_des - before)
            sent = self.motor_bus.command(replace(command, q_des=q_des))
        return replace(sent, ramp=command.ramp)

    def beat(self) -> None:
        """Report to the watchdog that this process is alive."""
        if self._watchdog is not None:
            self._watchdog.beat()

    def count(self, since: float) -> None:
        """Count the steps in which a motor did not answer; call once a step with the time of its commands [s]."""
        self._missed = np.where(self.motor_bus.came > since, 0, self._missed + 1)

    def state(self, since: float | FloatArray, now: float) -> RobotState:
        """Return the state from the answers that came after a time [s], or after one time for each joint (12,)."""
        q, dq, tau = self.motor_bus.readings(since)
        reading = self.motor_bus.imu.reading(now)
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
        """Return age and faults of the readings: how far they can be trusted now."""
        motor_bus = self.motor_bus
        newest, imu = motor_bus.feedback, motor_bus.imu.reading(now)
        faults = [0 if f is None else int(f.faults) for f in newest]
        return Health(
            age=now - motor_bus.came,
            missed=self._missed.copy(),
            faults=np.bitwise_or(faults, motor_bus.faults).astype(np.int64),
            running=np.array([f is not None and f.mode == MotorMode.RUNNING for f in newest]),
            temperature=motor_bus.temperature(),
            imu_age=imu.age,
            imu_unchanged=imu.unchanged,
            imu_count=imu.count,
            imu_valid=imu.valid,
            compute=compute,
            late=max(late, 0.0),
            bus_errors=motor_bus.errors + self._outages,
            guarded=self._watchdog is None or self._watchdog.alive(),
            foreign=motor_bus.foreign,
            voltage=motor_bus.voltage(),
            round_trip=motor_bus.round_trip,
        )

    def load(self) -> FloatArray:
        """Return the share of time that each bus was busy since the start, from the frames seen here (buses,)."""
        seconds = max(self._link.now() - self._began, self._description.dt)
        return (self.motor_bus.bits - self._bits) / self.motor_bus.wiring.bitrate / seconds

    def close(self) -> None:
        """Damp the robot until it rests, then switch its motors off. Safe to call twice; never raises MimicError."""
        if self._closed or not self._on:
            return
        self._closed, self._on = True, False
        if self._failing is not None and self._watchdog is not None and self._watchdog.alive():
            self.ending = self._watchdog.take_over()  # it opens the buses again
            if self.ending:
                return
        self.ending = "its motors were being damped when this program was interrupted"
        try:
            with suppress(KeyboardInterrupt):  # whoever insists gets motors that are off
                damp(self.motor_bus, self._description, self.beat)
            left = switch_off(self.motor_bus, self._description, self.beat)
            self.ending = shutdown_report(left)
        except MimicError as reason:
            left, self.ending = list(ALL), f"the motors could not be stopped: {reason}; cut the power"
        if self._watchdog is None:
            return
        if not left:
            self._watchdog.disarm()
        elif told := self._watchdog.take_over():
            self.ending = told
