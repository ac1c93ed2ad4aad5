"""How likely innovations are: Student's t with a scale of its own in each joint and log, and steady corrections."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from mimic.records import FloatArray
from mimic.sysid.engine.data import Data

FREEDOM = 8.0
"""Degrees of freedom: tails as those of stick and slip, and of single wrong readings. Source: Lange, Little, Taylor
1989, robust statistical modelling using the t distribution."""

DECAY = 0.1
"""Time constant of the unknown torque [s]: slower than a reading, faster than a motion."""

FOLLOWING = 0.1
"""Unknown torque while readings are followed, as a share of the torque of the joint."""

SPEED_NOISE = 0.05
LEAST_NOISE = 1e-7
"""Share of the unknown torque that acts on the speed at once, and least noise of a state: keep gains finite."""


def scales(e: FloatArray, data: Data) -> FloatArray:
    """Return the scale of innovations (T, J) in each joint and log (L, J) of maximum likelihood."""
    out = np.ones((data.logs, data.joints))
    for log in range(data.logs):
        rows = data.record.log == log
        for j in range(data.joints):
            x = e[rows & data.counts[:, j], j]
            if len(x) < 2:
                continue
            square = x * x
            v = max(2.0 * float(np.median(square)), 1e-30)
            for _ in range(12):
                v = max(float(np.mean((FREEDOM + 1.0) * square / (FREEDOM + square / v))), 1e-30)
            out[log, j] = np.sqrt(v)
    return np.maximum(out, 0.1 * data.noise)


def misfit(e: FloatArray, scale: FloatArray, data: Data) -> FloatArray:
    """Return minus the log density of innovations (T, J), a constant left out; 0 where they do not count."""
    s = scale[data.record.log]
    return np.where(data.counts, np.log(s) + 0.5 * (FREEDOM + 1.0) * np.log1p((e / s) ** 2 / FREEDOM), 0.0)


def weights(e: FloatArray, scale: FloatArray, data: Data) -> FloatArray:
    """Return the weight of each squared innovation (T, J) in a step of least squares."""
    s = scale[data.record.log]
    return np.where(data.counts, (FREEDOM + 1.0) / (FREEDOM + (e / s) ** 2) / s**2, 0.0)


class Gains:
    """Steady Kalman gains of a position, speed and unknown torque in each joint."""

    def __init__(self, data: Data, inertia: FloatArray, damping: FloatArray, torque: FloatArray) -> None:
        """Take what the gains follow from.

        Args:
            data: Logs.
            inertia: Usual inertia of each joint (J,) [kg m^2].
            damping: Viscous damping beside the drive's (J,) [N m s/rad].
            torque: Usual torque of each joint (J,) [N m].
        """
        self._data = data
        self.inertia = inertia
        self.damping = damping
        self.torque = torque
        self._known: dict[tuple[int, int, int, float], FloatArray] = {}
        record = data.record
        steps = np.diff(record.t)
        self._steps = [float(np.median(steps[(record.log[1:] == k) & ~record.fresh[1:]])) for k in range(data.logs)]

    def over(self, data: Data) -> Gains:
        """Return the gains of the same machine over other logs."""
        return Gains(data, self.inertia, self.damping, self.torque)

    def of(self, unknown: FloatArray) -> FloatArray:
        """Return the gains (L, 2, 2, J, 3) of the first start and of those of blocks, with drives off and on, at these
        sizes of the unknown torque (J,) [N m] before blocks; none where it is 0.
        """
        out = np.zeros((self._data.logs, 2, 2, self._data.joints, 3))
        for log, on, j in np.ndindex(self._data.logs, 2, self._data.joints):
            out[log, 0, on, j] = self._gain(log, j, on, float(FOLLOWING * self.torque[j]))
            if unknown[j] > 0.0:
                out[log, 1, on, j] = self._gain(log, j, on, float(unknown[j]))
        return out

    def _gain(self, log: int, j: int, on: int, size: float) -> FloatArray:
        key = (log, j, on, size)
        if key not in self._known:
            self._known[key] = self._steady(*key)
        return self._known[key]

    def _steady(self, log: int, j: int, on: int, size: float) -> FloatArray:
        record = self._data.record
        mass = float(self.inertia[j])
        h = self._steps[log]
        stiff = on * record.kp[log, j] / mass
        damp = (on * record.kd[log, j] + self.damping[j]) / mass
        noise = float(self._data.noise[j])
        a = expm(np.array([[0.0, 1.0, 0.0], [-stiff, -damp, size / mass], [0.0, 0.0, -1.0 / DECAY]]) * h)
        enters = np.array([0.5 * h * h * size / mass, h * size / mass, 1.0])
        added = (1.0 - np.exp(-2.0 * h / DECAY)) * np.outer(enters, enters)
        quick = (SPEED_NOISE * size * h / mass) ** 2
        added += np.diag([(1e-3 * noise) ** 2, quick + (LEAST_NOISE * noise / h) ** 2, 1e-9])
        scale = np.diag([1.0 / noise, h / noise, 1.0])
        back = np.linalg.inv(scale)
        a = scale @ a @ back
        added = scale @ added @ scale
        reading = np.array([[1.0, 0.0, 0.0]])
        spread = solve_discrete_are(a.T, reading.T, added, np.eye(1))
        gain = (spread @ reading.T / (reading @ spread @ reading.T + 1.0))[:, 0]
        return np.array([1.0, 1.0 / h, size / noise]) * gain
