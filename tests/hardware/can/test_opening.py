"""Buses are opened by what the user typed, or refused in a line that says what to do."""

from __future__ import annotations

import errno
import socket
import threading

import can
import pytest
import serial

from mimic.errors import BusError, ConfigError
from mimic.hardware.can.opening import open_link
from mimic.hardware.motors.cybergear.codec import Codec

HOST, PATIENCE = 0xFD, 30.0
CODEC = Codec()


def test_a_handshake_into_which_frames_of_a_busy_bus_come_is_tried_again():
    refused = 6
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            server.accept()[0].close()  # somebody only looks whether anyone listens
            for number in range(refused + 1):
                client, _ = server.accept()
                frame = b"< frame 006 12.830067 0503 >" if number < refused else b""
                client.sendall(b"< hi >")
                for _ in ("open", "rawmode"):
                    if not client.recv(100):
                        break
                    client.sendall(b"< ok >" + frame)
                clients.append(client)

        clients: list[socket.socket] = []
        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        link = open_link(f"socketcand://127.0.0.1:{server.getsockname()[1]}/can0")
        thread.join(PATIENCE)
        assert len(clients) == refused + 1
        link.close()
        for client in clients:
            client.close()


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as sock:
        return sock.getsockname()[1]


@pytest.mark.slow
def test_where_nobody_listens_is_said_at_once():
    with pytest.raises(BusError, match=r"nobody listens.*mimic emulate"):
        open_link(f"socketcand://127.0.0.1:{_free_port()}/can0")


@pytest.mark.slow
def test_a_server_that_never_answers_is_given_up():
    with socket.create_server(("127.0.0.1", 0)) as mute, pytest.raises(BusError, match="cannot be opened"):
        open_link(f"socketcand://127.0.0.1:{mute.getsockname()[1]}/can0")


@pytest.mark.parametrize(
    ("bus_url", "says"),
    [
        ("", "expected different ones"),
        ("can0,", "expected different ones"),
        ("can0,can0", "expected different ones"),
        ("my bus", "is not a bus"),
        ("telepathy:here", "is not a bus"),
        ("slcan:", "is not a bus"),
        ("slcan:socket://127.0.0.1:29536", "is not a bus"),
        ("socketcand://127.0.0.1/can0", "lacks host or port"),
        ("socketcand://127.0.0.1:99999/can0", "no usable host or port"),
        ("socketcand://[::1/can0", "no usable host or port"),
        (None, "the bus is None; expected text"),
        ("socketcand://127.0.0.1:29536", "names no bus"),
    ],
)
def test_a_word_that_names_no_bus_is_refused(bus_url, says):
    with pytest.raises(ConfigError, match=says):
        open_link(bus_url)


@pytest.mark.parametrize("word", ["slcan:/dev/no_such_adapter", "no_such_can"])
def test_an_adapter_that_is_not_there_is_an_error(word):
    with pytest.raises(BusError, match=r"no_such"):
        open_link(word)


@pytest.mark.parametrize(
    ("number", "advice"),
    [(errno.EACCES, "no permission; add your user"), (errno.EBUSY, "another program uses it"), (errno.ENOENT, "plug")],
)
def test_a_serial_port_that_cannot_be_opened_says_what_to_do(number, advice, monkeypatch):
    def refuse(*_: object, **__: object) -> None:
        raise serial.SerialException(number, "could not open port")

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    with pytest.raises(BusError, match=f"slcan:/dev/ttyACM0 cannot be opened: .*{advice}") as error:
        open_link("slcan:/dev/ttyACM0")
    assert "\n" not in str(error.value)


def test_an_interface_that_is_not_there_says_how_to_bring_it_up(monkeypatch):
    def missing(**_: object) -> None:
        raise OSError(errno.ENODEV, "No such device")

    monkeypatch.setattr(can, "Bus", missing)
    with pytest.raises(BusError, match="ip link set can3 up"):
        open_link("can3")
