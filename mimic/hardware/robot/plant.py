"""A robot as a plant: an order to the sender at each control step, reports of it back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mimic.control.plant import damping_command
from mimic.errors import PlantError, SenderError
from mimic.hardware.robot.driver import no_report
from mimic.hardware.robot.process import HANGS, SenderProcess
from mimic.hardware.robot.sender import Order, State
from mimic.records import JOINTS, FloatArray, Health, JointCommand, JointSamples, RobotState, Tick
from mimic.robot.description import RobotDescription

DEVIATES = 0.1
"""A sender that has not sent what it was ordered for this long is ended [s]."""

ROUNDED = 0.01, 0.002
"""A stiffness [N m/rad] and a target [rad] may be sent with this difference; a frame on CAN holds 16 bits of each."""

ANSWERS = 0.005
"""A step that begins late still waits this long for answers [s]."""


class Robot:
    """A robot in real time: a step lasts one control step.

    The state holds what the motors said during the step. A joint that said nothing is NaN, and its age grows in the
    health. The position of the base is not measured.
    """

    def __init__(self, link: SenderProcess, description: RobotDescription, *, suspended: bool = False) -> None:
        """Prepare the plant; nothing is sent yet.

        Args:
            link: The process that sends.
            description: The robot.
            suspended: The robot hangs in the air instead of lying on the floor.
        """
        self.link = link
        self.description = description
        self._suspended = suspended
        self.report: Any = no_report()
        """Newest report of the sender; a scalar of REPORT."""
        self._samples: list[Any] = []
        self._missed = np.zeros(len(JOINTS), dtype=np.int64)
        self._err_flag = 0
        self._gap = 0.0
        self._began = self._ended = self._due = link.now()
        self._busy: FloatArray | None = None
        self._started = self._damps = False
        self._command: JointCommand | None = None
        self._strays_since = np.inf
        self.ending = "nothing was switched on"
        """How the robot was left, as a sentence without its full stop."""

    def start(self) -> RobotState:
        """Switch the motors on where they are, without gains, and return the state.

        Raises:
            PlantError: If the robot does not follow, or something stands against moving.
            BusError: If a bus fails.
        """
        link = self.link
        d = self.description
        self._started = True
        self._damps = False
        self._command = None
        link.start(suspended=self._suspended)
        self._missed[:] = 0
        self._began = self._ended = self._due = link.now()
        self.report["t"] = self._began
        self._busy = None
        q = np.nan_to_num(np.clip(self.report["q"], d.q_min, d.q_max))
        return self.step(damping_command(q, 0.0)).state  # without gains

    def step(self, command: JointCommand, dt: float | None = None) -> Tick:
        """Send a command, collect what the robot says, and wait for the end of the control step.

        Args:
            command: For the joints.
            dt: Length of this step [s]; by default the control step.

        Raises:
            SenderError: If the sender has ended, hangs, does not obey, or has damped the robot by itself.
        """
        link = self.link
        dt = self.description.dt if dt is None else dt
        asked = link.now()
        compute = asked - self._ended
        if not self._damps:
            link.order(Order(command=command, begin=self._due))
        sent_before = int(self.report["sent"])
        self._due += dt
        self._take(link.wait(max(self._due, asked + ANSWERS)))
        now = link.now()
        late = now - self._due
        self._ended = now
        if late > dt:
            self._due = now  # missed time is not caught up
        if link.problem and not self._damps:
            raise SenderError(link.problem)
        heard = float(self.report["t"])
        if now - heard > HANGS and not link.left:
            raise SenderError(f"the process that sends to the robot hangs: it said nothing for {now - heard:.2f} s")
        if heard > asked:
            self._compare(command, sent_before, asked)
        t = now if heard > asked else heard  # nothing ages while the sender is silent
        if heard > asked:
            self._missed = np.where(self.report["came"] > asked, 0, self._missed + 1)
        sent = self._sent(command)
        return Tick(
            state=self.state(asked),
            sent=sent,
            health=self._health(compute, max(late, 0.0), now, t),
            samples=self._joint_samples(sent),
        )

    def damp(self) -> bool:
        """Have the robot damped for good, by one message; return False once the sender has left it."""
        if self._started and not self._damps:
            self._damps = True
            self._strays_since = np.inf
            self.link.damp()
        return self._started and not self.link.left

    def _compare(self, command: JointCommand, sent_before: int, asked: float) -> None:
        """End a sender that does not send what it was ordered.

        Raises:
            SenderError: If it has not for DEVIATES.
        """
        before = self._command
        self._command = command
        strays = self._strays(command, before or command, sent_before)
        self._strays_since = min(self._strays_since, asked) if strays else np.inf
        seconds = self.link.now() - self._strays_since
        if seconds > DEVIATES:
            self.link.end()
            raise SenderError(f"the process that sends to the robot {strays} for {seconds:.2f} s, and was ended")

    def _strays(self, command: JointCommand, before: JointCommand, sent_before: int) -> str:
        """Return what the sender does instead of what it was ordered; empty where it obeys."""
        report = self.report
        (stiffer, away) = ROUNDED
        if report["state"] >= State.ENDING:
            return ""
        if report["sent"] <= sent_before:
            return "has sent nothing"
        kp = np.zeros(len(JOINTS)) if self._damps else command.kp
        if np.any(np.abs(report["kp_sent"] - kp) > stiffer):  # false for NaN, where a bus took nothing
            return "has sent another stiffness than it was ordered"
        if self._damps:
            return ""
        first = before.q_des if command.ramp > 0.0 else command.q_des
        low = np.minimum(first, command.q_des) - away
        high = np.maximum(first, command.q_des) + away
        q = report["q_sent"]
        return "has sent other targets than it was ordered" if np.any((q < low) | (q > high)) else ""

    @property
    def now(self) -> float:
        """The time of the reports [s]."""
        return self.link.now()

    def look(self) -> None:
        """Take what has come since the end of the step."""
        self._take(self.link.wait(self.link.now()))

    def _take(self, reports: Sequence[Any]) -> None:
        """Keep the newest report, and what must not be missed of the others."""
        self._err_flag = 0
        self._gap = 0.0
        self._samples = []
        for report in reports:
            if report["readings"] > self.report["readings"]:
                self._samples.append(report)
            self.report = report
            self._busy = np.array(report["busy"]) if self._busy is None else self._busy
            if report["err_flag"] > 0:
                self._err_flag |= int(report["err_flag"])
                self._gap = max(self._gap, float(report["gap"]))

    def _sent(self, command: JointCommand) -> JointCommand:
        q, kp, kd = (np.array(self.report[name]) for name in ("q_sent", "kp_sent", "kd_sent"))
        return replace(command, q_des=q, kp=kp, kd=kd)

    def state(self, since: float | FloatArray) -> RobotState:
        """Return the state, with NaN for joints that have said nothing after a time [s], or one time each (12,)."""
        report = self.report
        nothing = np.full(3, np.nan)
        said = report["came"] > since
        joints: dict[str, Any] = {name: np.where(said, report[name], np.nan) for name in ("q", "dq", "tau")}
        base: dict[str, Any] = {name: np.array(report[name]) for name in ("quat_WB", "omega_B")}
        return RobotState(t=self._ended - self._began, **joints, **base, p_WB=nothing, v_WB=nothing)

    def _health(self, compute: float, late: float, now: float, t: float) -> Health:
        report = self.report
        return Health(
            age=t - np.array(report["came"]),
            missed=self._missed.copy(),
            faults=np.array(report["faults"]),
            running=np.array(report["running"], dtype=bool),
            temperature=np.array(report["temperature"]),
            imu_age=t - float(report["imu_came"]),
            imu_unchanged=t - float(report["imu_changed"]),
            imu_count=int(report["imu_count"]),
            imu_valid=None if report["imu_valid"] < 0 else bool(report["imu_valid"]),
            compute=compute,
            late=late,
            bus_errors=int(report["errors"]),
            sender_age=now - float(report["t"]),
            err_flag=self._err_flag,
            command_gap=self._gap,
            foreign=int(report["foreign"]),
            voltage=float(report["voltage"]),
            round_trip=float(report["round_trip"]),
        )

    def _joint_samples(self, sent: JointCommand) -> JointSamples | None:
        rows = self._samples
        if not rows:
            return None
        readings: dict[str, Any] = {}
        for name in ("q", "dq", "tau"):
            readings[name] = np.array([row[name] for row in rows])
        t = np.array([float(row["came"].max()) - self._began for row in rows])
        return JointSamples(t=t, **readings, q_des=np.repeat(sent.position_target()[None], len(rows), axis=0))

    def load(self) -> FloatArray:
        """Return the share of time that each bus was busy since the start (buses,); empty for a motion board."""
        busy = np.array(self.report["busy"]) - (np.nan if self._busy is None else self._busy)
        return busy[np.isfinite(busy)] / max(float(self.report["t"]) - self._began, self.description.dt)

    def close(self) -> None:
        """Damp the robot until it rests, then switch its motors off. Safe to call twice; never raises MimicError."""
        if not self._started:
            return
        self._started = False
        try:
            self.ending = self.link.finish()
        except PlantError as reason:
            self.ending = f"it is not known how the robot was left: {reason}"
