"""An emulated stock robot behind a proxy, with a second program on its network.

Used by lab/faults/faults_outside.py.
"""

from __future__ import annotations

import heapq
from collections import deque
from typing import Any

import numpy as np

from lab.faults.faults_scene import Trouble
from mimic.config.emulator import EmulateSettings
from mimic.emulator.board import EmulatedBoard
from mimic.emulator.board_link import EmulatedBoardLink
from mimic.hardware.stock.messages import MOTOR_CTRL
from mimic.hardware.stock.plant import StockRobot
from mimic.hardware.stock.sender import OBEYS_ANOTHER, UNREACHED
from mimic.hardware.stock.wiring import load_board
from mimic.robot.description import RobotDescription

PROXIES = ("delays", "drops", "corrupts", "repeats", "forges", "cuts")
"""What a proxy of the LCM link does."""

MASTERS = ("master_commands", "master_once", "sender_killed", "sender_stopped")
"""What a second program on the same robot does, and what happens to the sending process."""


class StockScene:
    """An emulated stock robot and what is between it and its driver."""

    def __init__(self, description: RobotDescription, trouble: Trouble) -> None:
        """Switch the robot on.

        Args:
            description: The robot.
            trouble: What goes wrong.
        """
        self.trouble = trouble
        wiring, faults = load_board(), [] if trouble.fault is None else [trouble.fault]
        settings = EmulateSettings(placement=0.02, seed=trouble.seed)
        self.board = EmulatedBoard(description, wiring, settings, faults=faults)
        self.link = EmulatedBoardLink(self.board, wiring, description)
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

    def _give(self, channel: str, data: bytes, t: float) -> None:
        if channel:
            self._heard(channel, data, t)
        else:
            self._receive(data, t)

    def _pass(self, data: bytes, t: float, channel: str) -> None:
        """Let a message through, to the board where it has no channel, else to the sender."""
        kind, rng = self.trouble.kind if self.trouble.active(t) else None, self.trouble.rng
        if kind == "cuts" or (kind == "drops" and self.trouble.hit()):
            return
        if channel == "":
            self._old.append(data)
        if kind == "delays" and self.trouble.hit():
            self._count += 1
            heapq.heappush(self._held, (t + self.trouble.lag * rng.random(), self._count, channel, data))
            return
        if kind in ("corrupts", "forges") and self.trouble.hit() and channel not in ("", MOTOR_CTRL.channel):
            damaged = bytearray(data)
            first = 8 if kind == "forges" else 0
            for _ in range(int(rng.integers(1, 4))):
                damaged[int(rng.integers(first, len(damaged)))] = int(rng.integers(256))
            data = bytes(damaged)
        if kind == "repeats" and channel == "" and self.trouble.hit():
            self._receive(self._old[int(rng.integers(len(self._old)))], t)
        self._give(channel, data, t)

    def _cycle(self, t: float) -> None:
        """Let held messages go, and the second program speak."""
        while self._held and self._held[0][0] <= t:
            _, _, channel, data = heapq.heappop(self._held)
            self._give(channel, data, t)
        if not self.trouble.active(t):
            if self.trouble.kind == "sender_stopped":
                self.link.halted = False
            return
        if self.trouble.kind in ("sender_killed", "sender_stopped"):
            self.link.halted = True
        once = self.trouble.kind == "master_once"
        if once or (self.trouble.kind == "master_commands" and self.trouble.rng.random() < 0.5):
            q = self.trouble.rng.uniform(-0.5, 0.5, 12)
            zeros = np.zeros(12)
            self.link.foreign(
                MOTOR_CTRL.encode(q_des=q, qd_des=zeros, kp_des=zeros + 20.0, kd_des=zeros + 1.0, tau_des=zeros)
            )
            self.trouble.end = t if once else self.trouble.end

    def stands_still(self, seconds: float) -> None:
        self.lets_go(seconds)

    def is_alone(self) -> None:
        self.lets_go(12.0)

    def lets_go(self, seconds: float) -> None:
        self.link.wait(self.link.now() + seconds)

    def on(self) -> list[str]:
        return self.driven()

    def driven(self) -> list[str]:
        return list(self.board.driven())

    def reachable(self) -> bool:
        """Return whether no other program still commands the robot, whose firmware obeys whoever sends."""
        return not (self.trouble.kind == "master_commands" and self.trouble.active(self.now()))

    def told(self) -> bool:
        return self.plant.ending in (OBEYS_ANOTHER, UNREACHED)
