"""Serves an emulated stock board over LCM on this computer, in real time."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from mimic.emulator.board import TICK, EmulatedBoard
from mimic.hardware.stock.lcm_bus import LcmBus
from mimic.hardware.stock.messages import MOTOR_CTRL
from mimic.hardware.stock.wiring import BoardWiring

CATCH_UP = 0.02
"""A longer delay than this is not caught up [s]; as in the maker's bench."""


@dataclass(frozen=True, kw_only=True, slots=True)
class BoardStatus:
    """Statistics of the emulation so far."""

    t: float
    """Time of the emulation [s]."""
    commands: int
    """motor_ctrl messages received."""
    late_ticks: int
    """Cycles with error 0x01."""
    err_flag: int
    stood_still: float
    """How long emulated time stopped because the machine was too slow [s]."""


class BoardServer:
    """Serves one emulated board. Its messages never leave this computer (ttl 0)."""

    def __init__(self, board: EmulatedBoard, wiring: BoardWiring) -> None:
        """Open LCM.

        Args:
            board: Nothing else may advance its time.
            wiring: Group and ports.

        Raises:
            BusError, MissingExtra: If LCM cannot be opened.
        """
        self.board = board
        self._bus = LcmBus(wiring, 0, self._take)
        self._commands = 0
        self._stood_still = 0.0
        self._begin = time.monotonic() - board.now

    def _take(self, channel: str, data: bytes, t: float) -> None:
        if channel == MOTOR_CTRL.channel:
            self._commands += 1
            self.board.receive(data, min(t - self._begin, self.board.now + TICK))

    def run(self, stop: Callable[[], bool], each: Callable[[], None] = lambda: None) -> None:
        """Serve until ``stop`` returns True; ``each`` is called every cycle."""
        self._begin = time.monotonic() - self.board.now
        while not stop():
            due = self._begin + self.board.now + TICK
            behind = time.monotonic() - due
            if behind > CATCH_UP:
                self._begin += behind
                self._stood_still += behind
            self._bus.listen(self._begin + self.board.now + TICK)
            self.board.advance(self.board.now + TICK)
            for message in self.board.published(self.board.now):
                self._bus.publish(message.channel, message.data)
            each()

    def close(self) -> None:
        """Close LCM."""
        self._bus.close()

    def status(self) -> BoardStatus:
        """Return the statistics so far."""
        return BoardStatus(
            t=self.board.now,
            commands=self._commands,
            late_ticks=self.board.late_ticks,
            err_flag=self.board.err_flag,
            stood_still=self._stood_still,
        )
