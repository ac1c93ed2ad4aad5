"""Sentences -> key frames by a small grammar, without a language model (docs/manual/text.md).

sentence = clause { ("then" | "," | ";" | ".") clause }      one after the other
clause   = action { ("while" | "and" | "as") action }        at the same time
action   = a verb with its direction or side, count, duration, speed, in any order
"""

from __future__ import annotations

import difflib
import math
import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mimic.errors import SourceError
from mimic.io.keyframes import MOST_FRAMES, KeyFrame, KeyFrames
from mimic.records import SIDES, FloatArray
from mimic.robot.arm_mapping import posture
from mimic.robot.reach import FRONT, Reach

STEP_SECONDS, STEP_SPEED = 1.0, 0.25
"""Of one step [s], [m/s]."""
WALK_SECONDS, STOP_SECONDS, HOLD_SECONDS = 3.0, 0.5, 1.0
MOVE_SECONDS = 0.8
"""From one arm posture to the next [s]."""
PUNCH_SECONDS = 0.35
TURN_RATE = math.radians(30)
"""[rad/s]"""

_VERBS = {
    "step": ["step", "steps", "stepping", "march", "marching"],
    "walk": ["walk", "walking", "go", "move", "moving"],
    "stop": ["stop", "stand", "halt", "standing"],
    "turn": ["turn", "turning", "rotate", "rotating"],
    "wave": ["wave", "waving"],
    "raise": ["raise", "raising", "lift", "lifting"],
    "lower": ["lower", "lowering", "drop", "dropping"],
    "punch": ["punch", "punching", "punches", "box", "boxing"],
    "open": ["open", "opening", "spread", "spreading"],
    "hold": ["hold", "holding", "wait", "waiting", "pause", "rest"],
}
_LEGS = ("step", "walk", "stop", "turn")
_SPEED = {"slowly": 0.6, "slow": 0.6, "quickly": 1.5, "quick": 1.5, "fast": 1.5}
_COUNTED = "zero one two three four five six seven eight nine ten eleven twelve"
_NUMBERS: dict[str, float] = {word: float(n) for n, word in enumerate(_COUNTED.split())}
_NUMBERS |= {"once": 1, "twice": 2, "thrice": 3, "half": 0.5}
_UNITS = {
    "s": "seconds", "sec": "seconds", "second": "seconds", "seconds": "seconds",
    "time": "times", "times": "times",
    "deg": "degrees", "degree": "degrees", "degrees": "degrees", "°": "degrees",
    "m/s": "m/s",
    "m": "metres", "metre": "metres", "metres": "metres", "meter": "metres", "meters": "metres",
}  # fmt: skip
_SIDES = {"left": "left", "right": "right", "both": "both"}
_WAYS = {"forward": 1.0, "forwards": 1.0, "ahead": 1.0, "backward": -1.0, "backwards": -1.0, "back": -1.0}
_HIGH = {"up": "up", "down": "down", "out": "open", "sideways": "open", "forward": "forward"}
_THEN = {"then", ",", ";", "."}
_WHILE = {"while", "and", "as"}
_FILLERS = {
    "a", "an", "the", "your", "its", "his", "her", "please", "robot", "to", "of", "with", "at", "in", "for", "by",
    "around", "it", "you", "hand", "hands", "arm", "arms", "leg", "legs", "paw", "paws", "still", "again", "after",
    "afterwards", "first", "finally", "take", "make", "do", "now", "m", "per", "side", "wide", "high",
}  # fmt: skip

_WORDS = re.compile(r"\d+(?:\.\d+)?|m/s|[^\W\d_]+|[,;.°]")


@dataclass(slots=True)
class _Action:
    """A verb with all that is said about it."""

    verb: str
    side: str | None = None
    way: float | None = None
    heights: list[str] = field(default_factory=list)
    speed: float = 1.0
    amounts: dict[str, float] = field(default_factory=dict)
    words: list[str] = field(default_factory=list)

    @property
    def legs(self) -> bool:
        return self.verb in _LEGS


@dataclass(slots=True, eq=False)
class _Timeline:
    """What a clause does: to the base piece by piece, to each hand from posture to posture."""

    base: list[tuple[float, float, float]] = field(default_factory=list)
    """Duration [s], forward velocity [m/s], heading gained [rad]."""
    hands: dict[str, list[tuple[float, FloatArray]]] = field(default_factory=dict)
    """For a side: duration [s] and joints (3,) [rad] reached."""
    open_end: bool = True
    """Whether the base goes on for as long as the hands need."""

    def hand_seconds(self) -> float:
        return max((sum(duration for duration, _ in moves) for moves in self.hands.values()), default=0.0)


def plan_by_grammar(sentence: str, reach: Reach) -> KeyFrames:
    """Return the key frames of a sentence.

    Raises:
        SourceError: If a word or a sentence is not understood; unknown words are named with the nearest known ones.
    """
    clauses = _clauses(_words(sentence))
    home = reach.description.poses["upright"][:FRONT]
    hands = {"left": home[:3], "right": home[3:]}
    heading, frames = 0.0, []
    for clause in clauses:
        timeline = _Timeline()
        for action in clause:
            (_move_base if action.legs else _move_hands)(action, timeline, hands, reach)
        rows, heading = _frames(timeline, hands, heading, " ".join(word for action in clause for word in action.words))
        frames += rows
        if len(frames) > MOST_FRAMES:
            raise SourceError(f"the sentence makes more than {MOST_FRAMES} key frames; say less, or fewer times")
    return KeyFrames(frames=tuple(frames), sentence=sentence, planner="grammar")


def known_words() -> list[str]:
    """Return every word that is understood."""
    words = {word for words in _VERBS.values() for word in words}
    for table in (_SPEED, _NUMBERS, _UNITS, _SIDES, _WAYS, _HIGH):
        words |= set(table)
    return sorted(words | _THEN | _WHILE | _FILLERS)


def _words(sentence: str) -> list[str]:
    words = _WORDS.findall(sentence.lower())
    known = known_words()
    unknown = list(dict.fromkeys(w for w in words if w not in known and not w[0].isdigit()))
    if unknown:
        named = []
        for word in unknown[:6]:
            near = difflib.get_close_matches(word, known, n=3, cutoff=0.6)
            named.append(f"{word!r}" + (f" (near: {', '.join(near)})" if near else ""))
        verbs = ", ".join(_VERBS)
        raise SourceError(
            f"the grammar has no word {', '.join(named)}; its verbs are {verbs}; docs/manual/text.md has the grammar, "
            "or ask a language model with --planner llm"
        )
    return words


def _clauses(words: list[str]) -> list[list[_Action]]:
    verbs = {word: verb for verb, own in _VERBS.items() for word in own}
    clauses: list[list[_Action]] = [[]]
    number: float | None = None
    for at, word in enumerate(words):
        now = clauses[-1][-1] if clauses[-1] else None
        if word in _THEN:
            if clauses[-1]:
                clauses.append([])
        elif word in verbs and not (now and verbs[word] == "step" and number is not None):
            clauses[-1].append(_Action(verbs[word]))
            now = clauses[-1][-1]
            if number is not None:
                now.amounts["times"], number = number, None
        elif word in _WHILE or (word in _FILLERS and word not in _UNITS):
            pass
        elif now is None and word not in _NUMBERS and not word[0].isdigit():
            raise SourceError(f"{word!r} stands before any verb; begin with one of {', '.join(_VERBS)}")
        elif word[0].isdigit() or word in _NUMBERS:
            number = float(word) if word[0].isdigit() else float(_NUMBERS[word])
            if now is not None and word in ("once", "twice", "thrice"):
                now.amounts["times"], number = number, None
        elif now is not None:
            number = _say(now, word, number, words[at - 1] if at else "")
        if now is not None and word not in _THEN | _WHILE:
            now.words.append(word)
    clauses = [clause for clause in clauses if clause]
    if not clauses:
        raise SourceError(f"the sentence has no verb; say what to do with one of {', '.join(_VERBS)}")
    if number is not None:
        raise SourceError(
            f"the number {number:g} at the end has no unit; say seconds, times, steps, degrees, metres or m/s"
        )
    return clauses


def _say(action: _Action, word: str, number: float | None, before: str) -> float | None:
    """Add a word to an action; return the number that still waits for its unit."""
    if word in _UNITS or word in _VERBS["step"]:
        if number is None:
            if word in ("m", "s"):
                return None
            raise SourceError(f"{word!r} after {before!r} has no number")
        action.amounts[_UNITS.get(word, "times")] = number
        return None
    if word in _SPEED:
        action.speed = _SPEED[word]
    elif word in _SIDES:
        action.side = _SIDES[word]
    elif action.legs and word in _WAYS:
        action.way = _WAYS[word]
    elif not action.legs and word in _HIGH:
        action.heights.append(_HIGH[word])
    elif word == "sideways" or word in _HIGH or word in _WAYS:
        raise SourceError(f"to {action.verb} {word!r} is not something the robot does")
    return number


def _move_base(action: _Action, timeline: _Timeline, hands: dict[str, FloatArray], reach: Reach) -> None:
    said = action.amounts
    if action.verb == "turn":
        if action.side not in ("left", "right"):
            raise SourceError("say where to turn: turn left, or turn right 60 degrees")
        angle = math.radians(said.get("degrees", 90.0)) * (1.0 if action.side == "left" else -1.0)
        seconds = said.get("seconds", abs(angle) / (TURN_RATE * min(action.speed, 1.1)))
        timeline.base.append((seconds, 0.0, angle))
        timeline.open_end = False
        return
    if action.side is not None:
        raise SourceError(f"the robot does not {action.verb} sideways; turn {action.side} first")
    most = float(reach.description.commands.velocity[0])
    if action.verb == "stop":
        timeline.base.append((said.get("seconds", STOP_SECONDS), 0.0, 0.0))
        timeline.open_end = timeline.open_end and "seconds" not in said
        return
    speed = said.get("m/s", min(most, STEP_SPEED * action.speed))
    if not 0.0 < speed <= most:
        raise SourceError(f"{speed:g} m/s is not a speed of this robot; it walks with up to {most:g} m/s")
    if action.verb == "step":
        seconds = said.get("seconds", STEP_SECONDS * said.get("times", 1.0))
    else:
        seconds = said.get("seconds", said["metres"] / speed if "metres" in said else WALK_SECONDS)
    timeline.open_end = timeline.open_end and action.verb == "walk" and not {"seconds", "metres"} & said.keys()
    timeline.base.append((seconds, speed * (action.way or 1.0), 0.0))


def _move_hands(action: _Action, timeline: _Timeline, hands: dict[str, FloatArray], reach: Reach) -> None:
    said, times = action.amounts, max(1, round(action.amounts.get("times", 1 if action.verb != "wave" else 2)))
    if times > MOST_FRAMES:
        raise SourceError(f"{times} times is more than the {MOST_FRAMES} key frames of a motion")
    sides = SIDES if action.side in (None, "both") else (action.side,)
    if action.side is None and action.verb in ("wave", "punch"):
        sides = ("right",)
    move = MOVE_SECONDS / action.speed

    def joints(name: str, side: str) -> FloatArray:
        q = posture(name, reach)
        return q[:3] if side == "left" else q[3:]

    for side in sides:
        way: list[tuple[float, Any]]
        if action.verb == "hold":
            way = [(said.get("seconds", HOLD_SECONDS), hands[side])]
        elif action.verb == "wave":
            way = [(move, joints(name, side)) for name in ("wave high", "wave low") * times]
        elif action.verb == "punch":
            quick = PUNCH_SECONDS / min(action.speed, 1.0)
            way = [(MOVE_SECONDS, joints("guard", side))]
            way += [(quick, joints(name, side)) for name in ("forward", "guard") * times]
        else:
            default = {"raise": "up", "lower": "down", "open": "open"}[action.verb]
            name = action.heights[-1] if action.verb == "raise" and action.heights else default
            name = "high and open" if action.verb == "open" and "up" in action.heights else name
            way = [(move, joints(name, side))]
        total = sum(duration for duration, _ in way)
        factor = said["seconds"] / total if "seconds" in said and action.verb != "hold" else 1.0
        timeline.hands.setdefault(side, []).extend((duration * factor, np.array(q)) for duration, q in way)


def _frames(
    timeline: _Timeline, hands: dict[str, FloatArray], heading: float, what: str
) -> tuple[list[KeyFrame], float]:
    """Return the key frames of a clause, at every moment at which base or a hand changes; hands end where they are."""
    base = list(timeline.base)
    lacking = timeline.hand_seconds() - sum(part[0] for part in base)
    if lacking > 1e-9:
        forward = base[-1][1] if base and timeline.open_end else 0.0
        base.append((lacking, forward, 0.0))
    ends = np.cumsum([part[0] for part in base])
    tracks = {}
    for side in SIDES:
        moves = timeline.hands.get(side, [])
        t = np.cumsum([0.0, *(duration for duration, _ in moves)])
        tracks[side] = t, np.stack([hands[side], *(q for _, q in moves)])
    moments = np.unique(np.round(np.concatenate([ends, *(t[1:] for t, _ in tracks.values())]), 6))
    moments = moments[moments > 1e-6]
    gains = np.cumsum([0.0, *(part[2] for part in base)])
    frames, before = [], 0.0
    for moment in moments:
        part = min(int(np.searchsorted(ends, moment - 1e-6)), len(base) - 1)
        q = np.concatenate([[np.interp(moment, t, own[:, i]) for i in range(3)] for t, own in tracks.values()])
        turned = float(np.interp(moment, [0.0, *ends], gains))
        frames.append(
            KeyFrame(
                duration=float(moment - before), velocity=(base[part][1], 0.0), heading=heading + turned, q=q, what=what
            )
        )
        before = float(moment)
    for side in SIDES:
        hands[side] = tracks[side][1][-1]
    return frames, heading + float(gains[-1])
