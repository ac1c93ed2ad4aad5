"""Twelve motors and an IMU on a link: sends commands, and matches answers to motors.

Motor protocols have no sequence numbers. An answer belongs to the last command that was sent before it arrived. An
answer that is delayed by a whole control step is taken from the link before the next commands go out, and so keeps
its own time.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from statistics import median

import numpy as np

from mimic.errors import BusError, FrameError, UnknownFrame
from mimic.hardware.can.frame import CanFrame, Link, Received
from mimic.hardware.can.load import BitCount
from mimic.hardware.can.wiring import Wiring
from mimic.hardware.motors.imu import Imu, make_imu
from mimic.hardware.motors.interface import (
    FaultReport,
    Feedback,
    Identity,
    MotorCommand,
    MotorMode,
    OtherHost,
    Register,
    RegisterValue,
)
from mimic.records import DOUBLED, JOINTS, FloatArray, JointCommand, joint_names

ALL = tuple(range(len(JOINTS)))

ASK_TIMEOUT = 0.5
"""A question whose time is measured is given up after this [s]."""

REPORTED = 64
"""Fault bit that stands for a fault report; the bits of a feedback are below it."""

_TWICE = 10
"""So many answers that nothing asked for show that two motors have one id; a network may repeat a few."""

_OWED = 32
"""Answers that may still come; more are lost."""

ECHO_AT_ONCE = 0.05
"""An own frame, known by its bus, id and bytes, that comes back within this is an echo of the adapter [s]."""
ECHO_WITHIN = 0.5
"""The same for a command, which others hardly send alike [s]."""

_MOST_UNKNOWN = 1000
"""Identifiers of unknown senders that are remembered."""


class MotorBus:
    """The motors of a robot and its IMU, by joint."""

    def __init__(self, link: Link, wiring: Wiring, *, overhear: bool = False) -> None:
        """Take the buses; nothing is sent.

        Args:
            link: The buses.
            wiring: Which motor moves which joint.
            overhear: Also keep what motors answer to other computers.
        """
        self.link = link
        self.wiring = wiring
        self._overhear = overhear
        self.motors = wiring.motors()
        """The language of these motors."""
        self.imu: Imu = make_imu(wiring.imu)
        self.feedback: list[Feedback | None] = [None] * len(JOINTS)
        """Newest feedback of each motor."""
        self.came: FloatArray = np.full(len(JOINTS), -np.inf)
        """When each motor's newest feedback arrived [s]."""
        self.faults = np.zeros(len(JOINTS), dtype=int)
        """REPORTED where a fault report is in force, DOUBLED where two motors answer as one."""
        self.malformed = 0
        """Frames of motors and IMU so far that made no sense."""
        self.foreign = 0
        """Frames so far that show that another computer drives the motors."""
        self.foreign_text = ""
        """What the newest of them was."""
        self.echoes = 0
        """Own frames so far that came back: some adapters echo what they send."""
        self._sent: dict[tuple[int, CanFrame], float] = {}
        """Own frames of the last moments -> until when each may come back as an echo, the oldest first [s]."""
        self.unknown: Counter[tuple[int, str]] = Counter()
        """Frames of unknown senders so far: bus and identifier -> count."""
        self.values: dict[tuple[int, Register], float] = {}
        """Numbers of registers that motors told last, by joint."""
        self._asked: tuple[int, Register, float] | None = None
        self.round_trip = float("nan")
        """From the newest question by `ask_round_trip` with an answer to that answer [s]."""
        self.uids: dict[int, int] = {}
        """Unique numbers of motors that told theirs, by joint."""
        self._owed = np.zeros(len(JOINTS), dtype=int)
        self._unasked = np.zeros(len(JOINTS), dtype=int)
        self._load = BitCount(wiring.buses)
        self.taken: FloatArray = np.full(wiring.buses, link.now())
        self.heard: FloatArray = np.full(wiring.buses, link.now())
        """When each bus took, and said, anything last (buses,) [s]."""

    # ------------------------------------------------------------------ frames

    def send(self, joint: int, frame: CanFrame, *, echo_within: float = ECHO_AT_ONCE) -> None:
        """Send a frame on the bus of a joint's motor; its echo may come within a time [s].

        Raises:
            BusError: If the bus does not take it.
        """
        bus = int(self.wiring.bus[joint])
        self.link.send(bus, frame)
        self.taken[bus] = self.link.now()
        self._load.add(bus, frame)
        self._remember(bus, frame, echo_within)
        self._owed[joint] = min(self._owed[joint] + 1, _OWED)

    def _remember(self, bus: int, frame: CanFrame, within: float) -> None:
        """Remember an own frame, and forget those that can no longer come back."""
        now = self.link.now()
        self._sent.pop((bus, frame), None)
        self._sent[bus, frame] = now + within
        oldest = next(iter(self._sent))
        while now > self._sent[oldest]:
            del self._sent[oldest]
            oldest = next(iter(self._sent))

    def id(self, joint: int) -> int:
        """Return the id of a joint's motor."""
        return int(self.wiring.motor[joint])

    @property
    def bits(self) -> FloatArray:
        """Bits on each bus so far, as this computer saw the frames (buses,)."""
        return self._load.bits

    @property
    def errors(self) -> int:
        """Malformed frames so far, those that the adapter garbled among them."""
        return self.malformed + int(getattr(self.link, "garbled", 0))

    def _take(self, received: Received) -> None:
        """Keep what a frame says."""
        bus, frame, t = received
        self.heard[bus] = t
        self._load.add(bus, frame)
        try:
            if bus == self.wiring.imu.bus and self.imu.feed(frame, t):
                return
            answer = self.motors.decode(frame)
        except UnknownFrame:
            self._note_unknown(bus, frame)
            return
        except FrameError:
            self.malformed += 1
            return
        if answer is None:
            return
        joint = self.wiring.joint_of(bus, answer.motor)
        if joint is None:
            self._note_unknown(bus, frame)
            return
        match answer:
            case OtherHost() if t < self._sent.get((bus, frame), -np.inf):
                self.echoes += 1
            case OtherHost():
                if answer.commands:
                    self.foreign = self.foreign + 1
                    self.foreign_text = answer.text
                if answer.feedback is not None and self._overhear:
                    self.feedback[joint] = answer.feedback
                    self.came[joint] = t
            case Feedback():
                self.feedback[joint] = answer
                self.came[joint] = t
                self._answered(joint)
            case RegisterValue():
                self._answered(joint)
                self.values[joint, answer.register] = answer.value
                if self._asked is not None and self._asked[:2] == (joint, answer.register):
                    self.round_trip = t - self._asked[2]
                    self._asked = None
            case Identity():
                self.uids[joint] = answer.uid
                self._answered(joint)
            case FaultReport():
                self.faults[joint] = (self.faults[joint] & DOUBLED) | (REPORTED if answer.faults else 0)

    def _answered(self, joint: int) -> None:
        """Count an answer; where more come than were asked for, two motors have one id."""
        self._unasked[joint] += self._owed[joint] == 0
        self._owed[joint] = max(self._owed[joint] - 1, 0)
        if self._unasked[joint] >= _TWICE:
            self.faults[joint] |= DOUBLED

    def _note_unknown(self, bus: int, frame: CanFrame) -> None:
        name = f"0x{frame.id:08X}" if frame.extended else f"0x{frame.id:03X}"
        if len(self.unknown) < _MOST_UNKNOWN or (bus, name) in self.unknown:
            self.unknown[bus, name] += 1

    def drain(self) -> None:
        """Take what has arrived already."""
        while (received := self.link.receive(0.0)) is not None:
            self._take(received)

    def listen(self, until: float, enough: Callable[[], bool] | None = None) -> None:
        """Take what arrives up to a time [s], or until it is enough. What is left then is for the next call.

        Raises:
            BusError: If a bus has failed.
        """
        while not (enough is not None and enough()):
            left = until - self.link.now()
            if left <= 0:
                return
            received = self.link.receive(left)
            if received is not None:
                self._take(received)

    # ------------------------------------------------------------------ motors

    def command(self, command: JointCommand, joints: Sequence[int] = ALL) -> JointCommand:
        """Send a command to all motors at once and return what was sent, rounded as the frames round it.

        Joints that are left out keep their numbers in what is returned. Where a bus does not take a command, the motors
        on the other buses still get theirs.

        Raises:
            BusError: If a bus does not take it.
            FrameError: If it is not finite.
        """
        w = self.wiring
        p = w.p_of(command.q_des)
        dp = w.sign * command.dq_des
        tau = w.sign * command.tau_ff
        kp, kd, dq_des, tau_ff = (np.array(v) for v in (command.kp, command.kd, command.dq_des, command.tau_ff))
        failed: dict[int, BusError] = {}
        for j in joints:
            wanted = MotorCommand(float(p[j]), float(dp[j]), float(kp[j]), float(kd[j]), float(tau[j]))
            frame, sent = self.motors.command(self.id(j), wanted)
            bus = int(w.bus[j])
            if bus in failed:
                continue
            try:
                self.send(j, frame, echo_within=ECHO_WITHIN)
            except BusError as reason:
                failed[bus] = reason
                continue
            p[j] = sent.q
            dq_des[j] = w.sign[j] * sent.dq
            tau_ff[j] = w.sign[j] * sent.tau
            kp[j] = sent.kp
            kd[j] = sent.kd
        for reason in failed.values():
            raise reason
        return JointCommand(q_des=w.q_of(p), dq_des=dq_des, kp=kp, kd=kd, tau_ff=tau_ff)

    def ask_round_trip(self, joint: int, register: Register) -> None:
        """Ask one motor for a register, and measure how long its answer takes, unless one is waited for already."""
        waits = self._asked is not None and self.link.now() - self._asked[2] < ASK_TIMEOUT
        if register in self.motors.facts.registers and not waits:
            self._asked = joint, register, self.link.now()
            self.send(joint, self.motors.read(self.id(joint), register))

    def voltage(self) -> float:
        """Return the median of the supply voltages that the motors told last [V]; NaN where none did."""
        told = (self.values.get((joint, Register.SUPPLY_VOLTAGE), np.nan) for joint in ALL)
        known = [volts for volts in told if math.isfinite(volts)]
        return median(known) if known else math.nan

    # ------------------------------------------------------------------ readings

    def readings(self, since: float | FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return q, dq and tau (12,) of feedback after a time, or after one time each (12,); NaN without any."""
        rows = np.full((3, len(JOINTS)), np.nan)
        newer = self.came > since
        for joint, feedback in enumerate(self.feedback):
            if feedback is not None and newer[joint]:
                rows[:, joint] = feedback.q, feedback.dq, feedback.tau
        w = self.wiring
        return w.q_of(rows[0]), w.sign * rows[1], w.sign * rows[2]

    def in_other_mode(self, mode: MotorMode) -> str:
        """Return the names of the joints whose motors say that they are in another mode."""
        return joint_names(j for j, f in enumerate(self.feedback) if f is not None and f.mode != mode)

    def temperature(self) -> FloatArray:
        """Return the newest temperature of each motor (12,) [degC]."""
        return np.array([np.nan if f is None else f.temperature for f in self.feedback])
