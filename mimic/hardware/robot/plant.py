"""A robot as a plant: an order to the sender at each control step, reports of it back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mimic.errors import PlantError, SenderError
from mimic.hardware.robot.driver import ALL, no_report
from mimic.hardware.robot.process import HANGS, SenderLink
from mimic.hardware.robot.sender import Order
from mimic.records import JOINTS, FloatArray, Health, JointCommand, JointSamples, RobotState, Tick
from mimic.robot.description import RobotDescription

ANSWERS = 0.005
"""A step that begins late still waits this long for answers [s]."""


def idle_command(q: FloatArray) -> JointCommand:
    """Return the command without gains and without torque."""
    zeros = np.zeros(len(JOINTS))
    return JointCommand(q_des=np.nan_to_num(q), dq_des=zeros, kp=zeros, kd=zeros, tau_ff=zeros)


class Robot:
    """A robot in real time: a step lasts one control step.

    The state holds what the motors said during the step. A joint that said nothing is NaN, and its age grows in the
    health. The position of the base is not measured.
    """

    def __init__(self, link: SenderLink, description: RobotDescription, *, suspended: bool = False) -> None:
        """Prepare the plant; nothing is sent yet.

        Args:
            link: The process that sends.
            description: The robot.
            suspended: The robot hangs in the air instead of lying on the floor.
        """
        self.link, self.description, self._suspended = link, description, suspended
        self.report: Any = no_report()
        """Newest report of the sender; a scalar of REPORT."""
        self._samples: list[Any] = []
        self._missed = np.zeros(len(JOINTS), dtype=np.int64)
        self._err_flag, self._gap = 0, 0.0
        self._began = self._ended = self._due = link.now()
        self._busy: FloatArray | None = None
        self._started = False
        self.ending = "nothing was switched on"
        """How the robot was left, as a sentence without its full stop."""

    def start(self) -> RobotState:
        """Switch the motors on where they are, without gains, and return the state.

        Raises:
            PlantError: If the robot does not follow, or something stands against moving.
            BusError: If a bus fails.
        """
        link, d = self.link, self.description
        self._started = True
        link.start(suspended=self._suspended)
        self._missed[:] = 0
        self._began = self._ended = self._due = link.now()
        self.report["t"], self._busy = self._began, None
        return self.step(idle_command(np.clip(self.report["q"], d.q_min, d.q_max))).state

    def step(self, command: JointCommand, dt: float | None = None, joints: Sequence[int] = ALL) -> Tick:
        """Send a command, collect what the robot says, and wait for the end of the control step.

        Args:
            command: For the joints.
            dt: Length of this step [s]; by default the control step.
            joints: The motors that are commanded.

        Raises:
            SenderError: If the sender has ended, hangs, or has damped the robot.
        """
        link, dt = self.link, self.description.dt if dt is None else dt
        asked = link.now()
        compute = asked - self._ended
        link.order(Order(command=command, begin=self._due, joints=tuple(joints)))
        self._due += dt
        self._take(link.wait(max(self._due, asked + ANSWERS)))
        now = link.now()
        late, self._ended = now - self._due, now
        if late > dt:
            self._due = now  # missed time is not caught up
        if link.problem:
            raise SenderError(link.problem)
        heard = float(self.report["t"])
        if now - heard > HANGS:
            raise SenderError(f"the process that sends to the robot hangs: it said nothing for {now - heard:.2f} s")
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

    @property
    def now(self) -> float:
        """The time of the reports [s]."""
        return self.link.now()

    def look(self) -> None:
        """Take what has come since the end of the step."""
        self._take(self.link.wait(self.link.now()))

    def _take(self, reports: Sequence[Any]) -> None:
        """Keep the newest report, and what must not be missed of the others."""
        self._err_flag, self._gap, self._samples = 0, 0.0, []
        for report in reports:
            if report["readings"] > self.report["readings"]:
                self._samples.append(report)
            self.report = report
            self._busy = np.array(report["busy"]) if self._busy is None else self._busy
            if report["err_flag"] > 0:
                self._err_flag |= int(report["err_flag"])
                self._gap = max(self._gap, float(report["gap"]))

    def _sent(self, command: JointCommand) -> JointCommand:
        report = self.report
        return JointCommand(
            q_des=np.array(report["q_sent"]),
            dq_des=command.dq_des,
            kp=np.array(report["kp_sent"]),
            kd=np.array(report["kd_sent"]),
            tau_ff=command.tau_ff,
            ramp=command.ramp,
        )

    def state(self, since: float | FloatArray) -> RobotState:
        """Return the state, with NaN for joints that have said nothing after a time [s], or one time each (12,)."""
        report, nothing = self.report, np.full(3, np.nan)
        said = report["came"] > since
        return RobotState(
            t=self._ended - self._began,
            q=np.where(said, report["q"], np.nan),
            dq=np.where(said, report["dq"], np.nan),
            tau=np.where(said, report["tau"], np.nan),
            quat_WB=np.array(report["quat_WB"]),
            omega_B=np.array(report["omega_B"]),
            p_WB=nothing,
            v_WB=nothing,
        )

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
        return JointSamples(
            t=np.array([float(row["came"].max()) - self._began for row in rows]),
            q=np.array([row["q"] for row in rows]),
            dq=np.array([row["dq"] for row in rows]),
            tau=np.array([row["tau"] for row in rows]),
            q_des=np.repeat(sent.position_target()[None], len(rows), axis=0),
        )

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
