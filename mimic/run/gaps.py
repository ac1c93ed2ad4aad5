"""What a policy is told of readings that did not come."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from mimic.frames import rotation_from_quat
from mimic.robot.description import RobotDescription
from mimic.robot.leg import all_toes
from mimic.types import FloatArray, RobotState, RunLog

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

    def filled(self, state: RobotState, unbelieved: Collection[int] = ()) -> tuple[FloatArray, FloatArray]:
        """Return joint positions (12,) [rad] and orientation (4,) without NaN: measured where they are and are believed."""
        d = self._description
        there = np.isfinite(state.q)
        there[list(unbelieved)] = False
        self._missing = np.where(there, 0, self._missing + 1)
        ahead = np.where(self._missing <= FORWARD, self._q + self._dq * d.dt, self._q)
        self._q = np.where(there, state.q, np.clip(ahead, d.q_min, d.q_max))
        self._dq = np.where(there, np.nan_to_num(state.dq), self._dq)
        if np.isfinite(state.quat_WB).all():
            self._quat = state.quat_WB
        return self._q.copy(), self._quat.copy()


def without_gaps(log: RunLog, description: RobotDescription) -> RunLog:
    """Return a log to look at and to take figures from: what was not measured is carried over from the tick before.

    The base, whose position no robot on a bus measures, is put where its lowest foot is on the ground.
    """
    names = ("q", "dq", "tau", "quat_WB", "omega_B", "q_sent", "kp", "kd")
    filled = {name: _carried(getattr(log, name)) for name in names}
    toes = all_toes(filled["q"], description)
    heights = np.einsum("tj,tlj->tl", rotation_from_quat(filled["quat_WB"])[:, 2], toes)
    p_WB = np.zeros((len(log.t), 3))
    p_WB[:, 2] = description.toe_radius - heights.min(axis=1)
    v_WB = np.zeros_like(p_WB)
    return replace(log, **filled, p_WB=p_WB, v_WB=v_WB, p_BE=toes[:, :2])


def _carried(values: FloatArray) -> FloatArray:
    """Return columns (rows, n) in which a number that is missing is the last one before; zero, or w of 1, before the first."""
    filled = np.array(values)
    first = np.eye(4)[0] if values.shape[1] == 4 else np.zeros(values.shape[1])
    for row in range(len(filled)):
        before = filled[row - 1] if row else first
        filled[row] = np.where(np.isnan(filled[row]), before, filled[row])
    return filled
