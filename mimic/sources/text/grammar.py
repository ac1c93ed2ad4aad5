"""Sentences -> key frames by a phrasebook, without a language model (docs/manual/text.md).

`sentence.lark` has the words, `meaning` makes actions of them, and this module gives each action its time, velocity,
heading and postures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from mimic.errors import SourceError
from mimic.io.keyframes import MOST_FRAMES, KeyFrame, KeyFrames
from mimic.records import SIDES, FloatArray
from mimic.robot.arm_mapping import posture
from mimic.robot.reach import FRONT, Reach
from mimic.sources.text.feasibility import MIN_DURATION
from mimic.sources.text.meaning import Action, parse

STEP_LENGTH = 0.25  # [m]
WALK_METRES = 0.5  # unless a distance, a time or a speed is said [m]
WALK_SPEED = {"forward": 0.25, "back": 0.15}  # unless another is said [m/s]
START_SECONDS = 0.75
REVERSE_SECONDS = 1.65  # what a walk takes beside its distance: to get going, to turn back [s]
STOP_SECONDS = 0.5
HOLD_SECONDS = 1.0  # default durations [s]
MOVE_SECONDS = 0.8
TRUNK_SECONDS = 1.0  # down into a crouch or a bow, and up again [s]
LITTLE = 0.5  # share of the way that "a little" goes
PUNCH_SECONDS = 0.35  # from one arm posture to the next; a punch out, and its way back [s]
TURN_RATE = math.radians(30)
FASTEST_TURN = 1.1  # default turning rate [rad/s]; largest factor on it

STARTS = {verb: [("guard", MOVE_SECONDS)] for verb in ("punch", "hook", "uppercut")}
CYCLES = {  # postures through which a gesture goes, with the time to each [s]
    "wave": [("wave high", MOVE_SECONDS), ("wave low", MOVE_SECONDS)],
    "cycle": [("up", MOVE_SECONDS), ("down", MOVE_SECONDS)],
    "punch": [("forward", PUNCH_SECONDS), ("guard", PUNCH_SECONDS)],
    **{
        verb: [(f"{verb} {first}", PUNCH_SECONDS), (f"{verb} {then}", PUNCH_SECONDS), ("guard", PUNCH_SECONDS)]
        for verb, first, then in (("hook", "out", "in"), ("uppercut", "low", "high"))
    },
}

_POSTURE_WORDS = {"open": "out to the side", "high and open": "up and out to the side", "guard": "into the guard"}


@dataclass(slots=True, eq=False)
class _Timeline:
    """What a group of actions does: the base piece by piece, each hand from posture to posture."""

    base: list[tuple[float, float, float]] = field(default_factory=list)  # duration [s], velocity [m/s], turn [rad]
    hands: dict[str, list[tuple[float, FloatArray]]] = field(default_factory=dict)  # duration [s], joints (3,) [rad]
    before: float = 0.0  # velocity when it begins [m/s]
    open_end: bool = False  # whether the base goes on for as long as the hands need
    understood: list[str] = field(default_factory=list)


def plan_by_grammar(sentence: str, reach: Reach) -> KeyFrames:
    """Return the key frames of a sentence; ``what`` of each says how its part of the sentence was understood.

    Raises:
        SourceError: If a word is unknown, or something said cannot be used.
    """
    home = reach.description.poses["upright"][:FRONT]
    hands = {"left": home[:3], "right": home[3:], "trunk": np.zeros(2)}
    heading = 0.0
    frames = []
    groups, typed = parse(sentence)
    for group in groups:
        timeline = _Timeline(before=frames[-1].velocity[0] if frames else 0.0)
        for action in group:
            add = _add_base if action.moves_base else _add_trunk if action.moves_trunk else _add_hands
            timeline.understood.append(add(action, timeline, hands, reach))
        if frames and frames[-1].what == " while ".join(timeline.understood):
            timeline.understood[-1] += ", again"
        rows, heading = _frames(timeline, hands, heading)
        frames += rows
        if len(frames) > MOST_FRAMES:
            raise SourceError(f"the sentence makes more than {MOST_FRAMES} key frames; say less, or fewer times")
    return KeyFrames(frames=tuple(frames), sentence=sentence, planner="grammar", typed=tuple(typed.items()))


def _add_base(action: Action, timeline: _Timeline, hands: dict[str, FloatArray], reach: Reach) -> str:
    said = action.amounts
    if action.verb == "wait":
        seconds = said.get("seconds", STOP_SECONDS if action.way == "stop" else HOLD_SECONDS)
        timeline.base.append((seconds, 0.0, 0.0))
        return f"{'stop' if action.way == 'stop' else 'wait'} {seconds:g} s"
    if action.verb == "turn" or "degrees" in said:
        return _turn(action, timeline)
    most = float(reach.description.commands.velocity_max[0])
    metres = STEP_LENGTH * said["times"] if "times" in said else said.get("metres")
    speed = said.get("mps", min(most, WALK_SPEED[action.way] * action.speed))
    timeline.open_end = action.verb == "walk" and metres is None and "seconds" not in said
    if metres is None and "seconds" not in said and "mps" not in said:
        metres = STEP_LENGTH if action.verb == "step" else WALK_METRES
    sign = -1.0 if action.way == "back" else 1.0
    if metres is not None and "mps" not in said:
        start = REVERSE_SECONDS if sign * timeline.before < 0.0 else START_SECONDS
        speed = metres / said.get("seconds", metres / speed + start)
    if not 0.0 < speed <= most + 1e-9:
        raise SourceError(f"{speed:.3g} m/s is not a speed of this robot; it walks with up to {most:g} m/s")
    seconds = metres / speed if metres is not None else said.get("seconds", WALK_METRES / speed)
    timeline.base.append((seconds, sign * speed, 0.0))
    count = f" {said['times']:g} times," if said.get("times", 1.0) > 1 else ""
    return f"{action.verb} {action.way}{count} {speed * seconds:.3g} m in {seconds:.3g} s"


def _turn(action: Action, timeline: _Timeline) -> str:
    """Turn on the spot, or walk in a circle."""
    said = action.amounts
    degrees = said.get("degrees", 90.0)
    side = (*action.sides, "left")[0]
    angle = math.radians(degrees) * (1.0 if side == "left" else -1.0)
    seconds = said.get("seconds", abs(angle) / (TURN_RATE * min(action.speed, FASTEST_TURN)))
    if action.verb == "turn":
        timeline.base.append((seconds, 0.0, angle))
        return f"turn {side} {degrees:g}° in {seconds:.3g} s"
    speed = said.get("mps", WALK_SPEED[action.way] * min(action.speed, FASTEST_TURN))
    timeline.base.append((seconds, -speed if action.way == "back" else speed, angle))
    return f"walk {action.way} in a circle to the {side}, {speed * seconds / math.pi:.2g} m across, in {seconds:.3g} s"


def _add_trunk(action: Action, timeline: _Timeline, hands: dict[str, FloatArray], reach: Reach) -> str:
    numbers = reach.description.trunk_numbers
    if numbers is None:
        raise SourceError(f"{reach.description.name} neither crouches nor leans; leave '{action.verb}' out")
    said = action.amounts
    share = LITTLE if action.way else 1.0
    height = share * numbers.height[0]
    pitch = math.radians(said["degrees"]) if "degrees" in said else share * numbers.pitch[1]
    if pitch > numbers.pitch[1]:
        raise SourceError(f"{said['degrees']:g}° are too far; the robot leans by {math.degrees(numbers.pitch[1]):.0f}°")
    stand = np.zeros(2)
    there = {"crouch": np.array([height, 0.0]), "squat": np.array([height, 0.0]), "rise": stand}
    goal = there.get(action.verb, np.array([0.0, pitch]))
    moving = TRUNK_SECONDS / action.speed
    times = int(said.get("times", 1.0))
    rows = [(moving, goal), (HOLD_SECONDS / 2, goal), (moving, stand)] * times
    if action.verb in ("crouch", "lean", "rise"):
        rows = [(moving, goal)]
    whole = sum(seconds for seconds, _ in rows)
    if "seconds" in said and action.stays and times == 1:
        rows.insert(1, (said["seconds"], goal))
    elif "seconds" in said:
        rows = [(seconds * said["seconds"] / whole, q) for seconds, q in rows]
    timeline.hands["trunk"] = rows
    far = f"{-100 * height:.0f} cm" if action.verb in ("crouch", "squat") else f"{math.degrees(pitch):.0f}°"
    took = "" if "seconds" not in said else f", {said['seconds']:g} s"
    often = f" {times} times" if times > 1 else ""
    return f"stand up straight{took}" if action.verb == "rise" else f"{action.verb} by {far}{often}{took}"


def _add_hands(action: Action, timeline: _Timeline, hands: dict[str, FloatArray], reach: Reach) -> str:
    if action.verb == "place":
        return _place(action, timeline, hands, reach)
    said = action.amounts
    start = [(name, seconds / action.speed) for name, seconds in STARTS.get(action.verb, [])]
    cycle = [(name, seconds / action.speed) for name, seconds in CYCLES[action.verb]]
    if all(np.allclose(hands[side], _own("guard", side, reach)) for side in action.sides):
        start = []
    first = sum(seconds for _, seconds in start)
    each = sum(seconds for _, seconds in cycle)
    times = int(said.get("times", 2.0 if action.verb == "wave" else 1.0))
    if "seconds" in said and "times" not in said:
        times = max(1, round((said["seconds"] - first) / each))
    if times > MOST_FRAMES:
        raise SourceError(f"{times} times is more than the {MOST_FRAMES} key frames of a motion")
    factor = said["seconds"] / (first + times * each) if "seconds" in said else 1.0
    rows = [(name, factor * seconds) for name, seconds in start + cycle * times]
    if action.every:
        rows = _every(action.every, start, cycle, times)
    for side in action.sides:
        timeline.hands[side] = [(seconds, _own(name, side, reach)) for name, seconds in rows]
    verb = "raise and lower" if action.verb == "cycle" else f"{action.verb} with"
    return f"{verb} {_who(action)} {times} time{'s' if times > 1 else ''}" + (
        f" in {said['seconds']:.3g} s" if "seconds" in said else ""
    )


Rows = list[tuple[str, float]]


def _every(period: float, start: Rows, cycle: Rows, times: int) -> Rows:
    """Return a gesture at regular times: what is left of a period waits at its end, the first has the start."""
    rows: Rows = []
    for part in [start + cycle] + [cycle] * (times - 1):
        needed = sum(seconds for _, seconds in part)
        rows += [(name, seconds * min(1.0, period / needed)) for name, seconds in part]
        rows += [(part[-1][0], period - needed)] * (period > needed + 1e-6)
    return rows


def _place(action: Action, timeline: _Timeline, hands: dict[str, FloatArray], reach: Reach) -> str:
    seconds = action.amounts.get("seconds")
    moving = seconds if seconds is not None and not action.stays else MOVE_SECONDS / action.speed
    for side in action.sides:
        q = _own(action.way, side, reach)
        there = (
            seconds is not None and action.stays and np.allclose(q, hands[side])
        )  # "raise it and keep it up for 2 s"
        timeline.hands[side] = [] if there else [(moving, q)]
        if seconds is not None and action.stays:
            timeline.hands[side].append((seconds, q))
    took = "" if seconds is None else f" and hold {seconds:g} s" if action.stays else f" in {seconds:.3g} s"
    where = _POSTURE_WORDS.get(action.way, action.way)
    return f"bring {_who(action)} {where}{took}"


def _own(name: str, side: str, reach: Reach) -> FloatArray:
    q = posture(name, reach)
    return q[:3] if side == "left" else q[3:]


def _who(action: Action) -> str:
    return "both hands" if len(action.sides) == 2 else f"the {action.sides[0]} hand"


def _frames(timeline: _Timeline, hands: dict[str, FloatArray], heading: float) -> tuple[list[KeyFrame], float]:
    """Return a key frame for each moment at which the base or a hand changes; updates ``hands`` to where they end."""
    base = list(timeline.base)
    tracks = {}
    for side in (*SIDES, "trunk"):
        moves = timeline.hands.get(side, [])
        t = np.cumsum([0.0, *(duration for duration, _ in moves)])
        tracks[side] = t, np.stack([hands[side], *(q for _, q in moves)])
    turning = np.unique(np.concatenate([t for t, _ in tracks.values()]))
    end = sum(part[0] for part in base)
    near = float(turning[np.argmin(abs(turning - end))])
    if base and near > 0.0 and 0.0 < abs(near - end) < MIN_DURATION:  # both end together, as far as before
        seconds, forward, turn = base[-1]
        longer = seconds + near - end
        base[-1] = (longer, forward * seconds / longer, turn)
        end = near
    lacking = turning[-1] - end
    if lacking > 1e-9:
        forward = base[-1][1] if base and timeline.open_end else 0.0
        base.append((lacking, forward, 0.0))
    ends = np.cumsum([part[0] for part in base])
    moments = np.unique(np.round(np.concatenate([ends, turning]), 6))
    moments = moments[moments > 1e-6]
    gains = np.cumsum([0.0, *(part[2] for part in base)])
    frames = []
    before = 0.0
    what = " while ".join(timeline.understood)
    columns = [(t, column) for t, values in tracks.values() for column in values.T]
    for moment in moments:
        part = min(int(np.searchsorted(ends, moment - 1e-6)), len(base) - 1)
        *q, height, lean = (float(np.interp(moment, *column)) for column in columns)
        turned = float(np.interp(moment, [0.0, *ends], gains))
        frames.append(
            KeyFrame(
                duration=float(moment - before),
                velocity=(base[part][1], 0.0),
                heading=heading + turned,
                q=np.array(q),
                trunk=(height, lean),
                what=what,
            )
        )
        before = float(moment)
    for side in tracks:
        hands[side] = tracks[side][1][-1]
    return frames, heading + float(gains[-1])
