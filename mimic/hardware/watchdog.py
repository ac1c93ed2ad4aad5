"""The watchdog: a small process that damps the robot when the one that drives it no longer can.

It is started first, has a socket of its own on the buses, and reads heartbeats from a pipe: one every control step
while it is armed. It acts when the pipe closes (the other process has ended, for whatever reason) or when no
heartbeat comes for BEAT_TIMEOUT: it damps all motors as much as they can until they rest, and switches them off. If a
bus fails, it opens it again.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from enum import Enum, auto
from pathlib import Path

from mimic.control.priority import WATCHDOG, real_time
from mimic.errors import BusError, MimicError, PlantError
from mimic.hardware.can.link import Link
from mimic.hardware.can.python_can import open_link
from mimic.hardware.motor_bus import ALL, MotorBus
from mimic.hardware.shutdown import damp, shutdown_report, switch_off
from mimic.hardware.wiring import Wiring, load_wiring
from mimic.robot.description import load_description

BEAT_TIMEOUT = 0.1
"""Five control steps [s]; the loop itself damps when one step is that late."""

POLL_PERIOD = 0.02
"""How often the watchdog polls its pipe and its buses [s]."""

REOPEN_FOR, REOPEN_EVERY = 30.0, 0.2
"""How long, and how often, a failed bus is opened again [s]."""

DEAD = 0.3
"""A bus that has taken nothing for so long is opened again [s]."""

OPEN_TRIES = 3
"""How many attempts to open the buses are made."""

START_TIMEOUT = 20.0
"""A watchdog that is not ready by then counts as failed [s]; starting takes about one second on an idle computer."""

_ARM, _BEAT, _DISARM, _TAKE_OVER = b"A", b".", b"D", b"T"
_READY, _TOOK_OVER = b"ready", b"took over"


class HeartbeatMonitor:
    """Decides from heartbeats and their absence what the watchdog does; without a clock or a pipe of its own."""

    class State(Enum):
        """What the watchdog does."""

        IDLE = auto()
        ARMED = auto()
        DAMP = auto()
        EXIT = auto()

    def __init__(self) -> None:
        self.state = HeartbeatMonitor.State.IDLE
        self.reason = ""
        self._last = 0.0

    def update(self, data: bytes | None, t: float) -> State:
        """Update the state with what came through the pipe at time t [s]: bytes, no bytes, or None if it has closed."""
        armed = self.state is HeartbeatMonitor.State.ARMED
        if data is None:
            return self._end("the process that drives the robot has ended") if armed else self._exit()
        for byte in (data[i : i + 1] for i in range(len(data))):
            if byte == _ARM:
                self.state, self._last = HeartbeatMonitor.State.ARMED, t
            elif byte == _BEAT:
                self._last = t
            elif byte == _TAKE_OVER:
                return self._end("on request")
            elif byte == _DISARM:
                return self._exit()
        if self.state is HeartbeatMonitor.State.ARMED and t - self._last > BEAT_TIMEOUT:
            return self._end(f"no heartbeat for {t - self._last:.2f} s")
        return self.state

    def _end(self, reason: str) -> State:
        self.state, self.reason = HeartbeatMonitor.State.DAMP, reason
        return self.state

    def _exit(self) -> State:
        self.state = HeartbeatMonitor.State.EXIT
        return self.state


def allows_second_socket(bus_url: str) -> bool:
    """Return whether a second process can open these buses: serial adapters and vendors' drivers do not allow it."""
    return all(
        ":" not in word or word.startswith("socketcand://") for word in (word.strip() for word in bus_url.split(","))
    )


class WatchdogProcess:
    """Starts the watchdog process and talks to it. A `mimic.hardware.plant.Watchdog`."""

    def __init__(self, bus_url: str, wiring: Path, *, keep: tuple[int, ...] = ()) -> None:
        """Start the process; it is not armed yet.

        Args:
            bus_url: The buses; see `mimic.hardware.can.python_can`.
            wiring: Wiring file.
            keep: Files that the process inherits and keeps open, such as the locks of the buses.

        Raises:
            PlantError: If it cannot open these buses.
        """
        command = [sys.executable, "-m", "mimic.hardware.watchdog", bus_url, str(wiring)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True, bufsize=0, pass_fds=keep
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._pipe, self._output = self._process.stdin.fileno(), self._process.stdout.fileno()
        os.set_blocking(self._pipe, False)
        self._text = b""
        self._gone = False
        if not select.select([self._output], [], [], START_TIMEOUT)[0] or not self._read().startswith(_READY):
            reason = self._text.decode(errors="replace").strip() or "it printed nothing"
            self.close()
            raise PlantError(
                f"the watchdog cannot watch {bus_url}: {reason}; fix that, or run without a watchdog with --no-watchdog"
            )

    @property
    def pid(self) -> int:
        """Id of the process."""
        return self._process.pid

    def _read(self) -> bytes:
        while select.select([self._output], [], [], 0.0)[0] and (data := os.read(self._output, 4096)):
            self._text += data
        return self._text

    def _send(self, word: bytes) -> None:
        try:
            os.write(self._pipe, word)
        except BlockingIOError:
            return  # it does not read its pipe, and will see no heartbeat
        except BrokenPipeError:
            self._gone = True

    def arm(self) -> None:
        """Start watching: from now on the robot is damped when no heartbeat comes."""
        self._send(_ARM)

    def beat(self) -> None:
        """Send a heartbeat."""
        self._send(_BEAT)

    def alive(self) -> bool:
        """Return whether it is still watching; False also once it has taken over."""
        return not self._gone and self._process.poll() is None and _TOOK_OVER not in self._read()

    def disarm(self) -> None:
        """Stop watching: the motors are off."""
        self._send(_DISARM)

    def take_over(self) -> str:
        """Damp the robot now, wait until that is done, and return how the robot was left; empty if nothing says so."""
        self._send(_TAKE_OVER)
        lines = self.close().splitlines()
        return lines[-1] if any(line.startswith(_TOOK_OVER.decode()) for line in lines[:-1]) else ""

    def close(self) -> str:
        """Wait for the end of the process, and return what it printed. Safe to call twice."""
        if self._process.stdin is not None and not self._process.stdin.closed:
            self._process.stdin.close()
        try:
            self._process.wait(REOPEN_FOR + START_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None and not self._process.stdout.closed:
            self._read()
            self._process.stdout.close()
        return self._text.decode(errors="replace").strip()


def damp_and_stop(bus_url: str, wiring: Wiring, link: Link | None, open_link: Callable[..., Link] = open_link) -> str:
    """Damp the robot and switch it off, over buses that are opened again if they fail, and return how that went."""
    description = load_description()
    report = "nothing was tried"
    end = time.monotonic() + REOPEN_FOR
    while time.monotonic() < end:
        try:
            link = open_link(bus_url, bitrate=wiring.bitrate) if link is None else link
            motor_bus = MotorBus(link, wiring)
            damp(motor_bus, description, lambda: None, patience=DEAD)
            left = switch_off(motor_bus, description, lambda: None)
            report = shutdown_report(left)
            if len(left) < len(ALL):
                return report
        except MimicError as reason:
            report = f"the motors could not be stopped: {reason}; cut the power"
        if link is not None:
            link.close()
            link = None
        time.sleep(REOPEN_EVERY)
    return report


def open_buses(bus_url: str, wiring: Wiring) -> Link:
    """Open the buses, with several attempts: a busy server may miss the time for its greeting.

    Raises:
        ConfigError, BusError: If that is not possible.
    """
    for _ in range(OPEN_TRIES - 1):
        try:
            return open_link(bus_url, bitrate=wiring.bitrate)
        except BusError:
            time.sleep(REOPEN_EVERY)
    return open_link(bus_url, bitrate=wiring.bitrate)


def _watch(bus_url: str, wiring: Wiring, link: Link) -> str:
    """Watch until disarmed or until the robot was damped; return how that went."""
    monitor, pipe, broken = HeartbeatMonitor(), sys.stdin.fileno(), False
    while True:
        data: bytes | None = b""
        if select.select([pipe], [], [], POLL_PERIOD)[0]:
            data = os.read(pipe, 4096) or None
        state = monitor.update(data, link.now())
        if state is HeartbeatMonitor.State.EXIT:
            return ""
        if state is HeartbeatMonitor.State.DAMP:
            _print(_TOOK_OVER + b": " + monitor.reason.encode())
            return damp_and_stop(bus_url, wiring, None if broken else link)
        try:
            while not broken and link.receive(0.0) is not None:
                pass  # the queue of a bus that nobody reads fills up
        except BusError:
            broken = True


def _print(text: bytes) -> None:
    try:
        os.write(sys.stdout.fileno(), text + b"\n")
    except BrokenPipeError:
        return  # no process is left to read it


def main(arguments: list[str]) -> int:
    """Watch the buses in the first argument, with the wiring file in the second."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    bus_url, path = arguments
    try:
        wiring = load_wiring(Path(path), buses=len(bus_url.split(",")))
        link = open_buses(bus_url, wiring)
    except MimicError as reason:
        _print(str(reason).encode())
        return 2
    _print(_READY)
    with real_time(WATCHDOG):
        ending = _watch(bus_url, wiring, link)
    if ending:
        _print(ending.encode())
    link.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
