"""A sentence -> groups of actions: groups one after the other, the actions of a group at the same time.

`sentence.lark` has the words and how they go together; here each rule gets its meaning. Every word is used or the
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
    "RADIANS": ("degrees", 57.29577951), "METRES": ("metres", 1.0), "CENTIMETRES": ("metres", 0.01),
    "FEET": ("metres", 0.3048), "INCHES": ("metres", 0.0254), "METRES_PER_SECOND": ("m/s", 1.0),
    "CENTIMETRES_PER_SECOND": ("m/s", 0.01),
}  # fmt: skip
TURNS = {"HALF_TURN": 180.0, "QUARTER_TURN": 90.0, "FULL_TURN": 360.0}
_SMALL = "zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen sixteen"
NUMBERS = {word: float(n) for n, word in enumerate(f"{_SMALL} seventeen eighteen nineteen".split())}
NUMBERS |= {w: 10.0 * n for n, w in enumerate("twenty thirty forty fifty sixty seventy eighty ninety".split(), 2)}
NUMBERS |= {"half": 0.5, "quarter": 0.25, "couple": 2.0}
_WAYS = {
    "FORWARD": "forward", "BACK": "back", "UP": "up", "BACK_UP": "up", "DOWN": "down", "SIDEWAYS": "side", "OPEN": "side",
    "OUT": "out", "UP_AND_DOWN": "up and down", "AROUND": "around",
}  # fmt: skip
_VERB_KINDS = {"STEP", "WALK", "RETREAT", "MOVE", "STOP", "WAIT", "HOLD", "TURN", "TURN_AROUND", "WAVE", "PUNCH", "CYCLE"}
_VERB_KINDS |= {"RAISE", "LOWER", "OPEN", "PLACE", "EXTEND", "STRETCH"}
_OUT = {"out": "open", "side": "open"}
_EACH_WAY = {"up": "up", "down": "down", "forward": "forward", **_OUT}
_HIGH = dict.fromkeys(("up", "out up", "side up"), "high and open")
POSTURES = {
    "raise": {"": "up", "up": "up", "forward": "forward", **_OUT},
    "lower": {"": "down", "down": "down"},
    "open": {"": "open", **_OUT, **_HIGH},
    "extend": {"": "forward", **_EACH_WAY},
    "stretch": _EACH_WAY,
    "place": _EACH_WAY,
}
"""For each verb the posture that a direction means."""
TAKES = {
    "step": ("times", "seconds", "metres", "m/s"),
    "walk": ("seconds", "metres", "m/s"),
    "turn": ("degrees", "seconds"),
    **dict.fromkeys(("stop", "wait", "place"), ("seconds",)),
    **dict.fromkeys(("wave", "punch", "cycle"), ("times", "seconds")),
}
"""Amounts that a verb takes."""
ENDLESS = {
    "times": ("step", "wave", "punch", "cycle"),
    "seconds": ("walk", "wave", "punch", "cycle"),
    "metres": ("walk", "step"),
    "degrees": ("turn",),
}
"""Verbs without an amount of their own that an amount behind the next verb can belong to as well."""
BASE = ("step", "walk", "turn", "stop", "wait")
"""Verbs of the base; all others move hands."""
OPPOSITE = {"left": "right", "right": "left"}
BOTH = ("left", "right")
VERBS = "step, walk, turn, stop, wait, wave, punch, raise, lower, open, put, hold, point, stretch"


@dataclass(frozen=True, kw_only=True, slots=True)
class Action:
    """One thing to do."""

    verb: str
    """step, walk, turn, stop, wait, wave, punch, cycle (up and down) or place (bring hands to a posture)."""
    sides: tuple[str, ...] = ()
    """Hands that move, or the side to turn to."""
    way: str = ""
    """forward or back for the base; the posture for hands."""
    amounts: dict[str, float] = field(default_factory=dict)
    """times, seconds, degrees, metres, m/s, as said."""
    stays: bool = True
    """Whether the seconds are how long a posture is held, not how long the movement takes."""
    speed: float = 1.0

    @property
    def moves_base(self) -> bool:
        """Whether it moves the base or lets it stand, not the hands."""
        return self.verb in BASE


Groups = list[list[Action]]


@dataclass(slots=True)
class _Clause:
    """The words of one action."""

    text: str
    verb: str = ""
    word: str = ""
    said: bool = False
    """Whether it has a verb of its own."""
    hands: list[str] = field(default_factory=list)
    sides: list[str] = field(default_factory=list)
    ways: set[str] = field(default_factory=set)
    amounts: dict[str, float] = field(default_factory=dict)
    last: str = ""
    """The amount with which it ends."""
    stays: bool = True
    pace: float | None = None
    pause: float = 0.0
    marks: set[str] = field(default_factory=set)
    along: list[_Clause] = field(default_factory=list)

    @property
    def bare(self) -> bool:
        """Whether it only adds an amount or a pace to the action before."""
        return not (self.verb or self.hands or self.sides or self.ways or self.marks & {"GREETING", "AGAIN", "BARE"})

    def error(self, message: str) -> SourceError:
        return SourceError(f"'{self.text}' {message}")

    def amount(self, name: str, value: float) -> None:
        if name in self.amounts:
            raise self.error(f"has two amounts in {name}: {self.amounts[name]:g} and {value:g}; say one")
        if not value > 0:
            raise self.error(f"has {value:g} {name}; expected more than 0")
        if name == "times" and value != int(value):
            raise self.error(f"has {value:g} times, which is not a count; expected 1, 2, 3, …")
        self.amounts[name] = value


# ---------------------------------------------------------------------- sentence to tree


class _Kept:
    """Keeps terminals that no rule has."""

    always_accept = ("UNKNOWN", "FILLER")

    def process(self, stream: Any) -> Any:
        return stream


def _to_word_end(terminal: Any) -> None:
    if terminal.name not in ("WS", "_COMMA", "COMMA_AND", "_NEXT", "_THEN", "UNKNOWN"):
        terminal.pattern = PatternRE(f"(?:{terminal.pattern.to_regexp()})(?![\\w'])")


@cache
def grammar() -> Lark:
    """Return the grammar of `sentence.lark`."""
    text = files(__package__).joinpath("sentence.lark").read_text("utf-8")
    return Lark(
        text, lexer="basic", ambiguity="explicit", propagate_positions=True, postlex=_Kept(), edit_terminals=_to_word_end
    )


def parse(sentence: str) -> Groups:
    """Return what a sentence asks for.

    Raises:
        SourceError: If a word is unknown, or anything said is not used by the action to which it belongs.
    """
    said = " ".join(re.sub(r"(?<=\w)-(?=[a-z])|(?<=\d)(?=[a-z°])", " ", sentence.lower().replace("’", "'")).split())
    if found := re.search(r"\d,\d|\d\s*[-–]\s*\d|[-–−]\s*\d|\d\s*%", said):
        raise SourceError(f"'{found.group().strip()}' is not a number of the phrasebook; write 45, 1.5 or three")
    text = re.sub(r"\b(half|quarter)( of)? an? ", r"\1 ", said.replace("back and forth", "forward and back"))
    text = re.sub(r"\b(a|an|another) (?=(second|minute|met(re|er)|foot)\b)", "1 ", text)
    filler = grammar().get_terminal("FILLER").pattern.to_regexp()
    text = " ".join(re.sub(rf"(?<![\w'])(?:{filler})", " ", text).split())
    if not re.search(r"\w", text):
        raise SourceError(f"the sentence has no verb; say what to do with one of {VERBS}")
    unknown = list(dict.fromkeys(str(token) for token in grammar().lex(text) if token.type == "UNKNOWN"))
    try:
        tree = grammar().parse(text)
    except UnexpectedInput as error:
        raise SourceError(_misfit(error, text, unknown)) from None
    return _Reader(text).sentence(tree)


def _misfit(error: UnexpectedInput, text: str, unknown: list[str]) -> str:
    """Return what does not fit into a sentence; for an unknown word the nearest words of the kind expected there."""
    if unknown:
        expected = set(getattr(error, "expected", ())) if getattr(error, "token", "") == unknown[0] else set()
        near = difflib.get_close_matches(unknown[0], sorted(vocabulary(expected)), n=3, cutoff=0.7)
        named = f"{unknown[0]!r}" + (f" (near: {', '.join(near)})" if near else "")
        return (
            f"the phrasebook has no word {', '.join([named, *map(repr, unknown[1:6])])}; its verbs are {VERBS}; "
            "docs/manual/text.md has the phrasebook, or ask a language model with --planner llm"
        )
    token = getattr(error, "token", None)
    if not token:
        return f"'{text}' ends too early; say what to do with one of {VERBS}"
    before = text[: token.start_pos].strip()
    where = f"behind '{before}'" if before else "at the beginning"
    return f"'{token}' {where} is not something the phrasebook understands; say it as two parts, joined by 'then'"


def vocabulary(kinds: set[str] | None = None) -> set[str]:
    """Return the words and phrases of some terminals, or of all."""
    text = " ".join(t.pattern.to_regexp() for t in grammar().terminals if kinds is None or t.name in kinds)
    text = re.sub(r"\(\?<?[=!](?:[^()]|\([^()]*\))*\)|\\\w", " ", text)
    return {word for word in re.findall(r"\b[a-z]{2,}\b", text)}


# ---------------------------------------------------------------------- tree to actions


class _Reader:
    """Turns trees into groups of actions in the order in which they are said; knows which hands moved last."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.hands: tuple[str, ...] = ()
        self.before: tuple[_Clause, Action] | None = None

    def sentence(self, tree: Any) -> Groups:
        if tree.data == "_ambig":
            raise SourceError(f"'{self.text}' can mean two things; say it in shorter parts, joined by 'then'")
        return [group for block in tree.children for group in self._block(block)]

    def _block(self, tree: Any) -> Groups:
        """Return the groups of parts joined by commas, the last of them perhaps in time with another."""
        parts: list[Any] = []
        for part in (child for child in tree.children if isinstance(child, Tree)):
            units = self._units(part) if part.data == "joined" else part
            if parts and isinstance(units, list) and units[0][0].bare:
                if units[0][0].amounts and (len(parts[0]) + len(parts) > 2 or self.before):
                    raise units[0][0].error("comes behind several actions; say it for each")
                self._add(parts[-1][-1][-1], units[0][0])
                parts[-1] += units[1:]
            else:
                parts.append(units)
        enumerated = any(isinstance(child, Token) for child in tree.children)
        groups: Groups = []
        for part in parts:
            new = self._joined(part) if isinstance(part, list) else self._timed(part)
            if groups and isinstance(part, list) and (enumerated or not part[0][0].said):
                self._scope(groups[-1], part[0][-1], at_once=False)
            groups += new
        return groups

    def _timed(self, tree: Any) -> Groups:
        if tree.data == "later":
            return self._later(tree)
        joint = next((child for child in tree.children if isinstance(child, Token)), None)
        kind = joint.type if joint else "WHILE"
        one, other = (self._joined(self._units(child)) for child in tree.children if isinstance(child, Tree))
        if kind == "WHILE":
            return self._together(one, other)
        if kind == "BEFORE_AND_AFTER":
            return [*one, *other, *one]
        if kind == "AFTER" and len(one) > 1 and joint is not tree.children[0]:
            raise SourceError("'after' comes behind more than one action; say them in their order, with 'then'")
        return [*other, *one] if (joint is tree.children[0]) == (kind == "BEFORE") else [*one, *other]

    def _later(self, tree: Any) -> Groups:
        """Return what comes "after 3 seconds": the robot waits for as long."""
        amount, main = sorted((c for c in tree.children if isinstance(c, Tree)), key=lambda child: child.data != "amount")
        wait = _Clause(self.text, verb="WAIT", word="after")
        self._amount(wait, amount.children)
        if self.before and self.before[1].verb in ("walk", "wave", "punch", "cycle", "stop", "wait") and not self.before[0].amounts:
            raise wait.error("does not say how long the action before takes; say for how long, then what comes next")
        return [[self._action(wait)], *self._joined(self._units(main))]

    def _units(self, tree: Any) -> list[list[_Clause]]:
        """Return the clauses of each unit."""
        if tree.data == "joined":
            return [unit for child in tree.children for unit in self._units(child)]
        clauses: list[_Clause] = []
        for child in [tree] if tree.data == "pose" else tree.children:
            clause = self._clause(child)
            if clauses and clause.bare:
                self._add(clauses[-1], clause)
            else:
                clauses.append(clause)
        return [clauses]

    def _clause(self, tree: Any) -> _Clause:
        """Collect the words of one action."""
        now = _Clause(self.text[tree.meta.start_pos : tree.meta.end_pos])
        if tree.data == "pose":
            now.verb, now.word = "PLACE", "with"
        for child in tree.children:
            now.last = ""
            if isinstance(child, Token):
                self._word(now, child)
            elif child.data == "verb":
                self._word(now, child.children[0], verb=True)
            elif child.data == "amount":
                self._amount(now, child.children)
            elif child.data == "between":
                pause = _Clause(now.text)
                self._amount(pause, next(c for c in child.children if isinstance(c, Tree)).children)
                now.pause = pause.amounts.get("seconds", 0.0)
            elif child.data == "counted":
                self._counted(now, child.children)
            else:
                now.along.append(self._clause(child))
        return now

    def _word(self, now: _Clause, token: Token, *, verb: bool = False) -> None:
        kind = token.type
        if verb or (not now.verb and kind in _VERB_KINDS):
            now.verb, now.word, now.said = kind, str(token), True
        elif kind == "HAND":
            now.hands.append(str(token).removesuffix(" there"))
        elif kind in ("LEFT", "RIGHT"):
            now.sides.append(kind.lower())
        elif kind in PACES:
            if now.pace is not None:
                raise now.error("has two paces; say one")
            now.pace = PACES[kind]
        elif kind in _WAYS:
            now.ways.add(_WAYS[kind])
        elif kind == "BARE":
            now.marks.add(f"BARE {number(token):g}")
        else:
            now.marks.add(kind if kind != "LEFT_AND_RIGHT" or token.startswith("left") else "RIGHT_AND_LEFT")

    def _amount(self, now: _Clause, tokens: list[Any]) -> None:
        kinds = {token.type: token for token in tokens}
        now.stays = "IN" not in kinds
        value = number(kinds["NUMBER"]) if "NUMBER" in kinds else 1.0 + "once twice thrice".split().index(kinds["ONCE"])
        name, factor = next((UNITS[kind] for kind in kinds if kind in UNITS), ("times", 1.0))
        now.amount(name, factor * (value + 0.5 * ("AND_HALF" in kinds)))
        now.marks |= kinds.keys() & {"EACH"}
        now.last = name

    def _counted(self, now: _Clause, tokens: list[Any]) -> None:
        """Add "two steps", "three left jabs" or "a half turn"."""
        noun = tokens[-1]
        if noun.type in TURNS:
            now.verb, now.word = now.verb or "TURN", now.word or str(noun)
            now.marks.add("ANGLE")
            return now.amount("degrees", TURNS[noun.type])
        if noun.type == "TURN":
            raise now.error(f"counts turns; say how many degrees")
        if now.verb == "RETREAT" and noun.type == "STEP":
            now.ways.add("back")
        if now.verb in ("", noun.type) or (noun.type == "STEP" and now.verb in ("WALK", "RETREAT", "MOVE", "BACK_UP")):
            now.ways |= {"back"} if now.verb in ("RETREAT", "BACK_UP") else set()
            now.verb, now.word = noun.type, str(noun)
        else:
            raise now.error(f"does not fit together: {now.word} and {tokens[0]} {noun}")
        for token in tokens[1:-1]:
            self._word(now, token)
        now.amount("times", number(tokens[0]))

    def _add(self, onto: _Clause, bare: _Clause) -> None:
        for name, value in bare.amounts.items():
            onto.amount(name, value)
        if bare.pace is not None and onto.pace is not None:
            raise onto.error("has two paces; say one")
        onto.pace, onto.pause = bare.pace or onto.pace, bare.pause or onto.pause
        onto.stays, onto.last = onto.stays and bare.stays, bare.last
        onto.marks |= bare.marks

    # ------------------------------------------------------------------ scope

    def _joined(self, units: list[list[_Clause]]) -> Groups:
        """Return the groups of units joined by "and"."""
        groups: Groups = []
        for unit in units:
            new, last = self._unit(unit), unit[-1]
            together = any("TOGETHER" in clause.marks for clause in unit)
            if not groups:
                if together and (len(new) > 1 or len(new[0]) + len(new[0][0].sides) < 3):
                    raise SourceError("'at the same time' needs two actions joined by 'and'")
                groups = new
                continue
            at_once = len(new) == 1 == len(new[0]) and _at_once(groups[-1], new[0][0])
            at_once = at_once or together
            self._scope(groups[-1], last, at_once)
            groups = self._together(groups, new) if at_once else [*groups, *new]
        return groups

    def _scope(self, group: list[Action], last: _Clause, at_once: bool) -> None:
        """Give an amount behind two joined actions to both, where they are at once; refuse it where it could be either's."""
        name = last.last
        free = [a for a in group if not a.amounts and a.verb in ENDLESS.get(name, ())]
        if name == "seconds" and not last.stays:
            free = [a for a in group if name not in a.amounts]
        if free and not (at_once and name == "seconds"):
            raise SourceError(
                f"{last.amounts[name]:g} {name} in '{last.text}' can belong to {free[0].verb} before it, too; say it for each"
            )
        for action in free:
            group[group.index(action)] = replace(action, amounts={name: last.amounts[name]}, stays=last.stays)

    def _unit(self, clauses: list[_Clause]) -> Groups:
        """Return the groups of clauses with one verb: what is said behind the last one belongs to all of them."""
        first, last, name = clauses[0], clauses[-1], clauses[-1].last
        in_turn = any("ALTERNATE" in clause.marks for clause in clauses) and len(clauses) > 1
        lacking = [clause for clause in clauses if name and name not in clause.amounts]
        rounds = 1
        if in_turn and "times" in last.amounts and "EACH" not in last.marks:
            raise last.error("can count single moves or pairs; say how many for each hand")
        if len(lacking) == len(clauses) - 1 > 0 and name == "times" and "EACH" not in last.marks:
            if first.verb in ("STEP", "WALK", "RETREAT", "TURN", "MOVE"):
                rounds, lacking = int(last.amounts.pop("times")), []
        if lacking:
            if len(lacking) < len(clauses) - 1 or any(clause.amounts for clause in lacking):
                raise last.error(f"says {name} for a part of what is joined; say it for each")
            for clause in lacking:
                clause.amounts, clause.stays = dict(last.amounts), last.stays
        if len(clauses) > 1 and not any(clause.ways for clause in clauses[:-1]) and last.hands:
            for clause in clauses:
                clause.ways |= last.ways
        groups: Groups = []
        for clause in clauses:
            clause.marks -= {"ALTERNATE"} if in_turn else set()
            new = self._repeated(clause, self._action(clause), several=len(clauses) > 1)
            for other in clause.along:
                new = self._together(new, self._along(clause, other))
            if groups and len(new) == 1 == len(new[0]) and not in_turn and _at_once(groups[-1], new[0][0]):
                groups[-1] += new[0]
            else:
                groups += new
        if len(groups) > 1 and lacking and name == "seconds" and "EACH" not in last.marks:
            raise last.error("has one time for two things one after the other; say it for each")
        if len(groups) > 1 and lacking and name == "times" and "EACH" not in last.marks:
            groups = [[replace(a, amounts={**a.amounts, "times": 1.0}) for a in group] for group in groups]
            rounds = int(last.amounts["times"])
        return _apart(groups * rounds, last.pause) if len(clauses) > 1 else groups

    def _along(self, clause: _Clause, other: _Clause) -> Groups:
        """Return what is said without a joint: "walk forward waving", "with both hands up"."""
        if clause.verb == "STOP" and other.word.endswith("ing") and not (other.hands or other.ways or other.amounts):
            if other.verb in ("WALK", "MOVE", "STEP", "TURN"):
                return []
            raise SourceError(f"'stop {other.word}' is not something the phrasebook does; say what to do instead")
        if other.word != "with" and not other.word.endswith("ing"):
            raise SourceError(f"'{other.word}' follows '{clause.word}' without 'then', 'and' or 'while' between them")
        return [[self._action(other)]]

    def _repeated(self, clause: _Clause, action: Action, *, several: bool) -> Groups:
        """Return an action hand by hand where it is said so, and with pauses in between."""
        marks, times = clause.marks, action.amounts.get("times")
        each = any(hand.startswith("each") for hand in clause.hands) and action.verb != "place"
        if not (marks & {"ALTERNATE", "ONE_EACH", "LEFT_AND_RIGHT", "RIGHT_AND_LEFT"} or each):
            if "EACH" in marks and len(action.sides) != 2 and not several:
                raise clause.error("has 'each' for one thing; say it for each, with 'then'")
            if not clause.pause or several:
                return [[action]]
            if times is None:
                raise clause.error("has a pause between nothing; say what comes before and behind it")
            return _apart([[replace(action, amounts={**action.amounts, "times": 1.0})]] * int(times), clause.pause)
        order = BOTH if "RIGHT_AND_LEFT" not in marks else BOTH[::-1]
        if action.verb in BASE or (clause.sides and "ALTERNATE" not in marks):
            raise clause.error("is not something that both hands do in turn")
        if "seconds" in action.amounts:
            raise clause.error("has a time for hands in turn; say how often instead")
        if each or "EACH" in marks:
            turns = list(order) if each else list(order) * int(times or 1)
            own = action.amounts if each else {"times": 1.0}
        else:
            if clause.last == "times" and "ALTERNATE" in marks and clause.text.startswith("alternat"):
                raise clause.error("can count single moves or pairs; say how many for each hand")
            count = int(times or (2 if "ONE_EACH" in marks or action.verb == "place" else 2))
            if "ONE_EACH" in marks and count != 2:
                raise clause.error(f"says {count} times and once for each of two hands")
            turns, own = [order[n % 2] for n in range(count)], {"times": 1.0}
        own = {} if action.verb == "place" else own
        return _apart([[replace(action, sides=(side,), amounts=own)] for side in turns], clause.pause)

    def _together(self, groups: Groups, more: Groups) -> Groups:
        """Return groups with actions at the same time as the last group."""
        if not more:
            return groups
        if len(more) > 1:
            raise SourceError("two things one after the other, at the same time as another, are not clear; say them in order")
        group = list(groups[-1])
        for action in more[0]:
            for other in group:
                if other.moves_base and action.moves_base:
                    raise SourceError(
                        f"to {other.verb} and to {action.verb} at the same time is not something the phrasebook does"
                    )
                if not other.moves_base and not action.moves_base and set(other.sides) & set(action.sides):
                    raise SourceError(
                        f"the {action.sides[0]} hand cannot {other.verb} and {action.verb} at the same time"
                    )
            group.append(action)
        for time in [a.amounts for a in group if a.verb in ("walk", "wait", "stop") and "seconds" in a.amounts]:
            free = [a for a in group if not a.moves_base and not a.amounts and a.verb != "place"]
            group = [replace(a, amounts={"seconds": time["seconds"]}) if a in free else a for a in group]
        return [*groups[:-1], group]

    # ------------------------------------------------------------------ one action

    def _action(self, now: _Clause) -> Action:
        self._complete(now)
        bare = next((mark for mark in now.marks if mark.startswith("BARE ")), None)
        if bare:
            value = float(bare[5:])
            if now.verb != "TURN" or "degrees" in now.amounts or value < 10:
                raise now.error(f"has the number {value:g} without a unit; say seconds, times, steps, degrees, metres or m/s")
            now.amount("degrees", value)
        if "GREETING" in now.marks and now.verb != "WAVE":
            raise now.error(f"greets; only 'wave' does, not {now.word!r}")
        verb = now.verb.lower()
        action = self._base(now, verb) if verb in BASE else self._of_hands(now, verb)
        for name, value in action.amounts.items():
            if name not in TAKES[action.verb]:
                takes = ", ".join(TAKES[action.verb])
                raise now.error(f"has {value:g} {name}, which {now.word!r} does not use; it takes {takes}")
        if {"metres", "seconds", "m/s"} <= action.amounts.keys() or {"times", "metres"} <= action.amounts.keys():
            raise now.error(f"says too much at once: {', '.join(action.amounts)}")
        if not action.moves_base:
            self.hands = action.sides
        self.before = now, action
        return action

    def _complete(self, now: _Clause) -> None:
        """Find the verb of a clause without one: "left hand up", "then the right"; tell moving a hand from walking."""
        if now.verb in ("RETREAT", "BACK_UP"):
            now.verb, now.ways = "WALK", now.ways | {"back"}
        elif now.verb == "TURN_AROUND":
            now.verb = "TURN"
            now.amount("degrees", 180.0)
        elif now.verb == "MOVE":
            now.verb = "PLACE" if now.hands else "WALK"
        elif now.verb == "HOLD":
            now.verb = "PLACE" if now.ways else "WAIT"
            if now.verb == "WAIT":  # "hold it", "hold your arms there": nothing moves
                now.hands, now.sides = [], []
        elif not now.verb and now.hands and now.ways:
            now.verb = now.word = "PLACE"
        if now.verb:
            return
        if self.before is None:
            raise now.error(f"has no verb; begin with one of {VERBS}")
        said, action = self.before
        if action.verb == "place" and now.ways and not (now.hands or now.sides):
            now.verb, now.word, now.hands = "PLACE", "move", ["them"]
            return
        sided = bool(now.sides or now.hands)
        count = next((float(mark[5:]) for mark in now.marks if mark.startswith("BARE")), 0.0)
        if count and "times" in said.amounts:
            now.marks.discard(f"BARE {count:g}")
            now.amount("times", count)
        fits = (
            (count > 0 and "times" in now.amounts and action.verb == "step" and not sided)
            or             (not action.moves_base and sided and not now.ways)
            or (action.verb == "turn" and bool(now.sides) and not now.hands and not now.ways)
            or (action.verb in ("walk", "step") and bool(now.ways) and not sided)
        )
        if not fits:
            raise now.error(f"has no verb; begin with one of {VERBS}")
        if said.amounts and not now.amounts and not any(mark.startswith("BARE") for mark in now.marks):
            raise now.error("does not say how far, how long or how often; say it for each")
        if action.verb == "wave" and not (said.hands or now.hands):
            raise SourceError("'wave left and right' can mean two things; say with which hand, or with both hands")
        now.verb, now.word = said.verb, said.word
        now.ways = now.ways or (set(said.ways) if not action.moves_base or count else set())

    def _base(self, now: _Clause, verb: str) -> Action:
        if now.hands:
            raise now.error(f"is not something a hand does: to {now.word}")
        if (now.pace or 1.0) > max(PACES["SLOW"], PACES["FAST"]):
            raise now.error("is faster than the robot; it walks with up to 0.3 m/s: say quickly, or a speed")
        speed, ways = now.pace or 1.0, now.ways
        if verb == "turn":
            degrees = now.amounts.get("degrees")
            if ways - {"around"}:
                raise now.error(f"is not something the robot does: it turns left or right")
            if ways and degrees is None:
                raise now.error("does not say how far; say turn around, or a number of degrees")
            if len(now.sides) > 1 or not (now.sides or degrees in (180.0, 360.0)):
                raise now.error("does not say where to turn; say turn left, or turn right 60 degrees")
            return Action(verb=verb, sides=(*now.sides, "left")[:1], amounts=now.amounts, speed=speed)
        if now.sides:
            raise now.error(f"goes sideways, and the robot does not {now.word} sideways; turn {now.sides[0]} first")
        if verb in ("stop", "wait") and (ways or now.pace):
            raise now.error(f"has more than a time, and to {now.word} takes nothing else")
        if not ways <= {"forward", "back"} or len(ways) > 1:
            raise now.error(f"has directions that the robot does not {now.word}; say forward or back")
        if now.pace is not None and "m/s" in now.amounts:
            raise now.error("has two speeds; say one")
        way = next(iter(ways), "forward" if verb in ("walk", "step") else "")
        return Action(verb=verb, way=way, amounts=now.amounts, speed=speed)

    def _of_hands(self, now: _Clause, verb: str) -> Action:
        sides, way = self._sides(now), ""
        if now.word in ("open", "opening") and re.search("hand|fist", " ".join(now.hands)):
            raise now.error("needs fingers, and the robot has none; say open the left arm, right arm or both arms")
        if verb in ("wave", "punch"):
            if not now.ways <= ({"up and down"} if verb == "wave" else {"forward"}):
                raise now.error(f"has a direction that to {now.word} does not take")
        elif verb == "cycle" or (now.ways == {"up and down"} and verb in ("raise", "place")):
            verb = "cycle"
        else:
            way, again = self._posture(now), now.amounts.get("times", 1.0) != 1.0
            verb = "cycle" if again and verb == "raise" and way == "up" else "place"
        amounts = {n: v for n, v in now.amounts.items() if verb != "place" or (n, v) != ("times", 1.0)}
        return Action(verb=verb, sides=sides, way=way, amounts=amounts, stays=now.stays, speed=now.pace or 1.0)

    def _sides(self, now: _Clause) -> tuple[str, ...]:
        """Return the hands that a clause names."""
        if now.marks & {"ALTERNATE", "ONE_EACH", "LEFT_AND_RIGHT", "RIGHT_AND_LEFT"}:
            return BOTH
        if len(now.hands) + len(now.sides) > 1:
            raise now.error("names more than one hand; join them with 'and' or 'then'")
        if now.sides:
            return (now.sides[0],)
        if not now.hands:
            if now.verb in ("WAVE", "PUNCH") and self.hands in ((), ("right",)):
                return ("right",)
            raise now.error("does not say which hand; say left hand, right hand or both hands")
        (hand,) = now.hands
        first, plural = hand.split()[0], hand.endswith("s")
        if first in ("it", "them"):
            if not self.hands or (first == "it" and len(self.hands) > 1):
                raise now.error("does not say which hand; say left, right or both")
            return self.hands
        if first == "other":
            if len(self.hands) != 1:
                raise now.error("does not say which hand is the other; say left or right")
            return (OPPOSITE[self.hands[0]],)
        if first in ("both", "two", "each") or " and " in hand:
            return BOTH
        if first in OPPOSITE:
            return (first,)
        if plural:
            return BOTH
        return self.hands if first not in ("one", "either", "any") and now.verb in ("LOWER", "PLACE") and self.hands else ("right",)

    def _posture(self, now: _Clause) -> str:
        """Return the posture that a verb and its directions mean."""
        ways = now.ways - {"out"} if now.ways & {"forward", "side"} else now.ways
        found = POSTURES[now.verb.lower()]
        way = " ".join(sorted(ways))
        if way not in found:
            known = ", ".join(sorted({name for name in found if name}))
            raise now.error(f"needs one direction for {now.word!r}: {known}")
        return found[way]


def _at_once(group: list[Action], action: Action) -> bool:
    """Return whether "and" means at the same time: other hands, or hands and a walk without an end."""
    if len(group) > 1 or action.verb == group[0].verb == "punch":
        return False
    (other,) = group
    if other.moves_base != action.moves_base:
        base = other if other.moves_base else action
        return base.verb == "walk" and not base.amounts
    return not other.moves_base and not set(other.sides) & set(action.sides)


def _apart(groups: Groups, pause: float) -> Groups:
    """Return groups with a pause [s] between them."""
    wait = [[Action(verb="wait", amounts={"seconds": pause})]] if pause else []
    return [part for number, group in enumerate(groups) for part in ((wait if number else []) + [group])]


def number(text: str) -> float:
    """Return the value of a number in digits or words."""
    value = 0.0
    for word in text.replace("and half", "half").split():
        if word == "hundred":
            value = 100.0 * (value or 1.0)
        elif word != "and":
            value += NUMBERS[word] if word in NUMBERS else float(word)
    return value
