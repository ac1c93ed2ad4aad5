"""The zeros of a robot on CAN: kept on this computer, and whether its motors still have them."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mimic.errors import AssetError
from mimic.frozen import frozen_arrays
from mimic.hardware.can.wiring import Wiring
from mimic.hardware.motors import registers
from mimic.hardware.motors.bus import MotorBus
from mimic.hardware.motors.interface import Register
from mimic.io.store import load_json, save_json
from mimic.records import JOINTS, FloatArray

LYING_TOLERANCE = 0.35
"""How far a joint may be from a lying pose so that its rotor turn is certain [rad]; half a turn is 0.405."""

UNEVEN = 0.25
"""Difference between a joint and the same joint on the other side that is reported [rad]."""


@frozen_arrays
class Homing:
    """The zeros of one robot. Joint arrays are (12,)."""

    uid: tuple[int, ...]
    """Unique number of the motor of each joint."""
    mark: float
    """Number that the motors keep in POWER_UP_MARK as long as they have power."""
    offset: FloatArray
    """Joint angle where each motor reads zero now [rad]."""
    phase: FloatArray
    """Joint angle less signed motor angle at power-up, within a rotor turn [rad]; NaN where not known yet."""

    def save(self, path: Path) -> None:
        """Write the zeros to a JSON file.

        Raises:
            AssetError: If the file cannot be written.
        """
        offset = self.offset.tolist()
        phase = self.phase.tolist()
        try:
            save_json({"uid": list(self.uid), "mark": self.mark, "offset": offset, "phase": phase}, path)
        except OSError as reason:
            raise AssetError(
                f"the zeros cannot be kept in {path}: {reason.strerror}; set XDG_STATE_HOME to a writable folder and "
                "run it again"
            ) from None


def homing_file(wiring: Wiring) -> Path:
    """Return the file with the zeros of a robot: one for each wiring file."""
    base = os.environ.get("XDG_STATE_HOME")
    folder = (Path(base) if base else Path.home() / ".local" / "state") / "mimic"
    return folder / f"zeros-{wiring.path.parent.name}-{wiring.path.stem}.json"


def read_homing(path: Path) -> Homing | None:
    """Return the zeros in a file, or None if there is no such file.

    Raises:
        AssetError: If the file holds something else.
    """
    if not path.is_file():
        return None
    raw: Any = load_json(path)
    try:
        offset = np.array(raw["offset"], dtype=np.float64)  # null becomes NaN
        phase = np.array(raw["phase"], dtype=np.float64)
        found = Homing(uid=tuple(map(int, raw["uid"])), mark=float(raw["mark"]), offset=offset, phase=phase)
        if not len(found.uid) == len(offset) == len(phase) == len(JOINTS):
            raise ValueError
    except (KeyError, TypeError, ValueError):
        raise AssetError(f"{path} does not hold the zeros of a robot; remove it and run: mimic robot zero") from None
    return found


def zero_problems(motor_bus: MotorBus, homing: Homing | None) -> list[str]:
    """Return why the zeros cannot be trusted, joint by joint; empty if they can."""
    if homing is None:
        return ["no zeros were set on this computer"]
    mark = registers.read(motor_bus, Register.POWER_UP_MARK)
    uid = registers.read_uids(motor_bus)
    problems = []
    for joint, name in enumerate(JOINTS):
        if uid.get(joint) != homing.uid[joint]:
            problems.append(f"{name} has another motor than when its zero was set")
        elif not abs(mark[joint] - homing.mark) < 1e-3:
            problems.append(f"{name} has lost its zero (was the power off?)")
    return problems


def with_homing(wiring: Wiring, homing: Homing) -> Wiring:
    """Return the wiring with the zeros of this power-up."""
    return replace(wiring, offset=homing.offset)


def uneven(q: FloatArray) -> list[str]:
    """Return the joints that differ much from the same joint on the other side, as sentences."""
    differences = []
    for left, right in ((0, 3), (6, 9)):
        for part in range(3):
            one = q[left + part]
            other = q[right + part]
            apart = abs(one + other) if part == 0 else abs(one - other)
            if apart > UNEVEN:
                differences.append(
                    f"{JOINTS[left + part]} and {JOINTS[right + part]} differ by {np.rad2deg(apart):.0f} deg"
                )
    return differences
