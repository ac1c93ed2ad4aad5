"""Ground contacts of a simulated run at every physics step: which parts touch, and how fast."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from mimic.records import FloatArray
from mimic.robot.description import RobotDescription

AVERAGING_TIME = 0.02
"""The base's acceleration is averaged over this long [s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Touchdown:
    """Contacts and speeds of a robot that sits down."""

    head_touched: bool
    """Whether the head ever touched the ground."""
    trunk_touched: bool
    """Whether trunk or belly did."""
    impact_speed: float
    """Speed of the base at the first contact of trunk or belly [m/s]; 0 without one."""
    sinking_speed: float
    """Greatest downward speed of the base [m/s]."""
    acceleration: float
    """Greatest acceleration of the base, averaged over 20 ms [m/s^2]."""


class ContactRecorder:
    """Records every physics step of a SimulatedPlant that gets it as ``observer``."""

    def __init__(self, description: RobotDescription) -> None:
        self._shapes = description.names.shapes
        self._parts: tuple[set[int], set[int]] | None = None
        self._rows: list[tuple[float, bool, bool, FloatArray]] = []

    def __call__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Record one physics step."""
        if self._parts is None:
            self._parts = self._ids(model, "trunk", "abad", "shoulder"), self._ids(model, "head")
        trunk, head = self._parts
        touching = set(data.contact.geom.ravel().tolist())
        self._rows.append((data.time, bool(touching & trunk), bool(touching & head), data.qvel[:3].copy()))

    def _ids(self, model: mujoco.MjModel, *roles: str) -> set[int]:
        return {model.geom(name).id for name in self._shapes(*roles)}

    def touchdown(self, begin: float) -> Touchdown:
        """Return contacts and speeds from time ``begin`` [s] on.

        Args:
            begin: When it began to sit down [s].
        """
        rows = (row for row in self._rows if row[0] > begin)
        t, trunk, head, velocity = (np.array(column) for column in zip(*rows, strict=True))
        speed = np.linalg.norm(velocity, axis=1)
        span = max(1, round(AVERAGING_TIME / float(t[1] - t[0])))
        change = np.linalg.norm(velocity[span:] - velocity[:-span], axis=1)
        return Touchdown(
            head_touched=bool(head.any()),
            trunk_touched=bool(trunk.any()),
            impact_speed=float(speed[max(int(np.argmax(trunk)) - 1, 0)]) if trunk.any() else 0.0,
            sinking_speed=float(np.max(-velocity[:, 2], initial=0.0)),
            acceleration=float(change.max() / (span * (t[1] - t[0]))),
        )
