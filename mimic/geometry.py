"""Rotations, quaternion order and the axes that human and robot share.

Quaternions are wxyz everywhere in mimic. ``R_AB`` maps a vector from B axes to A axes.

Camera axes ``C``: x right in the image, y down, z away from the camera (the axes of BlazePose's world landmarks). Torso
axes ``T`` of a person: x forward, y left, z up. Base axes ``B`` of the robot: x forward, y left, z up while on four
legs; standing upright, x points up, y left, -z forward.

Functions whose arrays may be NumPy or PyTorch use operators only, so that training and running share them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

R_CT = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
"""Torso axes of a person who faces the camera, in camera axes: forward is -z, left is +x of the image, up is -y.

The person's left is on the right-hand side of the image; the table of axes gives (forward, left, up) = (-z, x, -y).
"""

R_BT = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Torso axes of a person in base axes of the upright robot: up is base +x, left is base +y, forward is base -z."""


def quat_parts(quat: Any) -> Any:
    """Return w, x, y and z of quaternions (..., 4); Python floats of a single one, with which arithmetic is fastest."""
    values = np.asarray(quat, dtype=np.float64)
    return values.tolist() if values.ndim == 1 else np.moveaxis(values, -1, 0)


def rotation_from_quat(quat_AB: Any) -> NDArray[np.float64]:
    """Return R_AB (..., 3, 3) for unit quaternions wxyz (..., 4)."""
    w, x, y, z = quat_parts(quat_AB)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    if isinstance(w, float):
        return np.array(rows)
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def multiply_quats(quat_AB: Any, quat_BC: Any) -> NDArray[np.float64]:
    """Return quat_AC (..., 4) of two rotations one after the other, wxyz."""
    parts = _product(quat_parts(quat_AB), quat_parts(quat_BC))
    return np.array(parts) if isinstance(parts[0], float) else np.stack(parts, axis=-1)


def _product(first: tuple[Any, ...], second: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the product of two quaternions, each in its four parts, wxyz."""
    a, b, c, d = first
    w, x, y, z = second
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )


def turned_about_up(quat_WB: Any, angle: float) -> NDArray[np.float64]:
    """Return orientations (..., 4), wxyz, turned about the world's z axis by an angle [rad]."""
    return multiply_quats([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)], quat_WB)


def turned_by(quat_WB: Any, rotation: Any, xp: Any) -> Any:
    """Return orientations (..., 4), wxyz, turned by rotation vectors (..., 3) in world axes [rad].

    ``xp`` is ``numpy`` or ``torch``.
    """
    angle = xp.sqrt((rotation * rotation).sum(-1) + 1e-18)
    share = xp.sin(0.5 * angle) / angle
    a = xp.cos(0.5 * angle)
    b, c, d = (rotation[..., i] * share for i in range(3))
    return xp.stack(_product((a, b, c, d), tuple(quat_WB[..., i] for i in range(4))), -1)


def without_pitch(quat_WB: Any, pitch: Any, xp: Any) -> Any:
    """Return orientations (..., 4), wxyz, of a base before it was turned about its own y axis.

    Args:
        quat_WB: Orientations after that.
        pitch: By how much it was turned (...,) [rad].
        xp: ``numpy`` or ``torch``.
    """
    w, x, y, z = (quat_WB[..., i] for i in range(4))
    c = xp.cos(0.5 * pitch)
    s = xp.sin(0.5 * pitch)
    return xp.stack([c * w + s * y, c * x + s * z, c * y - s * w, c * z - s * x], -1)


def without_pitch_rate(omega_B: Any, pitch: Any, rate: Any, xp: Any) -> Any:
    """Return the angular velocity (..., 3) [rad/s] of that base; ``rate`` is that of the pitch [rad/s]."""
    x, y, z = (omega_B[..., i] for i in range(3))
    c = xp.cos(pitch)
    s = xp.sin(pitch)
    return xp.stack([c * x + s * z, y - rate, c * z - s * x], -1)


def world_axes_in_base(w: Any, x: Any, y: Any, z: Any) -> tuple[tuple[Any, Any, Any], tuple[Any, Any, Any]]:
    """Return the world's down (0, 0, -1) and x axis (1, 0, 0), both seen from the base.

    Args:
        w, x, y, z: Parts of quat_WB, arrays of any shape, NumPy or PyTorch.

    Returns:
        down_B and forward_B, each as three arrays of the parts' shape.
    """
    down_B = (-2 * (x * z - w * y), -2 * (y * z + w * x), -(1 - 2 * (x * x + y * y)))
    forward_B = (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y))
    return down_B, forward_B


def heading_sin_cos(w: Any, x: Any, y: Any, z: Any) -> tuple[Any, Any]:
    """Return the unnormalised sine and cosine of the heading: the yaw of the base's left axis, less 90 degrees.

    Unlike the yaw of base x, it stays defined from lying on four feet to standing upright, where it is the direction
    that the belly faces.
    """
    return -2 * (x * y - w * z), 1 - 2 * (x * x + z * z)


def heading_from_quat(quat_WB: Any) -> NDArray[np.float64]:
    """Return the heading [rad] (...,) of quat_WB (..., 4)."""
    sine, cosine = heading_sin_cos(*quat_parts(quat_WB))
    return np.arctan2(sine, cosine)


def rpy_from_quat(quat_WB: Any) -> NDArray[np.float64]:
    """Return roll, pitch and yaw (3,) [rad] of an orientation (4,), wxyz: about x, then y, then z of the world."""
    R = rotation_from_quat(quat_WB)
    pitch = -np.arcsin(np.clip(R[2, 0], -1.0, 1.0))
    return np.array([np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])])


def wrap_angle(angle: Any) -> Any:
    """Return the angle [rad] brought into [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def smoothstep(share: Any) -> Any:
    """Return a share of a motion, 0 to 1, that begins and ends at rest, from the share of its time (any array type)."""
    return share * share * (3 - 2 * share)


def upright_cosine(w: Any, x: Any, y: Any, z: Any, heading: Any, direction: Any, xp: Any) -> Any:
    """Return the cosine between base x and a direction given in the heading frame.

    Args:
        w, x, y, z: Parts of quat_WB.
        heading: Of the base [rad].
        direction: Unit vector (3,) in the plane of forward and up, such as the upright direction of a robot.
        xp: ``numpy`` or ``torch``.
    """
    forward_x = 1 - 2 * (y * y + z * z)
    forward_y = 2 * (x * y + w * z)
    ahead = forward_x * xp.cos(heading) + forward_y * xp.sin(heading)
    return float(direction[0]) * ahead + float(direction[2]) * up_cosine(w, x, y, z)


def up_cosine(w: Any, x: Any, y: Any, z: Any) -> Any:
    """Return the cosine between base x and world up: 0 on four feet, 1 standing upright."""
    return 2 * (x * z - w * y)
