"""Emulated motion boards as the buses of their drivers, in the board's own time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from mimic.emulator.boards.board_base import TICK, NetworkBoard
from mimic.hardware.go2.messages import LOWCMD
from mimic.hardware.robot.board import Bus
from mimic.hardware.stock.messages import MOTOR_CTRL


class EmulatedBoardBus(Bus):
    """Two LCM ports without a network: listening advances the board."""

    def __init__(self, board: NetworkBoard[Any]) -> None:
        """Connect to a board; nothing else may advance it."""
        self.board = board
        self.heard = lambda channel, data, t: None
        self.hook: Callable[[float], None] = lambda t: None
        """Called each cycle with the time, for whatever else happens on the network."""

    def now(self) -> float:
        """Return the board's time [s]."""
        return self.board.now

    def publish(self, channel: str, data: bytes) -> None:
        """Send a command; it comes back, as by multicast."""
        self.board.take(channel, data, self.now())
        self.heard(channel, data, self.now())

    def listen(self, until: float, wake: int | None = None) -> None:
        """Let the board go on until a time [s], and hand on what it says."""
        while self.board.now < until - 1e-9:
            self.hook(self.board.now)
            self.board.advance(self.board.now + TICK)
            for message in self.board.published(self.board.now):
                self.heard(message.channel, message.data, message.t)

    def foreign(self, data: bytes) -> None:
        """Let another program send a command."""
        self.publish(MOTOR_CTRL.channel, data)

    def close(self) -> None:
        """Leave the network."""


class EmulatedGo2Bus(EmulatedBoardBus):
    """An emulated Go2 as the bus of `mimic.hardware.go2.driver`, in the robot's own time."""

    rivals: Sequence[str] = ()
    """Who else may write commands."""
    robots: Sequence[str] = ("this robot",)
    """Who writes readings."""

    def ready(self, topic: str) -> bool:
        """Return True: the robot hears everything."""
        return True

    def others(self, topic: str = LOWCMD) -> list[str]:
        """Return who else may write a topic."""
        return list(self.rivals if topic == LOWCMD else self.robots)

    def publish(self, channel: str, data: bytes) -> None:
        """Send a message."""
        self.board.take(channel, data, self.now())

    def foreign(self, data: bytes) -> None:
        """Let another program send a command."""
        self.publish(LOWCMD, data)
        self.heard(LOWCMD, data, self.now())
