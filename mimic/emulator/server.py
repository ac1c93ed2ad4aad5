"""Serves the emulated robot to other processes: socketcand over TCP, slcan on pseudo-terminals as a serial adapter.

Its time follows the wall clock.

One thread does everything: it reads from the clients, advances the emulation to now, sends frames to the clients, and
sleeps until the next event. If the machine is slow, the emulation catches up. If it is very slow, emulated time stops
and the pause is counted: a robot that goes on while nobody can answer shows nothing.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import termios
import time
import tty
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
"""A client of socketcand that leaves more than this many bytes unread is dropped; a serial adapter drops frames."""


@dataclass(eq=False)
class _Client:
    file: int
    """What is read and written."""
    close: Callable[[], None]
    session: Session
    terminal: int | None = None
    """The side of a pseudo-terminal that the client opens."""
    host: Host | None = None
    waiting: bytes = b""
    quiet_until: float = 0.0


class EmulatorServer:
    """Serves one emulated robot."""

    def __init__(self, robot: EmulatedRobot, *, host: str = "127.0.0.1", port: int = 0, slcan: bool = False) -> None:
        """Listen.

        Args:
            robot: The robot; nothing else may advance its time.
            host: Address to listen at.
            port: For socketcand, all buses; 0 takes a free one.
            slcan: Whether each bus is also a serial adapter on a pseudo-terminal.

        Raises:
            BusError: If an address cannot be listened at.
        """
        self.robot = robot
        """The robot that is served."""
        self._names = [f"can{i}" for i in range(len(robot.buses))]
        self._clients: list[_Client] = []
        self.addresses: list[str] = []
        """What a user gives to --robot, one for each bus and protocol."""
        self._listening = self._listen(host, port)
        port = int(self._listening.getsockname()[1])
        self.addresses += [f"socketcand://{host}:{port}/{name}" for name in self._names]
        for bus in range(len(robot.buses)) if slcan else ():
            self.addresses.append(f"slcan:{self._plug_in(bus)}")
        self._begin = time.monotonic() - robot.now
        self.late = 0
        """Frames handed out more than 2 ms after they were on the bus."""
        self.stood_still = 0.0
        """How long emulated time stopped because the machine was too slow [s]."""
        self._latest = 0.0
        self._before = self._totals()

    def _totals(self) -> tuple[float, list[tuple[int, int]], int, float]:
        counts = [(bus.bits, bus.frames) for bus in self.robot.buses]
        return self.robot.now, counts, self.late, self.stood_still

    def _listen(self, host: str, port: int) -> socket.socket:
        try:
            sock = socket.create_server((host, port))
        except OSError as reason:
            raise BusError(
                f"cannot listen at {host}:{port}: {reason.strerror or reason}; name another with --listen"
            ) from None
        sock.setblocking(False)
        return sock

    def _plug_in(self, bus: int) -> str:
        """Make a serial adapter of a bus and return its device."""
        ours, terminal = os.openpty()
        tty.setraw(terminal)
        os.set_blocking(ours, False)

        def close() -> None:
            os.close(ours)
            os.close(terminal)

        self._clients.append(_Client(ours, close, SlcanSession(bus), terminal))
        return os.ttyname(terminal)

    # ------------------------------------------------------------------ the loop

    def run(self, stop: Callable[[], bool], each: Callable[[], None] = lambda: None) -> None:
        """Serve until ``stop`` returns True; ``each`` is called at every turn."""
        self._begin = time.monotonic() - self.robot.now
        while not stop():
            self.turn()
            each()

    def turn(self) -> None:
        """Wait until something is due, at most 10 ms, and do it."""
        ready, writable = self._await_due()
        self._keep_up()
        if self._listening.fileno() in ready:
            self._accept()
        for client in [c for c in self._clients if c.file in ready]:
            self._read(client)
        self.robot.advance(max(self._time(), self.robot.now))
        self._hand_out()
        for client in [c for c in self._clients if c.file in writable or c.waiting]:
            self._write(client)
        self._drop_unplugged()

    def _await_due(self) -> tuple[list[int], list[int]]:
        """Wait until the robot has something to send or a client does something; return who can be read and written."""
        anybody = any(client.host is not None for client in self._clients)
        left = self.robot.next_event - self._time() if anybody else LONGEST_SLEEP
        reading = [self._listening.fileno(), *(client.file for client in self._clients)]
        writing = [client.file for client in self._clients if client.waiting]
        ready, writable, _ = select.select(reading, writing, [], min(max(left, GRAIN), LONGEST_SLEEP))
        return ready, writable

    def _drop_unplugged(self) -> None:
        for client in list(self._clients):
            bus = None if client.host is None else client.host.bus
            if bus is not None and self.robot.unplugged(bus):
                self._drop(client)

    def _time(self) -> float:
        return time.monotonic() - self._begin

    def _keep_up(self) -> None:
        behind = self._time() - self.robot.now - LONGEST_SLEEP
        if behind > CATCH_UP:
            self._begin += behind - CATCH_UP
            self.stood_still += behind - CATCH_UP

    def line(self) -> str:
        """Return a line of the statistics since the last one."""
        robot = self.robot
        (before, counts, late, stood_still) = self._before
        span = max(robot.now - before, 1e-9)
        self._before = _, now, _, _ = self._totals()
        buses = ", ".join(
            f"{(a[0] - b[0]) / robot.wiring.bitrate / span:.1%} at {(a[1] - b[1]) / span:.0f} frames/s"
            for a, b in zip(now, counts, strict=True)
        )
        clients = sum(client.host is not None for client in self._clients)
        line = f"{robot.now:9.1f} s  bus load {buses}; {clients} client{'s' if clients != 1 else ''}"
        if self.late > late:
            line += f"; {self.late - late} frames late, {1e3 * self._latest:.1f} ms at most"
        if self.stood_still > stood_still:
            line += f"; stood still for {self.stood_still - stood_still:.2f} s"
        self._latest = 0.0
        return line

    def figures(self) -> dict[str, str]:
        """Return rows of a table of what has happened."""
        robot = self.robot
        bits = sum(bus.bits for bus in robot.buses)
        frames = sum(bus.frames for bus in robot.buses)
        return {
            "frames": f"{frames}, {bits / max(frames, 1):.1f} bits each on average",
            "bus load": ", ".join(f"{robot.load(bus):.1%}" for bus in range(len(robot.buses))),
            "commands": f"at most {1e3 * robot.oldest:.0f} ms old while they drove a motor",
            "delivered late": f"{self.late} frames by more than 2 ms",
        }

    def close(self) -> None:
        """Close all connections."""
        for client in list(self._clients):
            self._drop(client)
        self._listening.close()

    # ------------------------------------------------------------------ clients

    def _accept(self) -> None:
        try:
            sock, _ = self._listening.accept()
        except OSError:
            return
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        session = SocketcandSession(self._names)
        self._clients.append(_Client(sock.fileno(), sock.close, session, waiting=session.greet()))

    def _read(self, client: _Client) -> None:
        try:
            data = os.read(client.file, 65536)
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
            client.waiting = b""
            if client.terminal is not None:  # the next program does not read what was meant for this one
                termios.tcflush(client.terminal, termios.TCIFLUSH)
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
                self.late = self.late + (late > LATE)
                self._latest = max(self._latest, late)
                parts.append(client.session.give(received.frame, received.t))
            client.waiting += b"".join(parts)

    def _write(self, client: _Client) -> None:
        if not client.waiting:
            return
        try:
            client.waiting = client.waiting[os.write(client.file, client.waiting) :]
        except BlockingIOError:
            pass
        except OSError:
            self._drop(client)
            return
        if len(client.waiting) <= MOST_WAITING:
            return
        if client.terminal is None:
            self._drop(client)
        else:
            client.waiting = b""

    def _drop(self, client: _Client) -> None:
        if client.host is not None:
            self.robot.disconnect(client.host)
        if client in self._clients:
            self._clients.remove(client)
        client.close()
