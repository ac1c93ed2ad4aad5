"""Keeps the messages of C++ libraries from the terminal, where no log level of theirs does."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def quiet_stderr() -> Iterator[None]:
    """Silence file descriptor 2 of the whole process for a moment; Python's own errors still rise through it."""
    try:
        saved = os.dup(2)
    except OSError:  # there is no stderr to silence
        yield
        return
    sys.stderr.flush()
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    os.close(null)
    try:
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
