"""Talking with twelve motors and an IMU over a link: commands out, answers matched by motor, parameters read and written.

The protocol has no sequence numbers. An answer belongs to the last command that was sent before it came; one that is late
by a whole control step is taken out of the link before the next commands go out, and so keeps its own time of arrival.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from mimic.errors import FrameError, PlantError
from mimic.robot.wiring import Wiring
from mimic.run.can_frame import CanFrame, frame_bits
from mimic.run.cybergear import Codec
from mimic.run.imu import Imu, make_imu
from mimic.run.link import Link, Received
from mimic.run.motor_messages import (
    DeviceId,
    FaultReport,
    Feedback,
    Message,
    Operation,
    ParameterValue,
    ReadParameter,
    WriteParameter,
)
from mimic.types import JOINTS, FloatArray, JointCommand

ALL = tuple(range(len(JOINTS)))

ANSWER_WITHIN = 0.05
"""A motor answers within a millisecond on a quiet bus; adapters and a busy computer take the rest [s]."""

TRIES = 4
"""How often a motor is asked before it counts as silent."""

REPORTED = 64
"""Fault bit that stands for a fault report (type 21), beside the six bits of a feedback."""

_WEIGHED = 16
"""One frame in so many is weighed bit by bit; frames of a kind hardly differ."""

NOT_TAKEN = 1e-3
"""A parameter that reads back further away than this was not taken."""


class Exchange:
    """What goes over the buses and what has come back."""

    def __init__(self, link: Link, wiring: Wiring) -> None:
        self.link, self.wiring = link, wiring
        self.codec = Codec(position_range=wiring.position_range)
        self.imu: Imu = make_imu(wiring.imu)
        self.feedback: list[Feedback | None] = [None] * len(JOINTS)
        self.came: FloatArray = np.full(len(JOINTS), -np.inf)
        """When each motor's newest feedback came [s]."""
        self.faults = np.zeros(len(JOINTS), dtype=int)
        """Fault bits of fault reports so far."""
        self.strays = 0
        """Frames that made no sense or came from nobody who is known."""
        self._values: dict[tuple[int, int], float] = {}
        self._ids: dict[int, int] = {}
        self.bits: FloatArray = np.zeros(wiring.buses)
        """Bits on each bus so far, as this computer saw the frames (buses,)."""
        self._frames = 0
        self._weights: dict[tuple[int, int], int] = {}

    # ------------------------------------------------------------------ frames

    def send(self, joint: int, message: Message) -> CanFrame:
        """Send a message to the motor of a joint and return its frame.

        Raises:
            BusError: If the bus does not take it.
        """
        frame, bus = self.codec.encode(message), int(self.wiring.bus[joint])
        self.link.send(bus, frame)
        self._weigh(bus, frame)
        return frame

    def _weigh(self, bus: int, frame: CanFrame) -> None:
        kind = (len(frame.data), frame.id >> 24 if frame.extended else frame.id)
        if kind not in self._weights or self._frames % _WEIGHED == 0:
            self._weights[kind] = frame_bits(frame)
        self._frames += 1
        self.bits[bus] += self._weights[kind]

    @property
    def errors(self) -> int:
        """Frames that made no sense so far, those that the adapter garbled among them."""
        return self.strays + int(getattr(self.link, "garbled", 0))

    def _take(self, received: Received) -> int | None:
        """Keep what a frame says; return the joint whose feedback it is, or None."""
        bus, frame, t = received
        self._weigh(bus, frame)
        try:
            if bus == self.wiring.imu.bus and self.imu.feed(frame, t):
                return None
            message = self.codec.decode(frame)
        except FrameError:
            self.strays += 1
            return None
        if not isinstance(message, Feedback | DeviceId | ParameterValue | FaultReport):
            return None  # another program's command
        joint = self.wiring.joint_of(bus, message.motor)
        if joint is None:
            self.strays += 1
            return None
        match message:
            case Feedback():
                self.feedback[joint], self.came[joint] = message, t
                return joint
            case ParameterValue():
                self._values[joint, message.index] = message.value
            case DeviceId():
                self._ids[joint] = message.uid
            case FaultReport():
                self.faults[joint] = REPORTED if message.faults else 0
        return None

    def drain(self) -> None:
        """Take what has come already."""
        while (received := self.link.receive(0.0)) is not None:
            self._take(received)

    def listen(self, until: float, enough: Callable[[], bool] | None = None) -> None:
        """Take what comes up to a time [s], or until it is enough.

        Raises:
            BusError: If a bus has failed.
        """
        while not (enough is not None and enough()):
            left = until - self.link.now()
            if left <= 0:
                return self.drain()
            received = self.link.receive(left)
            if received is not None:
                self._take(received)

    # ------------------------------------------------------------------ motors

    def command(self, command: JointCommand, joints: Sequence[int] = ALL) -> JointCommand:
        """Send a command to all motors at once and return what really went out, rounded as the frames round it.

        Joints that are left out keep their numbers in what is returned.

        Raises:
            BusError: If a bus does not take it.
            FrameError: If it is not finite.
        """
        w = self.wiring
        p, dp, tau = w.p_of(command.q_des), w.sign * command.dq_des, w.sign * command.tau_ff
        frames = []
        for j in joints:
            frames.append(
                self.send(
                    j,
                    Operation(
                        motor=int(w.motor[j]),
                        q=float(p[j]),
                        dq=float(dp[j]),
                        kp=float(command.kp[j]),
                        kd=float(command.kd[j]),
                        tau=float(tau[j]),
                    ),
                )
            )
        kp, kd, dq_des, tau_ff = (np.array(v) for v in (command.kp, command.kd, command.dq_des, command.tau_ff))
        for j, frame in zip(joints, frames, strict=True):
            sent = self.codec.decode(frame)
            assert isinstance(sent, Operation)
            p[j], dq_des[j], tau_ff[j] = sent.q, w.sign[j] * sent.dq, w.sign[j] * sent.tau
            kp[j], kd[j] = sent.kp, sent.kd
        return JointCommand(q_des=w.q_of(p), dq_des=dq_des, kp=kp, kd=kd, tau_ff=tau_ff)

    def ask(self, message: Callable[[int], Message], answered: Callable[[int], bool]) -> list[int]:
        """Send a message to every motor, a few times where no answer comes, and return the joints that stayed silent.

        Args:
            message: Of a motor's id.
            answered: Whether the motor of a joint has answered.
        """
        silent = list(ALL)
        for _ in range(TRIES):
            for joint in silent:
                self.send(joint, message(int(self.wiring.motor[joint])))
            waiting = tuple(silent)
            self.listen(self.link.now() + ANSWER_WITHIN, lambda waiting=waiting: all(map(answered, waiting)))
            silent = [joint for joint in silent if not answered(joint)]
            if not silent:
                break
        return silent

    def ask_feedback(self, message: Callable[[int], Message]) -> list[int]:
        """Send a message that every motor answers with a feedback; return the joints that stayed silent."""
        self.drain()
        since = self.link.now()
        return self.ask(message, lambda joint: self.came[joint] > since)

    def device_ids(self, message: Callable[[int], Message]) -> dict[int, int]:
        """Return the unique id of the motor of each joint that answers."""
        self._ids.clear()
        self.ask(message, lambda joint: joint in self._ids)
        return dict(self._ids)

    def read(self, index: int) -> FloatArray:
        """Return a parameter of every motor (12,); NaN where none answered."""
        for joint in ALL:
            self._values.pop((joint, index), None)
        host = self.wiring.host
        self.ask(
            lambda motor: ReadParameter(motor=motor, host=host, index=index),
            lambda joint: (joint, index) in self._values,
        )
        return np.array([self._values.get((joint, index), np.nan) for joint in ALL])

    def value(self, joint: int, index: int) -> float:
        """Return the newest value of a parameter that came; NaN where none did."""
        return self._values.get((joint, index), float("nan"))

    def write(self, index: int, value: float) -> FloatArray:
        """Write a parameter of every motor and return what each reads back (12,)."""
        host = self.wiring.host
        self.ask_feedback(lambda motor: WriteParameter(motor=motor, host=host, index=index, value=value))
        return self.read(index)

    def set(self, index: int, value: float, name: str) -> None:
        """Write a parameter of every motor and see that it was taken.

        Raises:
            PlantError: If a motor does not read back what was written.
        """
        got = self.write(index, value)
        wrong = np.flatnonzero(~(np.abs(got - value) <= NOT_TAKEN))
        if len(wrong):
            told = ", ".join(f"{JOINTS[j]} reads {got[j]:g}" for j in wrong)
            raise PlantError(f"{name} was set to {value:g}, but {told}; expected all twelve motors to take it")

    def readings(self, since: float | FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return q, dq and tau (12,) of the feedback that came after a time, or after these (12,); NaN where none did."""
        rows, newer = np.full((3, len(JOINTS)), np.nan), self.came > since
        for joint, feedback in enumerate(self.feedback):
            if feedback is not None and newer[joint]:
                rows[:, joint] = feedback.q, feedback.dq, feedback.tau
        w = self.wiring
        return w.q_of(rows[0]), w.sign * rows[1], w.sign * rows[2]

    def temperature(self) -> FloatArray:
        """Return the newest temperature of each motor (12,) [degC]."""
        return np.array([np.nan if f is None else f.temperature for f in self.feedback])
