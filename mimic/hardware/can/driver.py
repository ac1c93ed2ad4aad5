"""Twelve motors and an IMU on CAN behind mimic's `mimic.hardware.robot.driver.Driver`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import cycle, product
from typing import Any

import numpy as np

from mimic.control.plant import damping_command
from mimic.errors import BusError
from mimic.hardware.can.frame import Link
from mimic.hardware.can.preflight import preflight
from mimic.hardware.can.step_budget import PARTS
from mimic.hardware.can.wiring import Wiring
from mimic.hardware.can.zeros import Homing
from mimic.hardware.motors import registers
from mimic.hardware.motors.bus import MotorBus
from mimic.hardware.motors.interface import MotorMode, Register
from mimic.hardware.robot.checks import Check, CheckOptions
from mimic.hardware.robot.driver import ALL, no_report
from mimic.records import JOINTS, FloatArray, JointCommand, joint_names
from mimic.robot.description import RobotDescription

ASK_EVERY = 0.1
"""Time between two questions for a supply voltage, whose answers also show how long answers take [s]."""

REFUSES = 0.05
"""A bus that has taken nothing for so long is opened again while the robot is damped; also from one attempt to the next
[s]."""

DEAD = 0.3
"""… and one that has said nothing for so long, as when an adapter was taken out while frames go into a buffer [s]."""

STOP_FOR = 1.0
"""Stops are sent until every motor confirms, for this long at most [s]: a busy computer reads late."""

HEEDS = 0.1
"""From this long after the first damping on, motors that damp have no torque but what brakes them [s]."""

BEYOND_BRAKE = 0.3
"""Torque beyond kd times the faster of two velocities in a row that shows that a motor is driven, as a share of its
peak. Emulated robots that fall damped show up to 0.2."""

_LOOK = 0.002
"""How often to look for orders while a bus fails [s]."""


class CanDriver:
    """See `mimic.hardware.robot.driver.Driver`."""

    repeats = False

    def __init__(
        self,
        link: Link,
        wiring: Wiring,
        description: RobotDescription,
        *,
        torque_limit: float | None = None,
        homing: Homing | None = None,
        zeroed: bool = False,
        dry_run: bool = False,
    ) -> None:
        """Take open buses; nothing is sent.

        Args:
            link: The buses of the robot.
            wiring: Which motor moves which joint, with the offsets of this power-up.
            description: The robot.
            torque_limit: Largest torque of each motor [N m]; by default its peak torque.
            homing: What is known about its zeros.
            zeroed: Use the zeros as the wiring has them.
            dry_run: The motors stay off; they are asked for readings by orders to stop.
        """
        self.period = description.dt / PARTS
        self.problem = ""
        self.motor_bus = MotorBus(link, wiring)
        self._description = description
        self._homing = homing
        self._zeroed = zeroed
        self._dry = dry_run
        self._torque_limit = float(description.torque_max.min()) if torque_limit is None else torque_limit
        self._report = no_report()
        self._failures = 0
        self._questions = cycle(product(ALL, (Register.SUPPLY_VOLTAGE, Register.POSITION)))
        """One motor after the other is asked for its supply voltage; where it has none to tell, for its position."""
        self._tried: FloatArray = np.full(wiring.buses, -np.inf)
        self._next_question = -np.inf
        self._waits: float | None = None
        """When the motors were asked that have not all answered [s]."""
        self._damped = -np.inf
        self._heeds = np.inf
        self._dq: FloatArray = np.zeros(len(JOINTS))
        self._driven = np.zeros(len(JOINTS), dtype=int)
        """Answers of each motor that show that it is driven although it was told to damp."""
        self._left = list(ALL)
        self._on = False

    @property
    def report(self) -> Any:
        """Newest readings; a scalar of REPORT."""
        motor_bus = self.motor_bus
        report = self._report
        now = self.now()
        report["q"], report["dq"], report["tau"] = motor_bus.readings(-np.inf)
        report["came"] = motor_bus.came
        newest = motor_bus.feedback
        report["faults"] = np.bitwise_or([0 if f is None else int(f.faults) for f in newest], motor_bus.faults)
        report["running"] = [f is not None and f.mode == MotorMode.RUNNING for f in newest]
        report["temperature"] = motor_bus.temperature()
        imu = motor_bus.imu.reading(now)
        report["quat_WB"] = imu.quat_WB
        report["omega_B"] = imu.omega_B
        report["imu_came"] = now - imu.age
        report["imu_changed"] = now - imu.unchanged
        report["imu_count"] = imu.count
        report["imu_valid"] = -1 if imu.valid is None else imu.valid
        report["heard"] = max(motor_bus.came.max(), report["imu_came"])
        report["errors"] = motor_bus.errors + self._failures
        report["foreign"] = motor_bus.foreign
        report["voltage"] = motor_bus.voltage()
        report["round_trip"] = motor_bus.round_trip
        busy = motor_bus.bits / motor_bus.wiring.bitrate
        report["busy"][: len(busy)] = busy
        return report

    def now(self) -> float:
        """Return the time of the buses [s]."""
        return self.motor_bus.link.now()

    def checks(self, options: CheckOptions) -> list[Check]:
        """Check a robot whose motors are off; nothing moves."""
        return preflight(self.motor_bus, self._description, options, homing=self._homing, trust_zeros=self._zeroed)

    # ------------------------------------------------------------------ driving

    def start(self, *, suspended: bool) -> None:
        """Switch the motors on where they are, without gains.

        Raises:
            PlantError: If a motor does not answer, or does not accept its settings.
            BusError: If a bus fails.
        """
        registers.need_all_off(self.motor_bus)
        if not self._dry:
            registers.set_up(self.motor_bus, self._torque_limit)
            self._on = True
            registers.switch_on(self.motor_bus)

    def abandon(self) -> str:
        """Return that nothing was switched on, where that is so."""
        return "" if self._on else "nothing was switched on"

    def drive(self, command: JointCommand) -> None:
        """Send a command; where a bus does not take it, the report's ``q_sent`` is NaN."""
        motor_bus = self.motor_bus
        now = self.now()
        sent = None
        with self._noted():
            motor_bus.drain()
        with self._noted():
            if self._dry:
                self._stop(ALL)
                sent = command
            else:
                sent = motor_bus.command(command)
            if now >= self._next_question:
                self._next_question = now + ASK_EVERY
                motor_bus.ask_round_trip(*next(self._questions))
        self._note_sent(sent, ALL)
        self._waits = now

    def _note_sent(self, sent: JointCommand | None, joints: Sequence[int]) -> None:
        """Count a command to these joints in the report; None where their bus did not take it."""
        report = self._report
        asked = list(joints)
        report["sent"] += 1
        for name, value in (("q_sent", "q_des"), ("kp_sent", "kp"), ("kd_sent", "kd")):
            report[name][asked] = np.nan if sent is None else getattr(sent, value)[asked]

    def _stop(self, joints: Sequence[int]) -> None:
        motor_bus = self.motor_bus
        for joint in joints:
            motor_bus.send(joint, motor_bus.motors.stop(motor_bus.id(joint)))

    @contextmanager
    def _noted(self) -> Iterator[None]:
        """Note where a bus fails, and go on."""
        try:
            yield
        except BusError as reason:
            self._failures += 1
            self.problem = str(reason)

    def listen(self, until: float, wake: int | None = None) -> bool:
        """Take what comes until a time [s]; return early, with True, once every motor that was asked has answered."""
        link = self.motor_bus.link
        link.wake = wake
        link.woken = False
        failures = self._failures
        with self._noted():
            self.motor_bus.listen(until, lambda: self._complete() or link.woken)
        if self._failures > failures:
            left = max(until - self.now(), 0.0)
            link.sleep(left if wake is None else min(left, _LOOK))
        if self._complete():
            self._waits = None
            self.problem = ""
            return True
        return False

    def _complete(self) -> bool:
        return self._waits is not None and bool(np.all(self.motor_bus.came > self._waits))

    # ------------------------------------------------------------------ damping and off

    def damp(self) -> None:
        """Damp every motor as much as it can, or switch off what is driven all the same.

        A bus that fails is opened again; the others are still served.
        """
        motor_bus = self.motor_bus
        d = self._description
        now = self.now()
        self._note_driven(now)
        off = (self._driven > 1) | (np.count_nonzero(self._driven) > 2) | self._dry
        q, _, _ = motor_bus.readings(-np.inf)
        q = np.clip(np.where(np.isnan(q), d.poses["lie"], q), d.q_min, d.q_max)
        damping = damping_command(q, d.kd_max)
        self._damped = now
        for joint in ALL:
            sent = damping if off[joint] else None
            with self._noted():
                if off[joint]:
                    self._stop([joint])
                else:
                    sent = motor_bus.command(damping, [joint])
            self._note_sent(sent, [joint])
        self._open_again(ALL, now)

    def _note_driven(self, now: float) -> None:
        """Count answers to the last damping with a torque that does not brake: such a bus changes what it carries."""
        self._heeds = min(self._heeds, now + HEEDS)
        _, dq, tau = self.motor_bus.readings(self._damped)
        d = self._description
        most = d.kd_max * np.fmax(np.abs(dq), np.abs(self._dq)) + BEYOND_BRAKE * d.torque_max
        answered = ~np.isnan(self._dq)  # the damping before, too: the first answer after a gap is to an older command
        self._driven += (np.abs(tau) > most) & answered & (now > self._heeds)
        self._dq = dq

    def _open_again(self, joints: Sequence[int], now: float) -> None:
        """Begin to open the buses of joints again that fail."""
        motor_bus = self.motor_bus
        refuses = now - np.maximum(motor_bus.taken, self._tried) > REFUSES
        silent = now - np.maximum(motor_bus.heard, self._tried) > DEAD
        for bus in np.intersect1d(np.flatnonzero(refuses | silent), motor_bus.wiring.bus[list(joints)]):
            self._tried[bus] = now
            motor_bus.link.reopen(int(bus))

    def speed(self) -> float:
        """Return how fast the fastest joint moves by answers to damping [rad/s]; infinite without any."""
        if self._dry:
            return 0.0
        _, dq, _ = self.motor_bus.readings(self._damped)
        return float("inf") if np.isnan(dq).all() else float(np.nanmax(np.abs(dq)))

    @property
    def lost(self) -> bool:
        """Whether no bus takes frames."""
        return not self._dry and bool(np.all(self.now() - self.motor_bus.taken > DEAD))

    def end(self, *, since: float, rested: bool) -> str | None:
        """Send stops; return how the motors were left once all confirm or were asked often enough."""
        if self._dry:
            return "dry run: nothing was switched on"
        self._left = [joint for joint in self._left if not self._is_off(joint, since)]
        now = self.now()
        if not self._left or now - since >= STOP_FOR:
            return self._left_as()
        for joint in self._left:
            with self._noted():
                self._stop([joint])
        self._open_again(self._left, now)
        return None

    @property
    def off(self) -> bool:
        """Whether every motor has confirmed that it is off."""
        return not self._left

    def _is_off(self, joint: int, since: float) -> bool:
        newest = self.motor_bus.feedback[joint]
        return newest is not None and self.motor_bus.came[joint] > since and newest.mode == MotorMode.OFF

    def _left_as(self) -> str:
        if not self._left:
            return "the robot was damped and all motors are off"
        names = "the motors" if len(self._left) == len(ALL) else joint_names(self._left)
        refused = self.now() - self.motor_bus.taken[self.motor_bus.wiring.bus[self._left]] > DEAD
        if refused.all():
            return f"{names} could not be stopped: {self.problem}; cut the power"
        return f"damping was sent, but {names} did not confirm that they are off: cut the power"

    def close(self) -> None:
        """Let go of the buses."""
        self.motor_bus.link.close()
