"""What emulated adapters say over a connection: the protocols of socketcand and of slcan, pure.

Sources: socketcand's doc/protocol.md and python-can 4.6.1, interfaces/socketcand and interfaces/slcan.py, which are the
clients that these sessions must suit.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from mimic.errors import FrameError
from mimic.hardware.can.frame import CanFrame

LONGEST = 4096
"""Characters without an end of a message, after which they are dropped."""


class SocketcandSession:
    """A client of socketcand in raw mode."""

    _MESSAGE = re.compile(r"<([^<>]*)>")

    def __init__(self, buses: Sequence[str]) -> None:
        """Take the names of the buses that can be opened."""
        self._buses = list(buses)
        self._text = ""
        self.bus: int | None = None
        """Bus that the client has opened; None before."""
        self.open = False
        """Whether it wants frames."""

    def greet(self) -> bytes:
        """Return what is said when the connection is made."""
        return b"< hi >"

    def take(self, data: bytes) -> tuple[list[CanFrame], bytes]:
        """Take what the client sent, and return the frames in it and what to answer."""
        self._text += data.decode("ascii", "replace")
        frames: list[CanFrame] = []
        answer = b""
        end = 0
        for found in self._MESSAGE.finditer(self._text):
            end = found.end()
            answer += self._execute(found[1].split(), frames)
        self._text = self._text[end:][-LONGEST:]
        return frames, answer

    def _execute(self, words: list[str], frames: list[CanFrame]) -> bytes:
        match words:
            case ["open", name] if name in self._buses:
                self.bus = self._buses.index(name)
                return b"< ok >"
            case ["open", *_]:
                return b"< error could not open bus >"
            case ["rawmode"] if self.bus is not None:
                self.open = True
                return b"< ok >"
            case ["echo"]:
                return b"< echo >"
            case ["send", identifier, count, *data] if self.bus is not None:
                try:
                    content = bytes(int(byte, 16) for byte in data)
                    if len(content) != int(count, 16):
                        return b"< error could not send frame >"
                    frames.append(CanFrame(int(identifier, 16), content, len(identifier) > 3))
                except (ValueError, FrameError):
                    return b"< error could not send frame >"
                return b""
            case _:
                return b"< error unknown command >"

    def give(self, frame: CanFrame, t: float) -> bytes:
        """Return a frame that was on the bus at time t [s], as the client reads it."""
        identifier = f"{frame.id:0{8 if frame.extended else 3}X}"
        return f"< frame {identifier} {t:.6f} {frame.data.hex().upper()} >".encode("ascii")


class SlcanSession:
    """A client of a serial adapter, which has one bus."""

    def __init__(self, bus: int) -> None:
        """Take the index of the bus."""
        self._line = b""
        self.bus: int | None = bus
        """That one."""
        self.open = False
        """Whether the client wants frames."""

    def take(self, data: bytes) -> tuple[list[CanFrame], bytes]:
        """Take what the client sent, and return the frames in it and what to answer: a bell where it is none."""
        *lines, rest = (self._line + data).split(b"\r")
        self._line = rest[-LONGEST:]
        frames: list[CanFrame] = []
        answer = b""
        for line in lines:
            answer += self._execute(line.decode("ascii", "replace").strip(), frames)
        return frames, answer

    def _execute(self, line: str, frames: list[CanFrame]) -> bytes:
        match line[:1]:
            case "" | "S" | "s" | "Y":  # bit rates: the emulated bus has its own
                pass
            case "O" | "L":
                self.open = True
            case "C":
                self.open = False
            case "T" | "t" if self.open:
                width = 8 if line[0] == "T" else 3
                try:
                    count = int(line[1 + width])
                    text = line[2 + width :]
                    frame = CanFrame(int(line[1 : 1 + width], 16), bytes.fromhex(text), line[0] == "T")
                except (ValueError, IndexError, FrameError):
                    return b"\a"
                if len(frame.data) != count:
                    return b"\a"
                frames.append(frame)
            case _:
                return b"\a"
        return b""

    def give(self, frame: CanFrame, t: float) -> bytes:
        """Return a frame as the client reads it; the time t [s] when it was on the bus is not in it."""
        head = f"T{frame.id:08X}" if frame.extended else f"t{frame.id:03X}"
        return f"{head}{len(frame.data)}{frame.data.hex().upper()}\r".encode("ascii")


Session = SocketcandSession | SlcanSession
"""One client of an adapter."""
