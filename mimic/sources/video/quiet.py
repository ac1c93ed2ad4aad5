"""Hides messages that C++ libraries write to stderr regardless of their log level."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def quiet_stderr() -> Iterator[None]:
    """Redirect file descriptor 2 of the whole process to nowhere; Python exceptions still propagate."""
    try:
        saved = os.dup(2)
    except OSError:  # no stderr to redirect
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
