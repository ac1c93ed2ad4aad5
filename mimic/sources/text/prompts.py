"""Prompts of the language model: rules about this robot, made from its description, and the two questions of the paper.

Source: Li et al. 2024, section III-C: first a description of each key frame, then its exact targets.
"""

from __future__ import annotations

import json

import numpy as np

from mimic.geometry import R_BT
from mimic.io.keyframes import MOST_FRAMES, plain_frame
from mimic.records import JOINTS
from mimic.robot.arm_mapping import POSTURES, posture
from mimic.robot.reach import FRONT, Reach
from mimic.sources.text.grammar import plan_by_grammar

EXAMPLE = "step forward, then raise the left hand"


def rules(reach: Reach, longest: float) -> str:
    """Return what there is to know about the robot, each number from its description or its kinematics."""
    description = reach.description
    commands = description.commands
    leg = reach.legs[0]
    limits = "\n".join(
        f"  {name}: {np.degrees(low):.0f} to {np.degrees(high):.0f}"
        for name, low, high in zip(JOINTS[:FRONT], reach.q_min, reach.q_max, strict=True)
    )
    shank = float(np.hypot(leg.toe[0], leg.toe[2]))
    shoulders = np.array([own.origin + (0.0, own.offset, 0.0) for own in reach.legs])

    def hand(q: np.ndarray) -> str:
        forward, left, up = 100 * (reach.toes(q)[0] - shoulders[0]) @ R_BT
        return f"hand {forward:+.0f} cm forward, {left:+.0f} cm left, {up:+.0f} cm up from its shoulder"

    postures = {"standing": description.poses["upright"][:FRONT]}
    postures |= {name: posture(name, reach) for name in POSTURES}
    table = "\n".join(
        f"  {name}: left_deg {np.degrees(q[:3]).round().astype(int).tolist()}, right_deg "
        f"{np.degrees(q[3:]).round().astype(int).tolist()} ({hand(q)})"
        for name, q in postures.items()
    )
    v_x, v_y = commands.velocity_max
    sideways = "it cannot walk sideways: the second number is 0" if v_y == 0 else f"{-v_y:g} to {v_y:g} m/s to the left"
    return f"""The robot is a {description.name} that stands upright on its two hind legs. \
Its front legs are its arms, its
front toes its hands; "left" and "right" are the robot's own. You control:
- velocity: [forward, left] in m/s on the way to the key frame; forward {-v_x:g} to {v_x:g}; {sideways}.
- heading_deg: where it faces when the key frame is reached, relative to the start of the motion, \
positive to the left; it
  turns by at most {np.degrees(commands.turn_rate_max):.0f} deg/s.
- left_deg, right_deg: angles of abad, hip and knee of each front leg in DEGREES when the key frame is reached.
- duration: seconds from the key frame before, at least 0.1. \
The whole motion takes at most {longest:g} s and {MOST_FRAMES} frames.
Each front leg: the upper arm is {100 * leg.thigh:.0f} cm long, the forearm {100 * shank:.0f} cm; so a hand is at most
{100 * (leg.thigh + shank):.0f} cm from its shoulder.
Allowed angles in degrees:
{limits}
No joint turns faster than {np.degrees(reach.speed_max.min()):.0f} deg/s. Hands must not touch each other or the body.
Postures that are known to be good; go between them:
{table}"""


def describe(sentence: str) -> str:
    """Return the question of the first round."""
    return f"""Plan this motion as key frames: {json.dumps(sentence)}

Describe each key frame in words, one after the other, along these points: base velocity; \
height of each hand (against its
shoulder); orientation of each hand (forward, up, down, outward); \
the joint between calf and thigh of each front leg (bent
or nearly straight); and how the key frame relates to the one before. Numbers come later. \
The motion begins with the posture
"standing" and no velocity. Waving, punching and the like need a key frame for each end of the movement."""


def ask_targets(reach: Reach) -> str:
    """Return the question of the second round."""
    example = plan_by_grammar(EXAMPLE, reach)
    frames = json.dumps({"frames": [plain_frame(frame) for frame in example.frames]})
    return f"""Now give the exact targets of these key frames as JSON and nothing else: an object with the list \
"frames"; each
frame has exactly the fields of this example, which is "{EXAMPLE}":
{frames}"""


def report_errors(errors: list[str]) -> str:
    """Return the question of a round in which an answer is corrected."""
    listed = "\n".join(f"- {text}" for text in errors)
    return f"This cannot be played:\n{listed}\nGive the whole JSON again with all of that corrected, and nothing else."
