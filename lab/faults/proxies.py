"""Networks that disturb, between a program and an emulated robot: over TCP for socketcand, over multicast for LCM.

Everything stays on the loopback. lab/stock_firmware uses the second, too.
"""

from __future__ import annotations

import re
import select
import socket
import struct
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from lab.faults.trouble import Trouble
from mimic.control.priority import LOOP, real_time
from mimic.hardware.stock.messages import MOTOR_CTRL
from mimic.hardware.stock.wiring import load_board


class Proxy(ABC):
    """A relay in a thread of its own; for a with statement."""

    def __init__(self, *seed: int) -> None:
        self.trouble = Trouble(np.random.default_rng(seed), time.monotonic)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def disturb(self, kind: str, share: float = 1.0, lag: float = 0.0, lasts: float = 1e9) -> None:
        """Begin now, for some time [s]."""
        self.trouble.share, self.trouble.lag = share, lag
        self.trouble.start(kind, lasts=lasts)

    @abstractmethod
    def relay(self) -> None:
        """Pass on what has come; wait a few ms for it at most."""

    @abstractmethod
    def sockets(self) -> Iterable[socket.socket]:
        """Return what is open."""

    def _run(self) -> None:
        with real_time(LOOP):
            while not self._over.is_set():
                self.relay()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, value: object, trace: TracebackType | None) -> None:
        self._over.set()
        self._thread.join()
        for one in self.sockets():
            one.close()


# ------------------------------------------------------------------------ TCP

_MESSAGE = re.compile(rb"<[^<>]*>")

_ANSWER = re.compile(rb"(< frame 02[0-9A-F]{6} [0-9.]+ )([0-9A-F]{16})( >)")


@dataclass(eq=False)
class _Way:
    """One direction of a connection."""

    source: socket.socket
    sink: socket.socket
    to_program: bool
    rest: bytes = b""


class TcpProxy(Proxy):
    """Stands before a socketcand server."""

    def __init__(self, port: int, seed: int = 0) -> None:
        """Take the port of the server on this computer."""
        super().__init__(seed, 59)
        self._port = port
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listening.getsockname()[1])
        self._ways: dict[socket.socket, _Way] = {}
        self._broken = False

    def sockets(self) -> Iterable[socket.socket]:
        return self._listening, *self._ways

    def disturb(self, kind: str, share: float = 1.0, lag: float = 0.0, lasts: float = 1e9) -> None:
        self._broken = False
        super().disturb(kind, share, lag, lasts)

    def relay(self) -> None:
        stalled = self.trouble.doing("stalls")
        ready, _, _ = select.select([self._listening, *([] if stalled else self._ways)], [], [], 0.002)
        for one in ready:
            if one is self._listening:
                self._accept()
            elif one in self._ways:
                self._read(self._ways[one])
        for way, data in self.trouble.due():
            self._write(way, data)
        if self.trouble.doing("half_closes", "resets", "refuses") and not self._broken:
            self._broken = True
            self._break()

    def _accept(self) -> None:
        program, _ = self._listening.accept()
        if self.trouble.doing("refuses"):
            program.close()
            return
        try:
            server = socket.create_connection(("127.0.0.1", self._port), timeout=2.0)
        except OSError:
            program.close()
            return
        for one in (program, server):
            one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            one.settimeout(0.5)
        self._ways[program] = _Way(program, server, to_program=False)
        self._ways[server] = _Way(server, program, to_program=True)

    def _break(self) -> None:
        """Do once what is done to whole connections."""
        for way in [way for way in self._ways.values() if way.to_program]:
            if self.trouble.kind == "half_closes":
                way.sink.shutdown(socket.SHUT_WR)
                continue
            way.sink.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            self._drop(way)

    def _drop(self, way: _Way) -> None:
        for one in (way.source, way.sink):
            self._ways.pop(one, None)
            one.close()

    def _read(self, way: _Way) -> None:
        try:
            data = way.source.recv(65536)
        except OSError:
            data = b""
        if not data:
            self._drop(way)
            return
        data = way.rest + data
        found = list(_MESSAGE.finditer(data))
        way.rest = data[found[-1].end() if found else 0 :]
        out = [self._garbage() + one for m in found for one in self._through(way, m.group())]
        self._write(way, b"".join(out))

    def _through(self, way: _Way, message: bytes) -> list[bytes]:
        return self.trouble.through(way, message, self.trouble.damaged, self._forged)

    def _garbage(self) -> bytes:
        rng = self.trouble.rng
        hit = self.trouble.doing("garbage") and self.trouble.hit()
        return rng.bytes(int(rng.integers(1, 200))) if hit else b""

    def _forged(self, message: bytes) -> bytes:
        data = self.trouble.rng.bytes(8).hex().upper().encode()
        return _ANSWER.sub(lambda found: found[1] + data + found[3], message)

    @staticmethod
    def _write(way: _Way, data: bytes) -> None:
        try:
            way.sink.sendall(data)
        except OSError:
            return  # that side is gone, or closed for writing


# ------------------------------------------------------------------ multicast

GROUP, PORT, STATE_PORT = "239.255.76.68", 17667, 17669
"""Of the program's side."""

_HEADER = struct.Struct(">4sI")


def wiring_through(path: Path) -> Path:
    """Write the wiring of a board that is behind the proxy, and return its path."""
    wiring = load_board()
    text = wiring.path.read_text(encoding="utf-8")
    for before, after in ((wiring.address, GROUP), (str(wiring.port), str(PORT)), (str(wiring.state_port), STATE_PORT)):
        text = text.replace(f'"{before}"', f'"{after}"').replace(f"port = {before} ", f"port = {after} ")
    path.write_text(text, encoding="utf-8")
    return path


class LcmProxy(Proxy):
    """Relays LCM messages from one multicast group to another."""

    def __init__(self, seed: int = 0) -> None:
        super().__init__(seed, 53)
        self._board = b = load_board()
        self._number = 0
        self._out = _sending()
        self._out.bind(("127.0.0.1", 0))
        self._own = self._out.getsockname()
        self._ways = {
            _listening(b.address, b.port): (GROUP, PORT),
            _listening(b.address, b.state_port): (GROUP, STATE_PORT),
            _listening(GROUP, PORT): (b.address, b.port),
        }

    def sockets(self) -> Iterable[socket.socket]:
        return *self._ways, self._out

    def inject(self, data: bytes) -> None:
        """Send a command to the board as another program would."""
        name = MOTOR_CTRL.channel.encode() + b"\0"
        with _sending() as other:
            self._number += 1
            packet = _HEADER.pack(b"LC02", self._number) + name + data
            other.sendto(packet, (self._board.address, self._board.port))

    def relay(self) -> None:
        due = self.trouble.next_due()
        wait = 0.02 if due is None else max(min(due - time.monotonic(), 0.02), 0.0)
        ready, _, _ = select.select(list(self._ways), [], [], wait)
        for one in ready:
            packet, sender = one.recvfrom(65536)
            if sender != self._own:
                self._through(packet, self._ways[one])
        for to, packet in self.trouble.due():
            self._send(packet, to)

    def _send(self, packet: bytes, to: tuple[str, int]) -> None:
        try:
            self._out.sendto(packet, to)
        except OSError:
            return  # the network is down

    def _through(self, packet: bytes, to: tuple[str, int]) -> None:
        end = packet.find(b"\0", _HEADER.size)
        channel, to_board = packet[_HEADER.size : end].decode(errors="replace"), to[0] == self._board.address
        if to_board and channel != MOTOR_CTRL.channel:
            return
        forge = None if to_board else lambda data: self.trouble.damaged(data, end + 9)
        for one in self.trouble.through(to, packet, self.trouble.damaged, forge):
            self._send(one, to)


def _sending() -> socket.socket:
    one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    one.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
    one.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
    return one


def _listening(group: str, port: int) -> socket.socket:
    one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    one.bind((group, port))
    joined = socket.inet_aton(group) + socket.inet_aton("127.0.0.1")
    one.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, joined)
    return one
