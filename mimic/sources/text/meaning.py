"""A sentence -> groups of actions: groups one after the other, the actions of a group at the same time.

`sentence.lark` has the words and how they go together; here its rules get their meaning. Every word is used or the
sentence is refused: an amount, side or direction that its verb does not take is an error.
"""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.resources import files
from typing import Any

from lark import Lark, Token, Tree, UnexpectedInput
from lark.lexer import PatternRE

from mimic.errors import SourceError

PACES = {"SLOW": 0.6, "FAST": 1.5, "TWICE_AS_FAST": 2.0, "HALF_AS_FAST": 0.5}
UNITS = {
    "SECONDS": ("seconds", 1.0), "MINUTES": ("seconds", 60.0), "TIMES": ("times", 1.0), "DEGREES": ("degrees", 1.0),
    "METRES": ("metres", 1.0), "CENTIMETRES": ("metres", 0.01), "FEET": ("metres", 0.3048),
    "INCHES": ("metres", 0.0254), "METRES_PER_SECOND": ("m/s", 1.0), "HALF_TURN": ("degrees", 180.0),
    "QUARTER_TURN": ("degrees", 90.0), "FULL_TURN": ("degrees", 360.0),
}  # fmt: skip
_SMALL = "zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen sixteen"
_TENS = "twenty thirty forty fifty sixty seventy eighty ninety"
NUMBERS = {word: float(n) for n, word in enumerate(f"{_SMALL} seventeen eighteen nineteen".split())}
NUMBERS |= {w: 10.0 * n for n, w in enumerate(_TENS.split(), 2)}
NUMBERS |= {"half": 0.5, "quarter": 0.25, "couple": 2.0, "once": 1.0, "twice": 2.0, "thrice": 3.0}
WAYS = {
    "FORWARD": "forward", "BACK": "back", "UP": "up", "BACK_UP": "up", "DOWN": "down", "SIDEWAYS": "side", "OUT": "out",
    "OPEN": "side", "UP_AND_DOWN": "up and down", "AROUND": "around",
}  # fmt: skip
_OUT = {"out": "open", "side": "open"}
_EACH_WAY = {"up": "up", "down": "down", "forward": "forward", **_OUT}
POSTURES = {  # for each verb the posture that a direction means
    "RAISE": {"": "up", "up": "up", "forward": "forward", **_OUT},
    "LOWER": {"": "down", "down": "down"},
    "OPEN": {"": "open", **_OUT, **dict.fromkeys(("up", "out up", "side up"), "high and open")},
    "EXTEND": {"": "forward", **_EACH_WAY},
    **dict.fromkeys(("STRETCH", "PLACE"), _EACH_WAY),
}
TAKES = {  # amounts that a verb takes
    "step": ("times", "seconds", "metres", "m/s"),
    "walk": ("seconds", "metres", "m/s"),
    "turn": ("degrees", "seconds"),
    **dict.fromkeys(("stop", "wait", "place"), ("seconds",)),
    **dict.fromkeys(("wave", "punch", "cycle"), ("times", "seconds")),
}
GESTURES = ("wave", "punch", "cycle")
BASE = ("step", "walk", "turn", "stop", "wait")  # verbs of the base; all others move hands
ONE_GESTURE = 1.5  # about what one wave or punch takes [s]
IN_TURN = {"ALTERNATE", "ONE_EACH", "LEFT_AND_RIGHT"}
MOVES = ("STEP", "WALK", "MOVE", "TURN")
BOTH = ("left", "right")
OPPOSITE = {"left": "right", "right": "left"}
VERBS = "step, walk, turn, stop, wait, wave, punch, raise, lower, open, put, move, hold, point or stretch"


@dataclass(kw_only=True, slots=True)
class Action:
    """One thing to do, and what was said of it."""

    verb: str = ""  # step, walk, turn, stop, wait, wave, punch, cycle (up and down) or place (hands into a posture)
    sides: tuple[str, ...] = ()  # hands that move, or the side to turn to
    way: str = ""  # forward or back for the base; the posture for hands
    amounts: dict[str, float] = field(default_factory=dict)  # times, seconds, degrees, metres, m/s, as said
    stays: bool = True  # whether the seconds are how long a posture is held, not how long the movement takes
    speed: float = 1.0
    text: str = ""
    kind: str = ""  # terminal of its verb, if it has one
    word: str = ""
    words: dict[str, list[str]] = field(default_factory=dict)  # for each other terminal its words
    ways: set[str] = field(default_factory=set)
    last: str = ""  # the amount with which it ends
    pause: float = 0.0  # between its parts [s]
    along: list[Action] = field(default_factory=list)

    @property
    def moves_base(self) -> bool:
        """Whether it moves the base or lets it stand, not the hands."""
        return self.verb in BASE

    @property
    def bare(self) -> bool:
        """Whether it only adds an amount or a pace to the action before."""
        own = self.words.keys() & {"HAND", "LEFT", "RIGHT", "AGAIN", "GREETING"}
        return not (self.kind or self.ways or own or "bare" in self.amounts)

    def error(self, message: str) -> SourceError:
        """Return an error about it."""
        return SourceError(f"'{self.text}' {message}")

    def refuse(self, wrong: object, message: str) -> None:
        """Raise an error about it if something is wrong."""
        if wrong:
            raise self.error(message)

    def amount(self, name: str, value: float) -> None:
        """Note an amount; there is one of each kind."""
        if name in self.amounts:
            raise self.error(f"has two amounts in {name}: {self.amounts[name]:g} and {value:g}; say one")
        if value <= 0 or (name == "times" and value != int(value)):
            raise self.error(f"has {value:g} {name}; expected {'1, 2, 3, …' if name == 'times' else 'more than 0'}")
        self.amounts[name] = value

    def add(self, other: Action) -> None:
        """Add what is said behind a comma: "wave, slowly"."""
        for name, value in other.amounts.items():
            self.amount(name, value)
        kinds = {**self.words, **other.words}
        self.words = {kind: self.words.get(kind, []) + other.words.get(kind, []) for kind in kinds}
        self.pause, self.stays = other.pause or self.pause, self.stays and other.stays
        self.last = other.last or self.last


Groups = list[list[Action]]

# ---------------------------------------------------------------------- sentence to tree


def _to_word_end(terminal: Any) -> None:
    if terminal.name not in ("WS", "_COMMA", "COMMA_AND", "_NEXT", "_THEN", "UNKNOWN"):
        terminal.pattern = PatternRE(f"(?:{terminal.pattern.to_regexp()})(?![\\w'])")


@cache
def grammar() -> Lark:
    """Return the grammar of `sentence.lark`."""
    text = files("mimic.sources.text").joinpath("sentence.lark").read_text("utf-8")
    options: dict[str, Any] = {"ambiguity": "explicit", "propagate_positions": True, "edit_terminals": _to_word_end}
    return Lark(text, lexer="basic", **options)


def vocabulary(kinds: set[str] | None = None) -> set[str]:
    """Return the words of some terminals, or of all."""
    text = " ".join(t.pattern.to_regexp() for t in grammar().terminals if kinds is None or t.name in kinds)
    text = re.sub(r"\(\?<?[=!](?:[^()]|\([^()]*\))*\)|\\\w", " ", text)
    return set(re.findall(r"\b[a-z]{2,}\b", text))


def parse(sentence: str) -> Groups:
    """Return what a sentence asks for.

    Raises:
        SourceError: If a word is unknown, or anything said is not used by the action to which it belongs.
    """
    text = re.sub(r"(?<=\w)-(?=[a-z])|(?<=\d)(?=[a-z°])|\s+", " ", sentence.lower().replace("’", "'"))
    if found := re.search(r"\d,\d|\d\s*[-–]\s*\d|[-–−]\s*\d|\d\s*%", text):
        raise SourceError(f"'{found.group().strip()}' is not a number of the phrasebook; write 45, 1.5 or three")
    text = re.sub(r"\bretreat(ing)?\b", r"walk\1 back", text.replace("back and forth", "forward and back"))
    text = re.sub(r"\b(half|quarter)( of)? an? ", r"\1 ", text)
    text = re.sub(r"\ban?(other)? (?=(second|minute|met(re|er)|foot)\b)", "1 ", text)
    text = re.sub(rf"(?<![\w'])(?:{grammar().get_terminal('FILLER').pattern.to_regexp()})", " ", text)
    text = " ".join(text.split())
    if not re.search(r"\w", text):
        raise SourceError(f"the sentence has no verb; say what to do with {VERBS}")
    try:
        tree: Any = grammar().parse(text)
    except UnexpectedInput as error:
        raise SourceError(_misfit(error, text)) from None
    if tree.data == "_ambig":
        raise SourceError(f"'{text}' can mean two things; say it in shorter parts, joined by 'then'")
    reader, again = _Reader(text), getattr(tree.children[-1], "type", "") == "REPEAT_ALL"
    groups = [group for block in tree.children if isinstance(block, Tree) for group in reader.block(block)]
    for side in BOTH if again else ():
        ways = [a.way for group in groups for a in group if side in a.sides and not a.moves_base]
        if ways and ways[0] and ways[0] == ways[-1]:
            raise SourceError(f"the {side} hand is {ways[0]} already when all begins again; say what it does before")
    return groups * 2 if again else groups


def _misfit(error: UnexpectedInput, text: str) -> str:
    """Return what does not fit into a sentence; for an unknown word the nearest words of the kind expected there."""
    unknown = list(dict.fromkeys(str(token) for token in grammar().lex(text) if token.type == "UNKNOWN"))
    token = getattr(error, "token", None)
    if unknown:
        expected: set[str] = set(getattr(error, "expected", ())) if token == unknown[0] else set()
        if "_DO" not in expected:  # behind a verb
            expected -= {*POSTURES, *MOVES, *map(str.upper, TAKES), "HOLD", "TURN_AROUND"}
        near = difflib.get_close_matches(unknown[0], sorted(vocabulary(expected) - {unknown[0]}), cutoff=0.7)
        named = f"{unknown[0]!r}" + (f" (near: {', '.join(near)})" if near else "")
        return (
            f"the phrasebook has no word {', '.join([named, *map(repr, unknown[1:6])])}; its verbs are {VERBS}; "
            "docs/manual/text.md has the phrasebook, or ask a language model: [text] planner in --config"
        )
    if not token:
        return f"'{text}' lacks something behind {text.split()[-1]!r}: a verb such as {VERBS}, a time, or a unit"
    before = text[: token.start_pos].strip()
    where = f"behind '{before}'" if before else "at the beginning"
    return f"'{token.strip()}' {where} is not something the phrasebook understands; say it in parts, joined by 'then'"


def number(text: str) -> float:
    """Return the value of a number in digits or words."""
    value = 0.0
    for word in text.replace("and", " ").split():
        value = 100.0 * (value or 1.0) if word == "hundred" else value + NUMBERS.get(word, 0.0)
        value += float(word) if word[-1].isdigit() else 0.0
    return value


# ---------------------------------------------------------------------- tree to actions


class _Reader:
    """Turns trees into groups of actions in the order in which they are said; knows which hands moved last."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.hands: tuple[str, ...] = ()
        self.before: Action | None = None
        self.turns: list[Action] = []  # since it faced as at first, or turned back

    def block(self, tree: Any) -> Groups:
        """Return the groups of parts joined by commas, the last of them perhaps in time with another."""
        parts: list[Any] = []
        for part in (child for child in tree.children if isinstance(child, Tree)):
            units = part if part.data == "timed" else self._units(part)
            if not parts or isinstance(units, Tree) or not units[0][0].bare:
                parts.append(units)
                continue
            if units[0][0].amounts and (len(parts[0]) + len(parts) > 2 or self.before):
                raise units[0][0].error("comes behind several actions; say it for each")
            parts[-1][-1][-1].add(units[0][0])
            parts[-1] += units[1:]
        enumerated = any(isinstance(child, Token) for child in tree.children)
        groups: Groups = []
        for part in parts:
            if isinstance(part, Tree):
                groups += self._timed(part)
                continue
            goes_on = enumerated or not part[0][0].kind
            group = groups[-1] if groups else [self.before] if self.before else []
            new = self._joined(part)
            if goes_on:
                self._scope(group, part[0][-1], at_once=False)
            groups += new
        return groups

    def _timed(self, tree: Any) -> Groups:
        joint = next((child for child in tree.children if isinstance(child, Token)), Token("WHILE", ""))
        leads = joint is tree.children[0]
        one, other = (self._joined(self._units(child)) for child in tree.children if isinstance(child, Tree))
        if joint.type == "WHILE":
            return _together(one, other)
        if joint.type == "BEFORE_AND_AFTER":
            return [*one, *other, *one]
        if joint.type == "AFTER" and len(one) > 1 and not leads:
            raise SourceError("'after' comes behind more than one action; say them in their order, with 'then'")
        return [*other, *one] if leads == (joint.type == "BEFORE") else [*one, *other]

    def _units(self, tree: Any) -> list[list[Action]]:
        """Return the actions of each unit, as they are said."""
        if tree.data in ("joined", "delayed"):
            children = tree.children if tree.data == "joined" else tree.children[::-1]
            return [unit for child in children for unit in self._units(child)]
        said: list[Action] = []
        for child in [tree] if tree.data in ("pose", "delay") else tree.children:
            now = self._said(child)
            if said and now.bare:
                said[-1].add(now)
            else:
                said.append(now)
        return [said]

    def _said(self, tree: Any) -> Action:
        """Collect the words of one action."""
        now = Action(text=self.text[tree.meta.start_pos : tree.meta.end_pos])
        now.kind, now.word = {"pose": ("PLACE", "with"), "delay": ("WAIT", "after")}.get(tree.data, ("", ""))
        for child in tree.children:
            if (child.type if isinstance(child, Token) else child.data) in {*WAYS, "HAND", "LEFT", "RIGHT", "along"}:
                now.last = ""
            if isinstance(child, Token):
                if child.type == "BACK_UP" and not now.kind:
                    now.kind, now.word, now.ways = "WALK", str(child), now.ways | {"back"}
                elif child.type == "BARE":
                    now.amount("bare", number(child))
                elif child.type in WAYS:
                    now.ways.add(WAYS[child.type])
                else:
                    now.words.setdefault(child.type, []).append(str(child).removesuffix(" there"))
            elif child.data == "verb":
                now.kind, now.word = child.children[0].type, str(child.children[0])
            elif child.data == "amount":
                now.last = _amount(now, child.children)
            elif child.data == "between":
                pause = Action(text=now.text)
                _amount(pause, next(c for c in child.children if isinstance(c, Tree)).children)
                now.pause = pause.amounts.get("seconds", 0.0)
            elif child.data == "counted":
                _counted(now, child.children)
            else:
                now.along.append(self._said(child))
        return now

    # ------------------------------------------------------------------ scope

    def _joined(self, units: list[list[Action]]) -> Groups:
        """Return the groups of units joined by "and"."""
        groups: Groups = []
        for unit in units:
            new = self._unit(unit)
            at_once = any("TOGETHER" in said.words for said in unit)
            if groups:
                at_once = at_once or (len(new) == 1 == len(new[0]) and _at_once(groups[-1], new[0][0]))
                self._scope(groups[-1], unit[-1], at_once)
                groups = _together(groups, new) if at_once else [*groups, *new]
            elif at_once and (len(new) > 1 or len(new[0]) + len(new[0][0].sides) < 3):
                raise SourceError("'at the same time' needs two actions joined by 'and'")
            else:
                groups = new
        return groups

    def _scope(self, group: list[Action], said: Action, at_once: bool) -> None:
        """Give a time behind two joined actions to both, where they are at once; refuse what could belong to both."""
        name = said.last
        takes = [a for a in group if name in TAKES[a.verb] and not a.amounts]
        free = [a for a in takes if name != "seconds" or a.verb in ("walk", *GESTURES)]
        if name == "seconds" and not said.stays:
            free = [a for a in group if name not in a.amounts]
        if free and not (at_once and name == "seconds"):
            value = f"{said.amounts[name]:g} {name}"
            raise said.error(
                f"has {value}, which can belong to {free[0].word or free[0].verb} before it, too; say it for each"
            )
        for action in free:
            action.amounts, action.stays = {name: said.amounts[name]}, said.stays

    def _unit(self, unit: list[Action]) -> Groups:
        """Return the groups of actions with one verb: what is said behind the last one belongs to all of them."""
        last, name, several, rounds = unit[-1], unit[-1].last, len(unit) > 1, 1
        each, in_turn = "EACH" in last.words, several and any("ALTERNATE" in said.words for said in unit)
        last.refuse(any(said.pause for said in unit[:-1]), "comes behind a pause between parts; put the pause last")
        either = in_turn and "times" in last.amounts and not each
        last.refuse(either, "can count single moves or pairs; say how many for each hand")
        lacking = [said for said in unit[:-1] if name and name not in said.amounts]
        in_rounds = lacking and name == "times" and not each and unit[0].kind in MOVES
        if lacking and (len(lacking) < len(unit) - 1 or (not in_rounds and any(said.amounts for said in lacking))):
            raise last.error(f"says {name} for a part of what is joined; say it for each")
        if in_rounds:
            rounds, lacking = int(last.amounts.pop("times")), []
        for said in lacking:
            said.amounts, said.stays = dict(last.amounts), last.stays
        for said in unit if in_turn else ():
            said.words.pop("ALTERNATE", None)
        if several and "HAND" in last.words and not any(said.ways for said in unit[:-1]):
            for said in unit:
                said.ways |= last.ways
        paced = [said for said in unit if said.words.keys() & PACES.keys()]
        if len(paced) == 1:
            for said in unit:
                said.words |= {kind: paced[0].words[kind] for kind in PACES if kind in paced[0].words}
        groups: Groups = []
        for said in unit:
            new = _repeated(said, self._action(said), several)
            for other in said.along:
                new = _together(new, self._along(said, other))
            if groups and len(new) == 1 == len(new[0]) and not in_turn and _at_once(groups[-1], new[0][0]):
                groups[-1] += new[0]
            else:
                groups += new
        if len(groups) > 1 and lacking and not each and name in ("seconds", "times"):
            last.refuse(name == "seconds", "has one time for two things one after the other; say it for each")
            groups = [[replace(a, amounts={**a.amounts, "times": 1.0}) for a in group] for group in groups]
            rounds = int(last.amounts["times"])
        return _apart(groups * rounds, last.pause) if several else groups

    def _along(self, said: Action, other: Action) -> Groups:
        """Return what is said without a joint: "walk forward waving", "with both hands up"."""
        if said.kind == "STOP" and other.word.endswith("ing"):
            if other.kind in MOVES and not (other.words or other.amounts):
                return []
            raise SourceError(f"'stop {other.word}' is not something the phrasebook does; say what to do instead")
        if other.word != "with" and not other.word.endswith("ing"):
            raise SourceError(f"'{other.word}' follows '{said.word}' without 'then', 'and' or 'while' between them")
        if other.word == "with" and said.verb in GESTURES and not said.words.keys() & {"HAND", "LEFT", "RIGHT"}:
            raise said.error("does not say which hand; say left hand, right hand or both hands")
        return [[self._action(other)]]

    # ------------------------------------------------------------------ one action

    def _action(self, now: Action) -> Action:
        """Return an action with its verb, hands and way."""
        self._complete(now)
        paces = [PACES[kind] for kind in now.words if kind in PACES for _ in now.words[kind]]
        now.refuse(len(paces) > 1 or (paces and "m/s" in now.amounts), "has two speeds; say one")
        now.speed = (*paces, 1.0)[0]
        if "bare" in now.amounts:
            value = now.amounts.pop("bare")
            if now.kind != "TURN" or value < 10:
                raise now.error(
                    f"has the number {value:g} without a unit; say seconds, times, steps, degrees or metres"
                )
            now.amount("degrees", value)
        now.refuse("IN_PLACE" in now.words and now.kind != "TURN", "stays in place; only 'turn' and 'stay' do")
        for word in now.words.get("GREETING", []):
            now.refuse(now.kind != "WAVE", f"has {word!r}, which only goes with 'wave'")
        now.verb = now.kind.lower()
        (self._base if now.verb in BASE else self._of_hands)(now)
        for name, value in now.amounts.items():
            if name not in TAKES[now.verb]:
                takes = ", ".join(TAKES[now.verb])
                raise now.error(f"has {value:g} {name}, which {now.word!r} does not use; it takes {takes}")
        for much in ({"metres", "seconds", "m/s"}, {"times", "metres"}):
            now.refuse(much <= now.amounts.keys(), f"says too much at once: {', '.join(now.amounts)}")
        self.hands = self.hands if now.moves_base else now.sides
        self.before = now
        return now

    def _complete(self, now: Action) -> None:
        """Find the verb of an action without one: "left hand up", "then the right"; tell moving a hand from walking."""
        before, hand, side = self.before, "HAND" in now.words, bool(now.words.keys() & {"LEFT", "RIGHT"})
        if now.word == "after" and before and before.verb in ("walk", *GESTURES) and not before.amounts:
            raise before.error("does not say for how long; say it, then what comes next")
        if now.kind == "TURN_AROUND":
            now.kind = "TURN"
            now.amount("degrees", 180.0)
        elif now.kind == "MOVE":
            now.kind = "PLACE" if hand else "WALK"
        elif now.kind == "HOLD":
            now.kind = "PLACE" if now.ways else "WAIT"
            if now.kind == "WAIT":  # "hold it", "hold your arms there": nothing moves
                now.words = {kind: said for kind, said in now.words.items() if kind not in ("HAND", "LEFT", "RIGHT")}
        elif not now.kind and hand and now.ways:
            now.kind = now.word = "PLACE"
        if now.kind:
            return
        if before is None:
            raise now.error(f"has no verb; begin with {VERBS}")
        if before.verb == "place" and now.ways and not (hand or side):
            now.kind, now.word, now.words["HAND"] = "PLACE", "move", ["them"]
            return
        counts = "times" in before.amounts and "bare" in now.amounts
        if before.moves_base:
            goes_on = before.verb in ("walk", "step") and not side and (counts or bool(now.ways))
            fits = not hand and (goes_on or (before.verb == "turn" and side and not now.ways))
        else:
            fits = (side or hand) and not now.ways
        now.refuse(not fits, f"has no verb; begin with {VERBS}")
        if counts:
            now.amount("times", now.amounts.pop("bare"))
        now.refuse(before.amounts and not now.amounts, "does not say how far, how long or how often; say it for each")
        if before.verb == "wave" and not (hand or "HAND" in before.words):
            raise SourceError("'wave left and right' can mean two things; say with which hand, or with both hands")
        now.kind, now.word = before.kind, before.word
        for kind in now.words.keys() & {"LEFT", "RIGHT"} if not before.moves_base else ():
            now.words["HAND"] = [f"{kind.lower()} hand" for _ in now.words.pop(kind)] + now.words.get("HAND", [])
        if not now.words.keys() & PACES.keys():
            now.words |= {kind: said for kind, said in before.words.items() if kind in PACES}
        now.ways = now.ways or (set(before.ways) if counts or not before.moves_base else set())

    def _base(self, now: Action) -> None:
        sides = [kind.lower() for kind in ("LEFT", "RIGHT") for _ in now.words.get(kind, [])]
        now.refuse("HAND" in now.words or now.words.keys() & IN_TURN, f"is not something a hand does: to {now.word}")
        now.refuse(now.speed > PACES["FAST"], "is faster than the robot walks or turns; say quickly, or a speed")
        if now.verb == "turn":
            degrees, turns = now.amounts.get("degrees"), [*self.turns, now]
            if now.ways == {"back"} and len(self.turns) == 1 and not sides and not degrees:
                sides, degrees = [OPPOSITE[turns[0].sides[0]]], turns[0].amounts.get("degrees", 90.0)
                now.amounts["degrees"], now.ways, turns = degrees, set(), []
            now.refuse(now.ways - {"around"}, "is not something the robot does; it turns left or right")
            now.refuse(now.ways and degrees is None, "does not say how far; say turn around, or a number of degrees")
            if len(sides) > 1 or not (sides or degrees in (180.0, 360.0)):
                raise now.error("does not say where to turn; say turn left, or turn right 60 degrees")
            now.sides, self.turns = (*sides, "left")[:1], turns
            return
        if sides:
            raise now.error(f"goes sideways, and the robot does not {now.word} sideways; turn {sides[0]} first")
        if now.verb in ("stop", "wait") and (now.ways or now.speed != 1.0):
            raise now.error(f"has more than a time, and to {now.word} takes nothing else")
        if not now.ways <= {"forward", "back"} or len(now.ways) > 1:
            raise now.error(f"has directions in which the robot does not {now.word}; say forward or back")
        now.way = (*now.ways, "forward" if now.verb in ("walk", "step") else "")[0]

    def _of_hands(self, now: Action) -> None:
        now.sides = self._sides(now)
        needs = now.kind in ("PLACE", "EXTEND", "STRETCH") and "HAND" not in now.words
        now.refuse(needs, f"does not say what to {now.word}; say left hand, right hand or both hands")
        if now.word in ("open", "opening") and re.search("hand|fist", " ".join(now.words.get("HAND", []))):
            raise now.error("needs fingers, and the robot has none; say open the left arm, right arm or both arms")
        if now.verb in ("wave", "punch"):
            if not now.ways <= ({"up and down", "up"} if now.verb == "wave" else {"forward"}):
                raise now.error(f"has {', '.join(sorted(now.ways))!r}, which {now.word!r} does not take")
        elif now.verb == "cycle" or (now.ways == {"up and down"} and now.verb in ("raise", "place")):
            now.verb = "cycle"
        else:
            ways = now.ways - {"out"} if now.ways & {"forward", "side"} else now.ways
            found = POSTURES[now.kind]
            if " ".join(sorted(ways)) not in found:
                raise now.error(f"needs one direction for {now.word!r}: {', '.join(sorted(filter(None, found)))}")
            now.way = found[" ".join(sorted(ways))]
            again = now.amounts.get("times", 1.0) != 1.0
            unclear = again and "seconds" in now.amounts and now.stays
            now.refuse(unclear, "says how often and for how long; say 'in' and the time of all")
            now.verb = "cycle" if again and now.verb == "raise" and now.way == "up" else "place"
            now.amounts = {n: v for n, v in now.amounts.items() if now.verb != "place" or (n, v) != ("times", 1.0)}

    def _sides(self, now: Action) -> tuple[str, ...]:
        """Return the hands that an action names."""
        named = [said for kind in ("HAND", "LEFT", "RIGHT") for said in now.words.get(kind, [])]
        if now.words.keys() & IN_TURN:
            now.refuse(now.words.keys() & {"LEFT", "RIGHT"}, "is not something that both hands do in turn")
            return BOTH
        now.refuse(len(named) > 1, "names more than one hand; join them with 'and' or 'then'")
        if not named and now.kind in ("WAVE", "PUNCH"):
            return self.hands or ("right",)
        hand = (*named, "no")[0]
        first = "right" if "RIGHT" in now.words else "left" if "LEFT" in now.words else hand.split()[0]
        if first in ("both", "two", "each") or " and " in hand:
            return BOTH
        if first in OPPOSITE:
            return (first,)
        if first == "other" and len(self.hands) == 1:
            return (OPPOSITE[self.hands[0]],)
        if self.hands and (first == "them" or (first == "it" and len(self.hands) == 1)):
            return self.hands
        unclear = first in ("no", "it", "them", "other")
        now.refuse(unclear, "does not say which hand; say left hand, right hand or both hands")
        if first in ("one", "either", "any"):
            return ("right",)
        last = self.hands if now.kind in ("LOWER", "PLACE") else ()
        return BOTH if hand.endswith("s") else last or ("right",)


def _amount(now: Action, tokens: list[Any]) -> str:
    """Note an amount with its unit; return its name."""
    kinds = {token.type: token for token in tokens}
    now.stays = "IN" not in kinds
    name, factor = next((UNITS[kind] for kind in kinds if kind in UNITS), ("times", 1.0))
    now.amount(name, factor * (number(kinds.get("NUMBER") or kinds["ONCE"]) + 0.5 * ("AND_HALF" in kinds)))
    now.words |= {"EACH": ["each"]} if "EACH" in kinds else {}
    return name


def _counted(now: Action, tokens: list[Any]) -> None:
    """Note "two steps", "three left jabs" or "a half turn"."""
    noun = tokens[-1]
    if noun.type in UNITS:
        now.kind, now.word = now.kind or "TURN", now.word or str(noun)
        return now.amount(*UNITS[noun.type])
    if noun.type == "TURN" and now.kind == "" and tokens[1].type == "DEGREES":
        now.kind, now.word = "TURN", "turn"
        now.words |= {token.type: [str(token)] for token in tokens[2:-1]}
        return now.amount("degrees", number(tokens[0]))
    if noun.type == now.kind == "TURN" and len(tokens) == 2:
        return now.amount("degrees", 360.0 * number(tokens[0]))
    if noun.type == "TURN" or not (now.kind in ("", noun.type) or (noun.type == "STEP" and now.kind in MOVES)):
        raise now.error(f"has {' '.join(tokens)}; say how far, how often or how many degrees")
    now.kind, now.word = noun.type, str(noun)
    for token in tokens[1:-1]:
        now.words.setdefault(token.type, []).append(str(token))
    return now.amount("times", number(tokens[0]))


def _repeated(said: Action, action: Action, several: bool) -> Groups:
    """Return an action hand by hand where it is said so, and with pauses in between."""
    times, seconds, words = action.amounts.get("times"), action.amounts.get("seconds"), said.words
    by_hand = words.get("HAND", [""])[0].startswith("each") and action.verb != "place"
    if not (words.keys() & IN_TURN or by_hand):
        if "EACH" in words and len(action.sides) != 2 and not several:
            raise said.error("has 'each' for one thing; say it for each, with 'then'")
        if not said.pause or several:
            return [[action]]
        said.refuse(not times, "has a pause between nothing; say what comes before and behind it")
        return _apart([[replace(action, amounts={**action.amounts, "times": 1.0})]] * int(times or 1), said.pause)
    pair = words.get("LEFT_AND_RIGHT", [""])[0] == "one two"
    each, once = by_hand or pair or "EACH" in words, action.amounts if by_hand else {"times": 1.0}
    unclear = seconds and (times or each or said.pause or action.verb == "place")
    said.refuse(unclear, "has a time for hands in turn; say how often instead")
    if said.last == "times" and said.text.startswith("alternat") and "EACH" not in words:
        raise said.error("can count single moves or pairs; say how many for each hand")
    if "ONE_EACH" in words and times not in (None, 2.0):
        raise said.error(f"says {times:g} times and once for each of two hands")
    order = BOTH[::-1] if words.get("LEFT_AND_RIGHT", [""])[0].startswith("right") else BOTH
    count = (1 if by_hand else int(times or 1)) * 2 if each else int(times or 2)
    if seconds:
        count = max(2, round(seconds * action.speed / ONE_GESTURE))
        once = {"times": 1.0, "seconds": seconds / count}
    once = {} if action.verb == "place" else once
    return _apart([[replace(action, sides=(order[n % 2],), amounts=dict(once))] for n in range(count)], said.pause)


def _at_once(group: list[Action], action: Action) -> bool:
    """Return whether "and" means at the same time: other hands, or hands and a walk without an end."""
    (other,) = group if len(group) == 1 else (action,)
    if len(group) > 1 or action.verb == other.verb == "punch":
        return False
    if other.moves_base != action.moves_base:
        base = other if other.moves_base else action
        return base.verb == "walk" and not base.amounts
    return not other.moves_base and not set(other.sides) & set(action.sides)


def _together(groups: Groups, more: Groups) -> Groups:
    """Return groups with actions at the same time as the last group."""
    if len(more) > 1:
        raise SourceError("two things one after the other during another are not clear; say them in order")
    group = [*groups[-1]]
    for action in (action for row in more for action in row):
        for other in group:
            if other.moves_base == action.moves_base and (action.moves_base or set(other.sides) & set(action.sides)):
                who = "the robot" if action.moves_base else f"the {action.sides[0]} hand"
                raise SourceError(f"{who} cannot {other.verb} and {action.verb} at the same time")
        group.append(action)
    for base in (a for a in group if a.verb in ("walk", "wait", "stop") and "seconds" in a.amounts):
        free = [a for a in group if a.verb in GESTURES and not a.amounts]
        group = [replace(a, amounts={"seconds": base.amounts["seconds"]}) if a in free else a for a in group]
    return [*groups[:-1], group]


def _apart(groups: Groups, pause: float) -> Groups:
    """Return groups with a pause [s] between them."""
    wait = [[Action(verb="wait", amounts={"seconds": pause})]] if pause else []
    return [part for n, group in enumerate(groups) for part in ([*wait, group] if n else [group])]
