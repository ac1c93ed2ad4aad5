"""Real-time priority for a thread with deadlines, where the system allows it."""

from __future__ import annotations

import os
from collections.abc import Generator
from contextlib import contextmanager

LOOP, WATCHDOG = 10, 20
"""Priorities of the control loop, and of its watchdog, which is idle until the loop fails."""


@contextmanager
def real_time(priority: int) -> Generator[bool]:
    """Run this thread before all threads without real-time priority; yield whether the system allowed it.

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
