"""A frame of a CAN 2.0 bus, how long it takes there, and what a host needs of its buses, real or emulated."""

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


_CRC = 0x4599
"""Polynomial of the check sum. Source: ISO 11898-1, CRC-15-CAN."""

_UNSTUFFED = 10 + 3
"""Bits after the check sum: its delimiter, acknowledge slot and delimiter, end of frame; the pause. ISO 11898-1."""


def _crc_bit(crc: int, bit: int) -> int:
    shifted = (crc << 1) & 0x7FFF
    return shifted ^ _CRC if bit ^ (crc >> 14) else shifted


def _crc_byte(byte: int) -> int:
    crc = byte << 7
    for _ in range(8):
        crc = _crc_bit(crc, 0)
    return crc


_CRC_TABLE = tuple(_crc_byte(byte) for byte in range(256))


def _run_bit(state: int, bit: int) -> tuple[int, int]:
    """Return the state after a bit, and 1 if a bit is stuffed; state = 2 * run length (1-5) + its bit, first 0."""
    length = state >> 1
    last = state & 1
    length = length + 1 if length and bit == last else 1
    return (2 + (1 - bit), 1) if length == 5 else (2 * length + bit, 0)


def _run_byte(state: int, byte: int) -> tuple[int, int]:
    stuffed = 0
    for place in range(7, -1, -1):
        state, more = _run_bit(state, byte >> place & 1)
        stuffed += more
    return state, stuffed


_RUN_TABLE = tuple(tuple(map(_run_byte, (state,) * 256, range(256))) for state in range(10))


def frame_bits(frame: CanFrame) -> int:
    """Return how many bits a frame takes on the bus, stuffed bits and the pause after it included.

    Source: ISO 11898-1: fields of a data frame, stuffing from start of frame to check sum.
    """
    count = len(frame.data)
    if frame.extended:  # start, 11 bits, SRR, IDE, 18 bits, RTR, two reserved, length
        base = frame.id >> 18
        rest = frame.id & 0x3FFFF
        head = ((base << 2 | 3) << 18 | rest) << 7 | count
        head_bits = 39
    else:  # start, 11 bits, RTR, IDE, one reserved, length
        head = frame.id << 7 | count
        head_bits = 19
    bits = head_bits + 8 * count
    value = head << 8 * count | int.from_bytes(frame.data, "big")
    crc = _check_sum(value, bits)
    stuffed = _stuffed(value << 15 | crc, bits + 15)
    return bits + 15 + stuffed + _UNSTUFFED


def _check_sum(value: int, bits: int) -> int:
    padded = value.to_bytes((bits + 7) // 8, "big")  # zeros in front leave the check sum of zero as it is
    crc = 0
    for byte in padded:
        crc = (crc << 8 & 0x7FFF) ^ _CRC_TABLE[crc >> 7 ^ byte]
    return crc


def _stuffed(value: int, bits: int) -> int:
    state = 0
    stuffed = 0
    odd = bits % 8
    for place in range(bits - 1, bits - 1 - odd, -1):
        state, more = _run_bit(state, value >> place & 1)
        stuffed += more
    if bits > odd:
        for byte in (value & ((1 << bits - odd) - 1)).to_bytes((bits - odd) // 8, "big"):
            state, more = _RUN_TABLE[state][byte]
            stuffed += more
    return stuffed


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
