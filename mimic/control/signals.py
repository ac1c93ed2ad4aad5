"""Ctrl-C and SIGTERM as numbers that the control loop reads, so that neither interrupts a control step."""

from __future__ import annotations

import signal
import threading
from collections.abc import Generator
from contextlib import contextmanager
from types import FrameType

FORCED = 5
"""This many Ctrl-C raise KeyboardInterrupt after all: the loop does not read the numbers."""


class Signals:
    """Requests to end, counted."""

    def __init__(self) -> None:
        self.interrupts = 0
        self.terminated = False

    def _take(self, number: int, frame: FrameType | None) -> None:
        if number == signal.SIGTERM:
            self.terminated = True
            return
        self.interrupts += 1
        if self.interrupts >= FORCED:
            raise KeyboardInterrupt

    @contextmanager
    def caught(self, *numbers: int) -> Generator[None]:
        """Count signals instead of being ended by them; only in the main thread.

        Args:
            numbers: Signals; by default SIGINT and SIGTERM.
        """
        before = {number: signal.signal(number, self._take) for number in numbers or (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    @contextmanager
    def interrupts_counted(self) -> Generator[None]:
        """Count Ctrl-C where it would raise KeyboardInterrupt; leave it alone where something else handles it."""
        main = threading.current_thread() is threading.main_thread()
        if main and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            with self.caught(signal.SIGINT):
                yield
        else:
            yield
