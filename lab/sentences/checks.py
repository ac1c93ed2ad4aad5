"""Does a motion do what a sentence says? Measured on the key frames alone, by forward kinematics.

Nothing here knows how a sentence was read: hands, order, counts, metres and degrees come from where the toes, the
velocity and the heading go.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from mimic.geometry import R_BT
from mimic.io.keyframes import KeyFrames
from mimic.robot.reach import FRONT, Reach

SENTENCES = Path(__file__).with_name("sentences.txt")
MORE = Path(__file__).with_name("more.txt")
STEP = 0.25
"""Length of a step as the manual gives it [m]."""
SMALL = 0.12
"""A hand that moves by less [arm lengths of the robot] stays."""
TOLERANCE = 0.06
"""Relative error of distances, angles and times."""


@dataclass(frozen=True, slots=True)
class Sentence:
    """A sentence and the readings that are right; () is a refusal."""

    text: str
    readings: tuple[str, ...]
    held_out: bool


@dataclass(frozen=True, slots=True)
class Event:
    """An expected event."""

    actor: str
    """base, L, R, 1, A or none."""
    kind: str
    amount: float | None
    seconds: float | None


@dataclass(frozen=True, slots=True)
class Piece:
    """What one channel (base or a hand) does for a while."""

    start: float
    end: float


@dataclass(frozen=True, slots=True)
class Travel(Piece):
    """A straight walk or a turn."""

    kind: str
    amount: float


@dataclass(frozen=True, slots=True, eq=False)
class Move(Piece):
    """A hand on its way from one point to the next, forward, outward and up [arm lengths]."""

    before: np.ndarray
    after: np.ndarray


def sentences(path: Path = SENTENCES) -> list[Sentence]:
    """Return a list."""
    lines = [line for line in path.read_text().splitlines() if line and not line.startswith("#")]
    found = []
    for number, line in enumerate(lines):
        text, expected = line.rsplit(" => ", 1)
        readings = tuple(reading.strip() for reading in expected.split("|"))
        found.append(Sentence(text, readings, held_out=number % 2 == 1))
    return found


def does(motion: KeyFrames, sentence: Sentence, reach: Reach) -> bool:
    """Return whether a motion is one of the readings of a sentence."""
    base, hands = _base(motion), _hands(motion, reach)
    return any(
        _matches(variant, base, hands, motion.seconds)
        for reading in sentence.readings
        if reading != "no"
        for variant in _variants(reading)
    )


# ---------------------------------------------------------------------- what is expected


Groups = list[tuple[bool, list[Event]]]


def _variants(reading: str) -> Iterator[Groups]:
    """Yield the reading with each free choice of a hand made."""
    sides = [("L", "R")] if re.search(r"(^|[>&+] )1 ", reading) else [("",)]
    sides = [("L", "R", "LR")] if re.search(r"(^|[>&+] )A ", reading) else sides
    for choice in sides[0]:
        groups: Groups = []
        for text in reading.split(" > "):
            together = re.search(r" \+ ", text) is not None
            events = []
            for part in re.split(r" [+&] ", text.strip()):
                events += _events(part.strip(), choice)
            groups.append((together, events))
        yield groups


def _events(text: str, choice: str) -> list[Event]:
    text, _, seconds = text.partition("@")
    words = text.split()
    took = float(seconds) if seconds else None
    if words[0] in ("go", "step", "turn", "hold", "stop"):
        if words[0] == "stop":
            return []
        if words[0] == "go" and words[1] in ("fwd", "back"):
            return [Event("base", f"go {words[1]}", None, took)]
        amount = float(words[1]) * (STEP if words[0] == "step" else 1.0)
        kind = "go" if words[0] == "step" else words[0]
        return [Event("none" if kind == "hold" else "base", kind, amount, took)]
    actors = {"B": "LR", "1": choice, "A": choice}.get(words[0], words[0])
    amount = float(words[2]) if len(words) > 2 else None
    return [Event(actor, words[1], amount, took) for actor in actors]


# ---------------------------------------------------------------------- what happens


def _base(motion: KeyFrames) -> list[Travel]:
    """Return walks and turns in the order of time; a turn while walking counts as both."""
    pieces: list[Travel] = []
    t, heading = 0.0, 0.0
    for frame in motion.frames:
        turned = np.degrees(frame.heading - heading)
        for kind, amount in (("go", frame.velocity[0] * frame.duration), ("turn", turned)):
            last = next((p for p in reversed(pieces) if p.kind == kind), None)
            if abs(amount) < 1e-3:
                continue
            if last is not None and last.end > t - 1e-6 and np.sign(last.amount) == np.sign(amount):
                pieces[pieces.index(last)] = Travel(last.start, t + frame.duration, kind, last.amount + amount)
            else:
                pieces.append(Travel(t, t + frame.duration, kind, amount))
        t, heading = t + frame.duration, frame.heading
    return sorted(pieces, key=lambda piece: piece.start)


def _hands(motion: KeyFrames, reach: Reach) -> dict[str, list[Move]]:
    """Return where each hand begins, as a move without length, and its moves; straight ones are one move."""
    workspace = reach.description.workspace
    shoulders = np.array([leg.origin + (0.0, leg.offset, 0.0) for leg in reach.legs])

    def points(q: np.ndarray) -> np.ndarray:
        p = ((reach.toes(q) - shoulders) @ R_BT - [workspace.forward, 0.0, 0.0]) / workspace.scale
        return p * [[1.0, 1.0, 1.0], [1.0, -1.0, 1.0]]

    times = np.cumsum([0.0, *(frame.duration for frame in motion.frames)])
    p = np.stack([points(q) for q in (reach.description.poses["upright"][:FRONT], *(f.q for f in motion.frames))])
    moves = {}
    for index, side in enumerate("LR"):
        own = [Move(0.0, 0.0, p[0, index], p[0, index])]
        for (t0, t1), (a, b) in zip(pairwise(times), pairwise(p[:, index]), strict=True):
            if np.linalg.norm(b - a) < 1e-2:
                continue
            last = own[-1]
            if len(own) > 1 and last.end > t0 - 1e-6 and _goes_on(last.after - last.before, b - a):
                own[-1] = Move(last.start, float(t1), last.before, b)
            else:
                own.append(Move(float(t0), float(t1), a, b))
        moves[side] = own[:1] + [move for move in own[1:] if np.linalg.norm(move.after - move.before) >= SMALL]
    return moves


def _goes_on(first: np.ndarray, second: np.ndarray) -> bool:
    return float(first @ second) > 0.8 * float(np.linalg.norm(first) * np.linalg.norm(second))


# ---------------------------------------------------------------------- are they the same


def _matches(groups: Groups, base: list[Travel], hands: dict[str, list[Move]], total: float) -> bool:
    """Return whether the events are all there, in order, and nothing else is."""
    numbered = [(number, event) for number, (_, events) in enumerate(groups) for event in events]
    for own in _assign_base([item for item in numbered if item[1].actor == "base"], base):
        for left in _assign_hand([item for item in numbered if item[1].actor == "L"], hands["L"]):
            for right in _assign_hand([item for item in numbered if item[1].actor == "R"], hands["R"]):
                if _in_order(groups, [*own, *left, *right], numbered, total):
                    return True
    return False


Assigned = list[tuple[int, Event, float, float]]


def _assign_base(events: list[tuple[int, Event]], base: list[Travel]) -> Iterator[Assigned]:
    if len(events) != len(base):
        return
    orders = [events]
    if len(events) == 2 and events[0][0] == events[1][0]:
        orders.append(events[::-1])
    for order in orders:
        if all(_is_travel(event, piece) for (_, event), piece in zip(order, base, strict=True)):
            yield [(n, event, piece.start, piece.end) for (n, event), piece in zip(order, base, strict=True)]


def _is_travel(event: Event, piece: Travel) -> bool:
    if not _near(piece.end - piece.start, event.seconds):
        return False
    if event.kind in ("go fwd", "go back"):
        return piece.kind == "go" and abs(piece.amount) > 0.1 and (piece.amount > 0) == (event.kind == "go fwd")
    return piece.kind == event.kind and _near(piece.amount, event.amount)


def _assign_hand(events: list[tuple[int, Event]], moves: list[Move]) -> Iterator[Assigned]:
    """Yield each way to share the moves of a hand among its events; the first one is where it is already."""
    if not events:
        if len(moves) == 1:
            yield []
        return
    number, event = events[0]
    if event.kind in ("up", "down", "out", "fwd") and _is_gesture(event, moves[:1]):  # it is there already
        yield from _assign_hand(events[1:], moves)
    for count in range(1, len(moves)):
        own = moves[1 : count + 1]
        if _is_gesture(event, own) and _near(own[-1].end - own[0].start, event.seconds):
            for rest in _assign_hand(events[1:], moves[count:]):
                yield [(number, event, own[0].start, own[-1].end), *rest]


def _is_gesture(event: Event, moves: list[Move]) -> bool:
    path = np.stack([moves[0].before, *(move.after for move in moves)])
    forward, out, up = path[-1]
    rise = np.diff(path[:, 2])
    if event.kind == "up":
        return bool(len(moves) <= 2 and up > 0.55 and (rise > -0.15).all())
    if event.kind == "down":
        return bool(len(moves) <= 2 and up < -0.45 and (rise < 0.15).all())
    if event.kind == "out":
        return bool(len(moves) <= 2 and out > 0.45 and abs(up) < 0.4)
    if event.kind == "fwd":
        return bool(len(moves) <= 2 and forward > 0.7 and abs(up) < 0.4)
    if event.kind == "cycle":
        return _peaks(path[:, 2], high=0.55, low=0.1) == _wanted(event, path[:, 2], 0.55, 0.1)
    if event.kind == "punch":
        return bool((np.abs(path[1:, 2]) < 0.5).all()) and _peaks(path[1:, 0], 0.7, 0.55) == _wanted(
            event, path[1:, 0], 0.7, 0.55
        )
    if event.kind == "guard":
        return bool(len(moves) <= 2 and 0.15 < forward < 0.6 and abs(up) < 0.4 and out < 0.45)
    if event.kind in ("hook", "uppercut"):
        return _is_swing(event, path)
    assert event.kind == "wave"
    if path[1:, 2].min() < -0.3 or path[1:, 2].max() < 0.4:
        return False
    axis = 2 if np.ptp(path[1:, 2]) > np.ptp(path[1:, 1]) else 1
    middle = (path[1:, axis].min() + path[1:, axis].max()) / 2
    return _peaks(path[:, axis], middle + 0.15, middle - 0.15) == _wanted(
        event, path[:, axis], middle + 0.15, middle - 0.15
    )


def _is_swing(event: Event, path: np.ndarray) -> bool:
    """Return whether a hand swings, from the side (hook) or from below (uppercut), and comes back."""
    axis = 1 if event.kind == "hook" else 2
    sign = 1.0 if event.kind == "hook" else -1.0
    swing = sign * path[:, axis]
    high, low = (0.4, 0.25) if event.kind == "hook" else (0.3, 0.1)
    if event.kind == "uppercut" and path[:, 2].max() < 0.25:
        return False
    return bool(path[1:, 0].max() > 0.5) and _peaks(swing[1:], high, low) == _wanted(event, swing[1:], high, low)


def _wanted(event: Event, values: np.ndarray, high: float, low: float) -> int:
    """Return the number of peaks asked for; any number above zero where none is."""
    return int(event.amount) if event.amount is not None else max(1, _peaks(values, high, low))


def _peaks(values: np.ndarray, high: float, low: float) -> int:
    """Return how often the values rise above ``high``, with a fall below ``low`` between."""
    peaks, above = 0, False
    for value in values:
        if value > high:
            above = True
        elif value < low and above:
            peaks, above = peaks + 1, False
    return peaks + above


def _near(value: float, wanted: float | None) -> bool:
    return wanted is None or abs(value - wanted) <= max(TOLERANCE * abs(wanted), 0.02)


def _in_order(groups: Groups, assigned: Assigned, numbered: list[tuple[int, Event]], total: float) -> bool:
    spans: dict[int, list[tuple[float, float]]] = {}
    for number, _, start, end in assigned:
        spans.setdefault(number, []).append((start, end))
    for number, (together, _) in enumerate(groups):
        own = spans.get(number, [])
        if together and own and max(start for start, _ in own) >= min(end for _, end in own) - 0.05:
            return False
    t = 0.0
    for number in range(len(groups)):
        holds = [event for n, event in numbered if n == number and event.actor == "none"]
        if number in spans:
            start = min(span[0] for span in spans[number])
            if start < t - 1e-3:
                return False
            t = max(span[1] for span in spans[number])
        for hold in holds:
            assert hold.amount is not None
            later = [span[0] for n, own in spans.items() if n > number for span in own]
            quiet = min(later, default=total) - t
            if not 0.95 * hold.amount <= quiet <= hold.amount + 0.6:
                return False
    return True
