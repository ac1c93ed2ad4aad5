"""Real-time priority for a thread that has to keep its time, where the system gives it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

LOOP, GUARDIAN = 10, 20
"""Priorities of the loop and of its guardian, which has next to nothing to do until it must."""


@contextmanager
def real_time(priority: int) -> Iterator[bool]:
    """Run this thread before all that have no such priority; gives whether the system allowed it.

    Linux allows it to root and to users with an ``rtprio`` limit. Processes started meanwhile do not inherit it.
    """
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
        allowed = True
    except OSError:
        allowed = False
    try:
        yield allowed
    finally:
        if allowed:
            os.sched_setscheduler(0, *before)
