"""Serves an emulated motion board over its network on this computer, in real time."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from mimic.emulator.boards.board_base import TICK, NetworkBoard
from mimic.hardware.robot.board import Bus

CATCH_UP = 0.02
"""A longer delay than this is not caught up [s]; as in the maker's bench."""


class BoardServer:
    """Serves one emulated board."""

    def __init__(self, board: NetworkBoard[Any], bus: Bus, address: str = "") -> None:
        """Listen.

        Args:
            board: Nothing else may advance its time.
            bus: Its network, open in the robot's place; closed with the server.
            address: What a user gives to --robot.
        """
        self.board = board
        self._bus = bus
        self.addresses = [address]
        bus.heard = self._take
        self.stood_still = 0.0
        """How long emulated time stopped because the machine was too slow [s]."""
        self.unsent = 0
        """Messages that the network did not take."""
        self._begin = time.monotonic() - board.now

    def _take(self, channel: str, data: bytes, t: float) -> None:
        self.board.take(channel, data, min(t - self._begin, self.board.now + TICK))

    def run(self, stop: Callable[[], bool], each: Callable[[], None] = lambda: None) -> None:
        """Serve until ``stop`` returns True; ``each`` is called every cycle."""
        self._begin = time.monotonic() - self.board.now
        while not stop():
            due = self._begin + self.board.now + TICK
            behind = time.monotonic() - due
            if behind > CATCH_UP:
                self._begin += behind
                self.stood_still += behind
            self._bus.listen(self._begin + self.board.now + TICK)
            self.board.advance(self.board.now + TICK)
            for message in self.board.published(self.board.now):
                try:
                    self._bus.publish(message.channel, message.data)
                except OSError:
                    self.unsent += 1
            each()

    def close(self) -> None:
        """Leave the network."""
        self._bus.close()

    def line(self) -> str:
        """Return a line of what has happened so far."""
        return f"{self.board.now:9.1f} s  {self.board.line()}"

    def figures(self) -> dict[str, str]:
        """Return rows of a table of what has happened."""
        lost = {"not sent": f"{self.unsent} messages: the network did not take them"} if self.unsent else {}
        return self.board.figures() | lost
