"""What emulated motion boards have in common: a body, messages that a network delays, loses or damages, and faults.

The owner advances the time. Messages go in with the time of their arrival, and come out with the time at which they
were sent.
"""

from __future__ import annotations

import heapq
import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from mimic.config.emulator import EmulateSettings
from mimic.dynamics.effect_set import EffectSet
from mimic.emulator.body import EmulatedBody
from mimic.emulator.faults import EmulatedFault, Schedule, miswiring
from mimic.emulator.motor import Drive
from mimic.errors import ConfigError
from mimic.geometry import multiply_quats
from mimic.hardware.robot.board_wiring import JointWiring
from mimic.records import JOINTS, FloatArray
from mimic.robot.description import RobotDescription

TICK = 0.002
"""The firmware's cycle [s]."""

OLD = 0.01
"""A command that is older is counted [s]."""

MESSAGE_FAULTS = ("frames_lost", "frames_late", "frames_doubled", "frames_corrupted", "frames_reordered")
"""Kinds of faults that its network has."""

W = TypeVar("W", bound=JointWiring)


class Published(NamedTuple):
    """A message of the board."""

    t: float
    """When it arrives [s]."""
    channel: str
    data: bytes


class NetworkBoard(Generic[W]):
    """A robot behind a network, from power-up on, lying or suspended. `_cycle` is its firmware."""

    name: str
    """In messages."""
    hears: Sequence[str]
    """Channels or topics that it takes."""
    kinds: Sequence[str]
    """Kinds of faults that it has; its network counts as bus 0."""

    def __init__(
        self,
        description: RobotDescription,
        wiring: W,
        settings: EmulateSettings | None = None,
        *,
        effects: EffectSet | None = None,
        faults: Sequence[EmulatedFault] = (),
        timestep: float = TICK,
    ) -> None:
        """Switch it on.

        Args:
            description: The robot.
            wiring: Order, signs and units of its messages.
            settings: How it lies or hangs, and its noise.
            effects: What its drives have besides.
            faults: What goes wrong.
            timestep: Of the physics [s].

        Raises:
            ConfigError: If a fault does not exist on this robot.
        """
        settings = settings or EmulateSettings()
        for fault in faults:
            if fault.kind not in self.kinds:
                raise ConfigError(f"{self.name} has no fault {fault.kind!r}; it has {', '.join(self.kinds)}")
        self._d = description
        self._wiring = wiring
        self._settings = settings
        self.body = EmulatedBody(
            description,
            effects=effects,
            suspended=settings.suspended,
            timestep=timestep,
            placement=settings.placement,
            seed=settings.seed,
        )
        self.body.release()
        self.body.miswire(*miswiring(faults), np.zeros(len(JOINTS)))
        self._rng = np.random.default_rng([settings.seed, 29])
        self.schedule = Schedule(faults, self._rng)
        self.now = 0.0
        """[s]"""
        self.ticks = 0
        self.commands = 0
        """Messages that were sent to it."""
        self.old_cycles = 0
        """Cycles with a command older than OLD while motors were driven."""
        self.oldest = 0.0
        """Age of the oldest command by which a motor was driven [s]."""
        self.events: deque[tuple[float, str]] = deque()
        """What happened, for whoever shows it."""
        self._incoming: list[tuple[float, int, str, bytes]] = []
        self._outgoing: list[tuple[float, int, str, bytes]] = []
        self._count = 0
        self._frozen: tuple[FloatArray, FloatArray, int] | None = None
        self._placed = self.body.joints(0.0)[0]

    # ------------------------------------------------------------------ the network

    def take(self, channel: str, data: bytes, t: float) -> None:
        """Take a message that was sent at time t [s]; what it does not listen to is left out."""
        if channel not in self.hears:
            return
        self.commands += 1
        for at, name, damaged in self._through(channel, data, t):
            self._count += 1
            heapq.heappush(self._incoming, (at, self._count, name, damaged))

    def published(self, t: float) -> list[Published]:
        """Return the messages that have arrived by time t [s], in their order."""
        out: list[Published] = []
        while self._outgoing and self._outgoing[0][0] <= t:
            at, _, channel, data = heapq.heappop(self._outgoing)
            out.append(Published(at, channel, data))
        return out

    def _publish(self, channel: str, data: bytes) -> None:
        for at, name, damaged in self._through(channel, data, self.now):
            self._count += 1
            heapq.heappush(self._outgoing, (at, self._count, name, damaged))

    def _through(self, channel: str, data: bytes, t: float) -> list[tuple[float, str, bytes]]:
        """Return what the network makes of a message: when it arrives, and how, once or twice or not at all."""
        faults = self.schedule
        if faults.value("bus_off", t, bus=0) is not None or faults.happens("frames_lost", t, 0):
            return []
        at = t + (faults.value("frames_late", t, bus=0) or 0.0)
        if faults.happens("frames_reordered", t, 0):
            at += 0.004 + 0.004 * self._rng.random()
        if faults.happens("frames_corrupted", t, 0):
            bits = bytearray(data)
            bits[int(self._rng.integers(len(bits)))] ^= 1 << int(self._rng.integers(8))
            data = bytes(bits)
        return [(at, channel, data)] * (2 if faults.happens("frames_doubled", t, 0) else 1)

    def _has(self, kind: str) -> bool:
        """Return whether a fault of the whole robot is there now."""
        return self.schedule.value(kind, self.now) is not None

    def _joints_with(self, kind: str) -> dict[int, float]:
        """Return the joints of the description that have a fault now, and its value."""
        return {
            int(fault.joint): fault.value
            for fault in self.schedule.faults
            if fault.kind == kind and fault.joint is not None and fault.active(self.now)
        }

    # ------------------------------------------------------------------ time

    def advance(self, t: float) -> None:
        """Go on, cycle by cycle, up to time t [s]."""
        while (self.ticks + 1) * TICK <= t + 1e-9:
            self.ticks += 1
            self.now = self.ticks * TICK
            self._cycle()

    def _cycle(self) -> None:
        raise NotImplementedError

    def _began(self) -> None:
        """Take note of the first command."""
        self.schedule.release(self.now)
        self.events.append((self.now, "the first command came"))

    def _drive(self, joint: int, drive: Drive) -> None:
        self.body.drive(joint, drive._replace(limit=float(self._d.torque_max[joint])), self.now)

    def _warm(self) -> FloatArray:
        """Return the temperatures that the motors report (12,) [degC]."""
        hot = self._joints_with("motor_hot")
        return np.array([max(self.body.temperature(j), hot.get(j, -math.inf)) for j in range(len(JOINTS))])

    @property
    def torques(self) -> FloatArray:
        """Torques that the motors give (12,), in the order and sign of the description's joints [N m]."""
        return self.body.joints(self.now)[2]

    def switched_on(self) -> tuple[str, ...]:
        """Return the joints whose motors are on: those that are driven."""
        return self.driven()

    def driven(self) -> tuple[str, ...]:
        """Return the joints with stiffness or a torque of a command."""
        raise NotImplementedError

    def _count_age(self, age: float) -> None:
        """Count the age of the command by which motors are driven [s]."""
        self.old_cycles += age > OLD
        self.oldest = max(self.oldest, age)

    def ages(self) -> str:
        """Return how old the commands were by which motors were driven."""
        return f"at most {1e3 * self.oldest:.0f} ms old; {self.old_cycles} cycles of 2 ms with one older than 10 ms"

    def line(self) -> str:
        """Return a line of what has happened so far."""
        raise NotImplementedError

    def figures(self) -> dict[str, str]:
        """Return rows of a table of what has happened."""
        raise NotImplementedError

    def _arrived_by_now(self, take: Callable[[str, bytes, float], None]) -> None:
        """Hand on the messages that have arrived."""
        while self._incoming and self._incoming[0][0] <= self.now:
            at, _, channel, data = heapq.heappop(self._incoming)
            take(channel, data, at)

    def orientation(self, stamp: int = 0) -> tuple[FloatArray, FloatArray, int]:
        """Return the IMU's quaternion wxyz (4,), its rate of turn (3,) [rad/s], and a stamp, all with its faults."""
        quat, omega = self.body.base()
        omega = omega + self._rng.normal(0.0, self._settings.imu_noise, 3)
        tilt = self.schedule.value("imu_tilted", self.now)
        if tilt is not None:
            quat = multiply_quats(quat, np.array([math.cos(tilt / 2), 0.0, math.sin(tilt / 2), 0.0]))
        if self._has("imu_frozen"):
            self._frozen = self._frozen or (quat, omega, stamp)
            return self._frozen
        self._frozen = None
        return quat, omega, stamp
