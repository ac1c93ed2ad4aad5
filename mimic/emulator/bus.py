"""One CAN bus in emulated time: every frame takes its bits, and when several wait, the lowest identifier goes first."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from mimic.hardware.can.frame import CanFrame
from mimic.hardware.can.load import frame_bits


def arbitration_key(frame: CanFrame) -> int:
    """Return a number that is the smaller the sooner a frame wins the bus.

    Bit by bit the dominant 0 wins: the first 11 bits of both kinds of identifier stand against each other, and of equal
    ones that of 11 bits wins, as its frame goes on with a 0.
    """
    if frame.extended:
        base = frame.id >> 18
        rest = frame.id & 0x3FFFF
        return base << 19 | 1 << 18 | rest
    return frame.id << 19


class Sent(NamedTuple):
    """A frame that has been on the bus."""

    t: float
    """When its last bit was [s]."""
    node: str
    """Who sent it."""
    frame: CanFrame


@dataclass
class EmulatedBus:
    """Nodes with a queue each; a node's frames keep their order, the first of each stand against each other."""

    bitrate: int
    """[bit/s]"""
    off: bool = False
    """Nothing gets through; what waits is lost, as a controller that is off drops its mailboxes."""
    bits: int = 0
    """Sent so far."""
    frames: int = 0
    """Sent so far."""
    _queues: dict[str, deque[tuple[float, CanFrame]]] = field(default_factory=dict)
    _free_at: float = 0.0
    _sending: Sent | None = None
    _next: float | None = None

    def submit(self, node: str, frame: CanFrame, ready: float) -> None:
        """Let a node send a frame as soon as it can from time ``ready`` [s] on."""
        if not self.off:
            self._queues.setdefault(node, deque()).append((ready, frame))
            self._next = None

    @property
    def waiting(self) -> int:
        """How many frames wait or are being sent."""
        return sum(len(queue) for queue in self._queues.values()) + (self._sending is not None)

    @property
    def next_event(self) -> float:
        """Time of the next event if nothing is submitted [s]; infinite if nothing is queued."""
        if self._next is None:
            if self._sending is not None:
                self._next = self._sending.t
            else:
                ready = min((queue[0][0] for queue in self._queues.values() if queue), default=math.inf)
                self._next = max(ready, self._free_at)
        return self._next

    def advance(self) -> Sent | None:
        """Go to the next event: the end of a frame, which is returned, or the beginning of one."""
        now = self.next_event
        self._next = None
        if self.off:
            self._queues.clear()
            self._sending = None
            return None
        if self._sending is not None:
            done = self._sending
            self._sending = None
            self._free_at = done.t
            return done
        waiting = [(node, queue) for node, queue in self._queues.items() if queue and queue[0][0] <= now]
        if not waiting:
            return None
        node, queue = min(waiting, key=lambda entry: arbitration_key(entry[1][0][1]))
        frame = queue.popleft()[1]
        bits = frame_bits(frame)
        self.bits = self.bits + bits
        self.frames = self.frames + 1
        self._sending = Sent(now + bits / self.bitrate, node, frame)
        return None
