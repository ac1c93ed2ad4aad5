"""Buses of python-can against an emulated robot that a thread serves; time limits are for hangs only."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator

import can
import pytest

from mimic.config.emulator import EmulateSettings
from mimic.emulator.faults import parse_fault
from mimic.emulator.robot import EmulatedRobot
from mimic.emulator.server import EmulatorServer
from mimic.errors import BusError
from mimic.hardware.can.frame import CanFrame
from mimic.hardware.can.opening import open_link
from mimic.hardware.can.python_can import CanLink
from mimic.hardware.can.wiring import load_wiring
from mimic.hardware.motors.cybergear.codec import Codec, HostMessage, Kind
from mimic.hardware.motors.interface import Feedback, MotorMode

HOST, PATIENCE = 0xFD, 30.0
CODEC = Codec()


class Served:
    """A robot served by a thread."""

    def __init__(self, description, buses: int = 1) -> None:
        self.robot = EmulatedRobot(description, load_wiring(buses=buses), EmulateSettings(zeroed=True))
        self.server = EmulatorServer(self.robot, slcan=True)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self.server.run, args=(self._end.is_set,), daemon=True)
        self._thread.start()

    def address(self, kind: str) -> str:
        return next(a for a in self.server.addresses if a.startswith(kind))

    def stop(self) -> None:
        self._end.set()
        self._thread.join(PATIENCE)
        assert not self._thread.is_alive()
        self.server.close()


@pytest.fixture
def served(description) -> Iterator[Callable[..., Served]]:
    made: list[Served] = []

    def make(**options: int) -> Served:
        made.append(Served(description, **options))
        return made[-1]

    yield make
    for one in made:
        one.stop()


def until(link: CanLink, wanted: Callable[[object], bool]) -> object:
    """Return the first thing that a motor says and that is wanted."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        received = link.receive(0.1)
        if received is not None and received.frame.extended:
            said = getattr(CODEC.decode(received.frame), "said", None)
            if wanted(said):
                return said
    raise AssertionError("it never came")


TRANSPORTS = ["socketcand", "slcan"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", TRANSPORTS)
def test_commands_get_their_answers(kind, served):
    robot = served()
    link = open_link(robot.address(kind))
    for motor in range(1, 13):
        link.send(0, CODEC.encode(HostMessage(Kind.ENABLE, motor)))
        answer = until(link, lambda m, motor=motor: isinstance(m, Feedback) and m.motor == motor)
        assert answer.mode is MotorMode.RUNNING
    link.close()
    link.close()


@pytest.mark.slow
@pytest.mark.parametrize("kind", TRANSPORTS)
def test_both_kinds_of_identifiers_and_all_lengths_come_through(kind, served):
    robot = served()
    one, other = open_link(robot.address(kind)), open_link(robot.address("socketcand"))
    sent = [CanFrame(0x1ABCDEF0 + n, bytes(range(n))) for n in range(9)]
    sent += [CanFrame(0x700 + n, bytes(range(n)), extended=False) for n in range(9)]
    for frame in sent:
        one.send(0, frame)
    got: list[CanFrame] = []
    end = time.monotonic() + PATIENCE
    while len(got) < len(sent) and time.monotonic() < end:
        received = other.receive(0.1)
        if received is not None and received.frame in sent:
            got.append(received.frame)
    assert sorted(map(str, got)) == sorted(map(str, sent))
    for link in (one, other):
        link.close()


def test_the_clock_goes_on_while_nothing_comes():
    link = open_link("virtual:silence")
    begin = link.now()
    assert link.receive(0.02) is None
    assert link.now() - begin >= 0.02
    link.sleep(0.01)
    assert link.receive(0.0) is None
    link.close()


def test_a_wait_ends_and_says_so_when_there_is_something_else_to_read():
    link = open_link("virtual:woken")
    link.wake, write = os.pipe()
    os.write(write, b".")
    assert link.receive(PATIENCE) is None
    assert link.woken
    link.close()


@pytest.mark.slow
def test_several_buses_are_one_link(served):
    robot = served(buses=2)
    names = ",".join(a for a in robot.server.addresses if a.startswith("socketcand"))
    link = open_link(names)
    assert len(link.names) == 2
    for bus, motor in ((0, 1), (1, 4)):
        link.send(bus, CODEC.encode(HostMessage(Kind.ENABLE, motor)))
        end = time.monotonic() + PATIENCE
        heard = None
        while heard is None and time.monotonic() < end:
            received = link.receive(0.1)
            if received is not None and received.frame.extended:
                said = getattr(CODEC.decode(received.frame), "said", None)
                heard = (received.bus, said.motor) if isinstance(said, Feedback) else None
        assert heard == (bus, motor)
    link.close()


def test_two_virtual_buses_of_one_name_are_one_wire():
    one, other = open_link("virtual:wire"), open_link("virtual:other,virtual:wire")
    frame = CanFrame(0x123, b"\x01\x02", extended=False)
    one.send(0, frame)
    received = other.receive(PATIENCE)
    assert received is not None
    assert (received.bus, received.frame) == (1, frame)
    one.close()
    other.close()


@pytest.mark.slow
@pytest.mark.parametrize("kind", TRANSPORTS)
def test_a_server_that_goes_away_is_an_error_and_not_silence(kind, served):
    robot = served()
    link = open_link(robot.address(kind))
    robot.stop()
    with pytest.raises(BusError, match=r"closed|failed"):
        _wait_for_failure(link)
    with contextlib.suppress(BusError):  # a first send after the end may still be taken
        link.send(0, CanFrame(0, b""))
    link.close()


def test_a_connection_that_is_reset_is_one_sentence_and_logs_no_traceback(caplog):
    """python-can logs the traceback of each error that it raises."""
    end = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            server.accept()[0].close()  # somebody only looks whether anyone listens
            client, _ = server.accept()
            client.sendall(b"< hi >")
            for _ in ("open", "rawmode"):
                client.recv(100)
                client.sendall(b"< ok >")
            end.wait(PATIENCE)
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            client.close()

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        link = open_link(f"socketcand://127.0.0.1:{server.getsockname()[1]}/can0")
        end.set()
        thread.join(PATIENCE)
        with pytest.raises(BusError, match="reset by peer"):
            link.receive(PATIENCE)
        link.close()
    assert [record.message for record in caplog.records] == []


@pytest.mark.slow
@pytest.mark.parametrize("kind", TRANSPORTS)
def test_an_adapter_that_is_unplugged_is_an_error_and_cannot_be_opened_again(kind, served):
    robot = served()
    link = open_link(robot.address(kind))
    robot.robot.inject(parse_fault("unplugged"))
    with pytest.raises(BusError, match=r"closed|failed"):
        _wait_for_failure(link)
    link.close()
    with pytest.raises(BusError):
        _wait_for_failure(open_link(robot.address(kind)))


def _wait_for_failure(link: CanLink) -> None:
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        link.receive(0.05)


@pytest.mark.slow
def test_a_bus_that_the_server_has_not_is_an_error(served):
    address = served().address("socketcand").replace("can0", "can7")
    with pytest.raises(BusError, match="could not open bus"):
        open_link(address)


@pytest.mark.slow
def test_lines_of_an_adapter_that_are_no_frames_are_counted_and_passed_over():
    adapter, terminal = os.openpty()
    link = open_link(f"slcan:{os.ttyname(terminal)}")
    os.write(adapter, b"tXYZ0\rT00000021\rt02120102\r")
    received = link.receive(PATIENCE)
    assert received is not None
    assert str(received.frame) == "021#0102"
    assert link.garbled == 2
    link.close()
    os.close(adapter)
    os.close(terminal)


@pytest.mark.slow
def test_all_that_is_there_is_read_however_it_is_cut():
    """A burst of 100 messages is read in pieces of 1024 bytes, which cut some in two."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        kept: list[socket.socket] = []
        burst = threading.Thread(target=_burst, args=(server, kept), daemon=True)
        burst.start()
        link = open_link(f"socketcand://127.0.0.1:{server.getsockname()[1]}/can0")
        burst.join(PATIENCE)
        first = link.receive(PATIENCE)
        assert first is not None
        got = [first.frame, *(r.frame for r in iter(lambda: link.receive(0.0), None))]
        assert [frame.id for frame in got] == list(range(100))
        link.close()
        kept[0].close()


def _burst(server: socket.socket, kept: list[socket.socket]) -> None:
    """Shake hands with a client of socketcand, then send it a hundred frames at once."""
    server.accept()[0].close()  # it knocks first
    sock, _ = server.accept()
    kept.append(sock)
    sock.sendall(b"< hi >")
    for _ in ("open", "rawmode"):
        sock.recv(100)
        sock.sendall(b"< ok >")
    time.sleep(0.3)  # python-can expects the last answer alone
    sock.sendall(b"".join(b"< frame %08X 0.000000 0102030405060708 >" % n for n in range(100)))


class FakeSocketcan:
    """What ``can.Bus`` gives for a SocketCAN interface, as far as it is needed here."""

    def __init__(self, sends: list[Exception | None], hears: list[can.Message]) -> None:
        self._sends, self._hears, self.sent = sends, hears, 0
        self._mine, self._theirs = socket.socketpair()
        self._theirs.send(b"x" * len(hears))

    def fileno(self) -> int:
        return self._mine.fileno()

    def send(self, message: can.Message, timeout: float) -> None:
        problem = self._sends.pop(0)
        if problem is not None:
            raise problem
        self.sent += 1

    def recv(self, timeout: float) -> can.Message:
        self._mine.recv(1)
        return self._hears.pop(0)

    def shutdown(self) -> None:
        self._mine.close()
        self._theirs.close()


@pytest.fixture
def socketcan(monkeypatch) -> Callable[..., tuple[CanLink, FakeSocketcan]]:
    """Return a function that opens can0 with what its sends raise and what it hears."""

    def make(
        sends: tuple[Exception | None, ...] = (), hears: tuple[can.Message, ...] = ()
    ) -> tuple[CanLink, FakeSocketcan]:
        fake = FakeSocketcan(list(sends), list(hears))
        monkeypatch.setattr(can, "Bus", lambda **_: fake)
        return open_link("can0"), fake

    return make


def test_a_queue_that_is_full_for_a_moment_is_waited_for(socketcan):
    """SocketCAN's default queue holds ten frames, and twelve commands are sent at once."""
    link, fake = socketcan(sends=(can.CanOperationError("full", errno.ENOBUFS),) * 3 + (None,))
    link.send(0, CanFrame(1, b""))
    assert fake.sent == 1
    link.close()


def test_a_queue_that_stays_full_is_an_error(socketcan):
    link, _ = socketcan(sends=(can.CanOperationError("full", errno.ENOBUFS),) * 10_000)
    with pytest.raises(BusError, match="no longer takes frames"):
        link.send(0, CanFrame(1, b""))
    link.close()


def test_other_problems_of_sending_are_errors_at_once(socketcan):
    link, fake = socketcan(sends=(can.CanOperationError("down", errno.ENETDOWN), None))
    with pytest.raises(BusError, match="down"):
        link.send(0, CanFrame(1, b""))
    assert fake.sent == 0
    link.close()


def test_an_error_frame_of_a_bus_that_is_off_is_an_error_and_others_are_passed_over(socketcan):
    frames = (
        can.Message(arbitration_id=0x04, is_error_frame=True, data=bytes(8)),
        can.Message(arbitration_id=0x10, is_remote_frame=True, is_extended_id=False),
        can.Message(arbitration_id=0x21, data=b"\x01", is_extended_id=False),
        can.Message(arbitration_id=0x40, is_error_frame=True, data=bytes(8)),
    )
    link, _ = socketcan(hears=frames)
    received = link.receive(PATIENCE)
    assert received is not None
    assert str(received.frame) == "021#01"
    with pytest.raises(BusError, match="can0 is off"):
        link.receive(PATIENCE)
    link.close()


def test_a_bus_that_is_down_says_how_to_bring_it_up(socketcan):
    link, _ = socketcan(sends=(can.CanOperationError("Network is down", errno.ENETDOWN),))
    with pytest.raises(BusError, match=r"interface is down; .*ip link set can0 up"):
        link.send(0, CanFrame(1, b""))
    link.close()
