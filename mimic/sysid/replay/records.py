"""What a replay is asked for and returns, the readings of its segments, and the targets on its grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

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


ON_EDGE = 1e-6
"""Share of a step within which a target begins to act at its edge."""


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


@dataclass(frozen=True, kw_only=True, eq=False)
class Targets:
    """Targets of a replay, or of several (V, ...): one comes in effect during each physics step, or none."""

    held: Any
    """In effect at the end of each step (..., steps, J)."""
    begun: Any
    """Share of each step after which that one came in effect; 0 where it was there from the start (..., steps)."""

    @staticmethod
    def stacked(several: Sequence[Targets]) -> Targets:
        """Return several as one (V, ...)."""
        return Targets(held=np.stack([t.held for t in several]), begun=np.stack([t.begun for t in several]))

    def some(self, rows: slice) -> Targets:
        """Return some of several."""
        return Targets(held=self.held[rows], begun=self.begun[rows])


def on_grid(arrival: FloatArray, values: FloatArray, step: float, steps: int) -> Targets:
    """Return targets as physics steps see them.

    Several that come in effect within one step are taken as one, at their mean time weighted by the size of their
    jumps.

    Args:
        arrival: When each comes in effect, growing, the first at 0 (K,) [s].
        values: Targets (K, J).
        step: Physics step [s].
        steps: How many.
    """
    at = arrival / step
    at = np.where(np.abs(at - np.round(at)) < ON_EDGE, np.round(at), at)
    cell = np.floor(at).astype(int)
    jump = np.sqrt((np.diff(values, axis=0, prepend=values[:1]) ** 2).sum(1)) + 1e-12
    inside = (cell >= 0) & (cell < steps)
    size, moment = np.zeros(steps), np.zeros(steps)
    np.add.at(size, cell[inside], jump[inside])
    np.add.at(moment, cell[inside], (jump * (at - cell))[inside])
    last = np.clip(np.searchsorted(cell, np.arange(steps), side="right") - 1, 0, len(values) - 1)
    return Targets(held=values[last], begun=moment / np.maximum(size, 1e-12))


def acting(
    before: Any, older: Any, newer: Any, begun: tuple[Any, Any], part: Any, xp: Any
) -> tuple[Any, list[tuple[Any, Any]]]:
    """Return the mean target of a step (N, J) that does not begin on the grid, and the targets with their shares of it.

    It takes ``part`` of one step of the grid and the rest of the next one.

    Args:
        before: Target held before the first of the two (N, J).
        older: At its end.
        newer: At the end of the second.
        begun: Shares of the two steps after which theirs came in effect (N, 1).
        part: How much of the first step is taken, from 0 to 1 (N, 1) or (N, J).
        xp: ``numpy`` or ``torch``.
    """
    first = xp.clip(begun[0] - (1.0 - part), 0.0, None)
    last = xp.clip(1.0 - part - begun[1], 0.0, None)
    mean = older + first * (before - older) + last * (newer - older)
    return mean, [(first, before), (1.0 - first - last, older), (last, newer)]
