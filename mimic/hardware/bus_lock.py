"""One program at a time on a bus: a lock for each bus, held by the system until the program ends."""

from __future__ import annotations

import fcntl
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mimic.errors import BusError


def _path(bus: str) -> Path:
    scheme, _, device = bus.partition(":")
    name = f"{scheme}:{os.path.realpath(device)}" if device.startswith("/dev/") else bus
    return Path(os.environ.get("TMPDIR") or "/tmp") / f"mimic-{re.sub(r'[^A-Za-z0-9.]+', '-', name)}.lock"


def _take(bus: str) -> int | None:
    """Return the file that holds the lock of a bus, or None where no such file can be made.

    Raises:
        BusError: If another program holds it.
    """
    path = _path(bus)
    file = -1
    for mode in (os.O_RDWR | os.O_CREAT, os.O_RDONLY):
        with suppress(OSError):
            file = os.open(path, mode | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
            break
    if file < 0:
        return None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        by = os.pread(file, 200, 0).decode(errors="replace").strip()
        os.close(file)
        text = f"{bus} is in use by {by or 'another program'}; end that first, or watch it with: mimic robot watch"
        raise BusError(text) from None
    with suppress(OSError):
        os.ftruncate(file, 0)
        os.pwrite(file, f"mimic {' '.join(sys.argv[1:3])} (process {os.getpid()})".encode(), 0)
    return file


@contextmanager
def bus_lock(bus_url: str) -> Iterator[tuple[int, ...]]:
    """Hold the locks of buses, several separated by commas.

    Where no lock file can be made, there is no lock: pre-flight also listens for other programs.

    Yields:
        Files that hold the locks; a process that inherits them goes on holding them when this one is gone.

    Raises:
        BusError: If another program holds one of them.
    """
    files: list[int] = []
    try:
        for bus in sorted({word.strip() for word in bus_url.split(",")}):
            file = _take(bus)
            if file is not None:
                files.append(file)
        yield tuple(files)
    finally:
        for file in files:
            os.close(file)
