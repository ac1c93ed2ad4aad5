"""The process at the board: sends at 500 Hz, and damps the robot when the process with the control loop cannot.

It is started first, as the watchdog of a robot on CAN is. Orders come and reports go through a socket between the two
processes. If this process ends instead, the control loop damps the robot over a connection of its own, and without
either of them the firmware damps it 0.5 s after the last message.
"""

from __future__ import annotations

import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mimic.control.priority import WATCHDOG, real_time
from mimic.errors import MimicError, PlantError
from mimic.hardware.stock.lcm_bus import LcmBus, check_network
from mimic.hardware.stock.messages import MOTOR_CTRL
from mimic.hardware.stock.readings import REPORT
from mimic.hardware.stock.sender import PERIOD, UNREACHED, Order, Sender, State
from mimic.hardware.stock.wiring import BoardWiring, load_board
from mimic.robot.description import RobotDescription, load_description

START_TIMEOUT = 20.0
"""A process that is not ready by then counts as failed [s]."""

BEHIND = 0.02
"""Time that is not caught up [s]."""

END_TIMEOUT = 12.0
"""Damping and ending take at most this long [s]: a robot's damp_seconds and some more."""

_READY, _REPORT, _TEXT = b"!", b"R", b"T"


class BoardProcess:
    """Starts the process at the board and talks to it. A `mimic.hardware.stock.plant.BoardLink`."""

    def __init__(self, wiring: BoardWiring, interface: str | None, description: RobotDescription) -> None:
        """Start the process; it only listens.

        Args:
            wiring: Of the board.
            interface: Network interface to the robot; None takes the one of the multicast route.
            description: The robot.

        Raises:
            BusError, ConfigError, MissingExtra: If the network cannot be used.
            PlantError: If the process does not start.
        """
        _, ttl = check_network(wiring, interface)
        self._sender = Sender(wiring, description)  # for the case that the process dies
        self._wiring, self._ttl = wiring, ttl
        self._ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        command = [sys.executable, "-m", "mimic.hardware.stock.process"]
        command += [str(theirs.fileno()), str(wiring.path), str(ttl), description.name]
        self._process = subprocess.Popen(
            command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, start_new_session=True
        )
        theirs.close()
        self._ours.setblocking(False)
        self._text = ""
        self._state = State.LISTEN
        self._lost = self._driven = False
        self._reports: list[Any] = []
        self._ready = False
        end = time.monotonic() + START_TIMEOUT
        while not (self._ready or self._lost) and time.monotonic() < end:
            self._read(0.1)
        if not self._ready:
            self.close()
            raise PlantError(f"the process that sends to the robot does not start: {self._text or 'it said nothing'}")

    @property
    def pid(self) -> int:
        """Id of the process."""
        return self._process.pid

    def now(self) -> float:
        """Return the monotonic clock [s]."""
        return time.monotonic()

    def order(self, order: Order) -> None:
        """Give an order."""
        self._driven = self._driven or order.state > State.LISTEN
        try:
            self._ours.send(order.to_bytes())
        except BlockingIOError:
            return  # it does not read: it sees no sign of life, and damps
        except OSError:
            self._lost = True

    def wait(self, until: float) -> list[Any]:
        """Wait until a time [s], and return the reports that came."""
        while (left := until - time.monotonic()) > 0.0 and not self._lost:
            self._read(left)
        self._read(0.0)
        time.sleep(max(until - time.monotonic(), 0.0))
        reports, self._reports = self._reports, []
        return reports

    def _read(self, timeout: float) -> None:
        """Take what the process says, for a time at most [s]."""
        if self._lost or not select.select([self._ours], [], [], timeout)[0]:
            return
        while True:
            try:
                data = self._ours.recv(8192)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if not data:
                self._lost = True
                return
            kind, content = data[:1], data[1:]
            if kind == _REPORT:
                report = np.frombuffer(content, REPORT)[0]
                self._state = State(int(report["state"]))
                self._reports.append(report)
            elif kind == _TEXT:
                self._text = content.decode(errors="replace")
            elif kind == _READY:
                self._ready = True

    def alive(self) -> bool:
        """Return whether it still sends what it is told; False also once it has taken over."""
        return not self._lost and self._process.poll() is None and self._state < State.DAMP

    def finish(self) -> str:
        """Damp the robot until it rests, and return how it was left."""
        if not self._driven:
            return "nothing was switched on"
        end = time.monotonic() + END_TIMEOUT
        while not (self._lost or self._text) and time.monotonic() < end:
            if self._state < State.DAMP:
                self.order(Order(state=State.DAMP))
            self._read(PERIOD * 10)
        if self._text:
            return self._text
        return damp_directly(self._sender, self._wiring, self._ttl)

    def close(self) -> None:
        """End the process. Safe to call twice."""
        self._ours.close()
        try:
            self._process.wait(END_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def damp_directly(sender: Sender, wiring: BoardWiring, ttl: int) -> str:
    """Damp the robot from this process until it rests, and return how it was left."""
    try:
        bus = LcmBus(wiring, ttl, sender.heard)
    except MimicError as reason:
        return f"{UNREACHED} ({reason})"
    sender.order(Order(state=State.DAMP), time.monotonic())
    _run(sender, bus, None, lambda text: None)
    return sender.ending or UNREACHED


def _run(sender: Sender, bus: LcmBus, orders: socket.socket | None, say: Callable[[str], None]) -> None:
    """Send until the sender is done."""
    due = time.monotonic()
    problem = ""
    while sender.state != State.DONE:
        now = time.monotonic()
        try:
            data = sender.message(now)
            if data is not None:
                bus.publish(MOTOR_CTRL.channel, data)
        except OSError as reason:
            if not problem:
                problem = str(reason)
        if orders is not None:
            orders = _exchange(sender, orders, now)
        due += PERIOD
        if time.monotonic() - due > BEHIND:
            due = time.monotonic()
        while bus.listen(due, () if orders is None else (orders.fileno(),)):
            assert orders is not None
            if not _take_orders(sender, orders):
                orders = None
            if orders is None or time.monotonic() >= due:
                break
    say(sender.ending)


def _exchange(sender: Sender, orders: socket.socket, now: float) -> socket.socket | None:
    """Report, and take what orders have come; return None once nobody is there to give them."""
    try:
        orders.send(_REPORT + sender.report(now))
    except BlockingIOError:
        pass  # nobody reads: that process is busy or stopped
    except OSError:
        pass  # it has ended: reading finds that
    return orders if _take_orders(sender, orders) else None


def _take_orders(sender: Sender, orders: socket.socket) -> bool:
    """Take all orders that have come; return whether more can come."""
    while True:
        try:
            data = orders.recv(8192)
        except BlockingIOError:
            return True
        except OSError:
            data = b""
        now = time.monotonic()
        if not data:
            sender.closed(now)
            return False
        try:
            sender.order(Order.from_bytes(data), now)
        except (MimicError, ValueError):
            sender.order(Order(state=State.DAMP), now)


def main(arguments: list[str]) -> int:
    """Serve the socket in the first argument: wiring file, ttl and the robot's name follow."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    fd, path, ttl, robot = arguments
    orders = socket.socket(fileno=int(fd))
    orders.setblocking(False)

    def say(text: str) -> None:
        try:
            orders.setblocking(True)
            orders.send(_TEXT + text.encode())
        except OSError:
            return  # no process is left to read it

    with real_time(WATCHDOG, inherited=True):  # also for the thread in which LCM receives
        try:
            wiring = load_board(Path(path))
            sender = Sender(wiring, load_description(robot))
            bus = LcmBus(wiring, int(ttl), sender.heard)
        except MimicError as reason:
            say(str(reason))
            return 2
        orders.send(_READY)
        _run(sender, bus, orders, say)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
