"""Faults of the emulated robot that are drawn by a seed."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mimic.emulator.faults import CAN_KINDS, KINDS, MISWIRED, EmulatedFault
from mimic.records import JOINTS

DRAWN = {
    "motor_hot": (80.0, 120.0),
    "motor_weak": (0.0, 0.6),
    "motor_runaway": (-12.0, 12.0),
    "joint_jammed": (10.0, 30.0),
    "frames_lost": (0.05, 1.0),
    "frames_late": (0.002, 0.1),
    "frames_doubled": (0.05, 1.0),
    "frames_corrupted": (0.01, 0.5),
    "frames_reordered": (0.05, 0.5),
    "imu_tilted": (0.3, 1.5),
    "imu_forged": (0.02, 0.5),
}
"""Ranges from which values are drawn; other kinds have their default."""


def random_fault(
    seed: int, *, start: tuple[float, float], after_release: bool = False, kinds: Sequence[str] = CAN_KINDS
) -> EmulatedFault:
    """Return a fault drawn by a seed: kind, place, value, begin, and whether and when it passes.

    Args:
        seed: The same seed and ranges give the same fault.
        start: Range of its begin [s].
        after_release: Count from when the first motor is switched on.
        kinds: To draw from; miswired joints are not drawn.
    """
    rng = np.random.default_rng([seed, 23])
    name = str(rng.choice([kind for kind in kinds if kind not in MISWIRED]))
    kind = KINDS[name]
    begin = float(rng.uniform(*start))
    lasts = math.inf if rng.random() < 0.5 else float(rng.choice([0.05, 0.2, 1.0]))
    value = float(rng.uniform(*DRAWN[name])) if name in DRAWN else kind.default
    if name == "motor_fault":
        value = float(1 << int(rng.integers(6)))
    joint = int(rng.integers(len(JOINTS))) if kind.scope == "joint" else None
    return EmulatedFault(
        kind=name, value=value, start=begin, until=begin + lasts, joint=joint, after_release=after_release
    )
