"""The server turn by turn, with a client made of bare sockets."""

from __future__ import annotations

import os
import re
import socket
import time
from collections.abc import Callable, Iterator

import pytest

from mimic.config.emulator import EmulateSettings
from mimic.emulator.faults import parse_fault
from mimic.emulator.robot import EmulatedRobot
from mimic.emulator.server import CATCH_UP, EmulatorServer
from mimic.errors import BusError
from mimic.hardware.can.wiring import load_wiring

PATIENCE = 30.0
"""Limit on hanging only [s]."""

pytestmark = pytest.mark.slow


@pytest.fixture
def server(description) -> Iterator[EmulatorServer]:
    made = EmulatorServer(EmulatedRobot(description, load_wiring(), EmulateSettings(zeroed=True)), slcan=True)
    yield made
    made.close()


class Client:
    """A bare socket or terminal; each wait lets the server do a turn."""

    def __init__(self, server: EmulatorServer, kind: str) -> None:
        address = next(a for a in server.addresses if a.startswith(kind))
        if kind == "slcan":
            self.file = os.open(address.partition(":")[2], os.O_RDWR | os.O_NOCTTY)
        else:
            port = int(address.rsplit(":", 1)[1].split("/")[0])
            self.file = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE).detach()
        os.set_blocking(self.file, False)
        self.server, self.text = server, b""

    def until(self, wanted: Callable[[bytes], bool]) -> bytes:
        end = time.monotonic() + PATIENCE
        while not wanted(self.text) and time.monotonic() < end:
            self.server.turn()
            try:
                self.text += os.read(self.file, 65536)
            except BlockingIOError:
                continue
        assert wanted(self.text), self.text[-200:]
        return self.text

    def send(self, data: bytes) -> None:
        assert os.write(self.file, data) == len(data)

    def close(self) -> None:
        os.close(self.file)


def opened(server: EmulatorServer) -> Client:
    client = Client(server, "socketcand")
    client.until(lambda text: b"< hi >" in text)
    client.send(b"< open can0 >< rawmode >")
    client.until(lambda text: text.count(b"< ok >") == 2)
    return client


def test_a_client_of_socketcand_hears_motors_and_imu(server):
    client = opened(server)
    client.send(b"< send 0300FD01 8 0 0 0 0 0 0 0 0 >")
    client.until(lambda text: b"< frame 028001FD" in text and b"< frame 021" in text)


def test_a_client_of_slcan_hears_motors_and_imu(server):
    client = Client(server, "slcan")
    client.send(b"C\rS8\r\rO\rT0300FD0180000000000000000\r")
    client.until(lambda text: b"T028001FD8" in text and b"t0218" in text)


def test_after_it_said_ok_the_server_is_quiet_for_a_moment(server):
    """Frames in the same segment as the answer would make python-can's handshake fail."""
    client = opened(server)
    assert client.text.endswith(b"< ok >")


def test_a_client_that_leaves_is_forgotten(server):
    client = opened(server)
    assert "; 1 client" in server.line()
    client.close()
    end = time.monotonic() + PATIENCE
    while "; 0 clients" not in server.line() and time.monotonic() < end:
        server.turn()
    assert "; 0 clients" in server.line()


def test_a_client_that_closes_the_channel_hears_no_more(server):
    client = Client(server, "slcan")
    client.send(b"O\r")
    client.until(lambda text: b"t0218" in text)
    client.send(b"C\r")
    end = time.monotonic() + PATIENCE
    while "; 0 clients" not in server.line() and time.monotonic() < end:
        server.turn()
    assert "; 0 clients" in server.line()


def test_an_unplugged_adapter_hangs_up(server):
    client = opened(server)
    server.robot.inject(parse_fault("unplugged"))
    end = time.monotonic() + PATIENCE
    closed = False
    while not closed and time.monotonic() < end:
        server.turn()
        try:
            closed = os.read(client.file, 65536) == b""
        except BlockingIOError:
            continue
        except ConnectionResetError:
            closed = True
    assert closed


def numbers(server: EmulatorServer) -> tuple[float, float]:
    """Return the share of time that the bus was busy, and frames a second, as the line of the statistics has them."""
    load, rate = re.search(r"bus load ([\d.]+)% at (\d+) frames/s", server.line()).groups()
    return float(load) / 100, float(rate)


def test_status_counts_frames_and_their_bits_since_the_last_time(server):
    client = opened(server)
    client.until(lambda text: text.count(b"< frame 021") >= 5)
    load, rate = numbers(server)
    assert 0.0 < load < 0.5
    assert 90 < load * 1e6 / rate < 160, "bits of a frame"
    assert numbers(server)[1] < rate * 100


def test_a_machine_that_was_too_slow_makes_time_stand_still_and_says_so(server):
    opened(server)
    server.line()
    before = server.robot.now
    time.sleep(4 * CATCH_UP)
    server.turn()
    still = re.search(r"stood still for ([\d.]+) s", server.line())
    assert float(still[1]) > CATCH_UP
    assert server.robot.now - before >= CATCH_UP * 0.9


def test_a_port_that_is_taken_is_an_error(server, description):
    port = int(server.addresses[0].rsplit(":", 1)[1].split("/")[0])
    robot = EmulatedRobot(description, load_wiring())
    with pytest.raises(BusError, match=r"cannot listen.*--listen"):
        EmulatorServer(robot, port=port)
