"""MuJoCo's internal timers, which take a quarter of the time of a small model's step."""

from __future__ import annotations

import ctypes
import logging
from functools import cache
from pathlib import Path

import mujoco

log = logging.getLogger(__name__)


@cache
def disable_timers() -> bool:
    """Turn MuJoCo's internal timers off in this process; ``MjData.timer`` then stays as it is.

    Nothing that is simulated changes. Python's bindings have no such switch; the C library has, the pointer
    ``mjcb_time``. Source: MuJoCo's documentation, physics callbacks.

    Returns:
        Whether they are off; where the library's file is not found they stay on, and steps take longer.
    """
    folder = Path(mujoco.__file__).parent
    for path in sorted(p for kind in ("*mujoco.so*", "*mujoco*.dylib", "mujoco.dll") for p in folder.glob(kind)):
        try:
            ctypes.c_void_p.in_dll(ctypes.CDLL(str(path)), "mjcb_time").value = None
        except (OSError, ValueError) as reason:
            log.debug("MuJoCo's timers stay on: %s", reason)
        else:
            return True
    return False
