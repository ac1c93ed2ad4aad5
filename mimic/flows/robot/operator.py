"""The person at a real robot, and a process that keeps out of the control loop's way."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from mimic.frozen import frozen_arrays

if TYPE_CHECKING:
    from mimic.control.safety.supervisor import Event
    from mimic.hardware.robot.checks import Check


@frozen_arrays
class Operator:
    """The person at the robot, who sees what happens and decides when it moves."""

    show_findings: Callable[[list[Check]], None] = lambda findings: None
    """Shows what the pre-flight check found, also where that forbids moving."""
    confirm: Callable[[str], None] = lambda what: None
    """Returns when the person wants the robot to move; may raise to refuse."""
    say: Callable[[str], None] = lambda text: None
    """Tells the person what to do now."""
    show_event: Callable[[Event], None] = lambda event: None
    """Shows what the supervisor found, while the robot runs; called from a thread of its own."""


@contextmanager
def undisturbed() -> Iterator[None]:
    """Keep other work out of the loop: real-time priority where allowed, and no garbage collection."""
    from mimic.control.priority import LOOP, real_time

    gc.collect()
    gc.freeze()
    try:
        with real_time(LOOP):
            yield
    finally:
        gc.unfreeze()
