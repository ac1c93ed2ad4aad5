"""Serves the emulated robot to other processes, over TCP as a real adapter does; its time follows the wall clock.

One thread does everything: it reads from the clients, advances the emulation to now, sends frames to the clients, and
sleeps until the next event. If the machine is slow, the emulation catches up. If it is very slow, emulated time stops
and the pause is counted: a robot that goes on while nobody can answer shows nothing.
"""

from __future__ import annotations

import contextlib
import select
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass

from mimic.emulator.robot import EmulatedRobot, Host
from mimic.emulator.wire_formats import Session, SlcanSession, SocketcandSession
from mimic.errors import BusError

GRAIN = 0.0005
"""Shortest sleep [s]: frames that are due sooner go out together."""

LONGEST_SLEEP = 0.01
"""Longest sleep [s]."""

CATCH_UP = 0.1
"""A longer delay than this is not caught up [s]."""

LATE = 0.002
"""A frame that is delivered later than this after it was on the bus counts as late [s]."""

QUIET = 0.05
"""How long frames are held back after a client of socketcand was answered [s]: python-can expects the answer alone."""

MOST_WAITING = 1 << 20
"""A client that leaves more than this many bytes unread is dropped."""


@dataclass(frozen=True, kw_only=True, slots=True)
class EmulatorStatus:
    """Statistics of the emulation since the last call."""

    t: float
    """Time of the emulation [s]."""
    load: tuple[float, ...]
    """Share of the time that each bus was busy."""
    frames: tuple[float, ...]
    """Frames a second on each bus."""
    clients: int
    late: int
    """Frames handed out more than 2 ms after they were on the bus."""
    latest: float
    """Longest delay of a frame [s]."""
    stood_still: float
    """How long emulated time stopped because the machine was too slow [s]."""


@dataclass(eq=False)
class _Client:
    sock: socket.socket
    session: Session
    host: Host | None = None
    waiting: bytes = b""
    quiet_until: float = 0.0


class EmulatorServer:
    """Serves one emulated robot."""

    def __init__(
        self, robot: EmulatedRobot, *, host: str = "127.0.0.1", port: int = 0, slcan: int | None = None
    ) -> None:
        """Listen.

        Args:
            robot: The robot; nothing else may advance its time.
            host: Address to listen at.
            port: For socketcand, all buses; 0 takes a free one.
            slcan: For slcan, the first bus, the others on the ports after it; 0 takes free ones, None does without.

        Raises:
            BusError: If an address cannot be listened at.
        """
        self.robot = robot
        """The robot that is served."""
        self._names = [f"can{i}" for i in range(len(robot.buses))]
        self._listening: dict[socket.socket, int | None] = {}
        self._clients: list[_Client] = []
        self.addresses: list[str] = []
        """What a user gives to --robot, one for each bus and protocol."""
        port = self._listen(host, port, None)
        self.addresses += [f"socketcand://{host}:{port}/{name}" for name in self._names]
        for bus in range(len(robot.buses)) if slcan is not None else ():
            port = self._listen(host, slcan + bus if slcan else 0, bus)
            self.addresses.append(f"slcan:socket://{host}:{port}")
        self._begin = time.monotonic() - robot.now
        self._late, self._latest, self._stood_still = 0, 0.0, 0.0
        self._before = (robot.now, [(bus.bits, bus.frames) for bus in robot.buses])

    def _listen(self, host: str, port: int, bus: int | None) -> int:
        try:
            sock = socket.create_server((host, port))
        except OSError as reason:
            self.close()
            raise BusError(
                f"cannot listen at {host}:{port}: {reason.strerror or reason}; name another with --listen"
            ) from None
        sock.setblocking(False)
        self._listening[sock] = bus
        return int(sock.getsockname()[1])

    # ------------------------------------------------------------------ the loop

    def run(self, stop: Callable[[], bool], each: Callable[[], None] = lambda: None) -> None:
        """Serve until ``stop`` returns True; ``each`` is called at every turn."""
        self._begin = time.monotonic() - self.robot.now
        while not stop():
            self.turn()
            each()

    def turn(self) -> None:
        """Wait until something is due, at most 10 ms, and do it."""
        anybody = any(client.host is not None for client in self._clients)
        left = self.robot.next_event - self._time() if anybody else LONGEST_SLEEP
        reading = [*self._listening, *(client.sock for client in self._clients)]
        writing = [client.sock for client in self._clients if client.waiting]
        ready, writable, _ = select.select(reading, writing, [], min(max(left, GRAIN), LONGEST_SLEEP))
        self._keep_up()
        for sock in ready:
            if sock in self._listening:
                self._accept(sock)
        for client in [c for c in self._clients if c.sock in ready]:
            self._read(client)
        self.robot.advance(max(self._time(), self.robot.now))
        self._hand_out()
        for client in [c for c in self._clients if c.sock in writable or c.waiting]:
            self._write(client)
        for client in [c for c in self._clients if c.host is not None and c.host.bus is not None]:
            assert client.host is not None
            assert client.host.bus is not None
            if self.robot.unplugged(client.host.bus):
                self._drop(client)

    def _time(self) -> float:
        return time.monotonic() - self._begin

    def _keep_up(self) -> None:
        behind = self._time() - self.robot.now - LONGEST_SLEEP
        if behind > CATCH_UP:
            self._begin += behind - CATCH_UP
            self._stood_still += behind - CATCH_UP

    def status(self) -> EmulatorStatus:
        """Return the statistics since the last call."""
        robot, (before, counts) = self.robot, self._before
        span = max(robot.now - before, 1e-9)
        now = [(bus.bits, bus.frames) for bus in robot.buses]
        status = EmulatorStatus(
            t=robot.now,
            load=tuple((a[0] - b[0]) / robot.wiring.bitrate / span for a, b in zip(now, counts, strict=True)),
            frames=tuple((a[1] - b[1]) / span for a, b in zip(now, counts, strict=True)),
            clients=sum(client.host is not None for client in self._clients),
            late=self._late,
            latest=self._latest,
            stood_still=self._stood_still,
        )
        self._before = robot.now, now
        self._late, self._latest, self._stood_still = 0, 0.0, 0.0
        return status

    def close(self) -> None:
        """Close all connections."""
        for client in list(self._clients):
            self._drop(client)
        for sock in self._listening:
            sock.close()
        self._listening.clear()

    # ------------------------------------------------------------------ clients

    def _accept(self, listening: socket.socket) -> None:
        try:
            sock, _ = listening.accept()
        except OSError:
            return
        bus = self._listening[listening]
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        session: Session = SocketcandSession(self._names) if bus is None else SlcanSession(bus)
        client = _Client(sock, session, waiting=session.greet())
        self._clients.append(client)

    def _read(self, client: _Client) -> None:
        try:
            data = client.sock.recv(65536)
            quickack = getattr(
                socket, "TCP_QUICKACK", None
            )  # Linux; without it a client's Nagle waits 40 ms for an answer
            if quickack is not None:
                client.sock.setsockopt(socket.IPPROTO_TCP, quickack, 1)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(client)
            return
        session = client.session
        frames, answer = session.take(data)
        client.waiting += answer
        if session.open and client.host is None and session.bus is not None:
            if self.robot.unplugged(session.bus):
                self._drop(client)
                return
            client.host = self.robot.connect(bus=session.bus)
            client.quiet_until = self._time() + (QUIET if answer else 0.0)
        elif not session.open and client.host is not None:
            self.robot.disconnect(client.host)
            client.host = None
        for frame in frames:
            if client.host is not None and client.host.bus is not None:
                with contextlib.suppress(BusError):  # unplugged: the connection is dropped in this turn
                    self.robot.send(client.host, client.host.bus, frame, at=self._time())

    def _hand_out(self) -> None:
        now = self._time()
        for client in self._clients:
            if client.host is None or now < client.quiet_until:
                continue
            heard = client.host.heard
            parts = []
            while heard:
                received = heard.popleft()
                late = now - received.t
                self._late, self._latest = self._late + (late > LATE), max(self._latest, late)
                parts.append(client.session.give(received.frame, received.t))
            client.waiting += b"".join(parts)

    def _write(self, client: _Client) -> None:
        if not client.waiting:
            return
        try:
            client.waiting = client.waiting[client.sock.send(client.waiting) :]
        except BlockingIOError:
            pass
        except OSError:
            self._drop(client)
            return
        if len(client.waiting) > MOST_WAITING:
            self._drop(client)

    def _drop(self, client: _Client) -> None:
        if client.host is not None:
            self.robot.disconnect(client.host)
        if client in self._clients:
            self._clients.remove(client)
        client.sock.close()
