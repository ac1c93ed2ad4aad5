"""One leg in closed form: three joints (abad about x, hip and knee about y) between the trunk and a toe."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from mimic.records import FloatArray
from mimic.robot.description import RobotDescription

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
    hip_middle: float = 0.0
    """Middle of the hip's range; hip angles are given within half a turn of it [rad]."""

    def forward(self, q: Any, xp: Any = np) -> Any:
        """Return base -> toe (..., 3) [m] for abad, hip and knee (..., 3) [rad].

        ``xp`` is ``numpy`` or ``torch``, whichever ``q`` is from; training and running share this formula.
        """
        hip = q[..., 1]
        bend = q[..., 1] + q[..., 2]
        toe_x = float(self.toe[0])
        toe_z = float(self.toe[2])
        x = -self.thigh * xp.sin(hip) + toe_x * xp.cos(bend) + toe_z * xp.sin(bend)
        z = -self.thigh * xp.cos(hip) - toe_x * xp.sin(bend) + toe_z * xp.cos(bend)
        return self._out_of_plane(q[..., 0], x, z, xp)

    def knee(self, q: FloatArray) -> FloatArray:
        """Return base -> knee axis (..., 3) [m] for abad, hip and knee (..., 3) [rad]."""
        return self._out_of_plane(q[..., 0], -self.thigh * np.sin(q[..., 1]), -self.thigh * np.cos(q[..., 1]), np)

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
            Joints (..., 2, 3) [rad]; abad in [-pi, pi), hip within pi of ``hip_middle``, knee in [-pi, 0] about the
            straight leg; NaN where the leg is too short or too long. Limits are not looked at.
        """
        ox, oy, oz = (float(v) for v in self.origin)
        x = p_BE[..., 0] - ox
        y = p_BE[..., 1] - oy
        z = p_BE[..., 2] - oz
        toe_x = float(self.toe[0])
        toe_z = float(self.toe[2])
        shank = math.hypot(toe_x, toe_z)
        lean = math.atan2(-toe_x, -toe_z)
        with np.errstate(invalid="ignore"):
            square = y * y + z * z - self.offset**2
            depth = np.sqrt(np.where(abs(square) < ROUNDING, 0.0, square))
            cosine = (x * x + depth * depth - self.thigh**2 - shank**2) / (2 * self.thigh * shank)
            bend = -np.arccos(cosine)
        tilt = np.arctan2(shank * np.sin(bend), self.thigh + shank * np.cos(bend))
        depths = np.stack([-depth, depth], -1)
        abad = np.arctan2(z, y)[..., None] - np.arctan2(depths, self.offset)
        hip = np.arctan2(-x[..., None], -depths) - tilt[..., None]
        knee = np.zeros_like(hip) + (bend - lean)[..., None]
        return np.stack([_wrapped(abad), self._within_half_a_turn(_wrapped(hip)), knee], -1)

    def _within_half_a_turn(self, hip: FloatArray) -> FloatArray:
        hip = np.where(hip < self.hip_middle - math.pi, hip + 2 * math.pi, hip)
        return np.where(hip >= self.hip_middle + math.pi, hip - 2 * math.pi, hip)


def _wrapped(angle: FloatArray) -> FloatArray:
    return (angle + math.pi) % (2 * math.pi) - math.pi


@cache
def all_legs(description: RobotDescription) -> tuple[Leg, ...]:
    """Return the four legs, in the order of LEGS."""
    own = description.leg
    middle = (description.q_min + description.q_max) / 2
    x, y, z = own.origin
    return tuple(
        Leg(
            origin=np.array([end * x, side * y, z]),
            offset=side * own.offset,
            thigh=own.thigh,
            toe=own.toe,
            hip_middle=float(middle[3 * index + 1]),
        )
        for index, (end, side) in enumerate(((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)))
    )


def front_legs(description: RobotDescription) -> tuple[Leg, Leg]:
    """Return the left and the right front leg."""
    left, right, *_ = all_legs(description)
    return left, right


def front_toes(q: Any, description: RobotDescription, xp: Any = np) -> Any:
    """Return base -> front toe (..., 2, 3) [m], base axes, from joint positions (..., 12) [rad], NumPy or PyTorch."""
    return xp.stack([leg.forward(q[..., 3 * i : 3 * i + 3], xp) for i, leg in enumerate(front_legs(description))], -2)


def front_postures(p_BE: FloatArray, description: RobotDescription) -> FloatArray:
    """Return both postures of each front leg (..., 2, 2, 3) [rad] that put the toes at p_BE (..., 2, 3); see `Leg`."""
    return np.stack([leg.inverse(p_BE[..., i, :]) for i, leg in enumerate(front_legs(description))], -3)


def all_toes(q: FloatArray, description: RobotDescription) -> FloatArray:
    """Return base -> toe of each leg (..., 4, 3) [m], base axes, from joint positions (..., 12) [rad]."""
    return np.stack([leg.forward(q[..., 3 * i : 3 * i + 3]) for i, leg in enumerate(all_legs(description))], -2)
