"""Hold to run: a key of the terminal, or a button of a gamepad, that somebody must hold as long as the robot runs."""

from __future__ import annotations

import os
import select
import struct
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from mimic.errors import ConfigError

FIRST_REPEAT = 0.8
"""A held key comes again within this the first time [s]; terminals repeat after 0.25 to 0.66 s."""
REPEAT = 0.3
"""… and later within this [s]; terminals repeat 10 to 30 times a second."""

KEY = "key"

_EVENT = struct.Struct("<IhBB")
"""Time [ms], value, type and number. Source: Linux, Documentation/input/joydev/joystick-api.rst."""

_BUTTON = 0x01
_INITIAL = 0x80


class HeldKey:
    """Any key of a terminal, seen by its repetition."""

    def __init__(self, file: int, clock: Callable[[], float] = time.monotonic) -> None:
        """Watch a terminal in a mode without line editing.

        Args:
            file: Descriptor of the terminal.
            clock: Returns the time [s].
        """
        self._file = file
        self._clock = clock
        self._last = -1e9
        self._repeats = False

    def held(self) -> bool:
        """Return whether a key is held now; never waits."""
        came = False
        while select.select([self._file], [], [], 0.0)[0]:
            try:
                data = os.read(self._file, 4096)
            except OSError:
                return False
            if not data:
                return False
            came = True
        now = self._clock()
        if came:
            self._repeats = now - self._last < FIRST_REPEAT
            self._last = now
        return now - self._last < (REPEAT if self._repeats else FIRST_REPEAT)


class HeldButton:
    """Any button of a gamepad."""

    def __init__(self, file: int) -> None:
        """Watch a joystick device that does not block."""
        self._file = file
        self._pressed = set[int]()
        self._gone = False

    def held(self) -> bool:
        """Return whether a button is held now, without waiting; never again once the gamepad is gone."""
        while not self._gone:
            try:
                data = os.read(self._file, _EVENT.size)
            except BlockingIOError:
                break
            except OSError:
                data = b""
            if len(data) < _EVENT.size:
                self._gone = True
                break
            _, value, kind, number = _EVENT.unpack(data)
            if kind & ~_INITIAL == _BUTTON:
                (self._pressed.add if value else self._pressed.discard)(number)
        return bool(self._pressed) and not self._gone


Hold = HeldKey | HeldButton
"""Something to hold."""


@contextmanager
def hold_to_run(what: str) -> Iterator[Hold]:
    """Open what is to be held.

    Args:
        what: ``key``, or the device of a gamepad, such as /dev/input/js0.

    Raises:
        ConfigError: If there is no terminal, or no such gamepad.
    """
    if what != KEY:
        try:
            file = os.open(what, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as reason:
            raise ConfigError(
                f"--hold {what}: {reason.strerror}; expected key, or a gamepad's device such as /dev/input/js0"
            ) from None
        try:
            yield HeldButton(file)
        finally:
            os.close(file)
        return
    if not sys.stdin.isatty():
        raise ConfigError(
            "--hold key needs a terminal; run it in one, or hold a gamepad's button: --hold /dev/input/js0"
        )
    file = sys.stdin.fileno()
    before = termios.tcgetattr(file)
    tty.setcbreak(file)
    try:
        yield HeldKey(file)
    finally:
        termios.tcsetattr(file, termios.TCSADRAIN, before)


def await_hold(hold: Hold, seconds: float, pause: Callable[[float], None] = time.sleep) -> bool:
    """Return whether somebody begins to hold within a time [s]."""
    for _ in range(round(seconds / 0.05)):
        if hold.held():
            return True
        pause(0.05)
    return False
