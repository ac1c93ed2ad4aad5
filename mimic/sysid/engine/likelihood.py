"""How likely innovations are: Student's t with a scale of its own in each joint and log, and steady corrections."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from mimic.records import FloatArray
from mimic.sysid.engine.data import Data
from mimic.sysid.engine.predictor import DECAY

FREEDOM = 8.0
"""Degrees of freedom: tails as those of stick and slip, and of single wrong readings. Source: Lange, Little, Taylor
1989, robust statistical modelling using the t distribution."""

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
            for _ in range(50):  # Newton's steps of the logarithm, in which the likelihood is concave
                r = square / v
                pull = (FREEDOM + 1.0) * r / (FREEDOM + r)
                by = np.clip((pull.mean() - 1.0) / (FREEDOM * pull / (FREEDOM + r)).mean(), -2.0, 2.0)
                v *= float(np.exp(by))
                if abs(by) < 1e-6:
                    break
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Gains:
    """Steady Kalman gains of a position, speed and unknown torque in each joint."""

    inertia: FloatArray
    """Usual inertia of each joint (J,) [kg m^2]."""
    damping: FloatArray
    """Viscous damping beside the drive's (J,) [N m s/rad]."""
    torque: FloatArray
    """Usual torque of each joint (J,) [N m]."""

    def of(self, unknown: FloatArray, data: Data) -> FloatArray:
        """Return the gains (L, 2, 2, J, 3) of the first start and of those of blocks, with drives off and on, at these
        sizes of the unknown torque (J,) [N m] before blocks; none where it is 0.
        """
        out = np.zeros((data.logs, 2, 2, data.joints, 3))
        sizes = np.stack([FOLLOWING * self.torque, unknown])
        for log, block, on, j in np.ndindex(out.shape[:-1]):
            if sizes[block, j] > 0.0:
                mass = self.inertia[j]
                stiff = on * data.record.kp[log, j] / mass
                damp = (on * data.record.kd[log, j] + self.damping[j]) / mass
                pushed = sizes[block, j] / mass
                out[log, block, on, j] = _steady(data.periods[log], stiff, damp, pushed, data.noise[j])
                out[log, block, on, j, 2] *= sizes[block, j]
        return out


@lru_cache(maxsize=10000)
def _steady(h: float, stiff: float, damp: float, pushed: float, noise: float) -> FloatArray:
    """Return the gains (3,) of position [1], speed [1/s] and unknown torque, in its size, for each radian.

    Args:
        h: Time between readings [s].
        stiff: Of the drive, over the inertia [1/s^2].
        damp: [1/s]
        pushed: Acceleration by the unknown torque [rad/s^2].
        noise: Of a reading [rad].
    """
    a = expm(np.array([[0.0, 1.0, 0.0], [-stiff, -damp, pushed], [0.0, 0.0, -1.0 / DECAY]]) * h)
    enters = np.array([0.5 * h * h * pushed, h * pushed, 1.0])
    added = (1.0 - np.exp(-2.0 * h / DECAY)) * np.outer(enters, enters)
    quick = (SPEED_NOISE * pushed * h) ** 2
    added += np.diag([(1e-3 * noise) ** 2, quick + (LEAST_NOISE * noise / h) ** 2, 1e-9])
    scale = np.diag([1.0 / noise, h / noise, 1.0])
    back = np.linalg.inv(scale)
    a = scale @ a @ back
    added = scale @ added @ scale
    reading = np.array([[1.0, 0.0, 0.0]])
    spread = solve_discrete_are(a.T, reading.T, added, np.eye(1))
    gain = (spread @ reading.T / (reading @ spread @ reading.T + 1.0))[:, 0]
    return np.array([1.0, 1.0 / h, 1.0 / noise]) * gain
