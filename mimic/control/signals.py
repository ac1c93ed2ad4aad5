"""Ctrl-C, SIGTERM and SIGHUP as numbers that the control loop reads, so that none interrupts a control step."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from types import FrameType

FORCED = 5
"""This many Ctrl-C that the loop has not read raise KeyboardInterrupt after all."""


class Signals:
    """Requests to end, counted."""

    def __init__(self) -> None:
        self.interrupts = 0
        self.terminated = False
        self.hung_up = False
        """Whether the terminal was closed; it counts as Ctrl-C."""
        self.hold: Callable[[], bool] | None = None
        """Returns whether somebody still holds what must be held; None where nothing must be."""
        self._read = 0

    @property
    def released(self) -> bool:
        """Whether what must be held was let go."""
        return self.hold is not None and not self.hold()

    def read(self) -> int:
        """Return how often Ctrl-C was pressed; call it at every control step."""
        self._read = self.interrupts
        return self._read

    def _take(self, number: int, frame: FrameType | None) -> None:
        if number == signal.SIGTERM:
            self.terminated = True
            return
        if number == signal.SIGHUP:
            self.interrupts = max(self.interrupts, 1)
            self.hung_up = True
            return
        self.interrupts += 1
        if self.interrupts - self._read >= FORCED:
            raise KeyboardInterrupt

    @contextmanager
    def caught(self, *numbers: int) -> Generator[None]:
        """Count signals instead of being ended by them; only in the main thread.

        Args:
            numbers: Signals; by default SIGINT, SIGTERM, and SIGHUP unless it is ignored, as under nohup.
        """
        if not numbers:
            ignored = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
            numbers = (signal.SIGINT, signal.SIGTERM, *(() if ignored else (signal.SIGHUP,)))
        before = {number: signal.signal(number, self._take) for number in numbers}
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
