"""Outer shapes of the Go2: what one sees, weightless and without contact.

Own primitives: a flat grey trunk with light flanks, a dark round face, round motor housings, slim bowed shanks.
"""

from __future__ import annotations

from outline import Shape, both, disc, ellipsoid, rod

MATERIALS: dict[str, dict[str, str]] = {
    "shell": {"rgba": "0.72 0.74 0.77 1", "specular": "0.5", "shininess": "0.6"},
    "silver": {"rgba": "0.55 0.58 0.62 1", "specular": "0.6", "shininess": "0.7"},
    "black": {"rgba": "0.09 0.09 0.10 1", "specular": "0.4", "shininess": "0.4"},
    "rubber": {"rgba": "0.06 0.06 0.06 1", "specular": "0.1", "shininess": "0.1"},
    "accent": {"rgba": "0.98 0.50 0.10 1", "specular": "0.3", "shininess": "0.3", "emission": "0.15"},
    "light": {"rgba": "0.85 0.95 1.0 1", "emission": "0.9"},
}

SHAPES: dict[str, tuple[Shape, ...]] = {
    "body": (
        ellipsoid(0.235, 0.085, 0.058, (0.0, 0, 0.005)),
        Shape(type="box", size=(0.150, 0.046, 0.050), pos=(0, 0, 0.002), material="black"),
        *both(
            ellipsoid(0.150, 0.020, 0.040, (0.0, 0.070, 0.008), "silver"),
            rod((0.140, 0.0465, 0), (0.240, 0.0465, 0), 0.042, "black", "cylinder"),
            rod((-0.140, 0.0465, 0), (-0.240, 0.0465, 0), 0.042, "black", "cylinder"),
        ),
        ellipsoid(0.060, 0.060, 0.052, (0.270, 0, 0.012), "silver"),
        ellipsoid(0.046, 0.048, 0.044, (0.293, 0, 0.000), "black"),
        rod((0.325, -0.020, 0.024), (0.325, 0.020, 0.024), 0.006, "light"),
        Shape(type="sphere", size=(0.044,), pos=(0.293, 0, -0.060), material="black"),
    ),
    "abad": (
        disc(0.044, 0.010, 0.050, "silver"),
        disc(0.046, 0.060, 0.040, "black"),
    ),
    "hip": (
        disc(0.045, -0.022, 0.036, "shell"),
        disc(0.030, 0.014, 0.006, "black"),
        ellipsoid(0.032, 0.019, 0.115, (0.0, 0, -0.100), "shell"),
    ),
    "knee": (
        disc(0.022, -0.017, 0.034, "black"),
        rod((0, 0, 0), (0.016, 0, -0.100), 0.012, "silver"),
        rod((0.016, 0, -0.100), (-0.002, 0, -0.205), 0.010, "black"),
        Shape(type="sphere", size=(0.0222,), pos=(-0.002, 0, -0.213), material="rubber", front_material="accent"),
    ),
}
