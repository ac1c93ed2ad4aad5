"""Primitives of a robot's outer shapes, given for the front left leg; appearance.py of each robot puts them together.

x mirrors at hind legs where ``mirror_x`` is set, y always mirrors on the right.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import asin, atan2, cos, dist, sin

Point = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Shape:
    """One primitive of the outline: sizes are MuJoCo's, positions in the link frame [m], angles about x, y, z [rad]."""

    type: str
    size: tuple[float, ...]
    pos: Point = (0.0, 0.0, 0.0)
    euler: Point = (0.0, 0.0, 0.0)
    material: str = "shell"
    front_material: str = ""
    """Material on a front leg; empty takes the same."""
    mirror_x: bool = False

    def attributes(self, f: int, s: int) -> dict[str, str]:
        """Return the MJCF attributes for a leg at the front (f = 1) or rear (-1), left (s = 1) or right (-1)."""
        x, y, z = self.pos
        roll, pitch, yaw = self.euler
        fx = f if self.mirror_x else 1
        quat = _quat(roll * s, pitch * fx, yaw * s * fx)
        return {
            "type": self.type,
            "size": " ".join(f"{v:.6g}" for v in self.size),
            "pos": " ".join(f"{v + 0.0:.6g}" for v in (x * fx, y * s, z)),
            "quat": " ".join(f"{v + 0.0:.8g}" for v in quat),
            "material": self.front_material if self.front_material and f > 0 else self.material,
        }


def _quat(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    cr, sr, cp, sp = cos(roll / 2), sin(roll / 2), cos(pitch / 2), sin(pitch / 2)
    cy, sy = cos(yaw / 2), sin(yaw / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


QUARTER = 1.5707963267948966


def ellipsoid(x: float, y: float, z: float, at: Point, material: str = "shell", **more: object) -> Shape:
    """Return an ellipsoid of half axes x, y, z [m]."""
    return Shape(type="ellipsoid", size=(x, y, z), pos=at, material=material, **more)  # type: ignore[arg-type]


def rod(one: Point, other: Point, radius: float, material: str = "shell", type: str = "capsule") -> Shape:
    """Return a capsule or cylinder between two points [m]."""
    length = dist(one, other)
    x, y, z = ((b - a) / length for a, b in zip(one, other, strict=True))
    middle = tuple((a + b) / 2 for a, b in zip(one, other, strict=True))
    turn = (-asin(y), atan2(x, z), 0.0)
    return Shape(type=type, size=(radius, length / 2), pos=middle, euler=turn, material=material)  # type: ignore[arg-type]


def disc(radius: float, y: float, thickness: float, material: str, x: float = 0.0, z: float = 0.0) -> Shape:
    """Return a disc that faces y, from y outwards [m]."""
    return Shape(
        type="cylinder",
        size=(radius, thickness / 2),
        pos=(x, y + thickness / 2, z),
        euler=(QUARTER, 0, 0),
        material=material,
    )


def both(*shapes: Shape) -> tuple[Shape, ...]:
    """Return the shapes of the left and their mirror images on the right."""
    right = []
    for shape in shapes:
        (x, y, z), (roll, pitch, yaw) = shape.pos, shape.euler
        right.append(replace(shape, pos=(x, -y, z), euler=(-roll, pitch, -yaw)))
    return (*shapes, *right)
