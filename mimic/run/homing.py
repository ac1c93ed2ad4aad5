"""Where the joints are after the power came: the motors forget their zero, and know their angle within one rotor turn only.

A robot that lies on its folded legs has each joint within less than half a rotor turn (23 deg) of the lying pose, which
tells the turn. The first homing has to take the lying pose itself for what it sees; it keeps where within its turn each rotor
stood there, so that every later one puts the joints back to the same angles, however the robot was laid down.

That the zero is set is written into the motors: LIMIT_SPD, which the operation mode does not use, gets a number, and is back at
its default when the power was away. That a motor's reading at power-up repeats within a rotor turn, and that LIMIT_SPD is
forgotten, follows from the maker's manual, and has not been tried on motors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mimic.errors import AssetError, PlantError
from mimic.robot.description import RobotDescription
from mimic.robot.wiring import Wiring
from mimic.run.exchange import Exchange
from mimic.run.motor_messages import LIMIT_SPD, GetDeviceId, SetZero, Stop
from mimic.store import load_json, save_json
from mimic.types import JOINTS, FloatArray, IntArray

NEAR = 0.35
"""How far from the lying pose a joint may be so that its rotor's turn is certain [rad]; half a turn is 0.405."""

SLACK = 0.1
"""How far beyond a joint limit a reading may be [rad]: half of what stops a robot that runs."""

ZERO = 0.01
"""A motor whose zero was just set reads less than this [rad]."""

FIRST_MARK, MARK_STEP, LAST_MARK = 1.0, 0.37, 20.0
"""What LIMIT_SPD is set to at the first homing, how much more at each later one, and where it begins anew [rad/s]."""

UNEVEN = 0.25
"""Difference between a joint and its neighbour on the other side that should be looked at [rad]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Homing:
    """What is known of the zeros of one robot. Joint arrays are (12,)."""

    uid: tuple[int, ...]
    """Which motor moved each joint."""
    mark: float
    """Number that the motors keep as long as they have power."""
    offset: FloatArray
    """Joint angle where each motor reads zero now [rad]."""
    phase: FloatArray
    """Joint angle less signed motor angle at power-up, within a rotor turn [rad]; NaN where not known yet."""

    def save(self, path: Path) -> None:
        """Write it to a file."""
        offset, phase = self.offset.tolist(), self.phase.tolist()
        save_json({"uid": list(self.uid), "mark": self.mark, "offset": offset, "phase": phase}, path)


def read_homing(path: Path) -> Homing | None:
    """Return what a file knows, or None where there is none.

    Raises:
        AssetError: If it is something else.
    """
    if not path.is_file():
        return None
    raw: Any = load_json(path)
    try:
        offset, phase = (
            np.array([np.nan if v is None else v for v in raw[name]], dtype=np.float64) for name in ("offset", "phase")
        )
        found = Homing(uid=tuple(map(int, raw["uid"])), mark=float(raw["mark"]), offset=offset, phase=phase)
        if not len(found.uid) == len(offset) == len(phase) == len(JOINTS):
            raise ValueError
    except (KeyError, TypeError, ValueError):
        raise AssetError(f"{path} does not hold the zeros of a robot; remove it and run: mimic robot zero") from None
    return found


def homed(exchange: Exchange, homing: Homing | None) -> list[str]:
    """Return why the zeros cannot be trusted, joint by joint; empty where they can."""
    if homing is None:
        return ["no zeros were set on this computer"]
    mark = exchange.read(LIMIT_SPD)
    uid = device_ids(exchange)
    told = []
    for joint, name in enumerate(JOINTS):
        if uid.get(joint) != homing.uid[joint]:
            told.append(f"{name} has another motor than when its zero was set")
        elif not abs(mark[joint] - homing.mark) < 1e-3:
            told.append(f"{name} has lost its zero (was the power away?)")
    return told


def device_ids(exchange: Exchange) -> dict[int, int]:
    """Return the unique id of the motor of each joint that answers."""
    host = exchange.wiring.host
    return exchange.device_ids(lambda motor: GetDeviceId(motor=motor, host=host))


def with_homing(wiring: Wiring, homing: Homing) -> Wiring:
    """Return the wiring with the zeros of this power-up."""
    return replace(wiring, offset=homing.offset)


def home(exchange: Exchange, description: RobotDescription, before: Homing | None) -> tuple[Homing, FloatArray]:
    """Set the zero of every motor of a robot that lies, and return what is known now and the joint angles (12,) [rad].

    Args:
        exchange: With the motors, which are off.
        description: The robot.
        before: What an earlier homing left.

    Raises:
        PlantError: If a motor does not answer or take its zero, or a joint is not where a lying robot has it.
    """
    host, wiring = exchange.wiring.host, exchange.wiring
    uid = device_ids(exchange)
    silent = exchange.ask_feedback(lambda motor: Stop(motor=motor, host=host))
    if silent or len(uid) < len(JOINTS):
        names = ", ".join(JOINTS[j] for j in range(len(JOINTS)) if j in silent or j not in uid)
        raise PlantError(f"no answer from {names}; is the power on? Look with: mimic robot scan")
    turned = wiring.sign * np.array([f.q for f in exchange.feedback if f is not None])
    mark = exchange.read(LIMIT_SPD)
    fresh = np.abs(mark) < 1e-3  # nobody has set a zero since the power came
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
    exchange.ask_feedback(lambda motor: SetZero(motor=motor, host=host))
    left = np.array([np.nan if f is None else f.q for f in exchange.feedback])
    wrong = np.flatnonzero(~(np.abs(left) < ZERO))
    if len(wrong):
        told = ", ".join(f"{JOINTS[j]} reads {left[j]:.3f} rad" for j in wrong)
        raise PlantError(f"zeros were set, but {told}; was the robot moved? Run it again")
    exchange.set(LIMIT_SPD, mark, "limit_spd (the mark of a zero that was set)")
    return Homing(uid=tuple(uid[j] for j in range(len(JOINTS))), mark=mark, offset=q, phase=phase), q


def joint_angles(kept: FloatArray, modulo: FloatArray, description: RobotDescription) -> FloatArray:
    """Return where the joints of a lying robot are (12,) [rad].

    Args:
        kept: Angles of joints whose motor has kept its zero (12,) [rad]; NaN of the others.
        modulo: Angles up to whole rotor turns, of joints whose motor forgot (12,) [rad]; NaN where not even that is known.
        description: The robot. Joints of which nothing is known are taken to be exactly where a lying robot has them.
    """
    lie, turn = description.poses["lie"], 2 * np.pi / float(description.raw["motor"]["gear_ratio"])
    near = modulo + turn * np.round((lie - modulo) / turn)
    q = np.where(np.isnan(kept), near, kept)
    return np.where(np.isnan(q), lie, q)


def check_lying(q: FloatArray, description: RobotDescription) -> None:
    """Refuse joints that are not near the lying pose, or beyond a limit.

    Raises:
        PlantError: Which joint, how far, and what to do.
    """
    lie = description.poses["lie"]
    off = q - lie
    far = np.flatnonzero(np.abs(off) > NEAR)
    if len(far):
        told = ", ".join(f"{JOINTS[j]} by {np.rad2deg(off[j]):+.0f} deg" for j in far)
        raise PlantError(
            f"the robot does not lie on its folded legs: {told}; lay it down closer than {np.rad2deg(NEAR):.0f} deg to "
            "the pose in docs/robot.md, all joints"
        )
    beyond = beyond_limits(q, description)
    if len(beyond):
        told = ", ".join(f"{JOINTS[j]} at {q[j]:.2f} rad" for j in beyond)
        raise PlantError(f"joints would be beyond their limits: {told}; the sign or the first homing must be wrong")


def beyond_limits(q: FloatArray, description: RobotDescription) -> IntArray:
    """Return the joints that read clearly beyond their limits."""
    return np.flatnonzero((q < description.q_min - SLACK) | (q > description.q_max + SLACK))


def uneven(q: FloatArray) -> list[str]:
    """Return the joints that differ much from their neighbours on the other side, which a rotor's turn would not explain."""
    told = []
    for left, right in ((0, 3), (6, 9)):
        for part in range(3):
            one, other = q[left + part], q[right + part]
            apart = abs(one + other) if part == 0 else abs(one - other)
            if apart > UNEVEN:
                told.append(f"{JOINTS[left + part]} and {JOINTS[right + part]} differ by {np.rad2deg(apart):.0f} deg")
    return told
