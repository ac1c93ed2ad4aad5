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
from mimic.hardware.motors import registers
from mimic.hardware.motors.bus import ALL, MotorBus
from mimic.hardware.motors.interface import Register
from mimic.hardware.robot.checks import beyond_limits
from mimic.records import JOINTS, BoolArray, FloatArray, joint_names
from mimic.robot.description import RobotDescription

ZERO_TOLERANCE = 0.01
"""A motor whose zero was just set must read less than this [rad]."""

SINKS_WITHIN = 0.2
"""A robot that sank has each joint within this of where its model does [rad]: with half and twice the dry friction, and
on grounds from .2 to .8, within 0.11."""

FIRST_MARK = 1.0
"""Mark of the first homing. No mark is 0 or 2, which a motor may have at power-up."""
MARK_STEP = 0.37
"""Increase at each later homing."""
LAST_MARK = 20.0
"""A larger mark starts again at the first."""


def home(motor_bus: MotorBus, description: RobotDescription, before: Homing | None) -> tuple[Homing, FloatArray]:
    """Set the zero of every motor of a robot that lies, and return the zeros and the joint angles (12,) [rad].

    Args:
        motor_bus: The motors, which are off.
        description: The robot.
        before: Zeros of an earlier homing.

    Raises:
        PlantError: If a motor does not answer or does not accept its zero, or a joint is not near the lying pose.
    """
    uid = _answering(motor_bus)
    turned = motor_bus.wiring.sign * np.array([f.q for f in motor_bus.feedback if f is not None])
    mark = registers.read(motor_bus, Register.POWER_UP_MARK)
    marked_here = np.zeros(len(JOINTS), dtype=bool)
    phase = np.full(len(JOINTS), np.nan)
    kept = np.full(len(JOINTS), np.nan)
    if before is not None:
        marked_here = np.abs(mark - before.mark) < 1e-3
        _refuse_others(_is_mark(mark) & ~marked_here)
        same = np.array([before.uid[j] == uid[j] for j in range(len(JOINTS))])
        phase = np.where(same, before.phase, np.nan)
        kept = np.where(same & marked_here, turned + before.offset, np.nan)
    fresh = np.isfinite(mark) & ~(marked_here | _is_mark(mark))  # no zero was set since power-up
    q = joint_angles(kept, np.where(fresh, turned + phase, np.nan), description)
    check_lying(q, description)
    phase = np.where(fresh & np.isnan(phase), q - turned, phase)
    new_mark = _next_mark(before)
    _set_zeros(motor_bus)
    registers.set_register(motor_bus, Register.POWER_UP_MARK, new_mark)
    return Homing(uid=tuple(uid[j] for j in range(len(JOINTS))), mark=new_mark, offset=q, phase=phase), q


def _answering(motor_bus: MotorBus) -> dict[int, int]:
    """Stop every motor and return its unique number, by joint.

    Raises:
        PlantError: If one does not answer.
    """
    uid = registers.read_uids(motor_bus)
    registers.need(sorted({*registers.stop(motor_bus), *(j for j in ALL if j not in uid)}))
    return uid


def _refuse_others(other: BoolArray) -> None:
    """Refuse motors (12,) whose zero another computer has set.

    Raises:
        PlantError: With their joints.
    """
    if other.any():
        raise PlantError(
            f"the zero of {joint_names(np.flatnonzero(other))} was set by another computer since power-up; switch the "
            "motor power off and on, then run it again"
        )


def _next_mark(before: Homing | None) -> float:
    """Return the mark of a homing after another one."""
    if before is None or before.mark + MARK_STEP > LAST_MARK:
        return FIRST_MARK
    return before.mark + MARK_STEP


def _set_zeros(motor_bus: MotorBus) -> None:
    """Let every motor read zero where it is.

    Raises:
        PlantError: If one reads something else then.
    """
    registers.set_zero(motor_bus)
    left = np.array([np.nan if f is None else f.q for f in motor_bus.feedback])
    wrong = np.flatnonzero(~(np.abs(left) < ZERO_TOLERANCE))
    if len(wrong):
        readings = ", ".join(f"{JOINTS[j]} reads {left[j]:.3f} rad" for j in wrong)
        raise PlantError(f"zeros were set, but {readings}; was the robot moved? Run it again")


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
    lie = description.poses["lie"]
    turn = 2 * np.pi / description.gear_ratio

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
