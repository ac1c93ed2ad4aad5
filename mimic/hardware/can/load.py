"""Bus load: how long a frame is, and the share of a bus's time that a robot takes, estimated before anything is sent.

The mean bits of commands and feedback are facts of the motors' maker.
"""

from __future__ import annotations

import numpy as np

from mimic.hardware.can.frame import CanFrame
from mimic.hardware.can.wiring import Wiring
from mimic.records import FloatArray

IMU_MESSAGE = {
    "quaternion": 114.8,
    "rate_of_turn": 102.1,
    "group_counter": 66.0,
    "status_word": 83.0,
    "sample_time": 86.0,
}
"""Length of each message, with stuffed bits and the pause after it [bit]: orientation and rate of turn are means of
20 000 frames of a moving robot; for counter, status and time one bit in twenty is assumed to be stuffed."""

MAX_LOAD = 0.9
"""Share of a bus above which frames pile up when they have more stuffed bits than on average."""

_COUNT_EVERY = 16
"""One frame in so many has its bits counted exactly; frames of one kind hardly differ."""


def expected_load(wiring: Wiring, rate_hz: float) -> FloatArray:
    """Return the expected share of each bus's time (buses,).

    Args:
        wiring: Which motor is on which bus.
        rate_hz: Commands a second to each motor [Hz].
    """
    motors = wiring.motors().facts
    bits = np.bincount(wiring.bus, minlength=wiring.buses) * rate_hz * (motors.command_bits + motors.feedback_bits)
    bits[wiring.imu.bus] += sum(IMU_MESSAGE[name] * rate for name, rate in wiring.imu.rate.items())
    return bits / wiring.bitrate


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


class BitCount:
    """Bits on each bus so far."""

    def __init__(self, buses: int) -> None:
        self.bits: FloatArray = np.zeros(buses)
        """Of each bus (buses,)."""
        self._frames = 0
        self._of_kind: dict[tuple[int, int], int] = {}

    def add(self, bus: int, frame: CanFrame) -> None:
        """Count a frame; of most, as many as the last one of its kind had."""
        kind = (len(frame.data), frame.id >> 24 if frame.extended else frame.id)
        if kind not in self._of_kind or self._frames % _COUNT_EVERY == 0:
            self._of_kind[kind] = frame_bits(frame)
        self._frames += 1
        self.bits[bus] += self._of_kind[kind]


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
