"""The process that sends to a robot, and the control loop's end of it.

Heartbeats go both ways: the sender damps the robot when no order comes (`mimic.hardware.robot.sender.ORDER_TIMEOUT`),
the loop when no report comes for HANGS. Whoever is left damps: the loop ends a sender that
hangs, and opens the robot's bus itself.
"""

from __future__ import annotations

import json
import select
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import asdict
from typing import Any

import numpy as np

from mimic import errors
from mimic.control.priority import SENDER, real_time
from mimic.errors import MimicError, PlantError
from mimic.hardware.robot.checks import Check
from mimic.hardware.robot.driver import REPORT, CheckOptions, DriverSettings
from mimic.hardware.robot.opening import load_driver, open_driver
from mimic.hardware.robot.sender import GIVE_UP, Order, Sender, State, why_lost
from mimic.robot.description import RobotDescription, load_description

ANSWER_WITHIN = 30.0
"""Opening the robot, its checks and switching it on take at most this long [s]."""

END_WITHIN = GIVE_UP + 12.0
"""Damping and ending take at most this long [s]: GIVE_UP, a robot's damp_seconds, and some more."""

HANGS = 0.2
"""A sender that has reported nothing for this long hangs [s]."""

OPEN_EVERY = 0.05
"""Time between two attempts to open a robot that must be damped [s]."""

FAILS = 0.1
"""A sender that can send nothing for this long, as something is raised each time, leaves the robot to the loop [s]."""

READ_WITHIN = 1.0
"""The loop takes the last word within this, or never [s]."""

BEHIND = 0.1
"""A computer whose clocks part by more than this has slept [s]."""

_ORDER = b"O"
_CHECK = b"C"
_START = b"S"
_DAMP = b"D"
_REPORT = b"R"
_ANSWER = b"A"
_ERROR = b"E"
_TAKEN_OVER = b"D"
_ENDING = b"T"

_LARGEST = 1 << 17


class SenderProcess:
    """Starts the process that sends, and talks to it."""

    def __init__(self, settings: DriverSettings, description: RobotDescription, *, keep: tuple[int, ...] = ()) -> None:
        """Start the process, which opens the robot and only listens.

        Args:
            settings: Which robot.
            description: The robot.
            keep: Files that the process inherits and keeps open, such as the locks of the buses.

        Raises:
            ConfigError, AssetError, BusError, MissingExtra: If the robot cannot be opened.
            PlantError: If the process does not start.
        """
        self._settings = settings
        self._description = description
        load_driver(settings)
        self._ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        command = [sys.executable, "-m", "mimic.hardware.robot.process"]
        command += [str(theirs.fileno()), json.dumps(asdict(settings))]
        self._process = subprocess.Popen(
            command, pass_fds=[theirs.fileno(), *keep], stdin=subprocess.DEVNULL, start_new_session=True
        )
        theirs.close()
        self._ours.setblocking(False)
        self._reports: list[Any] = []
        self._state = State.LISTEN
        self._lost = False
        self._started = False
        self._answer: Any = None
        self._failure: tuple[str, str] | None = None
        self._taken_over = ""
        self._damps = False
        self._ending: str | None = None
        self._heard = time.monotonic()
        try:
            self._ask(b"")
        except BaseException:
            self.close()
            raise

    @property
    def pid(self) -> int:
        """Id of the process."""
        return self._process.pid

    @property
    def problem(self) -> str:
        """Why the sender takes no orders any more; empty while it does."""
        gone = self._taken_over or self._lost or self._process.poll() is not None or self._state >= State.DAMP
        return why_lost(self._taken_over) if gone else ""

    def now(self) -> float:
        """Return the monotonic clock [s]."""
        return time.monotonic()

    def checks(self, options: CheckOptions) -> list[Check]:
        """Check a robot that nobody drives; nothing moves."""
        return [Check(**found) for found in self._ask(_CHECK + json.dumps(asdict(options)).encode())]

    def start(self, *, suspended: bool = False) -> None:
        """Switch the motors on without gains."""
        self._started = True
        self._reports.clear()
        self._ask(_START + json.dumps(suspended).encode())

    def _ask(self, request: bytes) -> Any:
        """Send a request, and return its answer."""
        self._answer = None
        if request:
            self._send(request)
        end = time.monotonic() + ANSWER_WITHIN
        while self._answer is None and self._failure is None and not self._lost and time.monotonic() < end:
            self._read(0.1)
        if self._failure is not None:
            (name, text) = self._failure
            self._failure = None
            raise _error(name, text)
        if self._answer is None:
            raise PlantError(f"the process that sends to the robot {'has ended' if self._lost else 'does not answer'}")
        return self._answer["is"]

    def _send(self, data: bytes) -> None:
        try:
            self._ours.send(data)
        except BlockingIOError:
            return  # it does not read: it sees no sign of life, and damps
        except OSError:
            self._lost = True

    def order(self, order: Order) -> None:
        """Give an order."""
        self._send(_ORDER + order.to_bytes())

    def wait(self, until: float) -> list[Any]:
        """Wait until a time [s], and return the reports that came."""
        while time.monotonic() < until and (self._damps or not self.problem):
            self._read(max(until - time.monotonic(), 0.0))
            if self._lost and self._damps:
                time.sleep(max(until - time.monotonic(), 0.0))
        self._read(0.0)
        reports = self._reports
        self._reports = []
        return reports

    def _read(self, timeout: float) -> None:
        """Take what the process says, for a time at most [s]."""
        if self._lost or not select.select([self._ours], [], [], timeout)[0]:
            return
        while True:
            try:
                data = self._ours.recv(_LARGEST)
            except BlockingIOError:
                return
            except ConnectionResetError:
                continue  # said once; what came before is still there
            except OSError:
                data = b""
            if not data:
                self._lost = True
                return
            self._heard = time.monotonic()
            kind = data[:1]
            content = data[1:]
            if kind == _REPORT:
                report = np.frombuffer(content, REPORT)[0]
                self._state = State(int(report["state"]))
                self._reports.append(report)
                continue
            said = json.loads(content)
            if kind == _ANSWER:
                self._answer = {"is": said}
            elif kind == _ERROR:
                self._failure = said[0], said[1]
            elif kind == _TAKEN_OVER:
                self._taken_over = said
            elif kind == _ENDING:
                self._ending = said

    def damp(self) -> None:
        """Have the robot damped, by one message."""
        self._damps = True
        self._send(_DAMP)

    @property
    def left(self) -> bool:
        """Whether the sender has said how the robot was left, or its socket is closed."""
        return self._lost or self._ending is not None

    def end(self) -> None:
        """End the process."""
        with suppress(ProcessLookupError):
            self._process.kill()
        self._lost = True

    def finish(self) -> str:
        """Damp the robot until it rests, and return how it was left."""
        if not self._started:
            return "nothing was switched on"
        end = time.monotonic() + END_WITHIN
        self.damp()
        while not self._lost and self._ending is None and time.monotonic() < end:
            self._read(0.02)
            self._reports.clear()
            if time.monotonic() - self._heard > HANGS:
                break
        return self._damp_directly() if self._ending is None else self._ending

    def _damp_directly(self) -> str:
        """End the process and damp the robot from this one."""
        self.end()
        end = time.monotonic() + GIVE_UP
        while True:
            try:
                driver = open_driver(self._settings, quick=True)
                break
            except MimicError as reason:
                if time.monotonic() > end:
                    return f"the robot could not be damped: {reason}; cut the power"
            time.sleep(OPEN_EVERY)
        try:
            return Sender(driver, self._description).run()
        finally:
            driver.close()

    def close(self) -> None:
        """End the process. Safe to call twice."""
        self._ours.close()
        try:
            self._process.wait(END_WITHIN)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def _error(name: str, text: str) -> MimicError:
    """Return an error of a class of `mimic.errors`, whatever its constructor takes."""
    kind: type[MimicError] = getattr(errors, name, PlantError)
    error = kind.__new__(kind)
    Exception.__init__(error, text)
    return error


# ------------------------------------------------------------------ the process itself


class _Server:
    """Serves the control loop's end of a socket."""

    def __init__(self, orders: socket.socket, sender: Sender) -> None:
        self._orders: socket.socket | None = orders
        self._sender = sender
        self._apart = _clocks_apart()
        self._told = False

    def run(self) -> None:
        """Send until the robot is left and nobody can ask for more."""
        sender = self._sender
        while sender.state != State.DONE:
            try:
                self._turn()
            except Exception as reason:
                sender.fail(reason)
            if sender.fails_for > FAILS and self._orders is not None:
                return
        if self._orders is not None:
            self._orders.settimeout(READ_WITHIN)
            self._say(_ENDING, json.dumps(sender.ending).encode())

    def _turn(self) -> None:
        sender = self._sender
        wake = None if self._orders is None else self._orders.fileno()
        report = sender.cycle(sender.driver.now() + 1.0, wake)
        slept = _clocks_apart() - self._apart
        if slept > BEHIND and sender.state == State.DRIVE:
            sender.damp(f"this computer slept for {slept:.1f} s")
        if report is not None:
            self._say(_REPORT, report.tobytes())
        self._take()
        if sender.reason and not self._told:
            self._told = True
            self._say(_TAKEN_OVER, json.dumps(sender.reason).encode())

    def _say(self, kind: bytes, content: bytes) -> None:
        if self._orders is None:
            return
        with suppress(BlockingIOError, OSError):  # who does not read is busy, stopped or gone; reading finds that
            self._orders.send(kind + content)

    def _take(self) -> None:
        """Take all that has come."""
        while self._orders is not None:
            try:
                data = self._orders.recv(_LARGEST)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if not data:
                self._orders = None
                self._sender.closed()
                return
            self._handle(data[:1], data[1:])

    def _handle(self, kind: bytes, content: bytes) -> None:
        sender = self._sender
        try:
            if kind == _ORDER:
                sender.order(Order.from_bytes(content))
            elif kind == _DAMP:
                sender.finish()
            elif kind == _CHECK:
                found = sender.driver.checks(CheckOptions(**json.loads(content)))
                self._say(_ANSWER, json.dumps([asdict(check) for check in found]).encode())
            elif kind == _START:
                sender.start(suspended=json.loads(content))
                self._say(_ANSWER, json.dumps(True).encode())
        except Exception as reason:
            if kind in (_ORDER, _DAMP):
                sender.fail(reason)
            else:
                self._say(_ERROR, _failure(reason))


def _failure(reason: Exception) -> bytes:
    return json.dumps([type(reason).__name__, str(reason)]).encode()


def _clocks_apart() -> float:
    """Return how far the clock that counts sleep is ahead of the one that does not [s]; 0 where there is none."""
    clock = getattr(time, "CLOCK_BOOTTIME", None)
    return 0.0 if clock is None else time.clock_gettime(clock) - time.monotonic()


def main(arguments: list[str]) -> int:
    """Serve the socket in the first argument with the robot of the settings in the second."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    orders = socket.socket(fileno=int(arguments[0]))
    settings = DriverSettings(**json.loads(arguments[1]))
    orders.setblocking(False)
    opened = load_driver(settings)
    description = load_description(settings.robot)
    with real_time(SENDER, inherited=True):  # also for the threads in which a bus receives
        try:
            driver = opened(settings)
            sender = Sender(driver, description)
        except MimicError as reason:
            with suppress(OSError):
                orders.send(_ERROR + _failure(reason))
            return 2
        orders.send(_ANSWER + json.dumps(True).encode())
        _Server(orders, sender).run()
        with suppress(Exception):
            driver.close()
    return 1 if sender.failure else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
