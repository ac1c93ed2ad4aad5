"""Checks key frames against the limits of the robot; each error has numbers, so that a person or a model can fix it."""

from __future__ import annotations

import numpy as np

from mimic.io.keyframes import KeyFrame, KeyFrames
from mimic.records import JOINTS, FloatArray
from mimic.robot.reach import FRONT, Reach

MIN_DURATION = 0.1  # least time between two key frames [s]
POINTS_BETWEEN = 5  # points on the way from one key frame to the next that must be clear, too
ROUNDING = 1e-3  # an angle may be beyond its limit by this [rad], as text has few digits


def violations(motion: KeyFrames, reach: Reach, max_seconds: float) -> list[str]:
    """Return what this robot cannot do of a motion, empty where it can do all of it.

    Joint angles, joint speeds and clearance of the front legs, velocity, turning, durations and the time in all.

    Args:
        motion: Key frames.
        reach: The robot.
        max_seconds: Most time in all [s].
    """
    errors = []
    if motion.seconds > max_seconds:
        errors.append(f"the motion takes {motion.seconds:g} s in all; at most {max_seconds:g} s are played")
    q = reach.description.poses["upright"][:FRONT]
    heading = 0.0
    for number, frame in enumerate(motion.frames, 1):
        where = f"frame {number}"
        if not frame.duration >= MIN_DURATION:
            errors.append(f"{where}: duration is {frame.duration:g} s; it must be at least {MIN_DURATION:g} s")
        commands = reach.description.commands
        turn = abs(frame.heading - heading)
        for name, value, most in zip(("forward", "left"), frame.velocity, commands.velocity_max, strict=True):
            if abs(value) > most + 1e-6:
                errors.append(f"{where}: velocity {name} is {value:g} m/s; it must be within ±{most:g}")
        if turn / max(frame.duration, MIN_DURATION) > commands.turn_rate_max + ROUNDING:
            errors.append(
                f"{where}: heading_deg changes by {np.degrees(turn):.0f} in {frame.duration:g} s; the robot turns by "
                f"at most {np.degrees(commands.turn_rate_max):.0f} deg/s, so take at least "
                f"{turn / commands.turn_rate_max:.1f} s"
            )
        errors += [f"{where}: {text}" for text in _trunk(frame, reach)]
        inside = [f"{where}: {text}" for text in _angles(frame.q, reach)]
        errors += inside or [f"{where}: {text}" for text in _path(q, frame.q, frame.duration, reach)]
        q = frame.q
        heading = frame.heading
    return errors


def _trunk(frame: KeyFrame, reach: Reach) -> list[str]:
    """Return violations of the range of the trunk."""
    numbers = reach.description.trunk_numbers
    height, lean = frame.trunk
    if numbers is None:
        return ["this robot neither crouches nor leans; leave height and lean_deg out"] if height or lean else []
    errors = []
    for name, value, (low, high), unit in (
        ("height", height, numbers.height, "m"),
        ("lean_deg", np.degrees(lean), np.degrees(numbers.pitch), "deg"),
    ):
        if not low - ROUNDING <= value <= high + ROUNDING:
            errors.append(f"{name} is {value:g} {unit}; it must be from {low:g} to {high:.3g} {unit}")
    return errors


def _angles(q: FloatArray, reach: Reach) -> list[str]:
    """Return violations about joint limits and gaps at a key frame."""
    errors = []
    for name, value, low, high in zip(JOINTS, q, reach.q_min, reach.q_max, strict=False):
        if not low - ROUNDING <= value <= high + ROUNDING:
            errors.append(
                f"{name} is {np.degrees(value):.0f} deg; "
                f"it must be from {np.degrees(low):.0f} to {np.degrees(high):.0f} deg"
            )
    if errors:
        return errors
    gap = reach.gap(q)
    if gap < reach.clearance - ROUNDING:
        errors.append(
            f"the front legs come within {100 * max(gap, 0.0):.1f} cm of each other or of the body; "
            f"{100 * reach.clearance:.1f} cm must stay free: turn the abad joints outward or lift the toes"
        )
    return errors


def _path(before: FloatArray, after: FloatArray, duration: float, reach: Reach) -> list[str]:
    """Return violations about how fast a key frame is reached, and what is hit on the way."""
    errors = []
    for name, turn, speed in zip(JOINTS, np.abs(after - before), reach.speed_max, strict=False):
        if turn > speed * max(duration, MIN_DURATION) + ROUNDING:
            errors.append(
                f"{name} turns by {np.degrees(turn):.0f} deg in {duration:g} s; "
                f"at most {np.degrees(speed):.0f} deg/s are possible, "
                f"so take at least {turn / speed:.2f} s"
            )
    shares = np.linspace(0.0, 1.0, POINTS_BETWEEN + 2)[1:-1]
    if not errors and min(reach.gap(before + share * (after - before)) for share in shares) < 0.0:
        errors.append(
            "the front legs hit each other or the body on the way from the frame before; add a frame around that"
        )
    return errors
