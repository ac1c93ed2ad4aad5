"""Numbers of effects: where a model stands, and which of them are fitted."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.machine import MachineModel
from mimic.dynamics.servo import neutral
from mimic.records import FloatArray

Key = tuple[str, str]
"""(effect, parameter)"""


@dataclass(frozen=True, kw_only=True, eq=False)
class FreeParameter:
    """One fitted number."""

    key: Key
    joint: int
    """Index of the joint; -1 for the whole machine."""
    step: float
    """A difference that matters."""
    centre: float
    """Value before anything is known."""
    spread: float
    """Standard deviation of what is plausible before anything is known."""

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and greatest value."""
        p = CATALOGUE[self.key[0]].parameter(self.key[1])
        return p.low, p.high


@dataclass(frozen=True, eq=False)
class Point:
    """Values of all effects that are in the model: (effect, parameter) -> (J,) or (1,)."""

    values: Mapping[Key, FloatArray] = field(default_factory=dict)

    @classmethod
    def of(cls, names: Iterable[str], machine: MachineModel) -> Point:
        """Return the point with these effects, all neutral."""
        point = cls()
        for name in names:
            point = point.with_effect(name, machine)
        return point

    def with_effect(self, name: str, machine: MachineModel, start: Mapping[str, object] | None = None) -> Point:
        """Return the point with an effect added, neutral or at ``start`` (numbers or rows)."""
        values = dict(self.values)
        for p in CATALOGUE[name].parameters:
            row = neutral(name, p.name, machine)
            if p.fixed and p.starts:
                row = np.full_like(row, p.starts[0])
            if start and p.name in start:
                row = np.broadcast_to(np.asarray(start[p.name], dtype=np.float64), row.shape).copy()
            values[name, p.name] = row
        return Point(values)

    def without(self, name: str) -> Point:
        """Return the point without an effect."""
        return Point({k: v for k, v in self.values.items() if k[0] != name})

    def moved(self, free_parameters: Sequence[FreeParameter], by: FloatArray) -> Point:
        """Return the point with each free parameter changed, inside its bounds."""
        values = {k: v.copy() for k, v in self.values.items()}
        for free, delta in zip(free_parameters, by, strict=True):
            at = max(free.joint, 0)
            values[free.key][at] = np.clip(values[free.key][at] + delta, *free.bounds)
        return Point(values)

    def is_at(self, other: Point) -> bool:
        """Return whether another point has the same values."""
        if self.values.keys() != other.values.keys():
            return False
        return all(np.array_equal(row, other.values[key]) for key, row in self.values.items())

    def read(self, free_parameters: Sequence[FreeParameter]) -> FloatArray:
        """Return the values of the free parameters."""
        return np.array([self.values[k.key][max(k.joint, 0)] for k in free_parameters])


def stack(points: Sequence[Point], machine: MachineModel) -> dict[Key, FloatArray]:
    """Return points as the replay takes them; effects that a point lacks are neutral there."""
    keys = {key for point in points for key in point.values}
    return {
        key: np.stack([p.values[key] if key in p.values else neutral(*key, machine) for p in points])
        for key in sorted(keys)
    }
