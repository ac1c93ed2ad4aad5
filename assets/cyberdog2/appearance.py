"""Outer shapes of the robot: what one sees, weightless and without contact.

Own primitives that follow the outline of the real robot: a dark grey trunk with silver flanks, round black motor
housings, slim grey legs with rubber toes, a narrow head with two pointed ears. Given for the front left leg; x mirrors
at hind legs where ``mirror_x`` is set, y always mirrors on the right.
"""

from __future__ import annotations

from dataclasses import dataclass

MATERIALS: dict[str, dict[str, str]] = {
    "shell": {"rgba": "0.30 0.32 0.35 1", "specular": "0.5", "shininess": "0.5"},
    "silver": {"rgba": "0.68 0.71 0.74 1", "specular": "0.7", "shininess": "0.7"},
    "black": {"rgba": "0.09 0.09 0.10 1", "specular": "0.4", "shininess": "0.4"},
    "rubber": {"rgba": "0.05 0.05 0.05 1", "specular": "0.1", "shininess": "0.1"},
    "accent": {"rgba": "0.95 0.48 0.12 1", "specular": "0.3", "shininess": "0.3"},
    "lens": {"rgba": "0.02 0.03 0.05 1", "specular": "1", "shininess": "1", "reflectance": "0.2"},
    "light": {"rgba": "0.55 0.85 1.0 1", "emission": "0.8"},
}


@dataclass(frozen=True, kw_only=True)
class Shape:
    """One primitive of the outline: sizes are MuJoCo's, positions in the link frame [m]."""

    type: str
    size: tuple[float, ...]
    pos: tuple[float, float, float] = (0.0, 0.0, 0.0)
    euler: tuple[float, float, float] = (0.0, 0.0, 0.0)
    material: str = "shell"
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
            "pos": f"{x * fx:.6g} {y * s:.6g} {z:.6g}",
            "quat": " ".join(f"{v:.8g}" for v in quat),
            "material": self.material,
        }


def _quat(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    from math import cos, sin

    cr, sr, cp, sp = cos(roll / 2), sin(roll / 2), cos(pitch / 2), sin(pitch / 2)
    cy, sy = cos(yaw / 2), sin(yaw / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


QUARTER = 1.5707963267948966

SHAPES: dict[str, tuple[Shape, ...]] = {
    "body": (
        Shape(type="box", size=(0.118, 0.060, 0.045), pos=(0, 0, 0)),
        Shape(type="box", size=(0.035, 0.03, 0.02), pos=(0.256, 0, 0.12), material="silver"),
    ),
    "abad": (Shape(type="cylinder", size=(0.039, 0.0175), euler=(QUARTER, 0, 0), material="black"),),
    "hip": (Shape(type="box", size=(0.017, 0.0125, 0.06), pos=(0, 0, -0.06), material="silver"),),
    "knee": (
        Shape(type="capsule", size=(0.009, 0.08), pos=(0.0025, 0, -0.09)),
        Shape(type="sphere", size=(0.019,), pos=(0.0055, 0, -0.17391), material="rubber"),
    ),
}
