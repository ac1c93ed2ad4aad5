"""Checks key frames against the limits of the robot; each error has numbers, so that a person or a model can fix it."""

from __future__ import annotations

import numpy as np

from mimic.io.keyframes import KeyFrames
from mimic.records import JOINTS, FloatArray
from mimic.robot.reach import FRONT, Reach

SHORTEST = 0.1
"""Least time between two key frames [s]."""
BETWEEN = 5
"""Points on the way from one key frame to the next that must be clear, too."""
ROUNDING = 1e-3
"""An angle may be beyond its limit by this [rad], as text has few digits."""


def complaints(motion: KeyFrames, reach: Reach, longest: float) -> list[str]:
    """Return what this robot cannot do of a motion, empty where it can do all of it.

    Joint angles, joint speeds and clearance of the front legs, velocity, turning, durations and the time in all.

    Args:
        motion: Key frames.
        reach: The robot.
        longest: Most time in all [s].
    """
    found = []
    if motion.seconds > longest:
        found.append(f"the motion takes {motion.seconds:g} s in all; at most {longest:g} s are played")
    q, heading = reach.description.poses["upright"][:FRONT], 0.0
    for number, frame in enumerate(motion.frames, 1):
        where = f"frame {number}"
        if not frame.duration >= SHORTEST:
            found.append(f"{where}: duration is {frame.duration:g} s; it must be at least {SHORTEST:g} s")
        found += [f"{where}: {text}" for text in _velocity(frame.velocity, reach)]
        rate = abs(frame.heading - heading) / max(frame.duration, SHORTEST)
        most = reach.description.commands.turn_rate
        if rate > most + ROUNDING:
            seconds = abs(frame.heading - heading) / most
            found.append(
                f"{where}: heading_deg changes by {np.degrees(abs(frame.heading - heading)):.0f} "
                f"in {frame.duration:g} s; the robot turns by at most {np.degrees(most):.0f} deg/s, "
                f"so take at least {seconds:.1f} s"
            )
        inside = [f"{where}: {text}" for text in _angles(frame.q, reach)]
        found += inside or [f"{where}: {text}" for text in _way(q, frame.q, frame.duration, reach)]
        q, heading = frame.q, frame.heading
    return found


def _velocity(velocity: tuple[float, float], reach: Reach) -> list[str]:
    found = []
    for name, value, most in zip(("forward", "left"), velocity, reach.description.commands.velocity, strict=True):
        if abs(value) > most + 1e-6:
            found.append(f"velocity {name} is {value:g} m/s; it must be within ±{most:g}")
    return found


def _angles(q: FloatArray, reach: Reach) -> list[str]:
    """Return complaints about joint limits and gaps at a key frame."""
    found = []
    for name, value, low, high in zip(JOINTS, q, reach.q_min, reach.q_max, strict=False):
        if not low - ROUNDING <= value <= high + ROUNDING:
            found.append(
                f"{name} is {np.degrees(value):.0f} deg; "
                f"it must be from {np.degrees(low):.0f} to {np.degrees(high):.0f} deg"
            )
    if not found and (gap := reach.gap(q)) < reach.clearance - ROUNDING:
        found.append(
            f"the front legs come within {100 * max(gap, 0.0):.1f} cm of each other or of the body; "
            f"{100 * reach.clearance:.1f} cm must stay free: turn the abad joints outward or lift the toes"
        )
    return found


def _way(before: FloatArray, after: FloatArray, duration: float, reach: Reach) -> list[str]:
    """Return complaints about how fast a key frame is reached, and what is hit on the way."""
    found = []
    for name, turn in zip(JOINTS, np.abs(after - before), strict=False):
        if turn > reach.speed_max * max(duration, SHORTEST) + ROUNDING:
            found.append(
                f"{name} turns by {np.degrees(turn):.0f} deg in {duration:g} s; "
                f"at most {np.degrees(reach.speed_max):.0f} deg/s are possible, "
                f"so take at least {turn / reach.speed_max:.2f} s"
            )
    shares = np.linspace(0.0, 1.0, BETWEEN + 2)[1:-1]
    if not found and min(reach.gap(before + share * (after - before)) for share in shares) < 0.0:
        found.append(
            "the front legs hit each other or the body on the way from the frame before; add a frame around that"
        )
    return found
