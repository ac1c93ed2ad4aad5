"""Opens buses by python-can, from the URL that the user gives.

    can0                            SocketCAN, the kernel's interfaces
    can0,can1                       several buses, in this order
    slcan:/dev/ttyACM0              serial adapter
    socketcand://127.0.0.1:PORT/can0
    virtual:NAME                    inside one process
    pcan:PCAN_USBBUS1               any other interface of python-can and its channel

Works around two limits of python-can 4.6.1: a server that never answers is given up; a closed port is reported at once
instead of after ten seconds.
"""

from __future__ import annotations

import errno
import logging
import re
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any
from urllib.parse import urlsplit

import can
import can.interfaces.socketcan
import can.interfaces.socketcand  # the first bus opens quickly then

from mimic.errors import BusError, ConfigError, MimicError
from mimic.hardware.can.python_can import CanLink, Port, Slcan, explain, first_line

ANSWER_WITHIN = 2.0
"""A server that does not answer within this is given up [s]."""

SHAKE_FOR = 5.0
"""How long handshakes of socketcand are tried [s]: on a busy bus a frame can come right after an answer, which
python-can refuses. On a loaded computer three of three tries failed."""

START_UP = 2.0
"""What a serial adapter gets to start up in [s], as in python-can."""

FORMS = "can0; slcan:/dev/ttyACM0; socketcand://HOST:PORT/can0; several with commas; or a stock cyberdog2 or go2"


def open_link(bus_url: str, *, bitrate: int = 1_000_000, quick: bool = False) -> CanLink:
    """Open buses.

    Args:
        bus_url: One bus, or several separated by commas; the forms are above.
        bitrate: For adapters that need one [bit/s]; SocketCAN has its own from ``ip link``.
        quick: Do not give a serial adapter two seconds to start up: it was in use a moment ago.

    Raises:
        ConfigError: If a bus has none of the forms.
        BusError: If a bus does not exist or does not answer.
    """
    if not isinstance(bus_url, str):
        raise ConfigError(f"the bus is {bus_url!r}; expected text, such as {FORMS}")
    names = [word.strip() for word in bus_url.split(",")]
    if len(set(names)) < len(names) or "" in names:
        raise ConfigError(f"the buses are {bus_url!r}; expected different ones, such as {FORMS}")
    logging.getLogger("can").setLevel(logging.CRITICAL)  # it logs tracebacks of what is raised here as one sentence
    ports: list[Port] = []
    again = partial(_open, bitrate=bitrate, quick=True)
    try:
        for name in names:
            ports.append(_open(name, bitrate, quick=quick))
    except BaseException:
        CanLink(ports, again).close()
        raise
    return CanLink(ports, again)


def _open(name: str, bitrate: int, *, quick: bool) -> Port:
    scheme, colon, rest = name.partition(":")
    try:
        if not colon:
            return _socketcan(name)
        if scheme == "socketcand":
            return _socketcand(name)
        if scheme == "slcan" and rest:
            if "://" in rest:
                raise ConfigError(f"{name!r} is not a bus; expected {FORMS}")
            pause = 0 if quick else START_UP
            bus = Slcan(rest, bitrate=bitrate, timeout=0, sleep_after_open=pause)
            return Port(name, bus, None, ready=False)
        if scheme in can.VALID_INTERFACES and rest and not rest.startswith("//"):
            bus = can.Bus(interface=scheme, channel=rest, bitrate=bitrate, ignore_config=True)
            return Port(name, bus, None, ready=False)
    except MimicError:
        raise
    except (NameError, ImportError, can.CanInterfaceNotImplementedError):
        raise BusError(f"{name} cannot be opened: the driver of {scheme} is not installed here") from None
    except Exception as reason:  # drivers raise classes of their own
        raise BusError(f"{name} cannot be opened: {explain(reason)}") from None
    raise ConfigError(f"{name!r} is not a bus; expected {FORMS}, or another interface of python-can")


def _socketcan(name: str) -> Port:
    if not re.fullmatch(r"[A-Za-z0-9_.-]{1,15}", name):
        raise ConfigError(f"{name!r} is not a bus; expected {FORMS}")
    try:
        return Port(name, can.Bus(interface="socketcan", channel=name, ignore_config=True), None, ready=True)
    except OSError as reason:
        if reason.errno == errno.EAFNOSUPPORT:
            raise BusError(f"{name} cannot be opened: this machine's kernel has no CAN; expected {FORMS}") from None
        if reason.errno == errno.ENODEV:
            raise BusError(
                f"there is no CAN interface {name}; plug the adapter in and bring it up, such as with: "
                f"ip link set {name} up type can bitrate 1000000"
            ) from None
        raise


def _socketcand(name: str) -> Port:
    host, port = _address(name)
    channel = urlsplit(name).path.strip("/")
    if not channel:
        raise ConfigError(f"{name} names no bus of that server; expected socketcand://HOST:PORT/can0")
    _knock(name, host, port)
    options: dict[str, Any] = {"channel": channel, "host": host, "port": port, "tcp_tune": True, "ignore_config": True}
    with _giving_up():
        end = time.monotonic() + SHAKE_FOR
        while True:
            try:
                bus = can.Bus(interface="socketcand", **options)
                return Port(name, bus, getattr(bus, "_SocketCanDaemonBus__socket", None), ready=False)
            except can.CanError as reason:
                if "< frame" not in str(reason):
                    raise
                if time.monotonic() > end:
                    problem = "frames of the bus come between the answers of its server"
                    raise BusError(f"{name} cannot be opened: {problem}; is this computer busy?") from None


def _address(name: str) -> tuple[str, int]:
    try:
        url = urlsplit(name)
        host = url.hostname
        port = url.port
    except ValueError as reason:
        raise ConfigError(f"{name} has no usable host or port: {reason}") from None
    if not host or not port:
        raise ConfigError(f"{name} lacks host or port; expected such as 127.0.0.1:29536")
    return host, port


def _knock(name: str, host: str, port: int) -> None:
    """Raise at once if nobody listens; python-can would try for ten seconds."""
    try:
        socket.create_connection((host, port), timeout=ANSWER_WITHIN).close()
    except OSError as reason:
        raise BusError(
            f"nobody listens at {host}:{port} ({first_line(reason)}); {name} needs a server, such as mimic emulate"
        ) from None


@contextmanager
def _giving_up() -> Iterator[None]:
    """Let sockets made meanwhile give up after a while, in the handshake and later."""
    before = socket.getdefaulttimeout()
    socket.setdefaulttimeout(ANSWER_WITHIN)
    try:
        yield
    finally:
        socket.setdefaulttimeout(before)
