"""An emulated robot on CAN behind a proxy, with a second master and a watchdog.

Used by lab/faults/faults_outside.py.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from lab.faults.faults_scene import Trouble
from mimic.config.emulator import EmulateSettings
from mimic.emulator.link import EmulatedLink
from mimic.emulator.robot import EmulatedRobot
from mimic.errors import BusError, FrameError
from mimic.hardware.can.frame import CanFrame
from mimic.hardware.can.link import Received
from mimic.hardware.cybergear.codec import Codec
from mimic.hardware.cybergear.messages import (
    Enable,
    Fault,
    Feedback,
    GetDeviceId,
    Mode,
    Operation,
    ReadParameter,
    SetZero,
    Stop,
    WriteParameter,
)
from mimic.hardware.plant import CanRobot
from mimic.hardware.watchdog import BEAT_TIMEOUT, damp_and_stop
from mimic.hardware.wiring import Wiring, load_wiring
from mimic.records import JointCommand, Tick
from mimic.robot.description import RobotDescription

PROXIES = (
    "delays",
    "drops",
    "corrupts",
    "repeats",
    "forges",
    "hears_nothing",
    "sends_nothing",
    "refuses_frames",
    "fails",
)
"""What a proxy of the CAN link does."""

MASTERS = (
    "master_commands",
    "master_stops",
    "master_zeroes",
    "master_enables",
    "master_sets_torque",
    "master_asks",
    "master_floods",
)
"""What a second program on the bus does."""


class ProxyLink:
    """A link whose frames pass through somebody else's hands."""

    def __init__(self, link: EmulatedLink, trouble: Trouble) -> None:
        """Stand between a link and whoever uses it."""
        self._link, self._trouble, self._rng, self._lag = link, trouble, trouble.rng, trouble.lag
        self._held: list[tuple[float, int, Received]] = []
        self._old: deque[Received] = deque(maxlen=400)
        self._sending: list[tuple[float, int, int, CanFrame]] = []
        self._count = 0
        self._codec = Codec()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._link, name)

    def _on(self, *kinds: str) -> bool:
        return self._trouble.kind in kinds and self._trouble.active(self._link.now())

    def _hit(self) -> bool:
        return self._trouble.hit()

    def send(self, bus: int, frame: CanFrame) -> None:
        self._flush()
        if self._on("refuses_frames", "fails"):
            raise BusError("the proxy takes no frames")
        if self._on("sends_nothing") or (self._on("drops") and self._hit()):
            return
        if self._on("corrupts") and self._hit():
            frame = self._damaged(frame)
        if self._on("delays") and self._hit():
            self._count += 1
            due = self._link.now() + self._lag * self._rng.random()
            heapq.heappush(self._sending, (due, self._count, bus, frame))
            return
        for _ in range(1 + (self._on("repeats") and self._hit())):
            self._link.send(bus, frame)

    def _flush(self) -> None:
        while self._sending and self._sending[0][0] <= self._link.now():
            _, _, bus, frame = heapq.heappop(self._sending)
            self._link.send(bus, frame)

    def _damaged(self, frame: CanFrame) -> CanFrame:
        data = bytearray(frame.data)
        for _ in range(int(self._rng.integers(1, 4))):
            data[int(self._rng.integers(len(data)))] = int(self._rng.integers(256))
        identifier = frame.id ^ (1 << int(self._rng.integers(29))) if frame.extended and self._hit() else frame.id
        return CanFrame(identifier, bytes(data), frame.extended)

    def receive(self, timeout: float) -> Received | None:
        end = self._link.now() + timeout
        while True:
            self._flush()
            if self._held and self._held[0][0] <= self._link.now():
                return heapq.heappop(self._held)[2]._replace(t=self._link.now())
            if self._on("fails"):
                self._link.sleep(min(timeout, 0.002))
                raise BusError("the proxy has failed")
            left = max(end - self._link.now(), 0.0)
            pending = self._sending or self._held
            received = self._link.receive(min(left, 0.002) if pending else left)
            if received is None:
                if self._link.now() >= end:
                    return None
                continue
            received = self._through(received)
            if received is not None:
                return received

    def _through(self, received: Received) -> Received | None:
        """Return a frame as it comes out of the proxy, or None where it does not yet or never."""
        self._old.append(received)
        if self._on("hears_nothing") or (self._on("drops") and self._hit()):
            return None
        if self._on("corrupts") and self._hit():
            return received._replace(frame=self._damaged(received.frame))
        if self._on("delays") and self._hit():
            self._count += 1
            due = self._link.now() + self._lag * self._rng.random()
            heapq.heappush(self._held, (due, self._count, received))
            return None
        if self._on("repeats") and self._hit():  # an old frame in its place
            return self._old[int(self._rng.integers(len(self._old)))]._replace(t=received.t)
        if self._on("forges") and self._hit():
            return received._replace(frame=self._forged(received.frame))
        return received

    def _forged(self, frame: CanFrame) -> CanFrame:
        try:
            message = self._codec.decode(frame)
        except FrameError:
            return CanFrame(frame.id, self._rng.bytes(len(frame.data)), frame.extended)
        if not isinstance(message, Feedback):
            return frame
        q, dq, tau = self._rng.uniform(-1, 1, 3) * [3.0, 25.0, 12.0]
        faults, warm = Fault(int(self._rng.integers(64))) if self._hit() else Fault(0), float(self._rng.uniform(20, 90))
        forged = Feedback(
            motor=message.motor,
            host=message.host,
            q=float(q),
            dq=float(dq),
            tau=float(tau),
            temperature=warm,
            mode=Mode(int(self._rng.integers(3))),
            faults=faults,
        )
        return self._codec.encode(forged)


class _Watched:
    """A watchdog that damps the robot by a link of its own, as the process does."""

    def __init__(self, link: EmulatedLink) -> None:
        self._link, self.there, self._beat = link, True, np.inf

    def arm(self) -> None: ...

    def beat(self) -> None:
        self._beat = self._link.now()

    def alive(self) -> bool:
        return self.there

    def disarm(self) -> None: ...

    def take_over(self) -> str:
        if not self.there:
            return ""
        self.there = False
        return damp_and_stop("", load_wiring(), self._link, lambda *_, **__: self._link)  # type: ignore[return-value]


class _WithMaster(CanRobot):
    """A driver beside which a second program speaks, once each control step."""

    def __init__(
        self, link: Any, wiring: Wiring, description: RobotDescription, watchdog: _Watched, master: Callable[[], None]
    ) -> None:
        super().__init__(link, wiring, description, watchdog=watchdog)
        self._master = master

    def step(self, command: JointCommand) -> Tick:
        self._master()
        return super().step(command)


class CanScene:
    """An emulated robot on CAN and what is between it and its driver."""

    def __init__(self, description: RobotDescription, trouble: Trouble) -> None:
        """Switch the robot on; half of the robots have motors with a timeout of their own.

        Args:
            description: The robot.
            trouble: What goes wrong.
        """
        self.trouble = trouble
        self._own_timeout = bool(trouble.rng.random() < 0.5)
        settings = EmulateSettings(zeroed=True, placement=0.03, seed=trouble.seed, can_timeout=self._own_timeout)
        wiring, faults = load_wiring(), [] if trouble.fault is None else [trouble.fault]
        self.robot = EmulatedRobot(description, wiring, settings, faults=faults)
        link = EmulatedLink(self.robot)
        link.sleep(0.3)
        self._other = EmulatedLink(self.robot)
        self._watchdog = _Watched(EmulatedLink(self.robot))
        self.plant = _WithMaster(ProxyLink(link, trouble), wiring, description, self._watchdog, self._master)

    def now(self) -> float:
        return self.robot.now

    def _master(self) -> None:
        """Let the second program speak, once each control step."""
        kind, rng, codec = self.trouble.kind, self.trouble.rng, Codec()
        if kind not in MASTERS or not self.trouble.active(self.now()):
            return
        frames: list[CanFrame] = []
        for motor in range(1, 13):
            q, dq, tau = rng.uniform(-1, 1, 3) * [2.0, 5.0, 6.0]
            message = {
                "master_commands": Operation(
                    motor=motor, q=float(q), dq=float(dq), kp=float(rng.uniform(0, 60)), kd=1.0, tau=float(tau)
                ),
                "master_stops": Stop(motor=motor, host=0xFD),
                "master_zeroes": SetZero(motor=motor, host=0xFD),
                "master_enables": Enable(motor=motor, host=0x80),
                "master_sets_torque": WriteParameter(motor=motor, host=0xFD, index=0x700B, value=float(abs(tau))),
                "master_asks": ReadParameter(motor=motor, host=0xFD, index=0x7019),
                "master_floods": GetDeviceId(motor=motor, host=0xFD),
            }[str(kind)]
            if rng.random() < 0.5:
                frames.append(codec.encode(message))
        if kind == "master_floods":
            frames += [CanFrame(int(rng.integers(16)), bytes(8), extended=False) for _ in range(120)]
        for frame in frames:
            self._other.send(0, frame)

    def stands_still(self, seconds: float) -> None:
        self._other.sleep(min(seconds, BEAT_TIMEOUT))
        if seconds > BEAT_TIMEOUT:
            self._watchdog.take_over()

    def is_alone(self) -> None:
        self._watchdog.take_over()

    def lets_go(self, seconds: float) -> None:
        self._other.sleep(seconds)

    def on(self) -> list[str]:
        return list(self.robot.switched_on())

    def driven(self) -> list[str]:
        return list(self.robot.driven())

    def reachable(self) -> bool:
        cut = ("bus_off", "unplugged", "motor_deaf", "stalled", "frames_lost", "frames_late", "frames_corrupted")
        fault = self.trouble.fault
        lost = fault is not None and fault.kind in cut and np.isinf(fault.until)
        return self._own_timeout or not lost

    def told(self) -> bool:
        ending = self.plant.ending
        return "did not confirm" in ending or "cut the power" in ending
