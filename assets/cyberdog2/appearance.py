"""Outer shapes of the robot: what one sees, weightless and without contact.

Own primitives that follow the outline of the real robot: a deep chest and a narrow waist in dark grey, silver flanks,
a rising neck, a narrow head with a dark face and two pointed ears, round black motor housings, slim legs, rubber toes.
"""

from __future__ import annotations

from outline import Shape, both, disc, ellipsoid, rod

MATERIALS: dict[str, dict[str, str]] = {
    "shell": {"rgba": "0.27 0.29 0.33 1", "specular": "0.5", "shininess": "0.6"},
    "silver": {"rgba": "0.66 0.71 0.77 1", "specular": "0.6", "shininess": "0.7"},
    "steel": {"rgba": "0.43 0.47 0.53 1", "specular": "0.6", "shininess": "0.6"},
    "black": {"rgba": "0.09 0.09 0.10 1", "specular": "0.4", "shininess": "0.4"},
    "rubber": {"rgba": "0.06 0.06 0.06 1", "specular": "0.1", "shininess": "0.1"},
    "accent": {"rgba": "0.98 0.50 0.10 1", "specular": "0.3", "shininess": "0.3", "emission": "0.15"},
    "lens": {"rgba": "0.02 0.03 0.05 1", "specular": "1", "shininess": "1"},
    "light": {"rgba": "0.45 0.85 1.0 1", "emission": "0.9"},
}

SHAPES: dict[str, tuple[Shape, ...]] = {
    "body": (
        # trunk: a deep chest, a tucked waist, a round rump, a dark spine, a lighter breast
        ellipsoid(0.105, 0.080, 0.068, (0.095, 0, -0.002)),
        ellipsoid(0.160, 0.072, 0.050, (0.0, 0, 0.012)),
        ellipsoid(0.090, 0.074, 0.055, (-0.110, 0, 0.008)),
        ellipsoid(0.095, 0.046, 0.036, (0.090, 0, -0.038), "steel", euler=(0, 0.06, 0)),
        rod((0.15, 0, 0.050), (-0.16, 0, 0.046), 0.020, "black"),
        rod((0.08, 0, 0.064), (-0.02, 0, 0.062), 0.007, "light"),
        *both(
            ellipsoid(0.092, 0.018, 0.036, (0.040, 0.074, 0.014), "silver", euler=(0.10, 0.10, 0)),
            ellipsoid(0.062, 0.016, 0.028, (-0.078, 0.069, 0.016), "steel", euler=(0.08, -0.08, 0)),
            # abad motors at both ends of the trunk
            rod((0.112, 0.042, 0), (0.197, 0.042, 0), 0.0325, "black", "cylinder"),
            rod((-0.112, 0.042, 0), (-0.197, 0.042, 0), 0.0325, "black", "cylinder"),
            rod((0.196, 0.042, 0), (0.201, 0.042, 0), 0.025, "steel", "cylinder"),
            # ears: a broad shell that narrows to a point, dark inside
            ellipsoid(0.009, 0.0145, 0.030, (0.208, 0.030, 0.176), "shell", euler=(-0.16, -0.22, 0)),
            ellipsoid(0.006, 0.0085, 0.032, (0.203, 0.0345, 0.196), "shell", euler=(-0.16, -0.22, 0)),
            ellipsoid(0.004, 0.0085, 0.026, (0.2135, 0.0325, 0.182), "black", euler=(-0.16, -0.22, 0)),
            # eyes
            Shape(type="sphere", size=(0.0085,), pos=(0.258, 0.0215, 0.1445), material="lens"),
            Shape(type="sphere", size=(0.0042,), pos=(0.2635, 0.0255, 0.147), material="light"),
        ),
        # covers over the motors
        ellipsoid(0.062, 0.070, 0.030, (0.150, 0, 0.022)),
        ellipsoid(0.058, 0.066, 0.026, (-0.155, 0, 0.022)),
        # neck: dark behind, light in front
        rod((0.135, 0, 0.030), (0.212, 0, 0.116), 0.036, "shell"),
        rod((0.170, 0, 0.022), (0.226, 0, 0.104), 0.027, "silver"),
        # head: skull, snout with a dark face, jaw, nose
        ellipsoid(0.044, 0.037, 0.034, (0.226, 0, 0.142), "shell"),
        rod((0.232, 0, 0.132), (0.284, 0, 0.119), 0.0235, "silver"),
        ellipsoid(0.040, 0.0205, 0.013, (0.268, 0, 0.1395), "black", euler=(0, 0.26, 0)),
        ellipsoid(0.012, 0.012, 0.010, (0.303, 0, 0.122), "black"),
        rod((0.236, 0, 0.114), (0.280, 0, 0.105), 0.014, "steel"),
    ),
    "abad": (
        disc(0.036, -0.005, 0.045, "steel"),
        disc(0.039, 0.040, 0.034, "black"),
    ),
    "hip": (
        disc(0.036, -0.020, 0.032, "silver"),
        disc(0.026, 0.012, 0.005, "black"),
        ellipsoid(0.029, 0.0165, 0.070, (0.003, 0, -0.053), "shell"),
        ellipsoid(0.014, 0.006, 0.036, (0.004, 0.0135, -0.060), "silver"),
    ),
    "knee": (
        disc(0.019, -0.0155, 0.031, "black"),
        rod((-0.003, 0, -0.006), (0.002, 0, -0.080), 0.0125, "steel"),
        rod((0.001, 0, -0.06), (0.0055, 0, -0.170), 0.0090, "shell"),
        Shape(type="sphere", size=(0.0192,), pos=(0.0055, 0, -0.17391), material="rubber", front_material="accent"),
    ),
}
