"""A stock CyberDog 2 as a plant: orders to the sender at each control step, reports of it back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from mimic.control.safety_limits import limits_for
from mimic.errors import PlantError
from mimic.hardware.plant import idle_command
from mimic.hardware.stock.messages import CUT, MOTOR_ERRORS, MOTOR_RUNNING, TIMED_OUT
from mimic.hardware.stock.readings import NO_ERR_FLAG
from mimic.hardware.stock.sender import Order, State
from mimic.hardware.stock.wiring import BoardWiring
from mimic.records import JOINTS, Health, JointCommand, JointSamples, RobotState, Tick
from mimic.robot.description import RobotDescription

OLD = 0.012
"""A reading that is older at the end of a control step counts as missing [s]: six messages were lost or are late."""

ENTER_TIMEOUT = 2.0
"""Motor mode is entered within this after the first zero message [s]; the firmware takes 5 ms."""

CLEAR_TIMEOUT = 8.0
"""Error 0x02 is cleared within this [s]; the firmware takes 2.5 s."""

GONE = 0.25
"""With no message from the robot for this long the run ends [s]; the rules have damped it before."""

HOT = 60.0
"""A motor this warm is not started [degC]."""

LYING_TOLERANCE = 0.6
"""Largest distance of a joint from the lying pose at the start [rad].

A limp robot rests on its trunk, its legs splayed: 0.37 rad from the lying pose, in the maker's firmware on the bench as
in the emulation. One that stands is 1.1 rad from it.
"""

START_TILT = 0.3
"""Largest tilt of the robot when it is taken over [rad]."""


class BoardLink(Protocol):
    """The process that speaks to the board, as the plant sees it."""

    def now(self) -> float:
        """Return the time of the reports [s]."""
        ...

    def order(self, order: Order) -> None:
        """Give an order; it also counts as a sign of life."""
        ...

    def wait(self, until: float) -> Sequence[Any]:
        """Wait until a time [s], and return the reports (scalars of REPORT) that came since the last call."""
        ...

    def alive(self) -> bool:
        """Return whether the sender still sends what it is told; False also once it has taken over."""
        ...

    def finish(self) -> str:
        """Damp the robot until it rests, and return how it was left, as a sentence without a full stop."""
        ...


class StockRobot:
    """A stock robot in real time: a step lasts one control step.

    The state holds the newest readings of the step. Joints whose readings are old are NaN. The position of the base is
    not measured.
    """

    def __init__(
        self,
        link: BoardLink,
        wiring: BoardWiring,
        description: RobotDescription,
        *,
        torque_limit: float | None = None,
        suspended: bool = False,
    ) -> None:
        """Prepare the plant; nothing is sent yet.

        Args:
            link: Process at the board.
            wiring: Of the board.
            description: The robot.
            torque_limit: Refused if below the motors' own: the board has no such limit.
            suspended: The robot hangs in the air instead of lying on the floor.

        Raises:
            PlantError: If a torque limit is asked for.
        """
        if torque_limit is not None and torque_limit < description.torque_max:
            raise PlantError(
                f"the stock board has no torque limit to set; leave out --torque-limit (given: {torque_limit:g} N m)"
            )
        self._link, self._wiring, self._description = link, wiring, description
        self._suspended, self._limits = suspended, limits_for(description)
        self._report: Any = None
        self._samples: list[Any] = []
        self._missed = np.zeros(len(JOINTS), dtype=np.int64)
        self._err_flag, self._gap = 0, 0.0
        self._imu_before = 0
        self._foreign = self._malformed = 0
        self._began = self._ended = self._due = link.now()
        self._started = self._closed = False
        self.late_commands = 0
        """Control steps in which the board reported a late command (0x01)."""
        self.ending = "nothing was switched on"
        """How the robot was left, as a sentence without a full stop."""

    @property
    def description(self) -> RobotDescription:
        """The description of the robot."""
        return self._description

    @property
    def wiring(self) -> BoardWiring:
        """The wiring of the board."""
        return self._wiring

    def start(self) -> RobotState:
        """Enter motor mode, clear error 0x02, check the robot once more, and return its state. It is limp until then.

        Raises:
            PlantError: If the board does not follow, or something stands against moving.
        """
        link = self._link
        self._started, self._closed = True, False
        began = link.now()
        self._await(
            lambda: self._report is not None and self._report["err_came"] > began,
            ENTER_TIMEOUT,
            "the robot does not enter motor mode, which it does only from lying, switched off or damped. It hears no "
            "other orders now: support it if it stands, switch it off, and start it again lying",
        )
        self._await(
            lambda: not int(self._report["err_flag"]) & TIMED_OUT and self._report["motors_came"] > began,
            CLEAR_TIMEOUT,
            "error 0x02 of the robot does not clear; switch it off and on. Is another program sending to it?",
        )
        self._await(  # the first message may come later than those of the motors
            lambda: link.now() - self._report["imu_came"] <= self._limits.imu_age,
            ENTER_TIMEOUT,
            "the robot was not moved: no orientation comes from the robot",
        )
        self._check()
        self._missed[:] = 0
        self._began = self._ended = self._due = link.now()
        d = self._description
        return self.step(idle_command(np.clip(self._report["q"], d.q_min, d.q_max))).state

    def _await(self, reached: Any, timeout: float, problem: str) -> None:
        """Send zero messages until something is reached.

        Raises:
            PlantError: If that takes too long, or the sender has ended.
        """
        link, dt = self._link, self._description.dt
        end = link.now() + timeout
        while link.now() < end:
            link.order(Order(state=State.ZERO))
            self._take(link.wait(link.now() + dt))
            if reached():
                return
            if not link.alive():
                raise PlantError("the process that sends to the robot has ended")
        raise PlantError(problem)

    def _check(self) -> None:
        """Check what is known only in motor mode, and again what may have changed since the pre-flight.

        Raises:
            PlantError: If something stands against moving.
        """
        report, problems = self._report, []
        for joint, flags in enumerate(report["flags"]):
            if int(flags) & MOTOR_ERRORS:
                problems.append(f"motor {JOINTS[joint]} reports the error {int(flags) & MOTOR_ERRORS:#x}")
        warmest = int(np.argmax(report["temperature"]))
        if report["temperature"][warmest] >= HOT:
            problems.append(f"motor {JOINTS[warmest]} is at {report['temperature'][warmest]:.0f} degC; let it cool")
        if report["foreign"]:
            problems.append("another program commands this robot")
        now = self._link.now()
        if now - report["imu_came"] > self._limits.imu_age:
            problems.append("no orientation comes from the robot")
        elif not self._suspended:
            _, x, y, _ = report["quat_WB"]
            if 1.0 - 2.0 * (x * x + y * y) < np.cos(START_TILT):
                problems.append("the robot is tilted")
            away = np.abs(report["q"] - self._description.poses["lie"])
            worst = int(np.argmax(away))
            if away[worst] > LYING_TOLERANCE:
                problems.append(f"{JOINTS[worst]} is {np.rad2deg(away[worst]):.0f} deg from the lying pose")
        if problems:
            raise PlantError(f"the robot was not moved: {'; '.join(problems)}")

    def step(self, command: JointCommand, dt: float | None = None) -> Tick:
        """Send a command, collect the readings, and wait for the end of the control step.

        Args:
            command: For the joints.
            dt: Length of this step [s]; by default the control step.

        Raises:
            PlantError: If the command is not finite, no message comes any more, or the sender has ended or taken over.
        """
        link, dt = self._link, self._description.dt if dt is None else dt
        numbers = np.concatenate([command.q_des, command.dq_des, command.kp, command.kd, command.tau_ff])
        if not np.isfinite(numbers).all():
            raise PlantError("the command holds numbers that are not finite")
        begun = link.now()
        compute = begun - self._ended
        link.order(Order(state=State.DRIVE, command=command))
        self._due += dt
        self._take(link.wait(max(self._due, begun + 0.25 * dt)))
        now = link.now()
        late, self._ended = now - self._due, now
        if late > dt:
            self._due = now  # missed time is not caught up
        if not link.alive():
            raise PlantError("the process that sends to the robot has ended or has taken over")
        assert self._report is not None
        heard = float(self._report["heard"])
        if now - heard > GONE:
            raise PlantError(f"no message came from the robot for {now - heard:.2f} s; is the cable in place?")
        fresh = now - float(self._report["motors_came"]) <= OLD
        self._missed = np.zeros_like(self._missed) if fresh else self._missed + 1
        sent = self._sent(command)
        return Tick(
            state=self._state(now, fresh=fresh),
            sent=sent,
            health=self._health(compute, late, now),
            samples=self._joint_samples(sent),
        )

    def _sent(self, command: JointCommand) -> JointCommand:
        wiring = self._wiring
        return JointCommand(
            q_des=command.q_des,
            dq_des=command.dq_des,
            kp=np.clip(command.kp, 0.0, wiring.kp_max),
            kd=np.clip(command.kd, 0.0, wiring.kd_max),
            tau_ff=np.clip(command.tau_ff, -wiring.torque_max, wiring.torque_max),
            ramp=command.ramp,
        )

    def _take(self, reports: Sequence[Any]) -> None:
        """Keep the newest report, and what must not be missed of the others."""
        self._err_flag, self._gap, self._samples = 0, 0.0, []
        for report in reports:
            if self._report is None or report["motors_count"] > self._report["motors_count"]:
                self._samples.append(report)
            self._report = report
            if report["err_flag"] != NO_ERR_FLAG:
                self._err_flag |= int(report["err_flag"])
                self._gap = max(self._gap, float(report["gap"]))
        self.late_commands += bool(self._err_flag & 0x01)

    def _state(self, now: float, *, fresh: bool) -> RobotState:
        report, nothing = self._report, np.full(3, np.nan)
        known = now - float(report["imu_came"]) <= self._limits.imu_age
        missing = np.full(len(JOINTS), np.nan)
        return RobotState(
            t=now - self._began,
            q=np.array(report["q"]) if fresh else missing,
            dq=np.array(report["dq"]) if fresh else missing,
            tau=np.array(report["tau"]) if fresh else missing,
            quat_WB=np.array(report["quat_WB"]) if known else np.full(4, np.nan),
            omega_B=np.array(report["omega_B"]) if known else nothing,
            p_WB=nothing,
            v_WB=nothing,
        )

    def _health(self, compute: float, late: float, now: float) -> Health:
        report = self._report
        flags = np.array(report["flags"])
        return Health(
            age=np.full(len(JOINTS), now - float(report["motors_came"])),
            missed=self._missed.copy(),
            faults=flags & MOTOR_ERRORS,
            running=flags >> 30 == MOTOR_RUNNING,
            temperature=np.array(report["temperature"]),
            imu_age=now - float(report["imu_came"]),
            imu_unchanged=now - float(report["imu_changed"]),
            imu_count=int(report["imu_count"]),
            imu_valid=None,
            compute=compute,
            late=max(late, 0.0),
            bus_errors=int(report["malformed"]),
            guarded=self._link.alive(),
            err_flag=self._err_flag & ~CUT,
            command_gap=self._gap,
            foreign=int(report["foreign"]),
        )

    def _joint_samples(self, sent: JointCommand) -> JointSamples | None:
        if not self._samples:
            return None
        rows = self._samples
        return JointSamples(
            t=np.array([float(row["motors_came"]) - self._began for row in rows]),
            q=np.array([row["q"] for row in rows]),
            dq=np.array([row["dq"] for row in rows]),
            tau=np.array([row["tau"] for row in rows]),
            q_des=np.repeat(sent.q_des[None], len(rows), axis=0),
        )

    def close(self) -> None:
        """Damp the robot until it rests, then leave its motors without torque. Safe to call twice; never raises."""
        if self._closed or not self._started:
            return
        self._closed, self._started = True, False
        self.ending = self._link.finish()
