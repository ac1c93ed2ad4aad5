"""A connection between a program and a socketcand server that does not do what it should.

Used by lab/faults/faults_in_processes.py.
"""

from __future__ import annotations

import heapq
import re
import select
import socket
import struct
import time
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

from lab.faults.proxy import Proxy

KINDS = ("delays", "drops", "corrupts", "repeats", "forges", "garbage", "stalls", "half_closes", "resets", "refuses")
"""What it does: lets some messages wait, loses some, changes letters in some, sends old ones in their place, writes a
motor's answers with other numbers, puts bytes that are no message between them, lets nothing through, ends its own side
of the connection only, breaks it, breaks it and takes no other."""

_MESSAGE = re.compile(rb"<[^<>]*>")

_ANSWER = re.compile(rb"(< frame 02[0-9A-F]{6} [0-9.]+ )([0-9A-F]{16})( >)")


@dataclass(eq=False)
class _Way:
    """One direction of a connection."""

    source: socket.socket
    sink: socket.socket
    to_program: bool
    rest: bytes = b""
    old: deque[bytes] = field(default_factory=lambda: deque(maxlen=200))


class TcpProxy(Proxy):
    """Stands before a server; what it does is one of KINDS, or nothing."""

    def __init__(self, port: int, seed: int = 0) -> None:
        """Take the port of the server on this computer."""
        super().__init__(seed, 59)
        self._port = port
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listening.getsockname()[1])
        self._ways: dict[socket.socket, _Way] = {}
        self._held: list[tuple[float, int, _Way, bytes]] = []
        self._count = 0
        self._broken = False

    def sockets(self) -> Iterable[socket.socket]:
        return self._listening, *self._ways

    def disturb(self, kind: str, share: float = 1.0, lag: float = 0.0, lasts: float = 1e9) -> None:
        self._broken = False
        super().disturb(kind, share, lag, lasts)

    def relay(self) -> None:
        stalled = self.kind == "stalls" and self.active()
        ready, _, _ = select.select([self._listening, *([] if stalled else self._ways)], [], [], 0.002)
        for one in ready:
            if one is self._listening:
                self._accept()
            elif isinstance(one, socket.socket) and one in self._ways:
                self._read(self._ways[one])
        while self._held and self._held[0][0] <= time.monotonic():
            _, _, way, data = heapq.heappop(self._held)
            self._write(way, data)
        if self.active() and not self._broken:
            self._break()

    def _accept(self) -> None:
        program, _ = self._listening.accept()
        if self.kind == "refuses" and self.active():
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
        self._broken = True
        if self.kind not in ("half_closes", "resets", "refuses"):
            return
        for way in [way for way in self._ways.values() if way.to_program]:
            if self.kind == "half_closes":
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
        *whole, way.rest = self._messages(way.rest + data)
        out = b"".join(self._through(way, message) for message in whole)
        self._write(way, out)

    @staticmethod
    def _messages(data: bytes) -> list[bytes]:
        """Return whole messages, and what is left behind them."""
        found = list(_MESSAGE.finditer(data))
        end = found[-1].end() if found else 0
        return [*(one.group() for one in found), data[end:]]

    def _write(self, way: _Way, data: bytes) -> None:
        if not data:
            return
        try:
            way.sink.sendall(data)
        except OSError:
            return  # that side is gone, or closed for writing

    def _through(self, way: _Way, message: bytes) -> bytes:
        way.old.append(message)
        if not self.active() or not self.hit():
            return message
        if self.kind == "drops":
            return b""
        if self.kind == "delays":
            self._count += 1
            due = time.monotonic() + self.lag * float(self.rng.random())
            heapq.heappush(self._held, (due, self._count, way, message))
            return b""
        if self.kind == "corrupts":
            return self.damaged(message)
        if self.kind == "repeats":
            return message + way.old[int(self.rng.integers(len(way.old)))]
        if self.kind == "forges":
            data = self.rng.bytes(8).hex().upper().encode()
            return _ANSWER.sub(lambda found: found[1] + data + found[3], message)
        if self.kind == "garbage":
            return self.rng.bytes(int(self.rng.integers(1, 200))) + message
        return message
