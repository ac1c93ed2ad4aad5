from __future__ import annotations

import pytest

from mimic.emulator.bus import EmulatedBus, Sent, arbitration_key
from mimic.hardware.can.frame import CanFrame
from mimic.hardware.can.load import frame_bits

LOW, HIGH = CanFrame(0x01000001, bytes(8)), CanFrame(0x04000001, bytes(8))
MBIT = 1_000_000


def run(bus: EmulatedBus) -> list[Sent]:
    sent = []
    while bus.waiting:
        done = bus.advance()
        if done is not None:
            sent.append(done)
    return sent


def test_a_frame_takes_its_bits():
    bus = EmulatedBus(MBIT)
    bus.submit("a", LOW, 0.5)
    (sent,) = run(bus)
    assert sent.t == pytest.approx(0.5 + frame_bits(LOW) / MBIT)
    assert (bus.bits, bus.frames) == (frame_bits(LOW), 1)


def test_on_a_slow_bus_it_takes_longer():
    bus = EmulatedBus(250_000)
    bus.submit("a", LOW, 0.0)
    assert run(bus)[0].t == pytest.approx(frame_bits(LOW) / 250_000)


def test_of_those_that_wait_the_lowest_identifier_goes_first():
    bus = EmulatedBus(MBIT)
    bus.submit("a", HIGH, 0.0)
    bus.submit("b", LOW, 0.0)
    assert [sent.frame for sent in run(bus)] == [LOW, HIGH]


def test_a_frame_that_has_begun_is_not_interrupted():
    bus = EmulatedBus(MBIT)
    bus.submit("a", HIGH, 0.0)
    bus.submit("b", LOW, 1e-6)
    first, second = run(bus)
    assert (first.frame, second.frame) == (HIGH, LOW)
    assert second.t == pytest.approx((frame_bits(HIGH) + frame_bits(LOW)) / MBIT)


def test_a_node_keeps_the_order_of_its_own_frames():
    bus = EmulatedBus(MBIT)
    for frame in (HIGH, LOW):
        bus.submit("a", frame, 0.0)
    assert [sent.frame for sent in run(bus)] == [HIGH, LOW]


def test_a_frame_waits_until_its_node_is_ready():
    bus = EmulatedBus(MBIT)
    bus.submit("a", HIGH, 0.0)
    bus.submit("b", LOW, 0.01)
    assert run(bus)[1].t == pytest.approx(0.01 + frame_bits(LOW) / MBIT)


def test_a_bus_that_is_off_takes_nothing_and_drops_what_waits():
    bus = EmulatedBus(MBIT)
    bus.submit("a", LOW, 0.0)
    bus.off = True
    bus.submit("a", HIGH, 0.0)
    assert run(bus) == []
    assert bus.next_event == float("inf")
    bus.off = False
    bus.submit("a", HIGH, 1.0)
    assert [sent.frame for sent in run(bus)] == [HIGH]


def test_the_lower_identifier_wins_and_eleven_bits_before_twenty_nine():
    order = [
        CanFrame(0x021, b"", extended=False),
        CanFrame(0x017FFF01, b""),  # an operation command: first eleven bits 0x05F
        CanFrame(0x0400FD01, b""),  # stop: 0x100
        CanFrame(0x100, b"", extended=False),
    ]
    winners = sorted(order, key=arbitration_key)
    assert winners == [order[0], order[1], order[3], order[2]]
