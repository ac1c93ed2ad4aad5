"""What a replay is asked for, what it returns, and which readings its segments predict."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mimic.dynamics.law import Parameters
from mimic.records import FloatArray, IntArray

if TYPE_CHECKING:
    from mimic.sysid.replay.cpu import Replay

LONGEST_STEP = 0.0025
"""[s]"""

UNSEEN, UNUSUAL = 0.05, 2.5
"""Readings further apart than this [s] and than so many usual distances: targets may have come and gone between them.
"""


def physics_step(rate: float, longest: float = LONGEST_STEP) -> float:
    """Return the longest step up to ``longest`` [s] that divides the time between readings at ``rate`` [Hz]."""
    between = 1.0 / rate
    return between / max(1, int(np.ceil(between / longest - 1e-6)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Readings:
    """Readings that the segments predict, in order of the step of its segment that each falls into; arrays (R,)."""

    row: IntArray
    """Of the log."""
    segment: IntArray
    step: IntArray
    """-1 for a reading at the very start of a segment."""
    part: FloatArray
    """How far into the step, up to 1 for its end."""
    since: IntArray
    """Steps of the segment that were over at the reading before; 0 for its first."""

    def at(self, steps: int) -> IntArray:
        """Return where the readings of each step begin (steps + 1,)."""
        return np.searchsorted(self.step, np.arange(steps + 1))


@dataclass(frozen=True, kw_only=True, eq=False)
class Prediction:
    """What the model did; arrays (N, T, J), NaN where a segment was still settling."""

    residual: FloatArray
    """Measured - predicted position, single precision."""
    torque_residual: FloatArray | None
    """Measured - predicted torque of the motor, its mean since the reading before, where the log has it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Job:
    """What `Replay.run` is asked for."""

    replay: Replay
    parameters: Parameters
    """Values (count, J) or (count, 1)."""
    count: int


def stretch_starts(t: FloatArray) -> FloatArray:
    """Return the start of the gap-free stretch that each reading (T,) is in [s]."""
    between = np.diff(t)
    gap = between > max(UNSEEN, UNUSUAL * float(np.median(between)))
    return np.maximum.accumulate(np.where(np.concatenate([[True], gap]), t, -np.inf))
