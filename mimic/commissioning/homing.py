"""Homing: finds the joint angles of a lying robot and sets the zeros of its motors.

A motor forgets its zero when the power goes, and then knows its angle only within one turn of its rotor. A robot that
lies on its folded legs, or as it sinks without power, has each joint within less than half a rotor turn (23 deg) of
that pose, so the turn is known. It sank if that explains all joints. The first homing takes the folded legs for the
true angles. It stores where each rotor stood within its turn, and every later one returns to it.

The motors remember that the zero is set: register POWER_UP_MARK gets a number, and reads another one after a loss of
power. Two things follow from the maker's manual and have not been tried on motors: that a reading at power-up repeats
within a rotor turn, and that the mark is forgotten.
"""

from __future__ import annotations

import numpy as np

from mimic.dynamics.lying import sunk_pose
from mimic.errors import PlantError
from mimic.hardware.can.zeros import LYING_TOLERANCE, Homing
from mimic.hardware.motors.bus import MotorBus
from mimic.hardware.motors.interface import Register
from mimic.hardware.robot.checks import beyond_limits
from mimic.records import JOINTS, FloatArray
from mimic.robot.description import RobotDescription

ZERO_TOLERANCE = 0.01
"""A motor whose zero was just set must read less than this [rad]."""

SINKS_WITHIN = 0.2
"""A robot that sank has each joint within this of where its model does [rad]: with half and twice the dry friction, and
on grounds from .2 to .8, within 0.11."""

FIRST_MARK, MARK_STEP, LAST_MARK = 1.0, 0.37, 20.0
"""Mark of the first homing, increase at each later one, and where it starts again. None is 0 or 2, which a motor may
have at power-up."""


def home(motor_bus: MotorBus, description: RobotDescription, before: Homing | None) -> tuple[Homing, FloatArray]:
    """Set the zero of every motor of a robot that lies, and return the zeros and the joint angles (12,) [rad].

    Args:
        motor_bus: The motors, which are off.
        description: The robot.
        before: Zeros of an earlier homing.

    Raises:
        PlantError: If a motor does not answer or does not accept its zero, or a joint is not near the lying pose.
    """
    wiring = motor_bus.wiring
    uid, silent = motor_bus.uids(), motor_bus.stop()
    if silent or len(uid) < len(JOINTS):
        names = ", ".join(JOINTS[j] for j in range(len(JOINTS)) if j in silent or j not in uid)
        raise PlantError(f"no answer from {names}; is the power on? Run: mimic robot scan")
    turned = wiring.sign * np.array([f.q for f in motor_bus.feedback if f is not None])
    mark = motor_bus.read(Register.POWER_UP_MARK)
    kept_here = np.abs(mark - (np.nan if before is None else before.mark)) < 1e-3
    fresh = np.isfinite(mark) & ~(kept_here | _is_mark(mark))  # no zero was set since power-up
    other = np.flatnonzero(_is_mark(mark) & ~kept_here)
    if before is not None and len(other):
        names = ", ".join(JOINTS[j] for j in other)
        raise PlantError(
            f"the zero of {names} was set by another computer since power-up; switch the motor power off and on, then "
            "run it again"
        )
    phase = np.full(len(JOINTS), np.nan)
    kept = phase.copy()
    if before is not None:
        same = np.array([before.uid[j] == uid[j] for j in range(len(JOINTS))])
        phase = np.where(same, before.phase, np.nan)
        kept = np.where(same & (np.abs(mark - before.mark) < 1e-3), turned + before.offset, np.nan)
    q = joint_angles(kept, np.where(fresh, turned + phase, np.nan), description)
    check_lying(q, description)
    phase = np.where(fresh & np.isnan(phase), q - turned, phase)
    mark = FIRST_MARK if before is None or before.mark + MARK_STEP > LAST_MARK else before.mark + MARK_STEP
    motor_bus.set_zero()
    left = np.array([np.nan if f is None else f.q for f in motor_bus.feedback])
    wrong = np.flatnonzero(~(np.abs(left) < ZERO_TOLERANCE))
    if len(wrong):
        readings = ", ".join(f"{JOINTS[j]} reads {left[j]:.3f} rad" for j in wrong)
        raise PlantError(f"zeros were set, but {readings}; was the robot moved? Run it again")
    motor_bus.set(Register.POWER_UP_MARK, mark)
    return Homing(uid=tuple(uid[j] for j in range(len(JOINTS))), mark=mark, offset=q, phase=phase), q


def _is_mark(value: FloatArray) -> np.ndarray:
    """Return whether numbers in POWER_UP_MARK are marks of a homing, and not what a motor has at power-up."""
    steps = np.round((value - FIRST_MARK) / MARK_STEP)
    return (np.abs(value - FIRST_MARK - steps * MARK_STEP) < 1e-3) & (value > 0.5) & (value < LAST_MARK + 1e-3)


def joint_angles(kept: FloatArray, modulo: FloatArray, description: RobotDescription) -> FloatArray:
    """Return where the joints of a lying robot are (12,) [rad].

    Args:
        kept: Angles of joints whose motor has kept its zero (12,) [rad]; NaN for the others.
        modulo: Angles up to whole rotor turns, of joints whose motor lost its zero (12,) [rad]; NaN where unknown.
        description: The robot. A joint of which nothing is known is assumed to be exactly in the lying pose.
    """
    lie, turn = description.poses["lie"], 2 * np.pi / description.gear_ratio

    def near(pose: FloatArray) -> FloatArray:
        known = np.where(np.isnan(kept), modulo + turn * np.round((pose - modulo) / turn), kept)
        return np.where(np.isnan(known), lie, known)

    as_it_sank = near(sunk_pose(description))
    return as_it_sank if _sank(as_it_sank, description) else near(lie)


def _sank(q: FloatArray, description: RobotDescription) -> bool:
    """Return whether joints (12,) are where a robot without power comes to rest."""
    return bool(np.abs(q - sunk_pose(description)).max() <= SINKS_WITHIN)


def check_lying(q: FloatArray, description: RobotDescription) -> None:
    """Refuse joints that are far from both lying poses or beyond a limit.

    Raises:
        PlantError: With the joints, how far they are off, and what to do.
    """
    lie = description.poses["lie"]
    off = q - lie
    far = np.flatnonzero(np.abs(off) > LYING_TOLERANCE)
    if len(far) and not _sank(q, description):
        angles = ", ".join(f"{JOINTS[j]} by {np.rad2deg(off[j]):+.0f} deg" for j in far)
        folded = ", ".join(f"{JOINTS[j][3:]} {np.rad2deg(lie[j]):.0f}" for j in range(3))
        raise PlantError(
            f"the robot does not lie as it sinks without power, nor on its folded legs: {angles}; lay it on its belly "
            f"and fold each leg to within {np.rad2deg(LYING_TOLERANCE):.0f} deg of {folded} deg"
        )
    beyond = beyond_limits(q, description)
    if len(beyond):
        angles = ", ".join(f"{JOINTS[j]} at {q[j]:.2f} rad" for j in beyond)
        raise PlantError(f"joints would be beyond their limits: {angles}; the sign or the first homing must be wrong")
