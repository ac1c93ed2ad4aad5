"""What the pre-flight of any robot finds, and the checks of pose, orientation and legs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mimic.errors import PlantError
from mimic.frozen import frozen
from mimic.geometry import rotation_from_quat
from mimic.records import JOINTS, FloatArray, IntArray
from mimic.robot.description import RobotDescription
from mimic.robot.leg_kinematics import all_toes

LYING_TOLERANCE = 0.6
"""Largest distance of a joint from the lying pose at the start [rad].

A limp robot rests on its trunk, its legs splayed: 0.36 rad from the lying pose, a Go2 0.48, by their models and on the
bench of the maker's firmware. One that stands is 1.1 rad from it.
"""

LIMIT_TOLERANCE = 0.1
"""How far beyond a joint limit a reading may be [rad]: half of what stops a robot that runs."""

MAX_TILT = 0.26
"""Largest tilt of a lying robot [rad]: 15 deg."""

MAX_LEGS_TILT = 0.2
"""Largest angle between up by the IMU and by the four feet [rad]; 0.1 rad in a joint tilts the feet by 0.06."""

MAX_TURN_RATE = 0.1
"""Largest rate of turn of a robot that nobody moves [rad/s]."""

HOT = 60.0
"""A motor this warm is not started [degC]: a run ends at 72."""


Verdict = Literal["ok", "note", "stop"]


@dataclass(frozen=True)
class Check:
    """The result of one check."""

    name: str
    verdict: Verdict
    text: str


@frozen
class CheckOptions:
    """What the pre-flight needs to know of the run."""

    rate_hz: float
    """Commands a second to each motor [Hz]."""
    suspended: bool = False
    """The robot hangs in the air instead of lying on the floor."""
    inference: float | None = None
    """Time that the policy takes on this computer [s]; None where no policy drives the robot."""


@contextmanager
def before_moving() -> Iterator[None]:
    """Let Ctrl-C say that nothing was moved."""
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt("nothing was moved") from None


def refuse(checks: list[Check], outcome: str = "nothing was moved") -> None:
    """Raise if a check forbids going on.

    Args:
        checks: What was found.
        outcome: What did not happen, as a sentence without its full stop.

    Raises:
        PlantError: With all checks that do.
    """
    against = [f"{check.name}: {check.text}" for check in checks if check.verdict == "stop"]
    if against:
        raise PlantError(f"{outcome}. {'; '.join(against)}")


def beyond_limits(q: FloatArray, description: RobotDescription) -> IntArray:
    """Return the joints that read clearly beyond their limits."""
    return np.flatnonzero((q < description.q_min - LIMIT_TOLERANCE) | (q > description.q_max + LIMIT_TOLERANCE))


def pose_check(
    q: FloatArray, description: RobotDescription, tolerance: float, *, suspended: bool, advice: str, note: str = ""
) -> Check:
    """Check that a robot lies, or that the joints of a suspended one are inside their limits.

    Args:
        q: Joint angles (12,) [rad]; all NaN where the zeros are not known.
        description: The robot.
        tolerance: Largest distance of a joint from the lying pose [rad].
        suspended: The robot hangs in the air.
        advice: What to do where it does not lie.
        note: What else is odd about the pose; empty where nothing is.
    """
    if np.isnan(q).all():
        return Check("pose", "note", "unknown without the zeros")
    beyond = beyond_limits(q, description)
    if len(beyond):
        angles = ", ".join(f"{JOINTS[j]} at {q[j]:.2f} rad" for j in beyond)
        return Check("pose", "stop", f"beyond the joint limits: {angles}")
    if suspended:
        return Check("pose", "ok", "all joints inside their limits")
    away = q - description.poses["lie"]
    worst = int(np.argmax(np.abs(away)))
    text = f"{JOINTS[worst]} is {np.rad2deg(away[worst]):+.0f} deg from the lying pose, the others less"
    if abs(away[worst]) > tolerance:
        return Check("pose", "stop", f"{text}; {advice}")
    return Check("pose", "note" if note else "ok", f"{text}; {note}" if note else text)


def imu_checks(
    quat_WB: FloatArray,
    omega_B: FloatArray,
    q: FloatArray,
    description: RobotDescription,
    *,
    suspended: bool,
    text: str,
) -> list[Check]:
    """Check that a robot at rest does not turn, lies level, and that its feet agree with its IMU.

    Args:
        quat_WB: Orientation (4,).
        omega_B: Rate of turn (3,) [rad/s].
        q: Joint angles (12,) [rad]; NaN where not known.
        description: The robot.
        suspended: The robot hangs in the air, and may swing.
        text: What is said of an IMU that is fine.
    """
    turning = float(np.linalg.norm(omega_B))
    if turning > MAX_TURN_RATE and not suspended:
        return [Check("IMU", "stop", f"it turns at {turning:.2f} rad/s; keep the robot still")]
    found = [Check("IMU", "ok", text)]
    if suspended:
        return found
    up = rotation_from_quat(quat_WB)[2]
    tilt = float(np.arccos(np.clip(up[2], -1.0, 1.0)))
    if tilt > MAX_TILT:
        text = f"tilted by {np.rad2deg(tilt):.0f} deg; a lying robot is level within {np.rad2deg(MAX_TILT):.0f} deg"
        return [*found, Check("IMU and legs", "stop", text)]
    if np.isnan(q).any():
        return found
    apart = float(np.arccos(np.clip(up @ feet_normal(q, description), -1.0, 1.0)))
    text = f"up by IMU and by the four feet differ by {np.rad2deg(apart):.0f} deg"
    if apart > MAX_LEGS_TILT:
        text = f"{text}; is the IMU mounted as the wiring says, and does every foot touch the ground?"
        return [*found, Check("IMU and legs", "stop", text)]
    return [*found, Check("IMU and legs", "ok", text)]


def feet_normal(q: FloatArray, description: RobotDescription) -> FloatArray:
    """Return the unit normal of the plane through the four feet, upward, base axes (3,)."""
    toes = all_toes(q, description)
    _, _, axes = np.linalg.svd(toes - toes.mean(axis=0))
    normal = axes[-1]
    return normal if normal[2] > 0 else -normal
