"""What touches the ground during a simulated run, how fast, and how hard the base is moved; at every physics step."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from mimic.types import BoolArray, FloatArray

TRUNK = ("body", "shoulder", "abad")
"""Shapes whose names end so are trunk or belly."""

HEAD = ("head_0", "head_1")
"""Shapes of the head."""

LIMBS = ("FL_toe", "FR_toe", "RL_rubber", "RR_rubber")
"""Balls whose way to the ground is recorded: front toes and hind knees."""

JOLT_SECONDS = 0.02
"""The base's acceleration is averaged over this long [s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Landing:
    """How gently a robot came down."""

    head_touched: bool
    """Whether the head ever touched the ground."""
    trunk_touched: bool
    """Whether trunk or belly did."""
    impact_speed: float
    """Speed of the base when trunk or belly touched first [m/s]; 0 where they never did."""
    sinking_speed: float
    """Greatest downward speed of the base [m/s]."""
    toe_speed: float
    """Greatest downward speed with which a front toe met the ground [m/s]."""
    knee_speed: float
    """Greatest downward speed with which a hind knee met the ground [m/s]."""
    acceleration: float
    """Greatest acceleration of the base, averaged over 20 ms [m/s^2]."""


class TouchRecorder:
    """Give it to a SimulatedPlant as ``watch``; ask it for the landing afterwards."""

    def __init__(self) -> None:
        self._parts: tuple[frozenset[int], frozenset[int], list[int]] | None = None
        self._rows: list[tuple[float, bool, bool, FloatArray, FloatArray]] = []

    def __call__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Record one physics step."""
        if self._parts is None:
            names = {model.geom(i).name: i for i in range(model.ngeom)}
            trunk = frozenset(i for name, i in names.items() if name.endswith(TRUNK))
            head = frozenset(names[name] for name in HEAD)
            self._parts = trunk, head, [names[name] for name in LIMBS]
        trunk, head, limbs = self._parts
        touching = set(data.contact.geom[:, 1].tolist()) | set(data.contact.geom[:, 0].tolist())
        clearance = data.geom_xpos[limbs, 2] - model.geom_size[limbs, 0]
        self._rows.append((data.time, bool(touching & trunk), bool(touching & head), data.qvel[:3].copy(), clearance))

    def landing(self, begin: float) -> Landing:
        """Return how gently the robot came down from time ``begin`` [s] on.

        Args:
            begin: When it began to come down.
        """
        t, trunk, head, velocity, limbs = (np.array(column) for column in zip(*self._rows, strict=True))
        rows = t > begin
        t, trunk, head, velocity, limbs = t[rows], trunk[rows], head[rows], velocity[rows], limbs[rows]
        speed = np.linalg.norm(velocity, axis=1)
        span = max(1, round(JOLT_SECONDS / float(t[1] - t[0])))
        change = np.linalg.norm(velocity[span:] - velocity[:-span], axis=1)
        return Landing(
            head_touched=bool(head.any()),
            trunk_touched=bool(trunk.any()),
            impact_speed=float(speed[max(int(np.argmax(trunk)) - 1, 0)]) if trunk.any() else 0.0,
            sinking_speed=float(np.max(-velocity[:, 2], initial=0.0)),
            toe_speed=_met_at(limbs[:, :2], t),
            knee_speed=_met_at(limbs[:, 2:], t),
            acceleration=float(change.max() / (span * (t[1] - t[0]))),
        )


def _met_at(clearance: FloatArray, t: FloatArray) -> float:
    """Return the greatest speed with which a clearance (steps, toes) [m] became zero."""
    met: BoolArray = (clearance[1:] <= 0.0) & (clearance[:-1] > 0.0)
    speed = -np.diff(clearance, axis=0) / np.diff(t)[:, None]
    return float(np.max(speed[met], initial=0.0))
