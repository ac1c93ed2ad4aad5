"""What the networks between a program and an emulated robot have in common: when they disturb, and their thread.

Used by lab/faults/lcm_proxy.py and lab/faults/tcp_proxy.py.
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterable
from socket import socket
from types import TracebackType
from typing import Self

import numpy as np

from mimic.control.priority import LOOP, real_time


class Proxy(ABC):
    """A relay in a thread of its own; for a with statement."""

    def __init__(self, *seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.kind = ""
        """What it does while it is active."""
        self.share, self.lag = 1.0, 0.0
        """Share of the messages that are hit; longest delay [s]."""
        self.begin = self.end = float("inf")
        """When it is active, on the monotonic clock [s]."""
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def disturb(self, kind: str, share: float = 1.0, lag: float = 0.0, lasts: float = 1e9) -> None:
        """Begin now, for some time [s]."""
        self.kind, self.share, self.lag = kind, share, lag
        begin = time.monotonic()
        self.end, self.begin = begin + lasts, begin

    def active(self) -> bool:
        """Return whether it disturbs now."""
        return self.begin <= time.monotonic() < self.end

    def hit(self) -> bool:
        """Return whether the next message is hit."""
        return bool(self.rng.random() < self.share)

    def damaged(self, data: bytes, first: int = 0) -> bytes:
        """Return a message with one to three other bytes from a place on."""
        changed = bytearray(data)
        for _ in range(int(self.rng.integers(1, 4))):
            changed[int(self.rng.integers(first, len(changed)))] = int(self.rng.integers(256))
        return bytes(changed)

    @abstractmethod
    def relay(self) -> None:
        """Pass on what has come; wait a few ms for it at most."""

    @abstractmethod
    def sockets(self) -> Iterable[socket]:
        """Return what is open."""

    def _run(self) -> None:
        with real_time(LOOP):
            while not self._over.is_set():
                self.relay()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, value: object, trace: TracebackType | None) -> None:
        self._over.set()
        self._thread.join()
        for one in self.sockets():
            one.close()
