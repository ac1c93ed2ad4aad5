"""A network between a program and a stock robot's board: relays LCM messages from one multicast group to another.

What goes through can be delayed, lost, damaged, repeated or forged. Used by lab/stock_firmware and
lab/faults/faults_in_processes.py; everything stays on the loopback.
"""

from __future__ import annotations

import heapq
import select
import socket
import struct
import time
from collections import deque
from collections.abc import Iterable
from pathlib import Path

from lab.faults.proxy import Proxy
from mimic.hardware.stock.messages import MOTOR_CTRL
from mimic.hardware.stock.wiring import BoardWiring, load_board

GROUP, PORT, STATE_PORT = "239.255.76.68", 17667, 17669
"""Of the program's side."""

KINDS = ("jitter", "delays", "drops", "corrupts", "repeats", "forges", "cuts")
"""What the network does: lets each message wait a while and keeps their order; lets some wait and be overtaken; loses
some; changes some bytes; sends an old one again; changes the numbers in some; lets nothing through."""

_HEADER = struct.Struct(">4sI")


def wiring_through(path: Path) -> Path:
    """Write the wiring of a board that is behind the proxy, and return its path."""
    text = load_board().path.read_text(encoding="utf-8")
    wiring = load_board()
    for before, after in ((wiring.address, GROUP), (str(wiring.port), str(PORT)), (str(wiring.state_port), STATE_PORT)):
        text = text.replace(f'"{before}"', f'"{after}"').replace(f"port = {before} ", f"port = {after} ")
    path.write_text(text, encoding="utf-8")
    return path


class LcmProxy(Proxy):
    """The relay; what it does is one of KINDS, or nothing."""

    def __init__(self, seed: int = 0) -> None:
        super().__init__(seed, 53)
        self._board: BoardWiring = load_board()
        self._held: list[tuple[float, int, tuple[str, int], bytes]] = []
        self._last: dict[tuple[str, int], float] = {}
        self._old: deque[tuple[tuple[str, int], bytes]] = deque(maxlen=400)
        self._number = 0
        self._out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        self._out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        self._out.bind(("127.0.0.1", 0))
        self._own = self._out.getsockname()
        b = self._board
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
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
            other.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
            self._number += 1
            packet = _HEADER.pack(b"LC02", self._number) + name + data
            other.sendto(packet, (self._board.address, self._board.port))

    def relay(self) -> None:
        wait = 0.02 if not self._held else max(min(self._held[0][0] - time.monotonic(), 0.02), 0.0)
        ready, _, _ = select.select(list(self._ways), [], [], wait)
        for one in ready:
            packet, sender = one.recvfrom(65536)
            if sender != self._own:
                self._through(packet, self._ways[one])
        while self._held and self._held[0][0] <= time.monotonic():
            _, _, to, packet = heapq.heappop(self._held)
            self._send(packet, to)

    def _send(self, packet: bytes, to: tuple[str, int]) -> None:
        try:
            self._out.sendto(packet, to)
        except OSError:
            return  # the network is down

    def _through(self, packet: bytes, to: tuple[str, int]) -> None:
        now = time.monotonic()
        channel, begins = _channel(packet)
        to_board = to[0] == self._board.address
        if to_board and channel != MOTOR_CTRL.channel:
            return
        if not self.active():
            self._pass(packet, to, now)
            return
        if self.kind == "jitter":
            due = max(now + self.lag * float(self.rng.random()), self._last.get(to, 0.0))
            self._last[to] = due
            self._pass(packet, to, due)
            return
        hit = self.hit()
        if self.kind == "cuts" or (self.kind == "drops" and hit):
            return
        if self.kind == "delays" and hit:
            self._pass(packet, to, now + self.lag * float(self.rng.random()))
            return
        self._old.append((to, packet))
        if self.kind == "repeats" and hit:
            where, old = self._old[int(self.rng.integers(len(self._old)))]
            self._send(old, where)
        if hit and (self.kind == "corrupts" or (self.kind == "forges" and not to_board)):
            packet = self.damaged(packet, begins + 8 if self.kind == "forges" else 0)
        self._pass(packet, to, now)

    def _pass(self, packet: bytes, to: tuple[str, int], due: float) -> None:
        if due <= time.monotonic() and not self._held:
            self._send(packet, to)
            return
        self._number += 1
        heapq.heappush(self._held, (due, self._number, to, packet))


def _listening(group: str, port: int) -> socket.socket:
    one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    one.bind((group, port))
    joined = socket.inet_aton(group) + socket.inet_aton("127.0.0.1")
    one.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, joined)
    return one


def _channel(packet: bytes) -> tuple[str, int]:
    """Return the channel of a message, and where its data begin."""
    end = packet.find(b"\0", _HEADER.size)
    return packet[_HEADER.size : end].decode(errors="replace"), end + 1
