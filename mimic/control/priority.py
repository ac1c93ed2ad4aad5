"""Real-time priority for a thread with deadlines, where the system allows it."""

from __future__ import annotations

import os
import sys
from collections.abc import Generator
from contextlib import contextmanager

EMULATOR = 5
"""Priority of an emulated robot."""
RECORDER = 9
"""Priority of who writes the log."""
LOOP = 10
"""Priority of the control loop."""
SENDER = 20
"""Priority of the process that sends to the robot."""


@contextmanager
def real_time(priority: int, *, inherited: bool = False) -> Generator[bool]:
    """Run this thread before all threads without real-time priority; yield whether the system allowed it.

    Linux allows it to root and to users with an ``rtprio`` limit.

    Args:
        priority: One of the above.
        inherited: Threads and processes that are started meanwhile have it too.
    """
    if sys.platform != "linux":
        yield False
        return
    policy = os.SCHED_FIFO | (0 if inherited else os.SCHED_RESET_ON_FORK)
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, policy, os.sched_param(priority))
        allowed = True
    except OSError:
        allowed = False
    try:
        yield allowed
    finally:
        if allowed:
            os.sched_setscheduler(0, *before)
