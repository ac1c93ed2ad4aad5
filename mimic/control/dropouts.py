"""Sensor dropouts: readings that are missing are estimated for the policy; the log keeps NaN in their place."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Any

import numpy as np

from mimic.geometry import rotation_from_quat
from mimic.records import FloatArray, RobotState, RunLog
from mimic.robot.description import RobotDescription
from mimic.robot.leg_kinematics import all_toes

RESTS = 0.1
"""A lying robot whose gyro shows less about each axis rests, and the gyro shows its bias [rad/s]."""

EXTRAPOLATED_TICKS = 2
"""Ticks over which a joint is extrapolated with its last velocity; after them its position is held."""


class DropoutFilter:
    """Estimates missing joint positions, and holds the last orientation, angular velocity and joint velocities."""

    def __init__(self, description: RobotDescription) -> None:
        self._description = description
        self._q = description.poses["lie"].copy()
        self._dq = np.zeros_like(self._q)
        self._missing = np.zeros(len(self._q), dtype=int)
        self._quat = np.array([1.0, 0.0, 0.0, 0.0])
        self._omega = np.zeros(3)
        self._blind = 0
        self._bias = np.zeros(3)
        self._rests = 0

    def rest(self, state: RobotState) -> None:
        """Learn the gyro's bias from a state of a robot that lies: the mean while gyro and joints show rest."""
        if np.all(np.abs(state.omega_B) < RESTS) and np.all(np.abs(state.dq) < self._description.safety.rest_speed):
            self._rests += 1
            self._bias = self._bias + (state.omega_B - self._bias) / self._rests

    def fill(self, state: RobotState, distrusted: Collection[int] = (), *, doubted: bool = False) -> RobotState:
        """Return the state without NaN in joint positions and velocities, orientation and angular velocity.

        Velocities are held no longer than a joint is extrapolated; then they are zero.

        Args:
            state: As measured, NaN where nothing was.
            distrusted: Joints whose measured positions are not used.
            doubted: Whether the orientation and the angular velocity are not used.
        """
        d = self._description
        measured = np.isfinite(state.q)
        measured[list(distrusted)] = False
        self._missing = np.where(measured, 0, self._missing + 1)
        ahead = np.where(self._missing <= EXTRAPOLATED_TICKS, self._q + self._dq * d.dt, self._q)
        self._q = np.where(measured, state.q, np.clip(ahead, d.q_min, d.q_max))
        self._dq = np.where(measured, np.nan_to_num(state.dq), self._dq)
        if np.isfinite(state.quat_WB).all() and not doubted:
            self._quat = state.quat_WB
        turns = np.isfinite(state.omega_B).all() and not doubted
        self._blind = 0 if turns else self._blind + 1
        if turns:
            self._omega = state.omega_B - self._bias
        dq = np.where(self._missing <= EXTRAPOLATED_TICKS, self._dq, 0.0)
        omega = self._omega if self._blind <= EXTRAPOLATED_TICKS else np.zeros(3)
        return replace(state, q=self._q, dq=dq, quat_WB=self._quat, omega_B=omega)


def fill_dropouts(log: RunLog, description: RobotDescription) -> RunLog:
    """Return a log for figures and pictures: what was not measured is the last value before it.

    A base position that was not measured, as on every robot on a bus, is put where the lowest foot is on the ground.
    What was measured does not change.
    """
    names = ("q", "dq", "tau", "quat_WB", "omega_B", "q_sent", "kp", "kd")
    filled: dict[str, Any] = {name: _forward_filled(getattr(log, name)) for name in names}
    toes = all_toes(filled["q"], description)
    heights = np.einsum("tj,tlj->tl", rotation_from_quat(filled["quat_WB"])[:, 2], toes)
    p_WB = np.zeros((len(log.t), 3))
    p_WB[:, 2] = description.toe_radius - heights.min(axis=1)
    derived = {"p_WB": p_WB, "v_WB": np.zeros_like(p_WB), "p_BE": toes[:, :2]}
    for name, value in derived.items():
        measured: FloatArray = getattr(log, name)
        filled[name] = np.where(np.isnan(measured), value, measured)
    return replace(log, **filled)


def _forward_filled(values: FloatArray) -> FloatArray:
    """Return columns (rows, n) with each NaN replaced by the last number before it.

    Before the first number it is zero, or the identity for quaternions (n = 4).
    """
    filled = np.array(values)
    first = np.eye(4)[0] if values.shape[1] == 4 else np.zeros(values.shape[1])
    for row in range(len(filled)):
        before = filled[row - 1] if row else first
        filled[row] = np.where(np.isnan(filled[row]), before, filled[row])
    return filled
