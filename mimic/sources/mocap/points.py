"""Named points over time, as a file stores them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mimic.config.pose import MocapSettings
from mimic.errors import SourceError
from mimic.records import SIDES, FloatArray

UPS = ("x", "y", "z", "-x", "-y", "-z")
"""Axes that may point up."""
UNITS = {"m": 1.0, "in": 0.0254, "cm": 0.01, "mm": 0.001}
"""Length of each unit that a file may use [m]."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Points:
    """Recorded motion in the axes and the unit of its file."""

    t: FloatArray
    """Time of each row (T,) [s]."""
    xyz: FloatArray
    """Positions (T, N, 3); NaN where nothing was seen."""
    score: FloatArray
    """Visibility (T, N), 0 to 1."""
    names: tuple[str, ...]
    """Name of each point."""
    unit: str | None = None
    """Unit of the positions, None where the file names none."""
    warnings: tuple[str, ...] = ()
    """Warnings for the user."""

    def middle(self, part: str) -> FloatArray | None:
        """Return the middle of both sides of a body part (T, 3), None where there is no such part."""
        sides = [f"{side}_{part}" for side in SIDES]
        return self.of(*sides).mean(axis=1) if set(sides) <= set(self.names) else None

    def of(self, *names: str) -> FloatArray:
        """Return the positions of some points (T, N, 3)."""
        return self.xyz[:, [self.names.index(name) for name in names]]


def clock(rows: int, rate: Any, settings: MocapSettings, path: Path) -> FloatArray:
    """Return the times of rows with the frame rate that was asked for, else with that of the file (T,) [s].

    Raises:
        SourceError: If there is none.
    """
    try:
        hz = settings.fps or float(np.asarray(rate).reshape(-1)[0])
    except (ValueError, TypeError, IndexError):
        hz = 0.0
    if not 0.0 < hz < np.inf:
        given = f"the frame rate {rate!r}" if rate is not None else "no times (t) and no frame rate (fps)"
        raise SourceError(f"{path.name} has {given}; store one, or give the frame rate as [mocap] fps in --config")
    return np.arange(rows) / hz
