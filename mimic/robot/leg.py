"""One leg in closed form: three joints (abad about x, hip and knee about y) between the trunk and a toe."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from mimic.robot.description import RobotDescription
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

    def forward(self, q: Any, xp: Any = np) -> Any:
        """Return base -> toe (..., 3) [m] for abad, hip and knee (..., 3) [rad].

        ``xp`` is ``numpy`` or ``torch``, whichever ``q`` is from; training and running share this formula.
        """
        hip, bend = q[..., 1], q[..., 1] + q[..., 2]
        toe_x, toe_z = float(self.toe[0]), float(self.toe[2])
        x = -self.thigh * xp.sin(hip) + toe_x * xp.cos(bend) + toe_z * xp.sin(bend)
        z = -self.thigh * xp.cos(hip) - toe_x * xp.sin(bend) + toe_z * xp.cos(bend)
        return self._out_of_plane(q[..., 0], x, z, xp)

    def knee(self, q: Any, xp: Any = np) -> Any:
        """Return base -> knee axis (..., 3) [m] for abad, hip and knee (..., 3) [rad]."""
        return self._out_of_plane(q[..., 0], -self.thigh * xp.sin(q[..., 1]), -self.thigh * xp.cos(q[..., 1]), xp)

    def _out_of_plane(self, abad: Any, x: Any, z: Any, xp: Any) -> Any:
        """Return base -> point (..., 3) of a point at x, z in the plane of hip and knee, turned by abad."""
        ox, oy, oz = (float(v) for v in self.origin)
        y = self.offset * xp.cos(abad) - z * xp.sin(abad)
        return xp.stack([ox + x, oy + y, oz + self.offset * xp.sin(abad) + z * xp.cos(abad)], -1)

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


@cache
def all_legs(description: RobotDescription) -> tuple[Leg, ...]:
    """Return the four legs, in the order of LEGS."""
    raw = description.raw
    x, y, z = raw["abad"]["origin"]
    return tuple(
        Leg(
            origin=np.array([end * x, side * y, z]),
            offset=side * raw["hip"]["origin"][1],
            thigh=raw["hip"]["length"],
            toe=np.array(raw["toe"]["position"]),
        )
        for end in (1.0, -1.0)
        for side in (1.0, -1.0)
    )


def front_legs(description: RobotDescription) -> tuple[Leg, Leg]:
    """Return the left and the right front leg."""
    left, right, *_ = all_legs(description)
    return left, right


def front_toes(q: Any, description: RobotDescription, xp: Any = np) -> Any:
    """Return base -> front toe (..., 2, 3) [m], base axes, from joint positions (..., 12) [rad], NumPy or PyTorch."""
    return xp.stack([leg.forward(q[..., 3 * i : 3 * i + 3], xp) for i, leg in enumerate(front_legs(description))], -2)


def all_toes(q: Any, description: RobotDescription, xp: Any = np) -> Any:
    """Return base -> toe of each leg (..., 4, 3) [m], base axes, from joint positions (..., 12) [rad]."""
    return xp.stack([leg.forward(q[..., 3 * i : 3 * i + 3], xp) for i, leg in enumerate(all_legs(description))], -2)
