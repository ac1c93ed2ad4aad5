from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mimic.hardware.can.frame import CanFrame
from mimic.hardware.can.load import frame_bits


def bit_by_bit(frame: CanFrame) -> int:
    """The fields of ISO 11898-1 written out, the check sum and the stuffing one bit at a time."""
    if frame.extended:
        text = f"0{frame.id >> 18:011b}11{frame.id & 0x3FFFF:018b}000{len(frame.data):04b}"
    else:
        text = f"0{frame.id:011b}000{len(frame.data):04b}"
    text += "".join(f"{byte:08b}" for byte in frame.data)
    crc = 0
    for bit in text:
        turn = int(bit) ^ (crc >> 14)
        crc = (crc << 1) & 0x7FFF
        crc ^= 0x4599 * turn
    sent = ""
    for bit in text + f"{crc:015b}":
        sent += bit
        if sent.endswith(("00000", "11111")):
            sent += "1" if bit == "0" else "0"
    return len(sent) + 13


payloads = st.one_of(st.binary(max_size=8), st.integers(0, 8).map(bytes))
frames = st.one_of(
    st.builds(CanFrame, st.integers(0, (1 << 29) - 1), payloads),
    st.builds(CanFrame, st.integers(0, (1 << 11) - 1), payloads, st.just(False)),
)


@given(frames)
def test_the_length_is_that_of_the_fields_stuffed_bit_by_bit(frame):
    # endswith() looks only at the five newest bits, of which the stuffed one is one, as the standard wants
    assert frame_bits(frame) == bit_by_bit(frame)


@pytest.mark.parametrize(
    ("extended", "count", "least", "most"), [(True, 8, 131, 160), (False, 8, 111, 135), (False, 6, 95, 115)]
)
@given(data=st.data())
def test_the_length_is_between_none_and_all_stuffed(extended, count, least, most, data):
    identifier = data.draw(st.integers(0, (1 << (29 if extended else 11)) - 1))
    frame = CanFrame(identifier, data.draw(st.binary(min_size=count, max_size=count)), extended)
    assert least <= frame_bits(frame) <= most
