"""Ctrl-C and SIGTERM as numbers that the loop looks at, so that neither can tear a control step apart."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

DESPERATE = 5
"""Ctrl-C this often raises KeyboardInterrupt after all: whoever should look at the numbers does not."""


class Signals:
    """What the process was asked since it was watched."""

    def __init__(self) -> None:
        self.interrupts = 0
        self.terminated = False

    def _take(self, number: int, frame: FrameType | None) -> None:
        if number == signal.SIGTERM:
            self.terminated = True
            return
        self.interrupts += 1
        if self.interrupts >= DESPERATE:
            raise KeyboardInterrupt

    @contextmanager
    def caught(self) -> Iterator[None]:
        """Count signals instead of being ended by them; only in the main thread."""
        before = {number: signal.signal(number, self._take) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
