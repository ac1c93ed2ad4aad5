"""The process that sends to a robot, and the control loop's end of it.

Heartbeats go both ways: the sender damps the robot when no order comes (`mimic.hardware.robot.sender.ORDER_TIMEOUT`),
the loop when no report comes for HANGS. Whoever is left damps: the loop ends a sender that
hangs, and opens the robot's bus itself.

What they say to each other is a kind and its content: order, damp, check and start; report, answer, taken over, ending.
"""

from __future__ import annotations

import json
import pickle
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

from mimic.control.priority import SENDER, real_time
from mimic.errors import MimicError, PlantError
from mimic.hardware.robot.checks import Check, CheckOptions
from mimic.hardware.robot.driver import REPORT, DriverSettings
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

_LARGEST = 1 << 17


def packed(kind: str, content: Any = None) -> bytes:
    """Return a message as bytes."""
    return pickle.dumps((kind, content))


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
        self._answers: list[Any] = []
        self._taken_over = ""
        self._damps = False
        self._ending: str | None = None
        self._heard = time.monotonic()
        try:
            self._ask()
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
        return list(self._ask("check", options))

    def start(self, *, suspended: bool = False) -> None:
        """Switch the motors on without gains."""
        self._started = True
        self._reports.clear()
        self._ask("start", suspended)

    def _ask(self, kind: str = "", content: Any = None) -> Any:
        """Send a request, if any, and return its answer."""
        self._answers.clear()
        if kind:
            self._send(kind, content)
        end = time.monotonic() + ANSWER_WITHIN
        while not self._answers and not self._lost and time.monotonic() < end:
            self._read(0.1)
        if not self._answers:
            raise PlantError(f"the process that sends to the robot {'has ended' if self._lost else 'does not answer'}")
        if isinstance(self._answers[0], Exception):
            raise self._answers[0]
        return self._answers[0]

    def _send(self, kind: str, content: Any = None) -> None:
        try:
            self._ours.send(packed(kind, content))
        except BlockingIOError:
            return  # it does not read: it sees no sign of life, and damps
        except OSError:
            self._lost = True

    def order(self, order: Order) -> None:
        """Give an order."""
        self._send("order", order)

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
            match pickle.loads(data):
                case "report", content:
                    report = np.frombuffer(content, REPORT)[0]
                    self._state = State(int(report["state"]))
                    self._reports.append(report)
                case "answer", content:
                    self._answers.append(content)
                case "taken over", content:
                    self._taken_over = content
                case "ending", content:
                    self._ending = content

    def damp(self) -> None:
        """Have the robot damped, by one message."""
        self._damps = True
        self._send("damp")

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
            self._say("ending", sender.ending)

    def _turn(self) -> None:
        sender = self._sender
        wake = None if self._orders is None else self._orders.fileno()
        report = sender.cycle(sender.driver.now() + 1.0, wake)
        slept = _clocks_apart() - self._apart
        if slept > BEHIND and sender.state == State.DRIVE:
            sender.damp(f"this computer slept for {slept:.1f} s")
        if report is not None:
            self._say("report", report.tobytes())
        self._take()
        if sender.reason and not self._told:
            self._told = True
            self._say("taken over", sender.reason)

    def _say(self, kind: str, content: Any) -> None:
        if self._orders is None:
            return
        with suppress(BlockingIOError, OSError):  # who does not read is busy, stopped or gone; reading finds that
            self._orders.send(packed(kind, content))

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
            (kind, content) = pickle.loads(data)
            if kind == "order":
                self._sender.order(content)
            elif kind == "damp":
                self._sender.finish()
            else:
                self._say("answer", self._answer(kind, content))

    def _answer(self, kind: str, content: Any) -> Any:
        """Return what a request leads to, or what stands against it."""
        try:
            if kind == "check":
                return self._sender.driver.checks(content)
            self._sender.start(suspended=content)
        except Exception as reason:
            return reason if isinstance(reason, MimicError) else PlantError(str(reason))
        return True


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
                orders.send(packed("answer", reason))
            return 2
        orders.send(packed("answer", True))
        _Server(orders, sender).run()
        with suppress(Exception):
            driver.close()
    return 1 if sender.failure else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
