"""What a host needs of its buses: the same for hardware, for an emulator in another process and for one in this one."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from mimic.hardware.can.frame import CanFrame


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
