"""What the scenes of the fault campaign have in common: the trouble that was drawn, and what is asked of a scene.

Used by lab/faults/faults_outside.py, with lab/faults/faults_can.py and lab/faults/faults_stock.py; its list of failures
also by lab/faults/faults_in_processes.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from mimic.emulator.faults import EmulatedFault


@dataclass(kw_only=True)
class Trouble:
    """What goes wrong in a run, and when."""

    seed: int
    rng: np.random.Generator
    fault: EmulatedFault | None = None
    """Of the emulator's own list."""
    kind: str | None = None
    """What somebody between driver and robot does, or beside them."""
    begin: float = np.inf
    end: float = np.inf
    """When it is there, in the robot's time [s]."""
    share: float = field(init=False)
    """Of the frames or messages that are hit."""
    lag: float = field(init=False)
    """Longest delay of one [s]."""

    def __post_init__(self) -> None:
        self.share, self.lag = float(self.rng.uniform(0.05, 0.6)), float(self.rng.uniform(0.002, 0.08))

    def active(self, t: float) -> bool:
        """Return whether it is there at a time [s]."""
        return self.begin <= t < self.end

    def hit(self) -> bool:
        """Return whether the next frame or message is hit."""
        return bool(self.rng.random() < self.share)


class Scene(Protocol):
    """An emulated robot in its own time, its driver, and what is between them."""

    trouble: Trouble
    plant: Any

    def now(self) -> float:
        """Return the robot's time [s]."""
        ...

    def stands_still(self, seconds: float) -> None:
        """Let the driving program stand still for a time [s]."""
        ...

    def is_alone(self) -> None:
        """Let happen what happens once the driving program is gone."""
        ...

    def lets_go(self, seconds: float) -> None:
        """Let a time pass [s]."""
        ...

    def on(self) -> list[str]:
        """Return the motors that are on."""
        ...

    def driven(self) -> list[str]:
        """Return the motors that are driven, rather than damped."""
        ...

    def reachable(self) -> bool:
        """Return whether the motors could be told at the end, or stop by themselves."""
        ...

    def told(self) -> bool:
        """Return whether the last line says that motors were left on."""
        ...


def print_failures(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print how many runs failed in each way, and the first of them."""
    for name in ("undamped", "hung", "traceback", "lost", "silent"):
        bad = [(row["seed"], row["fault"], row[name]) for row in rows if row[name]]
        print(f"  {name:10s} {len(bad)}", bad[:10])
