"""An emulated robot on CAN in its own time, with a proxy and a second program on the bus."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from lab.faults.trouble import Trouble, halt
from lab.in_process.can_link import EmulatedLink
from lab.in_process.sender_link import EmulatedSenderLink
from mimic.config.emulator import EmulateSettings
from mimic.emulator.faults import EmulatedFault
from mimic.emulator.motor import encode_answer
from mimic.emulator.robot import EmulatedRobot
from mimic.errors import BusError, FrameError
from mimic.hardware.can.driver import CanDriver
from mimic.hardware.can.frame import CanFrame, Received
from mimic.hardware.can.wiring import load_wiring
from mimic.hardware.motors.cybergear.codec import Codec, HostMessage, Kind, MotorMessage
from mimic.hardware.motors.interface import Feedback, MotorCommand, MotorMode
from mimic.hardware.robot.plant import Robot
from mimic.records import JOINTS, JointCommand, Tick
from mimic.robot.description import RobotDescription

CUTS = ("bus_off", "unplugged", "motor_deaf", "stalled", "frames_lost", "frames_late", "frames_corrupted")
"""Faults that can keep a motor from hearing anybody; without a timeout of its own it then goes on."""

NO_FRAMES = ("refuses_frames", "fails", "adapter_out", "sends_nothing")
"""Faults of others while which no frame reaches a motor."""

UNREACHABLE = (*NO_FRAMES, "flaps", "clock_stands", "drops", "delays")
"""Faults of others while which frames may not reach a motor."""

ANSWERS = "answers"
"""The way of frames from the motors; the way of the others is the number of their bus."""


LOOKS = 1e-4
"""Time that passes between two looks at a clock that stands still [s]."""


class ProxyLink:
    """A link whose frames pass through somebody else's hands."""

    def __init__(self, link: EmulatedLink, trouble: Trouble, look: Callable[[], None]) -> None:
        """Stand between a link and whoever uses it; look at the robot as time passes."""
        self._link, self._trouble, self._look = link, trouble, look
        self._ready: deque[Received] = deque()
        self._codec = Codec()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._link, name)

    def now(self) -> float:
        """Return the time of this computer, whose clock may stand still while the robot goes on."""
        if not self._trouble.doing("clock_stands"):
            return self._link.now()
        self._link.sleep(LOOKS)
        return self._trouble.begin

    def send(self, bus: int, frame: CanFrame) -> None:
        self._flush()
        if self._trouble.doing("refuses_frames", "fails", "adapter_out"):
            raise BusError("the proxy takes no frames")
        if not self._trouble.doing("sends_nothing"):
            for one in self._trouble.through(bus, frame, self._damaged, cut=self._cut):
                self._link.send(bus, one)

    def receive(self, timeout: float) -> Received | None:
        end = self._link.now() + timeout
        while True:
            self._flush()
            if self._ready:
                return self._ready.popleft()._replace(t=self.now())
            left = max(end - self._link.now(), 0.0)
            if self._trouble.doing("fails", "adapter_out"):
                self._link.sleep(min(left, 0.002))
                raise BusError("the proxy has failed")
            received = self._link.receive(left if self._trouble.next_due() is None else min(left, 0.002))
            self._look()
            if received is None:
                if self._link.now() >= end:
                    return None
            elif not self._trouble.doing("hears_nothing"):
                self._ready.extend(
                    self._trouble.through(ANSWERS, received, self._damaged_answer, self._forged, self._cut_answer)
                )

    def _flush(self) -> None:
        for way, message in self._trouble.due():
            if way == ANSWERS:
                self._ready.append(message)
            else:
                self._link.send(way, message)

    def _damaged(self, frame: CanFrame) -> CanFrame:
        bit = 1 << int(self._trouble.rng.integers(29))
        identifier = frame.id ^ bit if frame.extended and self._trouble.hit() else frame.id
        return CanFrame(identifier, self._trouble.damaged(frame.data), frame.extended)

    def _cut(self, frame: CanFrame) -> CanFrame:
        return CanFrame(frame.id, self._trouble.shorter(frame.data) if frame.data else b"", frame.extended)

    def _cut_answer(self, received: Received) -> Received:
        return received._replace(frame=self._cut(received.frame))

    def _damaged_answer(self, received: Received) -> Received:
        return received._replace(frame=self._damaged(received.frame))

    def _forged(self, received: Received) -> Received:
        frame, rng = received.frame, self._trouble.rng
        try:
            message = self._codec.decode(frame)
        except FrameError:
            return received._replace(frame=CanFrame(frame.id, rng.bytes(len(frame.data)), frame.extended))
        if not isinstance(message, MotorMessage) or not isinstance(message.said, Feedback):
            return received
        q, dq, tau = (float(x) for x in rng.uniform(-1, 1, 3) * [3.0, 25.0, 12.0])
        bits = int(rng.integers(64)) if self._trouble.hit() else 0
        warm, mode = float(rng.uniform(20, 90)), MotorMode(int(rng.integers(3)))
        forged = replace(message.said, q=q, dq=dq, tau=tau, temperature=warm, mode=mode, faults=bits)
        return received._replace(frame=encode_answer(self._codec, replace(message, said=forged)))


class _Plant(Robot):
    """A plant that counts its steps, beside which something happens in each."""

    steps = 0
    beside: Callable[[], None]

    def step(self, command: JointCommand, *more: Any) -> Tick:
        self.steps += 1
        self.beside()
        return super().step(command, *more)


class CanScene:
    """An emulated robot on CAN and what is between it and its driver."""

    def __init__(
        self, description: RobotDescription, rng: np.random.Generator, seed: int, fault: EmulatedFault | None
    ) -> None:
        """Switch the robot on: on one or two buses, half of them with motors that have a timeout of their own."""
        self._own_timeout, buses = bool(rng.random() < 0.5), int(rng.choice([1, 2]))
        self._fault = fault
        wiring = load_wiring(buses=buses)
        settings = EmulateSettings(zeroed=True, placement=0.03, seed=seed, can_timeout=self._own_timeout)
        self.robot = EmulatedRobot(description, wiring, settings, faults=[] if fault is None else [fault])
        link = EmulatedLink(self.robot)
        link.sleep(0.3)
        self.trouble = Trouble(rng, self.now)
        self.last_driven = -np.inf
        self._other = EmulatedLink(self.robot)

        driver = CanDriver(ProxyLink(link, self.trouble, self._look), wiring, description, zeroed=True)
        self.link = EmulatedSenderLink(driver, description)
        self.plant = _Plant(self.link, description)
        self.plant.beside = self._beside

    def now(self) -> float:
        return self.robot.now

    def _look(self) -> None:
        if self.robot.driven():
            self.last_driven = self.robot.now

    def _beside(self) -> None:
        """Stop the sender, and let the second program speak."""
        kind, rng, codec = self.trouble.kind, self.trouble.rng, Codec()
        halt(self.link, self.trouble)
        if not kind.startswith("master_") or not self.trouble.doing():
            return
        frames: list[CanFrame] = []
        for motor in range(1, 13):
            q, dq, tau = (float(x) for x in rng.uniform(-1, 1, 3) * [2.0, 5.0, 6.0])
            message = {
                "master_commands": HostMessage(
                    Kind.OPERATION,
                    motor,
                    command=MotorCommand(q=q, dq=dq, kp=float(rng.uniform(0, 60)), kd=1.0, tau=tau),
                ),
                "master_stops": HostMessage(Kind.STOP, motor),
                "master_zeroes": HostMessage(Kind.SET_ZERO, motor),
                "master_enables": HostMessage(Kind.ENABLE, motor, host=0x80),
                "master_sets_torque": HostMessage(Kind.WRITE, motor, index=0x700B, value=abs(tau)),
                "master_asks": HostMessage(Kind.READ, motor, index=0x7019),
                "master_floods": HostMessage(Kind.DEVICE_ID, motor),
            }[kind]
            if rng.random() < 0.5:
                frames.append(codec.encode(message))
        if kind == "master_floods":
            frames += [CanFrame(int(rng.integers(16)), bytes(8), extended=False) for _ in range(120)]
        for frame in frames:
            self._other.send(0, frame)

    def stands_still(self, seconds: float) -> None:
        self.wait(seconds)

    def is_alone(self) -> None:
        self.link.sender.closed()
        self.wait(12.0)

    def wait(self, seconds: float) -> None:
        self.link.wait(self.now() + seconds)

    def on(self) -> list[str]:
        return list(self.robot.switched_on())

    def driven(self) -> list[str]:
        return list(self.robot.driven())

    def reachable(self) -> bool:
        lost = self._fault is not None and self._fault.kind in CUTS and np.isinf(self._fault.until)
        return self._own_timeout or not (lost or self.trouble.doing(*NO_FRAMES))

    def actable(self, t: float) -> float:
        """Return from when on, after a time [s], somebody can reach all motors; infinite for never."""
        kind, trouble = self.trouble.kind, self.trouble
        if (kind in UNREACHABLE or kind.startswith("master_")) and t >= trouble.begin:
            return max(t, trouble.end)
        return max(
            [t, *(fault.until for fault in self.robot.schedule.faults if fault.kind in CUTS and fault.start <= t)]
        )

    def false_line(self) -> bool:
        """Return whether the last line asks for the power of a robot that is off and can be reached and heard."""
        line = self.plant.ending
        unknown = "did not confirm" in line or self.actable(self.now()) > self.now()
        return "cut the power" in line and not self.on() and not unknown

    def told(self) -> bool:
        ending, on = self.plant.ending, self.on()
        words = ("did not confirm", "cut the power", "all motors", "stopped")
        return any(word in ending for word in words) or all(joint in ending for joint in on if joint in JOINTS)
