"""One leg in closed form: three joints (abad about x, hip and knee about y) between the trunk and a toe."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mimic.types import FloatArray

ROUNDING = 1e-10
"""A squared depth of less than this is none at all [m^2]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Leg:
    """The lengths of a leg."""

    origin: FloatArray
    """Base -> abad axis, base axes (3,) [m]."""
    offset: float
    """Abad axis -> plane of hip and knee, along y; positive on the left [m]."""
    thigh: float
    """Hip axis -> knee axis, along -z [m]."""
    toe: FloatArray
    """Knee axis -> toe, knee axes (3,), y is zero [m]."""

    def forward(self, q: FloatArray) -> FloatArray:
        """Return base -> toe (..., 3) [m] for abad, hip and knee (..., 3) [rad]."""
        abad, hip, knee = np.moveaxis(np.asarray(q, dtype=np.float64), -1, 0)
        bend = hip + knee
        x = -self.thigh * np.sin(hip) + self.toe[0] * np.cos(bend) + self.toe[2] * np.sin(bend)
        z = -self.thigh * np.cos(hip) - self.toe[0] * np.sin(bend) + self.toe[2] * np.cos(bend)
        y = self.offset * np.cos(abad) - z * np.sin(abad)
        return self.origin + np.stack([x, y, self.offset * np.sin(abad) + z * np.cos(abad)], axis=-1)

    def inverse(self, p_BE: FloatArray) -> FloatArray:
        """Return both postures with a backward knee that put the toe at p_BE.

        The first has the toe in front of the hip axis (-z of the abad link), the second behind it.

        Args:
            p_BE: Base -> toe (..., 3), base axes [m].

        Returns:
            Joints (..., 2, 3) [rad]; abad and hip in [-pi, pi), knee in [-pi, 0] about the straight leg; NaN where the
            leg is too short or too long. Limits are not looked at.
        """
        x, y, z = np.moveaxis(np.asarray(p_BE, dtype=np.float64) - self.origin, -1, 0)
        shank, lean = np.hypot(self.toe[0], self.toe[2]), np.arctan2(-self.toe[0], -self.toe[2])
        with np.errstate(invalid="ignore"):
            square = y * y + z * z - self.offset**2
            depth = np.sqrt(np.where(np.abs(square) < ROUNDING, 0.0, square))
            cosine = (x * x + depth * depth - self.thigh**2 - shank**2) / (2 * self.thigh * shank)
            bend = -np.arccos(cosine)
        tilt = np.arctan2(shank * np.sin(bend), self.thigh + shank * np.cos(bend))
        postures = []
        for toe_z in (-depth, depth):
            abad = np.arctan2(z, y) - np.arctan2(toe_z, self.offset)
            hip = np.arctan2(-x, -toe_z) - tilt
            postures.append(np.stack([_wrapped(abad), _wrapped(hip), bend - lean], axis=-1))
        return np.stack(postures, axis=-2)


def _wrapped(angle: FloatArray) -> FloatArray:
    return (angle + np.pi) % (2 * np.pi) - np.pi
