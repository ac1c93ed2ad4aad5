"""Frames of the buses of python-can, whichever of them comes first; `mimic.hardware.can.opening` opens them.

Works around two limits of python-can 4.6.1: a socketcand server that died is an error; slcan reads byte by byte, and
waits until each frame has left.
"""

from __future__ import annotations

import errno
import logging
import math
import re
import select
import socket
import threading
import time
from collections.abc import Callable

import can
import serial
from can.exceptions import error_check
from can.interfaces.slcan import slcanBus

from mimic.errors import BusError, FrameError, MimicError
from mimic.hardware.can.frame import CanFrame, Received

SEND_WITHIN = 0.01
"""An adapter that does not take a frame within this has failed [s]."""

_FULL = 60
"""Times that a full queue is tried. SocketCAN queues ten frames unless told otherwise, and twelve commands come at
once."""
_FRAME = 0.00015
"""Wait between two tries [s]: about a frame at 1 Mbit/s."""

_SLICE = 0.0005
"""How long to wait at a time on a bus that cannot be waited for [s]."""

_LINE = re.compile(rb"[^\r\a]*[\r\a]")
"""A line of slcan with its end, which says whether it is an error."""

_CAN_ERR_BUSOFF = 0x40
"""Class of an error frame. Source: Linux include/uapi/linux/can/error.h."""


_OPENING = {
    errno.EACCES: "no permission; add your user to the group that owns it (often dialout) and log in again",
    errno.EPERM: "no permission; add your user to the group that owns it (often dialout) and log in again",
    errno.EBUSY: "another program uses it; close that program",
    errno.ENOENT: "there is no such device; plug the adapter in and check its name",
    errno.ENETDOWN: "the interface is down; bring it up, such as with: ip link set can0 up type can bitrate 1000000",
}


def first_line(reason: BaseException) -> str:
    """Return the first line of an exception's text, or its class name if it has no text."""
    text = str(reason).strip()
    return text.splitlines()[0] if text else type(reason).__name__


def error_number(reason: BaseException | None) -> int | None:
    """Return the operating system's error number behind an exception, or None; drivers wrap it in their own classes."""
    for _ in range(5):
        if reason is None:
            return None
        for name in ("errno", "error_code"):
            number = getattr(reason, name, None)
            if isinstance(number, int):
                return number
        reason = reason.__cause__ or reason.__context__
    return None


def explain(reason: BaseException) -> str:
    """Return what is wrong and what to do, in one line."""
    return _OPENING.get(error_number(reason) or 0, first_line(reason))


class Slcan(slcanBus):
    """Reads all that is there at once: python-can takes 1 ms for a dozen frames of a motor, byte by byte."""

    def _read(self, timeout: float | None) -> str | None:
        until = math.inf if timeout is None else time.monotonic() + timeout
        with error_check("Could not read from serial device"):
            while (line := _LINE.match(self._buffer)) is None:
                data = self.serialPortOrig.read(max(1, self.serialPortOrig.in_waiting))
                self._buffer += data
                left = until - time.monotonic()
                if not data and left <= 0:
                    return None
                if not data:
                    select.select([self.serialPortOrig.fileno()], [], [], None if left == math.inf else left)
        text = line[0].decode()
        del self._buffer[: len(text)]
        return text

    def _write(self, string: str) -> None:
        with error_check("Could not write to serial device"):
            self.serialPortOrig.write(string.encode() + self.LINE_TERMINATOR)


class Port:
    """One bus of python-can."""

    def __init__(self, name: str, bus: can.BusABC, sock: socket.socket | None, *, ready: bool) -> None:
        """Take an open bus.

        Args:
            name: As the user gave it.
            bus: Of python-can.
            sock: Its socket, where it has one.
            ready: Whether nothing is to be read unless its file says so.
        """
        self.name = name
        self._bus = bus
        self._sock = sock
        self._ready = ready
        self.garbled = 0
        self.file: int | None = sock.fileno() if sock is not None else _fileno(bus)

    def send(self, frame: CanFrame) -> None:
        """Hand a frame to the bus."""
        message = can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=frame.extended, check=False)
        for left in reversed(range(_FULL)):
            try:
                self._bus.send(message, timeout=SEND_WITHIN)
                return
            except Exception as reason:  # drivers raise classes of their own
                if getattr(reason, "error_code", None) == errno.ENOBUFS and left:
                    time.sleep(_FRAME)
                    continue
                # pyserial calls it a timeout also when all bytes went out and this process was put aside just then
                late = isinstance(reason.__cause__, serial.SerialTimeoutException)
                if late and self.file is not None and select.select([], [self.file], [], 0)[1]:
                    return
                raise BusError(f"{self.name} no longer takes frames: {explain(reason)}") from None

    def take(self) -> CanFrame | None:
        """Return a frame that is there already, or None."""
        while True:
            try:
                if self._ready and self.file is not None and not _readable(self.file):
                    return None
                message = self._bus.recv(0.0)
                if message is None:
                    self._check()
                    return None
                if message.is_error_frame and message.arbitration_id & _CAN_ERR_BUSOFF:
                    raise BusError(
                        f"{self.name} is off: the adapter saw too many errors (cable, bit rate, termination?)"
                    )
                if not (message.is_error_frame or message.is_remote_frame or message.is_fd):
                    return CanFrame(message.arbitration_id, bytes(message.data), message.is_extended_id)
            except (ValueError, FrameError):  # a garbled line of slcan; the next one is there already, or nothing
                self.garbled += 1
            except BusError:
                raise
            except Exception as reason:  # drivers raise classes of their own
                raise BusError(f"{self.name} has failed: {explain(reason)}") from None

    def _check(self) -> None:
        """Raise if the server is gone: python-can's socketcand client would be silent for ever."""
        if self._sock is not None and _readable(self._sock.fileno()) and not self._sock.recv(1, socket.MSG_PEEK):
            raise BusError(f"{self.name} has closed the connection")

    def close(self) -> None:
        """Let go of the bus."""
        try:
            self._bus.shutdown()
        except Exception:  # drivers raise classes of their own
            logging.getLogger(__name__).debug("%s did not close well", self.name, exc_info=True)
        if self._sock is not None:
            self._sock.close()  # python-can leaves it open when the other side is gone


class _Closed:
    """A bus that is being opened again."""

    file: None = None
    garbled = 0

    def __init__(self, name: str, problem: str = "") -> None:
        self.name = name
        self.opening = not problem
        self._problem = problem or f"{name} is being opened again"

    def send(self, frame: CanFrame) -> None:
        raise BusError(self._problem)

    def take(self) -> None: ...

    def close(self) -> None: ...


class CanLink:
    """Buses of python-can and the computer's monotonic clock. See `mimic.hardware.can.frame.Link`."""

    def __init__(self, ports: list[Port], open_again: Callable[[str], Port]) -> None:
        """Take open buses, and what opens one of them again by its name."""
        self._ports: list[Port | _Closed] = [*ports]
        self._opened = open_again
        self._next = 0
        self._closed = False
        self.wake: int | None = None
        """Descriptor that also ends a wait, when something is to be read from it."""
        self.woken = False
        """Whether that ended the last wait."""

    @property
    def names(self) -> tuple[str, ...]:
        """The buses, as the user named them."""
        return tuple(port.name for port in self._ports)

    @property
    def garbled(self) -> int:
        """How many lines of an adapter were no frame."""
        return sum(port.garbled for port in self._ports)

    def now(self) -> float:
        """Return the monotonic clock [s]."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        time.sleep(max(seconds, 0.0))

    def send(self, bus: int, frame: CanFrame) -> None:
        """Hand a frame to a bus.

        Raises:
            BusError: If the bus does not take it.
        """
        self._ports[bus].send(frame)

    def receive(self, timeout: float) -> Received | None:
        """Return the next frame of any bus, or None when there is none for ``timeout`` seconds; 0 only looks.

        Raises:
            BusError: If a bus has failed.
        """
        until = time.monotonic() + timeout
        wake = [] if self.wake is None else [self.wake]
        while True:
            for _ in self._ports:
                bus = self._next
                self._next = (self._next + 1) % len(self._ports)
                frame = self._ports[bus].take()
                if frame is not None:
                    return Received(bus, frame, time.monotonic())
            left = until - time.monotonic()
            if left <= 0:
                return None
            files = [port.file for port in self._ports if port.file is not None]
            if len(files) == len(self._ports):
                ready, _, _ = select.select([*files, *wake], [], [], left)
            else:
                ready, _, _ = select.select([*files, *wake], [], [], min(left, _SLICE))
            if any(file in ready for file in wake):
                self.woken = True
                return None

    def reopen(self, bus: int) -> None:
        """Begin to open a bus again, in a thread of its own."""
        old = self._ports[bus]
        if not (isinstance(old, _Closed) and old.opening):
            self._ports[bus] = _Closed(old.name)
            threading.Thread(target=self._open_again, args=(bus, old), daemon=True).start()

    def _open_again(self, bus: int, old: Port | _Closed) -> None:
        old.close()
        made: Port | _Closed
        try:
            made = self._opened(old.name)
        except MimicError as reason:
            made = _Closed(old.name, str(reason))
        self._ports[bus] = made
        if self._closed:
            made.close()

    def close(self) -> None:
        """Let go of the buses."""
        if not self._closed:
            self._closed = True
            for port in self._ports:
                port.close()


def _readable(file: int) -> bool:
    return bool(select.select([file], [], [], 0)[0])


def _fileno(bus: can.BusABC) -> int | None:
    try:
        return bus.fileno()
    except (NotImplementedError, can.CanError):
        return None
