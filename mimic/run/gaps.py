"""What a policy is told of readings that did not come."""

from __future__ import annotations

import numpy as np

from mimic.robot.description import RobotDescription
from mimic.types import FloatArray, RobotState

FORWARD = 2
"""Ticks over which a joint is taken to go on at its last speed; after them it is taken to stay."""


class Gaps:
    """Estimates positions that are missing and keeps the last orientation; the log has NaN there."""

    def __init__(self, description: RobotDescription) -> None:
        self._description = description
        self._q = description.poses["lie"].copy()
        self._dq = np.zeros_like(self._q)
        self._missing = np.zeros(len(self._q), dtype=int)
        self._quat = np.array([1.0, 0.0, 0.0, 0.0])

    def filled(self, state: RobotState) -> tuple[FloatArray, FloatArray]:
        """Return joint positions (12,) [rad] and orientation (4,) without NaN: measured where they are."""
        d = self._description
        there = np.isfinite(state.q)
        self._missing = np.where(there, 0, self._missing + 1)
        ahead = np.where(self._missing <= FORWARD, self._q + self._dq * d.dt, self._q)
        self._q = np.where(there, state.q, np.clip(ahead, d.q_min, d.q_max))
        self._dq = np.where(there, np.nan_to_num(state.dq), self._dq)
        if np.isfinite(state.quat_WB).all():
            self._quat = state.quat_WB
        return self._q.copy(), self._quat.copy()
