"""A frame of a CAN 2.0 bus, and what a host needs of its buses, real or emulated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

from mimic.errors import FrameError

EXTENDED_IDS = 1 << 29
"""Number of identifiers of 29 bits."""
STANDARD_IDS = 1 << 11
"""Number of identifiers of 11 bits."""


@dataclass(frozen=True, slots=True)
class CanFrame:
    """A data frame: identifier and up to eight bytes."""

    id: int
    data: bytes
    extended: bool = True
    """True for an identifier of 29 bits, False for one of 11."""

    def __post_init__(self) -> None:
        width = EXTENDED_IDS if self.extended else STANDARD_IDS
        if not 0 <= self.id < width:
            raise FrameError(f"the identifier is 0x{self.id:X}; expected less than 0x{width:X}")
        if len(self.data) > 8:
            raise FrameError(f"the frame has {len(self.data)} bytes; a CAN frame has at most 8")

    def __str__(self) -> str:
        """Return the frame as candump writes it, such as ``017FFF01#8A2F7FFF0F5C3333``."""
        return f"{self.id:0{8 if self.extended else 3}X}#{self.data.hex().upper()}"


class Received(NamedTuple):
    """A frame that came."""

    bus: int
    """Index of the bus."""
    frame: CanFrame
    t: float
    """When it came, on the clock of the link [s]."""


class Link(Protocol):
    """One or more buses and the clock that goes with them: the computer's, or that of an emulation."""

    wake: int | None
    """Descriptor that also ends a wait, when something is to be read from it."""
    woken: bool
    """Whether that ended the last wait."""

    @property
    def names(self) -> tuple[str, ...]:
        """The buses, as a person would call them."""
        ...

    def now(self) -> float:
        """Return the time [s]; it never goes back."""
        ...

    def send(self, bus: int, frame: CanFrame) -> None:
        """Hand a frame to a bus, without waiting for it to be sent.

        Raises:
            BusError: If the bus does not take it.
        """
        ...

    def receive(self, timeout: float) -> Received | None:
        """Return the next frame of any bus, or None when there is none for ``timeout`` seconds; 0 only looks.

        Raises:
            BusError: If a bus has failed.
        """
        ...

    def reopen(self, bus: int) -> None:
        """Begin to open a bus again that has failed, without waiting for it; meanwhile it takes and says nothing."""
        ...

    def sleep(self, seconds: float) -> None:
        """Let time pass; frames that come meanwhile wait."""
        ...

    def close(self) -> None:
        """Let go of the buses. Safe to call twice, and on a bus that has failed."""
        ...
