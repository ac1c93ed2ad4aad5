"""A small process that damps the robot when the one that drives it cannot any more.

It is started first, has a socket of its own on the buses, and listens to a pipe: a beat every control step while it is
armed. When the pipe closes (the other process is gone, however it went) or no beat comes for BEAT_WITHIN, it brakes all
motors as hard as they can until they rest, and switches them off. A bus that fails is opened again.
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

from mimic.errors import BusError, MimicError, PlantError
from mimic.robot.description import load_description
from mimic.robot.wiring import Wiring, load_wiring
from mimic.run.brake import damp, switch_off, told_off
from mimic.run.buses import open_link
from mimic.run.exchange import ALL, Exchange
from mimic.run.link import Link
from mimic.run.priority import GUARDIAN, real_time

BEAT_WITHIN = 0.1
"""[s] Five control steps; the loop itself damps when one step comes so late."""

LOOK_EVERY = 0.02
"""How often the guardian looks [s]."""

REOPEN_FOR, REOPEN_EVERY = 30.0, 0.2
"""How long and how often a failed bus is opened again [s]."""

OPEN_TRIES = 3
"""How often buses are opened before that counts as impossible."""

READY_WITHIN = 20.0
"""A guardian that is not ready by then will not be [s]; starting takes about one second on a quiet computer."""

_ARM, _BEAT, _DISARM, _TAKE_OVER = b"A", b".", b"D", b"T"
_READY, _TOOK_OVER = b"ready", b"took over"


class Vigil:
    """What a guardian makes of what it hears and of silence; without a clock or a pipe of its own."""

    class State(Enum):
        """What the guardian has to do."""

        WAIT = auto()
        WATCH = auto()
        ACT = auto()
        LEAVE = auto()

    def __init__(self) -> None:
        self.state = Vigil.State.WAIT
        self.reason = ""
        self._last = 0.0

    def hear(self, data: bytes | None, t: float) -> State:
        """Take what came through the pipe at time t [s]: bytes, nothing, or None where it has closed."""
        armed = self.state is Vigil.State.WATCH
        if data is None:
            return self._end("the process that drives the robot is gone") if armed else self._leave()
        for byte in (data[i : i + 1] for i in range(len(data))):
            if byte == _ARM:
                self.state, self._last = Vigil.State.WATCH, t
            elif byte == _BEAT:
                self._last = t
            elif byte == _TAKE_OVER:
                return self._end("it was asked to")
            elif byte == _DISARM:
                return self._leave()
        if self.state is Vigil.State.WATCH and t - self._last > BEAT_WITHIN:
            return self._end(f"no beat for {t - self._last:.2f} s")
        return self.state

    def _end(self, reason: str) -> State:
        self.state, self.reason = Vigil.State.ACT, reason
        return self.state

    def _leave(self) -> State:
        self.state = Vigil.State.LEAVE
        return self.state


def allows_second_socket(words: str) -> bool:
    """Return whether the buses that a person names can be opened twice: serial adapters and vendors' drivers cannot."""
    return all(
        ":" not in word or word.startswith(("socketcand://", "slcan:socket://"))
        for word in (word.strip() for word in words.split(","))
    )


class Guardian:
    """The process that drives the robot holds this end. A :class:`mimic.run.can_robot.Watcher`."""

    def __init__(self, words: str, wiring: Path) -> None:
        """Start the guardian; it is not armed yet.

        Args:
            words: The buses, as a person names them.
            wiring: File of the wiring.

        Raises:
            PlantError: If it cannot watch these buses.
        """
        command = [sys.executable, "-m", "mimic.run.guardian", words, str(wiring)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True, bufsize=0
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._pipe, self._told = self._process.stdin.fileno(), self._process.stdout.fileno()
        os.set_blocking(self._pipe, False)
        self._heard = b""
        self._left = False
        if not select.select([self._told], [], [], READY_WITHIN)[0] or not self._listen().startswith(_READY):
            told = self._heard.decode(errors="replace").strip() or "it said nothing"
            self.close()
            raise PlantError(
                f"the guardian cannot watch {words}: {told}; mend that, or go without it with --no-guardian"
            )

    @property
    def pid(self) -> int:
        """Its process."""
        return self._process.pid

    def _listen(self) -> bytes:
        while select.select([self._told], [], [], 0.0)[0] and (data := os.read(self._told, 4096)):
            self._heard += data
        return self._heard

    def _say(self, word: bytes) -> None:
        try:
            os.write(self._pipe, word)
        except BlockingIOError:
            return  # it does not read; what follows from that it knows itself
        except BrokenPipeError:
            self._left = True

    def arm(self) -> None:
        """From now on the robot is damped when no beat comes."""
        self._say(_ARM)

    def beat(self) -> None:
        """Say that all is well."""
        self._say(_BEAT)

    def alive(self) -> bool:
        """Return whether it still watches."""
        return not self._left and self._process.poll() is None and _TOOK_OVER not in self._listen()

    def disarm(self) -> None:
        """The motors are off; the guardian leaves."""
        self._say(_DISARM)

    def take_over(self) -> None:
        """Let the guardian damp the robot now, and wait until it has."""
        self._say(_TAKE_OVER)
        self.close()

    def close(self) -> str:
        """Let go of the guardian, wait for its end, and return what it said. Safe to call twice."""
        if self._process.stdin is not None and not self._process.stdin.closed:
            self._process.stdin.close()
        try:
            self._process.wait(REOPEN_FOR + READY_WITHIN)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None and not self._process.stdout.closed:
            self._listen()
            self._process.stdout.close()
        return self._heard.decode(errors="replace").strip()


def end_safely(words: str, wiring: Wiring, link: Link | None, opened: Callable[..., Link] = open_link) -> str:
    """Damp the robot and switch it off, over buses that are opened again where they fail, and return how that went."""
    description = load_description()
    told = "nothing was tried"
    end = time.monotonic() + REOPEN_FOR
    while time.monotonic() < end:
        try:
            link = opened(words, bitrate=wiring.bitrate) if link is None else link
            exchange = Exchange(link, wiring)
            damp(exchange, description, lambda: None)
            left = switch_off(exchange, description, lambda: None)
            told = told_off(left)
            if len(left) < len(ALL):
                return told
        except MimicError as reason:
            told = str(reason)
        if link is not None:
            link.close()
            link = None
        time.sleep(REOPEN_EVERY)
    return told


def opened(words: str, wiring: Wiring) -> Link:
    """Open the buses, more than once if need be: a busy server may miss the time for its greeting.

    Raises:
        ConfigError, BusError: If that is not possible.
    """
    for _ in range(OPEN_TRIES - 1):
        try:
            return open_link(words, bitrate=wiring.bitrate)
        except BusError:
            time.sleep(REOPEN_EVERY)
    return open_link(words, bitrate=wiring.bitrate)


def _watch(words: str, wiring: Wiring, link: Link) -> str:
    """Watch until there is nothing to watch any more; return what was done."""
    vigil, pipe, broken = Vigil(), sys.stdin.fileno(), False
    while True:
        data: bytes | None = b""
        if select.select([pipe], [], [], LOOK_EVERY)[0]:
            data = os.read(pipe, 4096) or None
        state = vigil.hear(data, link.now())
        if state is Vigil.State.LEAVE:
            return ""
        if state is Vigil.State.ACT:
            _tell(_TOOK_OVER + b": " + vigil.reason.encode())
            return end_safely(words, wiring, None if broken else link)
        try:
            while not broken and link.receive(0.0) is not None:
                pass  # a bus that nobody listens to fills up
        except BusError:
            broken = True


def _tell(text: bytes) -> None:
    try:
        os.write(sys.stdout.fileno(), text + b"\n")
    except BrokenPipeError:
        return  # nobody is left to be told


def main(arguments: list[str]) -> int:
    """Guard the buses that the arguments name, with the wiring of a file."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    words, path = arguments
    try:
        wiring = load_wiring(Path(path), buses=len(words.split(",")))
        link = opened(words, wiring)
    except MimicError as reason:
        _tell(str(reason).encode())
        return 2
    _tell(_READY)
    with real_time(GUARDIAN):
        ending = _watch(words, wiring, link)
    if ending:
        _tell(ending.encode())
    link.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
