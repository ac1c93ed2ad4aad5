"""What stands between a driver and an emulated robot: proxies of both links, second masters, a watchdog.

Used by benchmarks/faults_outside.py.
"""

from __future__ import annotations

import heapq
from collections import deque
from typing import Any

import numpy as np

from mimic.config.emulator import EmulateSettings
from mimic.emulator.board import EmulatedBoard
from mimic.emulator.board_link import EmulatedBoardLink
from mimic.emulator.faults import EmulatedFault
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
from mimic.hardware.stock.messages import MOTOR_CTRL
from mimic.hardware.stock.plant import StockRobot
from mimic.hardware.stock.wiring import load_board
from mimic.hardware.watchdog import BEAT_TIMEOUT, damp_and_stop
from mimic.hardware.wiring import load_wiring
from mimic.records import JOINTS
from mimic.robot.description import RobotDescription

CAN_PROXIES = (
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

STOCK_PROXIES = ("delays", "drops", "corrupts", "repeats", "forges", "cuts")
"""What a proxy of the LCM link does."""

MASTERS = {
    "can": (
        "master_commands",
        "master_stops",
        "master_zeroes",
        "master_enables",
        "master_sets_torque",
        "master_asks",
        "master_floods",
    ),
    "stock": ("master_commands", "master_once", "sender_killed", "sender_stopped"),
}
"""What a second program on the same robot does; on a stock robot, what happens to the sending process too."""


class _Window:
    """A fault that is there for a while."""

    begin = end = np.inf

    def active(self, t: float) -> bool:
        return self.begin <= t < self.end


class ProxyLink:
    """A link whose frames pass through somebody else's hands."""

    def __init__(self, link: EmulatedLink, kind: str | None, window: _Window, rng: np.random.Generator) -> None:
        self._link, self._kind, self._window, self._rng = link, kind, window, rng
        self._share = float(rng.uniform(0.05, 0.6))
        self._lag = float(rng.uniform(0.002, 0.08))
        self._held: list[tuple[float, int, Received]] = []
        self._old: deque[Received] = deque(maxlen=400)
        self._sending: list[tuple[float, int, int, CanFrame]] = []
        self._count = 0
        self._codec = Codec()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._link, name)

    def _on(self, *kinds: str) -> bool:
        return self._kind in kinds and self._window.active(self._link.now())

    def _hit(self) -> bool:
        return bool(self._rng.random() < self._share)

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


class CanScene:
    """An emulated robot on CAN and what is between it and its driver."""

    def __init__(
        self,
        description: RobotDescription,
        seed: int,
        rng: np.random.Generator,
        fault: EmulatedFault | None,
        kind: str | None,
    ) -> None:
        self._kind, self._window, self._rng, self._fault = kind, _Window(), rng, fault
        self._own_timeout = bool(rng.random() < 0.5)
        settings = EmulateSettings(zeroed=True, placement=0.03, seed=seed, can_timeout=self._own_timeout)
        wiring = load_wiring()
        self.robot = EmulatedRobot(description, wiring, settings, faults=[] if fault is None else [fault])
        link = EmulatedLink(self.robot)
        link.sleep(0.3)
        self._other = EmulatedLink(self.robot)
        self._watchdog = _Watched(EmulatedLink(self.robot))
        self._proxy = ProxyLink(link, kind, self._window, rng)
        self.plant: Any = CanRobot(self._proxy, wiring, description, watchdog=self._watchdog)
        if kind is not None and kind.startswith("master"):
            step = self.plant.step
            self.plant.step = lambda command: (self._master(), step(command))[1]

    def now(self) -> float:
        return self.robot.now

    def begins(self, begin: float, end: float) -> None:
        self._window.begin, self._window.end = begin, end

    def _master(self) -> None:
        """Let the second program speak, once each control step."""
        if not self._window.active(self.now()):
            return
        codec, rng = Codec(), self._rng
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
            }[str(self._kind)]
            if rng.random() < 0.5:
                frames.append(codec.encode(message))
        if self._kind == "master_floods":
            frames += [CanFrame(int(rng.integers(16)), bytes(8), extended=False) for _ in range(120)]
        for frame in frames:
            self._other.send(0, frame)

    def stands_still(self, seconds: float) -> None:
        """Let this program stand still; the watchdog acts as it would."""
        self._other.sleep(min(seconds, BEAT_TIMEOUT))
        if seconds > BEAT_TIMEOUT:
            self._watchdog.take_over()

    def is_alone(self) -> None:
        """Let the watchdog act after this program is gone."""
        self._watchdog.take_over()

    def lets_go(self, seconds: float) -> None:
        self._other.sleep(seconds)

    def on(self) -> list[str]:
        return [name for name, motor in zip(JOINTS, self.robot.motors, strict=True) if motor.mode is Mode.RUN]

    def driven(self) -> list[str]:
        return [
            name
            for name, motor in zip(JOINTS, self.robot.motors, strict=True)
            if motor.mode is Mode.RUN and (motor.drive.kp > 0.0 or motor.drive.tau)
        ]

    def reachable(self, lasts: float) -> bool:
        """Return whether the motors could be told at the end."""
        cut = ("bus_off", "unplugged", "motor_deaf", "stalled", "frames_lost", "frames_late", "frames_corrupted")
        lost = self._fault is not None and self._fault.kind in cut and np.isinf(self._fault.until)
        return self._own_timeout or not lost

    def told(self) -> bool:
        ending = self.plant.ending
        return "did not confirm" in ending or "cut the power" in ending


class StockScene:
    """An emulated stock robot and what is between it and its driver."""

    def __init__(
        self,
        description: RobotDescription,
        seed: int,
        rng: np.random.Generator,
        fault: EmulatedFault | None,
        kind: str | None,
    ) -> None:
        self._kind, self._window, self._rng = kind, _Window(), rng
        wiring = load_board()
        settings = EmulateSettings(placement=0.02, seed=seed)
        self.board = EmulatedBoard(description, wiring, settings, faults=[] if fault is None else [fault])
        self.link = EmulatedBoardLink(self.board, wiring, description)
        self._share, self._lag = float(rng.uniform(0.05, 0.6)), float(rng.uniform(0.002, 0.08))
        self._held: list[tuple[float, int, str, bytes]] = []
        self._old: deque[bytes] = deque(maxlen=200)
        self._count = 0
        self.link.wait(0.5)
        self.plant: Any = StockRobot(self.link, wiring, description)
        self._receive, self._heard = self.board.receive, self.link.sender.heard
        self.board.receive = lambda data, t: self._pass(data, t, "")  # type: ignore[method-assign]
        self.link.sender.heard = lambda channel, data, t: self._pass(data, t, channel)  # type: ignore[method-assign]
        self.link.hook = self._cycle

    def now(self) -> float:
        return self.board.now

    def begins(self, begin: float, end: float) -> None:
        self._window.begin, self._window.end = begin, end

    def _give(self, channel: str, data: bytes, t: float) -> None:
        if channel:
            self._heard(channel, data, t)
        else:
            self._receive(data, t)

    def _pass(self, data: bytes, t: float, channel: str) -> None:
        """Let a message through, to the board where it has no channel, else to the sender."""
        kind, rng = self._kind if self._window.active(t) else None, self._rng
        if kind == "cuts" or (kind == "drops" and rng.random() < self._share):
            return
        if channel == "":
            self._old.append(data)
        if kind == "delays" and rng.random() < self._share:
            self._count += 1
            heapq.heappush(self._held, (t + self._lag * rng.random(), self._count, channel, data))
            return
        if kind in ("corrupts", "forges") and rng.random() < self._share and channel not in ("", MOTOR_CTRL.channel):
            damaged = bytearray(data)
            first = 8 if kind == "forges" else 0
            for _ in range(int(rng.integers(1, 4))):
                damaged[int(rng.integers(first, len(damaged)))] = int(rng.integers(256))
            data = bytes(damaged)
        if kind == "repeats" and channel == "" and rng.random() < self._share:
            self._receive(self._old[int(rng.integers(len(self._old)))], t)
        self._give(channel, data, t)

    def _cycle(self, t: float) -> None:
        """Let held messages go, and the second program speak."""
        while self._held and self._held[0][0] <= t:
            _, _, channel, data = heapq.heappop(self._held)
            self._give(channel, data, t)
        if not self._window.active(t):
            if self._kind == "sender_stopped":
                self.link.halted = False
            return
        if self._kind in ("sender_killed", "sender_stopped"):
            self.link.halted = True
        once = self._kind == "master_once"
        if once or (self._kind == "master_commands" and self._rng.random() < 0.5):
            q = self._rng.uniform(-0.5, 0.5, 12)
            zeros = np.zeros(12)
            self.link.foreign(
                MOTOR_CTRL.encode(q_des=q, qd_des=zeros, kp_des=zeros + 20.0, kd_des=zeros + 1.0, tau_des=zeros)
            )
            self._window.end = t if once else self._window.end

    def stands_still(self, seconds: float) -> None:
        self.lets_go(seconds)

    def is_alone(self) -> None:
        self.lets_go(12.0)

    def lets_go(self, seconds: float) -> None:
        self.link.wait(self.link.now() + seconds)

    def on(self) -> list[str]:
        return self.driven()

    def driven(self) -> list[str]:
        kp, tau = self.board.applied[2], self.board.applied[4]
        rules = self.board._rules
        free = np.ones(12, dtype=bool) if rules is None else rules.limits == 0  # elsewhere the firmware's own springs
        return [f"place {i}" for i in np.flatnonzero((kp > 0.0) | (free & (np.abs(tau) > 0.1)))]

    def reachable(self, lasts: float) -> bool:
        return True

    def told(self) -> bool:
        return True
