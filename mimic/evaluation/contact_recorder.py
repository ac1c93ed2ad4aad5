"""Ground contacts of a simulated run at every physics step: which parts touch, and how fast."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from mimic.records import LEGS, BoolArray, FloatArray
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
    toe_speed: float
    """Greatest downward speed of a front toe at its contact with the ground [m/s]."""
    knee_speed: float
    """Greatest downward speed of a hind knee at its contact with the ground [m/s]."""
    acceleration: float
    """Greatest acceleration of the base, averaged over 20 ms [m/s^2]."""


class ContactRecorder:
    """Records every physics step of a SimulatedPlant that gets it as ``observer``."""

    def __init__(self, description: RobotDescription) -> None:
        self._shapes = description.names.shapes
        self._parts: tuple[frozenset[int], frozenset[int], list[int]] | None = None
        self._rows: list[tuple[float, bool, bool, FloatArray, FloatArray]] = []

    def __call__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Record one physics step."""
        if self._parts is None:
            trunk, head = (self._ids(model, *roles) for roles in (("trunk", "abad", "shoulder"), ("head",)))
            balls = self._ids(model, "toe", legs=LEGS[:2]) + self._ids(model, "knee", legs=LEGS[2:])
            self._parts = frozenset(trunk), frozenset(head), balls
        trunk, head, limbs = self._parts
        touching = set(data.contact.geom[:, 1].tolist()) | set(data.contact.geom[:, 0].tolist())
        clearance = data.geom_xpos[limbs, 2] - model.geom_size[limbs, 0]
        self._rows.append((data.time, bool(touching & trunk), bool(touching & head), data.qvel[:3].copy(), clearance))

    def _ids(self, model: mujoco.MjModel, *roles: str, legs: Sequence[str] = LEGS) -> list[int]:
        return [model.geom(name).id for name in self._shapes(*roles, legs=legs)]

    def touchdown(self, begin: float) -> Touchdown:
        """Return contacts and speeds from time ``begin`` [s] on.

        Args:
            begin: When it began to sit down [s].
        """
        rows = (row for row in self._rows if row[0] > begin)
        t, trunk, head, velocity, limbs = (np.array(column) for column in zip(*rows, strict=True))
        speed = np.linalg.norm(velocity, axis=1)
        span = max(1, round(AVERAGING_TIME / float(t[1] - t[0])))
        change = np.linalg.norm(velocity[span:] - velocity[:-span], axis=1)
        return Touchdown(
            head_touched=bool(head.any()),
            trunk_touched=bool(trunk.any()),
            impact_speed=float(speed[max(int(np.argmax(trunk)) - 1, 0)]) if trunk.any() else 0.0,
            sinking_speed=float(np.max(-velocity[:, 2], initial=0.0)),
            toe_speed=_contact_speed(limbs[:, :2], t),
            knee_speed=_contact_speed(limbs[:, 2:], t),
            acceleration=float(change.max() / (span * (t[1] - t[0]))),
        )


def _contact_speed(clearance: FloatArray, t: FloatArray) -> float:
    """Return the greatest speed with which a clearance (steps, toes) [m] became zero."""
    met: BoolArray = (clearance[1:] <= 0.0) & (clearance[:-1] > 0.0)
    speed = -np.diff(clearance, axis=0) / np.diff(t)[:, None]
    return float(np.max(speed[met], initial=0.0))
