from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mimic.emulator.wire_formats import SlcanSession, SocketcandSession
from mimic.hardware.can.frame import CanFrame

COMMAND = CanFrame(0x017FFF01, bytes.fromhex("8A2F7FFF0F5C3333"))
QUATERNION = CanFrame(0x021, bytes.fromhex("7FFF000000000000"), extended=False)


def raw() -> SocketcandSession:
    session = SocketcandSession(["can0", "can1"])
    session.take(b"< open can1 >")
    session.take(b"< rawmode >")
    return session


def opened() -> SlcanSession:
    session = SlcanSession(0)
    session.take(b"C\rS8\r\rO\rO\r")
    return session


def test_the_handshake_of_socketcand_is_the_one_its_client_expects():
    session = SocketcandSession(["can0", "can1"])
    assert session.greet() == b"< hi >"
    assert session.take(b"< open can1 >") == ([], b"< ok >")
    assert not session.open
    assert session.take(b"< rawmode >") == ([], b"< ok >")
    assert (session.open, session.bus) == (True, 1)


@pytest.mark.parametrize("said", [b"< open can7 >", b"< rawmode >", b"< send 1 0 >", b"< dance >", b"< >"])
def test_before_a_bus_is_open_nothing_else_is_understood(said):
    session = SocketcandSession(["can0"])
    frames, answer = session.take(said)
    assert frames == []
    assert answer.startswith(b"< error")
    assert not session.open


def test_a_frame_of_socketcand_is_read_as_its_client_writes_it():
    assert raw().take(b"< send 017FFF01 8 8a 2f 7f ff f 5c 33 33 >") == ([COMMAND], b"")
    assert raw().take(b"< send 021 2 7f f >") == ([CanFrame(0x21, b"\x7f\x0f", extended=False)], b"")
    assert raw().take(b"< send 021 0  >") == ([CanFrame(0x21, b"", extended=False)], b"")


@pytest.mark.parametrize(
    "said",
    [
        b"< send 021 2 7f >",
        b"< send XYZ 0 >",
        b"< send 021 1 1ff >",
        b"< send FFF 0 >",
        b"< send 021 9 1 1 1 1 1 1 1 1 1 >",
    ],
)
def test_what_is_no_frame_is_said_to_be_none(said):
    assert raw().take(said) == ([], b"< error could not send frame >")


def test_frames_are_given_as_the_clients_read_them():
    assert raw().give(COMMAND, 1.5) == b"< frame 017FFF01 1.500000 8A2F7FFF0F5C3333 >"
    assert raw().give(QUATERNION, 0.0) == b"< frame 021 0.000000 7FFF000000000000 >"
    assert opened().give(COMMAND, 1.5) == b"T017FFF0188A2F7FFF0F5C3333\r"
    assert opened().give(QUATERNION, 1.5) == b"t02187FFF000000000000\r"


def test_slcan_takes_frames_once_it_is_open():
    line = b"T017FFF0188A2F7FFF0F5C3333\r"
    session = SlcanSession(0)
    assert session.take(line) == ([], b"\a")
    session.take(b"S8\rO\r")
    assert session.take(line) == ([COMMAND], b"")
    session.take(b"C\r")
    assert not session.open


@pytest.mark.parametrize("line", [b"T017FFF018\r", b"tXYZ0\r", b"t02127F\r", b"T\r", b"?\r", b"tFFF0\r", b"t021\xff\r"])
def test_what_is_no_line_of_slcan_gets_a_bell(line):
    assert opened().take(line) == ([], b"\a")


frames = st.one_of(
    st.builds(CanFrame, st.integers(0, (1 << 29) - 1), st.binary(max_size=8)),
    st.builds(CanFrame, st.integers(0, (1 << 11) - 1), st.binary(max_size=8), st.just(False)),
)


@given(st.lists(frames, max_size=5), st.data())
def test_frames_arrive_however_the_connection_cuts_them(wanted, data):
    for session, text in (
        (raw(), b"".join(_send(f) for f in wanted)),
        (opened(), b"".join(SlcanSession(0).give(f, 0.0) for f in wanted)),
    ):
        got, rest = [], text
        while rest:
            cut = data.draw(st.integers(1, len(rest)))
            more, answer = session.take(rest[:cut])
            assert answer == b""
            got, rest = got + more, rest[cut:]
        assert got == wanted


def _send(frame: CanFrame) -> bytes:
    identifier = f"{frame.id:08X}" if frame.extended else f"{frame.id:03X}"
    data = " ".join(f"{byte:x}" for byte in frame.data)
    return f"< send {identifier} {len(frame.data):X} {data} >".encode()


@given(st.binary(max_size=200))
def test_any_bytes_are_taken_without_an_exception(data):
    for session in (raw(), opened()):
        for frame in session.take(data)[0]:
            assert len(frame.data) <= 8
