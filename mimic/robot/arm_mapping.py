"""Where a person's arms ask the front toes to be: the one place for scale and origin."""

from __future__ import annotations

import numpy as np

from mimic.geometry import R_BT
from mimic.records import FloatArray
from mimic.robot.reach import Reach


def toes_of_arms(p_SH: FloatArray, reach: Reach, scale: float = 1.0) -> FloatArray:
    """Return where arms ask the front toes to be, reachable or not; works row by row.

    Each toe is at its hip axis, plus the arm's vector stretched by ``[reach] scale`` of robot.toml along forward, left
    and up and by ``scale``, plus ``[reach] forward``.

    Args:
        p_SH: Shoulder -> wrist, left and right (..., 2, 3), torso axes [arm lengths].
        reach: The robot.
        scale: Factor on the arms.

    Returns:
        Base -> toe (..., 2, 3), base axes [m].
    """
    workspace = reach.description.workspace
    forward = np.array([workspace.forward, 0.0, 0.0])
    hips = np.array([leg.origin + (0.0, leg.offset, 0.0) for leg in reach.legs])
    return hips + (scale * workspace.scale * np.asarray(p_SH, dtype=np.float64) + forward) @ R_BT.T


POSTURES = {
    "down": (0.25, 0.1, -0.75),
    "forward": (0.95, 0.0, 0.0),
    "guard": (0.35, 0.1, 0.05),
    "up": (0.25, 0.1, 0.85),
    "open": (0.25, 0.7, 0.0),
    "high and open": (0.2, 0.6, 0.6),
    "wave high": (0.45, 0.25, 0.75),
    "wave low": (0.55, 0.25, 0.05),
    "hook out": (0.3, 0.65, 0.05),
    "hook in": (0.75, -0.1, 0.05),
    "uppercut low": (0.3, 0.1, -0.5),
    "uppercut high": (0.6, 0.0, 0.45),
}
"""Where a left hand is from its shoulder, forward, left and up [arm lengths]; the right one mirrors left."""


def posture(name: str, reach: Reach) -> FloatArray:
    """Return the front joints (6,) [rad] that bring both hands into a posture, as near as the robot can."""
    left = np.array(POSTURES[name])
    return reach.closest(toes_of_arms(np.stack([left, left * (1.0, -1.0, 1.0)]), reach)).q
