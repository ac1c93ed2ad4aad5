from __future__ import annotations

import pytest

from mimic.errors import FrameError
from mimic.hardware.can.frame import CanFrame


@pytest.mark.parametrize(
    ("arguments", "says"),
    [((1 << 29, b""), "less than"), ((0x800, b"", False), "less than"), ((1, bytes(9)), "at most 8")],
)
def test_what_cannot_be_a_frame_is_refused(arguments, says):
    with pytest.raises(FrameError, match=says):
        CanFrame(*arguments)


def test_a_frame_reads_as_candump_writes_it():
    assert str(CanFrame(0x028005FD, bytes(2))) == "028005FD#0000"
    assert str(CanFrame(0x21, b"\xab", extended=False)) == "021#AB"
