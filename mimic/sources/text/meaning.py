"""A sentence -> groups of actions: groups one after the other, the actions of a group at the same time.

`sentence.lark` has the words, how they go together, and what each verb takes; here its rules get their meaning. Every
word is used or the sentence is refused.
"""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass, field, replace
from math import prod
from typing import Any

from lark import Token, Transformer, Tree, UnexpectedInput
from lark.visitors import CollapseAmbiguities

from mimic.errors import SourceError
from mimic.sources.text.words import VERBS, grammar, prepared, vocabulary

PACES = {"SLOW": 0.6, "FAST": 1.5, "TWICE_AS_FAST": 2.0, "HALF_AS_FAST": 0.5}
FACTORS = {
    "MINUTES": 60.0, "CENTIMETRES": 0.01, "FEET": 0.3048, "INCHES": 0.0254, "HALF_TURN": 180.0, "QUARTER_TURN": 90.0,
    "FULL_TURN": 360.0, "TURN": 360.0, "CIRCLE": 360.0,
}  # fmt: skip
_SMALL = "zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen sixteen"
_TENS = "twenty thirty forty fifty sixty seventy eighty ninety"
NUMBERS = {word: float(n) for n, word in enumerate(f"{_SMALL} seventeen eighteen nineteen".split())}
NUMBERS |= {word: 10.0 * n for n, word in enumerate(_TENS.split(), 2)}
NUMBERS |= {"half": 0.5, "couple": 2.0, "once": 1.0, "twice": 2.0, "thrice": 3.0, "double": 2.0, "triple": 3.0}
WAYS = {
    "FORWARD": "forward", "BACK": "back", "UP": "up", "DOWN": "down", "SIDEWAYS": "side", "OUT": "out", "OPEN": "side",
    "UP_AND_DOWN": "up and down", "AROUND": "around", "IN": "forward",
}  # fmt: skip
_OUT = {"out": "open", "side": "open"}
_EACH_WAY = {"up": "up", "down": "down", "forward": "forward", **_OUT}
POSTURES = {  # for each verb the posture that a direction means
    "RAISE": {"": "up", "up": "up", "forward": "forward", **_OUT},
    "LOWER": {"": "down", "down": "down"},
    "OPEN": {"": "open", **_OUT, **dict.fromkeys(("up", "out up", "side up"), "high and open")},
    "CLOSE": {"": "down"},
    "HIGH_FIVE": {"": "up"},
    "EXTEND": {"": "forward", **_EACH_WAY},
    **dict.fromkeys(("STRETCH", "PLACE"), _EACH_WAY),
}
BASE = ("step", "walk", "turn", "wait")  # verbs of the base; all others move hands
WAYS_GONE = ("step", "walk", "turn")
GESTURES = ("wave", "punch", "hook", "uppercut", "cycle")
BOXED = {
    "JAB": ("punch", "left"),
    "CROSS": ("punch", "right"),
    "HOOK": ("hook", "left"),
    "UPPERCUT": ("uppercut", "right"),
}
WAYS_ONLY = {(False, False, True)}  # clauses without a verb that go on with a verb before, by hand, side and way
HANDS_ONLY = {(True, False, False), (False, True, False), (True, True, False)}
MOST_READINGS = 64  # of one sentence
TRUNK_WAYS = {  # for each verb of the trunk the directions that it takes
    "CROUCH": {"down"}, "SQUAT": {"down"}, "BOW": {"down", "forward"}, "LEAN": {"forward"}, "RISE": {"up"},
}  # fmt: skip
HALF = 180.0  # of a turn [degrees]
LASTING = {"squat": "crouch", "bow": "lean"}  # what stays down, for each that comes up again
UP_AGAIN = {stays: comes for comes, stays in LASTING.items()}
STAYS = {"hold", "stay", "keep", "remain", "freeze"}
ONE_GESTURE = 1.5  # about what one wave or punch takes [s]
LITTLE = {"turn": ("degrees", 30.0), "walk": ("metres", 0.25), "step": ("metres", 0.15)}
FURTHER = {
    "far": "metres",
    "distance": "metres",
    "long": "seconds",
    "time": "seconds",
    "often": "times",
    "times": "times",
}
IN_TURN = {"ALTERNATE", "ONE_EACH", "LEFT_AND_RIGHT", "ONE_TWO"}
BOTH = ("left", "right")
OPPOSITE = {"left": "right", "right": "left"}
VERBS_SAID = (
    "step, walk, turn, stop, wait, wave, punch, jab, raise, lower, open, put, move, hold, point, stretch, crouch or bow"
)
AMOUNTS = {
    "seconds", "metres", "mps", "degrees", "times", "turns", "count", "bare", "steps", "every", "pause", "circle",
}  # fmt: skip
NAMED = {"GUARD": "guard", "T_POSE": "open"}  # postures of both hands
CLAUSES = {
    "step", "walk", "turn", "still", "gesture", "place", "trunk", "pose", "repeat", "switch", "more", "forbid",
    "without",
}  # fmt: skip
KINDS = {*VERBS, *TRUNK_WAYS, *NAMED, "TURN_AROUND", "COME_BACK", "HIGH_FIVE", "ONE_TWO", "REPEAT", "REPEAT_ALL"}


@dataclass(kw_only=True, slots=True)
class Action:
    """One thing to do."""

    verb: str  # step, walk, turn, wait; wave, punch, hook, uppercut, cycle (up and down) or place (into a posture)
    sides: tuple[str, ...] = ()  # hands that move, or the side to turn to
    way: str = ""  # forward or back for the base; the posture for hands
    amounts: dict[str, float] = field(default_factory=dict)  # times, seconds, degrees, metres, mps, as said
    stays: bool = True  # whether the seconds are how long a posture is held, not how long the movement takes
    speed: float = 1.0
    every: float = 0.0  # from one gesture to the next [s]
    rounds: int = 1  # how often it is done with the posture before it

    @property
    def moves_base(self) -> bool:
        """Whether it moves the base or lets it stand, not the hands."""
        return self.verb in BASE

    @property
    def moves_trunk(self) -> bool:
        """Whether it lowers or leans the trunk."""
        return self.sides == ("trunk",)


Groups = list[list[Action]]


@dataclass(kw_only=True, slots=True)
class Clause:
    """What is said of one action."""

    text: str
    rule: str = ""
    kind: str = ""  # terminal of its verb, if it has one
    words: dict[str, list[str]] = field(default_factory=dict)  # for each other terminal its words
    ways: set[str] = field(default_factory=set)
    amounts: dict[str, float] = field(default_factory=dict)
    stays: bool = True
    last: str = ""  # the amount with which it ends
    pause: float = 0.0  # between its parts [s]
    every: float = 0.0  # from one to the next [s]
    along: list[Clause] = field(default_factory=list)

    @property
    def bare(self) -> bool:
        """Whether it only adds an amount or a pace to the clause before."""
        own = self.words.keys() & {"HAND", "LEFT", "RIGHT", "AGAIN", "GREETING", "RELATIVE", "SAME", "MORE"}
        return not (self.kind or self.ways or own or "bare" in self.amounts or self.rule != "more")

    @property
    def repeats(self) -> bool:
        """Whether it says what was said before once more."""
        return self.rule == "repeat" or (self.rule == "more" and self.words.keys() in ({"AGAIN"}, {"MORE"}))

    def has(self, *kinds: str) -> bool:
        """Return whether it has words of some terminals."""
        return not self.words.keys().isdisjoint(kinds)

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

    def add(self, other: Clause) -> None:
        """Add what is said behind a comma: "wave, slowly"."""
        for name, value in other.amounts.items():
            self.amount(name, value)
        for kind, said in other.words.items():
            self.words[kind] = self.words.get(kind, []) + said
        self.pause = other.pause or self.pause
        self.every = other.every or self.every
        self.stays = self.stays and other.stays
        self.last = other.last or self.last


# ---------------------------------------------------------------------- sentence to clauses


def parse(sentence: str) -> tuple[Groups, dict[str, str]]:
    """Return what a sentence asks for, and the mistyped words with what was read for them.

    Raises:
        SourceError: If a word is unknown, or anything said is not used by the action to which it belongs.
    """
    text, typed = prepared(sentence)
    if not text:
        raise SourceError(f"the sentence has no verb; say what to do with {VERBS_SAID}")
    try:
        return _only_meaning(grammar().parse(text), text), typed
    except UnexpectedInput as error:
        message = _misfit(error, text)
    except SourceError as error:
        message = str(error)
    raise SourceError(re.sub(r"\bing ", "", message))


def _only_meaning(tree: Tree[Any], text: str) -> Groups:
    """Return the groups of a tree; of several that can be read they must all be the same."""
    unclear = SourceError(f"'{text}' can mean two things; say it in shorter parts, joined by 'then'")
    if prod(len(node.children) for node in tree.find_data("_ambig")) > MOST_READINGS:
        raise unclear
    meanings: list[Groups] = []
    errors: list[SourceError] = []
    for one in CollapseAmbiguities().transform(tree) if any(tree.find_data("_ambig")) else [tree]:
        try:
            found = _Reader().read(_Clauses(text).transform(one))
        except SourceError as error:
            errors.append(error)
            continue
        if found not in meanings:
            meanings.append(found)
    if not meanings:
        raise errors[0]
    if len(meanings) > 1:
        raise unclear
    return meanings[0]


def _misfit(error: UnexpectedInput, text: str) -> str:
    """Return what does not fit into a sentence; for an unknown word the nearest words."""
    unknown = list(dict.fromkeys(str(token) for token in grammar().lex(text) if token.type == "UNKNOWN"))
    token: Any = getattr(error, "token", None)
    if unknown:
        near = difflib.get_close_matches(unknown[0], sorted(vocabulary() - {unknown[0]}), cutoff=0.7)
        named = f"{unknown[0]!r}" + (f" (near: {', '.join(near)})" if near else "")
        return (
            f"the phrasebook has no word {', '.join([named, *map(repr, unknown[1:6])])}; its verbs are {VERBS_SAID}, "
            "as in 'step forward, then wave the left hand'. Other words need a language model: llm_url, [text] in "
            "--config"
        )
    if not token:
        return f"'{text}' lacks something behind {text.split()[-1]!r}: a verb such as {VERBS_SAID}, a time, or a unit"
    words = text[: token.start_pos].split()
    said = [words.pop()] if words and _is_number(words[-1]) else []
    said += text[token.start_pos :].split()[:2] if str(token) == "ing" else [token.strip()]
    where = f"behind '{' '.join(words)}'" if words else "at the beginning"
    return f"'{' '.join(said)}' {where} is not something the phrasebook understands; say it in parts, joined by 'then'"


def _is_number(word: str) -> bool:
    return word in NUMBERS or word[-1].isdigit()


def number(text: str) -> float:
    """Return the value of a number in digits or words."""
    value = 0.0
    for word in text.replace("and", " ").split():
        value = 100.0 * (value or 1.0) if word == "hundred" else value + NUMBERS.get(word, 0.0)
        value += float(word) if word[-1].isdigit() else 0.0
    return value


@dataclass(slots=True)
class _Amount:
    name: str
    value: float
    tokens: list[Token]


class _Clauses(Transformer[Any, Any]):
    """Makes clauses of what the grammar found; the tree above them stays."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.text = text

    def __default__(self, data: Any, children: list[Any], meta: Any) -> Any:
        rule = str(data)
        if rule in AMOUNTS:
            return _amount(rule, children)
        if rule in CLAUSES:
            return _clause(rule, children, self.text[meta.start_pos : meta.end_pos])
        if rule == "later":
            (wait,) = [child for child in children if isinstance(child, _Amount)]
            text = self.text[meta.start_pos : meta.end_pos]
            waiting = Clause(text=text, rule="still", kind="WAIT", amounts={"seconds": wait.value})
            return Tree(data, [waiting, *(child for child in children if child is not wait)])
        return Tree(data, children, meta)


def _amount(name: str, children: list[Any]) -> _Amount:
    tokens = [child for child in children if isinstance(child, Token)]
    for inner in (child for child in children if isinstance(child, _Amount)):
        return _Amount(name, inner.value, tokens)  # a pause
    value = next((number(token) for token in tokens if token.type in ("NUMBER", "ONCE")), 1.0)
    value += 0.5 * any(token.type == "AND_HALF" for token in tokens)
    for token in tokens:
        value *= FACTORS.get(token.type, 1.0)
    return _Amount(name, value, tokens)


def _clause(rule: str, children: list[Any], text: str) -> Clause:
    now = Clause(text=text, rule=rule, kind="PLACE" if rule == "pose" else "")
    for child in children:
        if isinstance(child, Clause):
            now.along.append(child)
        elif isinstance(child, _Amount):
            _note_amount(now, child)
        else:
            _note_word(now, child)
    return now


def _note_amount(now: Clause, said: _Amount) -> None:
    if said.name in ("every", "pause"):
        setattr(now, said.name, said.value)
        return
    kinds = {token.type for token in said.tokens}
    name = {"count": "times", "steps": "times", "turns": "degrees", "circle": "degrees"}.get(said.name, said.name)
    if said.name == "steps" or (now.kind == "" and kinds & {"HALF_TURN", "QUARTER_TURN", "FULL_TURN", "CIRCLE"}):
        now.kind = "STEP" if said.name == "steps" else "TURN"
    now.stays = now.stays and "IN" not in kinds
    now.amount(name, said.value)
    now.last = name if said.name != "count" else ""
    for token in said.tokens:
        if token.type in (*PACES, "MORE"):
            now.words.setdefault(token.type, []).append(str(token))


def _note_word(now: Clause, token: Token) -> None:
    if (token.type in WAYS and now.rule not in ("turn", "still")) or token.type in ("AROUND", "BACK"):
        if token.type == "OPEN" and now.rule == "place":
            now.kind = "OPEN"
        else:
            now.ways.add("back" if token.type == "OUT" and now.rule == "step" else WAYS[token.type])
        now.last = ""
    elif token.type == "BACK_UP":
        now.kind = "WALK"
        now.ways = now.ways | {"back"}
    elif token.type in KINDS:
        now.kind = now.kind if now.kind == "STEP" or (token.type in NAMED and now.kind == "LOWER") else token.type
    else:
        if token.type in ("HAND", "LEFT", "RIGHT"):
            now.last = ""
        now.words.setdefault(token.type, []).append(str(token).removesuffix(" there"))


# ---------------------------------------------------------------------- clauses to actions


class _Reader:
    """Makes actions of clauses in the order in which they are said; knows which hands moved last."""

    def __init__(self) -> None:
        self.groups: Groups = []
        self.hands: tuple[str, ...] = ()
        self.before: Action | None = None
        self.done: Action | None = None  # the last one that was no wait
        self.said: Clause | None = None
        self.walk: Action | None = None
        self.turns: list[Action] = []  # since it faced as at first, or turned back
        self.way: list[Action] = []  # walks and turns since it came back
        self.forbidden: list[tuple[int, Clause]] = []  # from which group on
        self.at: dict[str, str] = {}  # posture in which each hand is
        self.switched = False

    def read(self, tree: Tree[Any]) -> Groups:
        """Return the groups of a sentence."""
        for part in tree.children:
            found = [self._list(c) if c.data == "list" else self._joined(_clauses(c)) for c in part.children]
            if part.data == "swapped":
                if len(found[0]) > 1:
                    raise SourceError(
                        "'after', 'before' or 'first' comes behind more than one action; say them in order"
                    )
                found = found[::-1]
            elif part.data == "around":
                found = [*found, found[0]]
            self.groups += [group for groups in found for group in groups]
        self._repeat_pairs()
        self.groups += self._switch(None)
        for start, clause in self.forbidden:
            for action in (action for group in self.groups[start:] for action in group):
                clause.refuse(_is_forbidden(action, clause), "is said of something that the sentence asks for")
        if not self.groups:
            raise SourceError("the sentence says only what not to do; say what to do, too")
        return self.groups

    def _repeat_pairs(self) -> None:
        """Do postures as often as was said, with the one before: "open the arms, then close them, three times"."""
        groups: Groups = []
        for group in self.groups:
            rounds = max(action.rounds for action in group)
            pair = [*groups[-1:], group]
            if rounds > 1 and [len(part) for part in pair] != [1, 1]:
                raise SourceError(f"it is not clear what is done {rounds} times; say it in shorter parts")
            groups += [group, *pair * (rounds - 1)]
        self.groups = groups

    def _list(self, tree: Tree[Any]) -> Groups:
        """Return the groups of items joined by commas."""
        enumerated = any(isinstance(child, Token) for child in tree.children)
        items: list[_Item] = []
        for child in (child for child in tree.children if isinstance(child, Tree)):
            item = _Item(child)
            if not items or not item.clauses[0].bare:
                items.append(item)
            else:
                name = item.clauses[0].last
                unclear = len(items) > 1 or any(name in _takes(action) for group in self.groups for action in group)
                item.clauses[0].refuse(name and unclear, "comes behind several actions; say it for each")
                items[-1].add(item)
        groups: Groups = []
        for item in items:
            first = item.clauses[0]
            last = item.clauses[-1]
            if first.repeats:
                groups += self._again(first, [*self.groups, *groups])
                continue
            before = (groups or [[self.before]] if self.before else groups)[-1:]
            goes_on = enumerated or not first.kind
            new = self._item(item)
            if before and goes_on:
                self._scope(before[0], last, at_once=False)
            groups += new
        return groups

    def _item(self, item: _Item) -> Groups:
        """Return the groups of an item, with what is done meanwhile."""
        early = [self._unit([clause]) for clause in item.during] if item.leads else []
        groups = self._joined(item.clauses) * item.rounds
        late = [self._unit([clause]) for clause in item.during] if not item.leads else []
        if not groups and item.during:
            raise item.during[0].error("goes with nothing; say what goes on meanwhile")
        for more in (*early, *late):
            if len(groups) > 1 and (item.clear or item.rounds > 1):
                raise item.during[0].error("goes with several actions; say with which")
            groups = _together(groups, more)
        return groups

    def _joined(self, clauses: list[Clause]) -> Groups:
        """Return the groups of clauses joined by "and"."""
        units: list[list[Clause]] = []
        for clause in clauses:
            if units and clause.bare:
                units[-1][-1].add(clause)
            elif units and not clause.kind:
                units[-1].append(clause)
            else:
                units.append([clause])
        groups: Groups = []
        for unit in units:
            if unit[0].repeats:
                return [*groups, *self._again(unit[0], [*self.groups, *groups])]
            new = self._unit(unit)
            if not new:
                continue
            at_once = any(clause.has("TOGETHER") for clause in unit)
            if not groups:
                wrong = at_once and (len(new) > 1 or len(new[0]) + len(new[0][0].sides) < 3)
                unit[0].refuse(wrong, "is one action; 'at the same time' needs two, joined by 'and'")
                groups = new
                continue
            at_once = at_once or (len(new) == 1 == len(new[0]) and _at_once(groups[-1], new[0][0]))
            self._scope(groups[-1], unit[-1], at_once)
            groups = _together(groups, new) if at_once else [*groups, *new]
        return groups

    def _scope(self, group: list[Action], said: Clause, at_once: bool) -> None:
        """Give a time behind two joined actions to both, where they are at once; refuse what could belong to both."""
        name = said.last
        free = [action for action in group if not action.amounts and name in _takes(action)]
        free = [action for action in free if name != "seconds" or action.verb in ("walk", *GESTURES)]
        if name == "seconds" and not said.stays:
            free = [action for action in group if name not in action.amounts]
        if free and not (at_once and name == "seconds"):
            value = f"{said.amounts[name]:g} {name}"
            raise said.error(f"has {value}, which can belong to {free[0].verb} before it, too; say it for each")
        for action in free:
            action.amounts = {name: said.amounts[name]}
            action.stays = said.stays

    # ------------------------------------------------------------------ clauses with one verb

    def _unit(self, unit: list[Clause]) -> Groups:
        """Return the groups of clauses with one verb: what is said behind the last one belongs to all of them."""
        if unit[0].rule in ("forbid", "without"):
            self.forbidden.append((len(self.groups), unit[0]))
            return []
        if self._ends_the_walk(unit[0]):
            return []
        groups = self._switch(unit[0])
        if unit[0].kind == "SWITCH":
            return groups
        rounds, shared = _share(unit)
        own: Groups = []
        in_turn = len(unit) > 1 and any(clause.words.pop("ALTERNATE", None) for clause in unit)
        for clause in unit:
            new = self._clause(clause, len(unit) > 1)
            if own and not in_turn and len(new) == 1 == len(new[0]) and _at_once(own[-1], new[0][0]):
                own[-1] += new[0]
            else:
                own += new
        if len(own) > 1 and shared in ("seconds", "times") and not unit[-1].has("EACH"):
            unit[-1].refuse(shared == "seconds", "has one time for two things one after the other; say it for each")
            own = [list(map(_once, group)) for group in own]
            rounds = int(unit[-1].amounts["times"])
        return [*groups, *(_apart(own * rounds, unit[-1].pause) if len(unit) > 1 else own)]

    def _ends_the_walk(self, now: Clause) -> bool:
        """Give a walk without an end the time of "stop after 5 seconds"; return whether that is what it was."""
        before = self.before
        if before is None or before.verb != "walk" or before.amounts:
            return False
        if now.kind != "WAIT" or not now.text.startswith("stop after"):
            return False
        before.amounts = dict(now.amounts)
        return True

    def _clause(self, now: Clause, several: bool) -> Groups:
        """Return the groups of one clause."""
        action = self._action(now)
        groups = _in_turn(now, action) if _is_in_turn(now, action) else _with_pauses(now, action, several)
        for pose in now.along:
            unclear = action.verb in GESTURES and not now.has("HAND", "LEFT", "RIGHT")
            now.refuse(unclear, "does not say which hand; say left hand, right hand or both hands")
            groups = _together(groups, [[self._action(pose)]])
        return groups

    def _again(self, now: Clause, groups: Groups) -> Groups:
        """Return all groups once more, or as often as is said."""
        now.refuse(not groups, "has nothing to repeat")
        times = now.amounts.get("times", 1.0)
        more = now.has("MORE")
        unclear = len(groups) > 1 and now.kind != "REPEAT_ALL" and not now.has("TOTAL")
        now.refuse(unclear, "can mean all or the last thing; say repeat everything")
        unclear = times > 1 and not more and not now.has("TOTAL")
        now.refuse(unclear, f"can mean {times:g} or {times + 1:g} times in all; say {times:g} times in total")
        for side in BOTH:
            ways = [
                action.way for group in groups for action in group if side in action.sides and not action.moves_base
            ]
            if ways and ways[0] and ways[0] == ways[-1]:
                raise now.error(f"finds the {side} hand {ways[0]} already; say what it does before")
        return groups * int(times - 1 if now.has("TOTAL") else times)

    def _switch(self, now: Clause | None) -> Groups:
        """Return what a "switch" before this clause asks for: the same with the other hand, or only that hand next."""
        pending = self.switched
        self.switched = now is not None and now.kind == "SWITCH"
        lasts = self.before is not None and self.before.verb in ("walk", *GESTURES) and not self.before.amounts
        if now is not None and now.rule == "still" and now.text.startswith("after"):
            now.refuse(lasts, "does not say for how long it goes on before; say it, then what comes next")
        if self.switched and now is not None:
            one = self.done is not None and not self.done.moves_base and len(self.hands) == 1
            now.refuse(not one, "does not say from which hand; say with which hand to go on")
        if not pending or self.done is None:
            return []
        self.hands = (OPPOSITE[self.hands[0]],)
        if now is not None and now.rule == "gesture" and not now.has("HAND", "LEFT", "RIGHT"):
            now.words["HAND"] = [f"{self.hands[0]} hand"]
            return []
        return [self._switched(self.done)]

    def _switched(self, before: Action) -> list[Action]:
        """Return an action with the other hand; where both hands were told a posture, they exchange it."""
        other = replace(before, sides=self.hands)
        self.before = other
        if other.verb != "place":
            return [other]
        if all(self.at.get(side) for side in BOTH):
            self.at = {side: self.at[OPPOSITE[side]] for side in BOTH}
            return [replace(other, sides=(side,), way=self.at[side]) for side in BOTH]
        return [other, Action(verb="place", sides=before.sides, way="down")]

    # ------------------------------------------------------------------ one action

    def _action(self, now: Clause) -> Action:
        """Return the action of a clause."""
        if not now.kind:
            self._inherit(now)
        self._after_the_trunk(now)
        if now.has("RELATIVE"):
            self._relate(now)
        paces = [PACES[kind] for kind in now.words if kind in PACES for _ in now.words[kind]]
        now.refuse(len(paces) > 1 or (paces and "mps" in now.amounts), "has two speeds; say one")
        speed = paces[0] if paces else 1.0
        means = self._base if _moves_base(now) else self._trunk if now.kind in TRUNK_WAYS else self._of_hands
        action = means(now, speed)
        takes = _takes(action)
        for name, value in action.amounts.items():
            now.refuse(name not in takes, f"has {value:g} {name}; {action.verb} takes {', '.join(takes)}")
        for much in ({"metres", "seconds", "mps"}, {"times", "metres"}, {"metres", "degrees"}):
            now.refuse(much <= action.amounts.keys(), f"says too much at once: {', '.join(action.amounts)}")
        greeting = now.words.get("GREETING", [""])[0]
        odd = greeting and action.verb not in ("wave", "bow")
        now.refuse(odd, f"has {greeting!r}, which only goes with 'wave' and 'bow'")
        if not action.moves_base and not action.moves_trunk:
            self.hands = action.sides
            self.at |= dict.fromkeys(action.sides, action.way)
        self.walk = action if action.verb in ("walk", "step") else self.walk
        if action.verb in WAYS_GONE:
            self.way.append(action)
        self.before = action
        self.done = self.done if action.verb == "wait" else action
        self.said = now
        return action

    def _after_the_trunk(self, now: Clause) -> None:
        """Let a squat or bow last until it is held or ended; "back up" behind one, or behind hands, is no walk."""
        before = self.done
        if before is None or before.moves_base:
            return
        if now.text == "back up" and now.kind == "WALK":
            now.refuse(not before.moves_trunk, "can mean the hands or the way back; say raise them, or walk backward")
            now.kind = "RISE"
            now.ways = set()
        held = now.rule == "still" and now.text.split()[0] in STAYS
        if "times" not in before.amounts and (held or now.kind == "RISE"):
            before.verb = LASTING.get(before.verb, before.verb)

    def _inherit(self, now: Clause) -> None:
        """Find the verb of a clause without one: "left hand up", "then the right", "and half of that back"."""
        before = self.before
        said = self.said
        if now.ways and (now.has("HAND") or (now.has("LEFT", "RIGHT") and not (before and before.moves_base))):
            now.kind = "PUT"
            return
        if before is None or said is None:
            raise now.error(f"has no verb; begin with {VERBS_SAID}")
        if before.verb == "place" and now.ways and not now.has("HAND", "LEFT", "RIGHT"):
            now.kind = "PUT"
            now.words["HAND"] = ["them"]
            return
        self._go_on(now, before, said)

    def _go_on(self, now: Clause, before: Action, said: Clause) -> None:
        """Give a clause without a verb the verb of the clause before, and what else it does not say."""
        counts = "times" in before.amounts and "bare" in now.amounts
        goes_on = {"walk": WAYS_ONLY, "step": WAYS_ONLY, "turn": {(False, True, False)}}.get(before.verb, HANDS_ONLY)
        given = (now.has("HAND"), now.has("LEFT", "RIGHT"), bool(now.ways) or (counts and before.moves_base))
        now.refuse(given not in goes_on, f"has no verb; begin with {VERBS_SAID}")
        unclear = before.verb == "wave" and not (counts or now.has("HAND") or said.has("HAND"))
        now.refuse(unclear, "can mean two things; say with which hand, or with both hands")
        if counts:
            now.amount("times", now.amounts.pop("bare"))
        if now.has("SAME"):
            now.amounts = before.amounts | now.amounts
        unsaid = before.amounts and not (now.amounts or now.has("RELATIVE"))
        now.refuse(unsaid, "does not say how far, how long or how often; say it for each")
        now.kind = said.kind
        kept = set() if now.has(*PACES) else PACES.keys() & said.words.keys()
        now.words |= {kind: said.words[kind] for kind in kept}
        if counts or not before.moves_base:
            now.ways = now.ways or set(said.ways)

    def _relate(self, now: Clause) -> None:
        """Turn "twice as far" and "half of that" into an amount of what was said before."""
        words = now.words["RELATIVE"][0].split()
        factor = number(" ".join(words[:1])) if words[0] in NUMBERS else 1.0
        names = {FURTHER[word] for word in words[1:] if word in FURTHER} or set(
            self.before.amounts if self.before else ()
        )
        last = self.walk if names == {"metres"} else self.before
        before = last.amounts if last else {}
        name = next(iter(names & before.keys()), "")
        if names == {"metres"} and not name:  # "step twice, then half as far back", "walk for 2 seconds, then …"
            name = next((other for other in ("times", "seconds") if other in before), "")
        now.refuse(not name, "compares with nothing that was said before; say how far, how long or how often")
        now.amount(name, factor * before[name])

    def _base(self, now: Clause, speed: float) -> Action:
        now.refuse(speed > PACES["FAST"], "is faster than the robot walks or turns; say quickly, or a speed")
        now.refuse(now.has("HAND") and now.kind != "HOLD", "is not something a hand does")
        if now.kind in ("STOP", "WAIT", "HOLD"):
            return Action(verb="wait", way=now.kind.lower(), amounts=dict(now.amounts))
        verb = {"STEP": "step", "WALK": "walk", "MOVE": "walk", "COME_BACK": "walk"}.get(now.kind, "turn")
        if now.has("LITTLE"):
            now.amount(*LITTLE[verb])
        if verb == "turn":
            return self._turn(now, speed)
        if now.kind == "COME_BACK":
            return self._come_back(now, speed)
        sides = [kind.lower() for kind in ("LEFT", "RIGHT") if kind in now.words]
        now.refuse(
            sides and "degrees" not in now.amounts,
            f"goes sideways, and the robot does not {verb} sideways; turn {'/'.join(sides)} first",
        )
        wrong = not now.ways <= {"forward", "back"} or len(now.ways) > 1
        now.refuse(wrong, f"has directions in which the robot does not {verb}; say forward or back")
        way = next(iter(now.ways), "forward")
        if way == "back" and self._faces_back(now):
            if not now.amounts and len(self.way) > 1:
                return self._come_back(now, speed)
            way = "forward"
        return Action(verb=verb, sides=tuple(sides), way=way, amounts=dict(now.amounts), speed=speed)

    def _faces_back(self, now: Clause) -> bool:
        """Return whether "walk back" is the way back, forward: behind a turn by 180°."""
        last = self.way[-1] if self.way else None
        if last is None or last.verb != "turn" or last.amounts.get("degrees") != HALF or "back up" in now.text:
            return False
        if "back" not in now.text.split():
            return False
        unclear = now.rule != "walk" or now.kind == "MOVE"
        now.refuse(unclear, "can mean backward or the way back; say backward or forward")
        return True

    def _come_back(self, now: Clause, speed: float) -> Action:
        """Return the one walk before, the other way; the same way if the robot has turned around since."""
        walks = [n for n, action in enumerate(self.way) if action.verb != "turn"]
        now.refuse(
            len(walks) != 1 and not (now.amounts and not self.way), "does not say how far; say walk back 1 metre"
        )
        walk = self.way[walks[0]] if walks else Action(verb="walk", way="forward")
        turned = sum(turn.amounts.get("degrees", 90.0) for turn in self.way[walks[0] + 1 :]) if walks else 0.0
        unclear = turned not in (0.0, HALF) or now.ways - {"back"} or "degrees" in walk.amounts
        now.refuse(unclear, "does not say how; say walk back 1 metre")
        way = walk.way if turned else "forward" if walk.way == "back" else "back"
        self.way = []
        return replace(walk, way=way, amounts=dict(now.amounts or walk.amounts), speed=speed)

    def _turn(self, now: Clause, speed: float) -> Action:
        sides = [kind.lower() for kind in ("LEFT", "RIGHT") for _ in now.words.get(kind, [])]
        amounts = dict(now.amounts)
        if "bare" in amounts:
            value = amounts.pop("bare")
            now.refuse(value < 10, f"has the number {value:g} without a unit; say degrees, steps or seconds")
            amounts["degrees"] = value
        if now.kind == "TURN_AROUND":
            amounts.setdefault("degrees", HALF)
        elif now.kind == "SPIN" or "times" in amounts:
            now.refuse(
                now.kind == "TURN" and now.last == "times", f"has {amounts.get('times', 0):g} times; say degrees"
            )
            now.refuse("times" in amounts and "degrees" in amounts, "says how far in two ways; say degrees")
            amounts.setdefault("degrees", 360.0 * amounts.pop("times", 1.0))
        degrees = amounts.get("degrees")
        if now.ways == {"back"} and len(self.turns) == 1 and not sides and not degrees:
            turn = self.turns.pop()
            amounts["degrees"] = turn.amounts.get("degrees", 90.0)
            return Action(verb="turn", sides=(OPPOSITE[turn.sides[0]],), amounts=amounts, speed=speed)
        now.refuse(now.ways - {"around"}, "is not something the robot does; it turns left or right")
        now.refuse(now.ways and degrees is None, "does not say how far; say turn around, or a number of degrees")
        unclear = len(sides) > 1 or not (sides or degrees in (HALF, 360.0) or now.kind == "SPIN")
        now.refuse(unclear, "does not say where to turn; say turn left, or turn right 60 degrees")
        action = Action(verb="turn", sides=(*sides, "left")[:1], amounts=amounts, speed=speed)
        self.turns.append(action)
        return action

    def _trunk(self, now: Clause, speed: float) -> Action:
        now.refuse(now.ways - TRUNK_WAYS[now.kind], "has a direction in which the trunk does not go")
        now.refuse("degrees" in now.amounts and now.kind not in ("BOW", "LEAN"), "has degrees; say them of a bow")
        way = "a little" if now.has("LITTLE") else ""
        amounts = dict(now.amounts)
        verb = now.kind.lower()
        verb = UP_AGAIN.get(verb, verb) if "times" in amounts else verb
        return Action(verb=verb, sides=("trunk",), way=way, amounts=amounts, stays=now.stays, speed=speed)

    def _of_hands(self, now: Clause, speed: float) -> Action:
        now.refuse("bare" in now.amounts, f"has the number {now.amounts.get('bare', 0):g} without a unit; say times")
        amounts = dict(now.amounts)
        action = Action(verb="", sides=self._sides(now), amounts=amounts, stays=now.stays, speed=speed, every=now.every)
        if now.every:
            now.refuse(not amounts, "does not say how long or how often")
            amounts["times"] = amounts.get("times") or max(1.0, round(amounts["seconds"] / now.every))
            amounts["seconds"] = now.every * amounts["times"]
        if now.kind in NAMED:
            action.verb = "place"
            action.way = NAMED[now.kind]
        elif now.rule == "gesture" or now.kind in ("WAVE", "PUNCH", "ONE_TWO", *BOXED):
            action.verb = BOXED.get(now.kind, ("punch" if now.kind == "ONE_TWO" else now.kind.lower(), ""))[0]
            allowed = {"wave": {"up and down", "up"}, "cycle": {"up and down", "up"}}.get(action.verb, {"forward"})
            now.refuse(now.ways - allowed, f"has {', '.join(sorted(now.ways))!r}, which {action.verb!r} does not take")
        else:
            self._place(now, action)
        return action

    def _place(self, now: Clause, action: Action) -> None:
        kind = "PLACE" if now.kind in ("MOVE", "HOLD", "PUT") else now.kind
        hands = " ".join(now.words.get("HAND", []))
        now.refuse(not hands and kind in ("EXTEND", "STRETCH"), "does not say which hand")
        wrong = kind == "OPEN" and any(word in hands for word in ("hand", "fist"))
        now.refuse(wrong, "needs fingers, and the robot has none; say open the left arm, right arm or both arms")
        action.verb = "cycle" if now.ways == {"up and down"} and kind in ("RAISE", "PLACE") else "place"
        if action.verb == "cycle":
            return
        ways = now.ways - {"out"} if now.ways & {"forward", "side"} else now.ways
        found = POSTURES[kind]
        way = " ".join(sorted(ways))
        now.refuse(way not in found, f"needs one direction: {', '.join(sorted(filter(None, found)))}")
        action.way = found[way]
        times = action.amounts.get("times", 1.0)
        unclear = times > 1 and "seconds" in action.amounts and action.stays
        now.refuse(unclear, "says how often and for how long; say 'in' and the time of all")
        if times > 1 and kind == "RAISE" and action.way == "up":
            action.verb = "cycle"
            action.way = ""
        elif times == 1.0 or self._comes_back(action):
            action.rounds = int(action.amounts.pop("times", 1.0))
        there = now.has("AGAIN") and all(self.at.get(side) == action.way for side in action.sides)
        now.refuse(there, f"finds the hand {action.way} already; say what it does before")

    def _comes_back(self, action: Action) -> bool:
        """Return whether a posture ends what the one before it began: "open the arms, then close them, three times"."""
        before = self.before
        same = before is not None and (before.verb, before.sides) == ("place", action.sides)
        return same and before.way != action.way

    def _sides(self, now: Clause) -> tuple[str, ...]:
        """Return the hands that a clause names."""
        named = [word for kind in ("HAND", "LEFT", "RIGHT") for word in now.words.get(kind, [])]
        if now.has(*IN_TURN) or now.kind in ("ONE_TWO", *NAMED):
            now.refuse(now.has("LEFT", "RIGHT"), "is not something that both hands do in turn")
            return BOTH
        now.refuse(len(named) > 1, "names more than one hand; join them with 'and' or 'then'")
        if named:
            return self._named(now, named[0])
        if now.kind in BOXED:
            return (BOXED[now.kind][1],)
        unclear = now.kind not in ("WAVE", "PUNCH", "HIGH_FIVE") and not (self.hands and now.kind in ("LOWER", "CLOSE"))
        now.refuse(unclear, "does not say which hand; say left hand, right hand or both hands")
        return self.hands or ("right",)

    def _named(self, now: Clause, hand: str) -> tuple[str, ...]:
        """Return the hands of a phrase such as "the other one"."""
        first = "right" if now.has("RIGHT") else "left" if now.has("LEFT") else hand.split()[0]
        if first in ("both", "two", "each") or " and " in hand:
            return BOTH
        if first in OPPOSITE:
            return (first,)
        if first == "other" and len(self.hands) == 1:
            return (OPPOSITE[self.hands[0]],)
        if self.hands and (first == "them" or (first == "it" and len(self.hands) == 1)):
            return self.hands
        unclear = first in ("it", "them", "other")
        now.refuse(unclear, "does not say which hand; say left hand, right hand or both hands")
        if first in ("one", "either", "any"):
            return ("right",)
        last = self.hands if now.kind in ("LOWER", "PLACE", "PUT", "MOVE", "CLOSE") else ()
        return BOTH if hand.endswith("s") else last or ("right",)


class _Item:
    """Clauses joined by "and", what is done meanwhile, and how often all of it."""

    def __init__(self, tree: Tree[Any]) -> None:
        self.leads = tree.data == "meanwhile"
        parts = tree.children[::-1] if self.leads else tree.children
        self.clauses = _clauses(parts[0])
        self.during = _clauses(parts[1]) if len(parts) > 1 else []
        self.clear = len(parts) > 1 and getattr(parts[1], "data", "") == "doing"  # with what it goes
        self.rounds = 1

    def add(self, more: _Item) -> None:
        """Add a bare item behind a comma."""
        bare = more.clauses[0]
        last = self.clauses[-1]
        times = int(bare.amounts.get("times", 0))
        whole = any(clause.amounts for clause in self.clauses) or last.kind in ("LOWER", "CLOSE")
        if len(self.clauses) > 1 and times and whole and not bare.has("EACH"):
            self.rounds = times
        else:
            last.add(bare)
        self.clauses += more.clauses[1:]
        self.during += more.during
        self.clear = self.clear or more.clear


def _clauses(tree: Tree[Any] | Clause) -> list[Clause]:
    """Return the clauses of a tree in their order."""
    if isinstance(tree, Clause):
        return [tree]
    return [clause for child in tree.children for clause in _clauses(child)]


def _moves_base(now: Clause) -> bool:
    """Return whether a clause is about the base: "move forward", but "move the left hand up"."""
    if now.kind in ("MOVE", "HOLD"):
        return now.rule != "place"
    return now.kind in ("STEP", "WALK", "COME_BACK", "STOP", "WAIT", "TURN", "SPIN", "TURN_AROUND")


def _is_forbidden(action: Action, said: Clause) -> bool:
    """Return whether an action is what must not be done: with the hand that is named, or of the kind that is."""
    if said.kind in ("STEP", "WALK", "TURN", "SPIN", "TURN_AROUND"):
        return (action.verb == "turn") == said.kind.startswith(("TURN", "SPIN")) and action.verb in WAYS_GONE
    if not said.has("HAND", "LEFT", "RIGHT"):
        return said.kind != "MOVE" or action.verb in WAYS_GONE
    named = {word for kind in ("HAND", "LEFT", "RIGHT") for words in said.words.get(kind, []) for word in words.split()}
    return not action.moves_base and bool(named & {*action.sides} or not named & {*BOTH})


def _takes(action: Action) -> tuple[str, ...]:
    """Return the amounts that an action takes."""
    if action.verb in GESTURES:
        return ("times", "seconds")
    moves = {
        "step": ("times", "seconds", "metres", "mps"),
        "walk": ("seconds", "metres", "mps", "degrees"),
        "turn": ("degrees", "seconds"),
        "squat": ("times", "seconds"),
        "bow": ("times", "degrees", "seconds"),
        "lean": ("degrees", "seconds"),
    }
    return moves.get(action.verb, ("seconds",))


def _share(unit: list[Clause]) -> tuple[int, str]:
    """Give what is said behind the last of several clauses to all; return how often all is done, and what is shared."""
    last = unit[-1]
    others = unit[:-1]
    last.refuse(any(clause.pause for clause in others), "comes behind a pause between parts; put the pause last")
    if not others:
        return 1, ""
    _share_words(unit)
    rounds, name = _rounds(unit)
    lacking = [clause for clause in others if name and name not in clause.amounts]
    partly = lacking and (len(lacking) < len(others) or any(clause.amounts for clause in lacking))
    last.refuse(partly, f"says {name} for a part of what is joined; say it for each")
    for clause in lacking:
        clause.amounts = dict(last.amounts)
        clause.stays = last.stays
    return rounds, name if lacking else ""


def _share_words(unit: list[Clause]) -> None:
    """Give the one pace of clauses to all, and the way behind the last hand to the hands before."""
    last = unit[-1]
    others = unit[:-1]
    paced = [clause for clause in unit if clause.has(*PACES)]
    for clause in unit if len(paced) == 1 else ():
        clause.words |= {kind: words for kind, words in paced[0].words.items() if kind in PACES}
    if last.has("HAND") and not any(clause.ways for clause in others):
        for clause in others:
            clause.ways |= last.ways


def _rounds(unit: list[Clause]) -> tuple[int, str]:
    """Return how often clauses of the base are done, all in turn, and the amount behind the last that is left."""
    last = unit[-1]
    others = unit[:-1]
    name = last.last
    each = last.has("EACH")
    either = any(clause.has("ALTERNATE") for clause in unit) and "times" in last.amounts and not each
    last.refuse(either, "can count single moves or pairs; say how many for each hand")
    moves = unit[0].kind in ("STEP", "WALK", "MOVE", "TURN") and not any("times" in clause.amounts for clause in others)
    if not moves or "times" not in last.amounts or (each and name == "times"):
        return 1, name
    return int(last.amounts.pop("times")), "" if name == "times" else name


def _is_in_turn(now: Clause, action: Action) -> bool:
    return now.has(*IN_TURN) or now.kind == "ONE_TWO" or _by_hand(now, action)


def _by_hand(now: Clause, action: Action) -> bool:
    """Return whether each hand does all of it: "wave twice with each hand"."""
    return now.words.get("HAND", [""])[0].startswith("each") and action.verb != "place"


def _with_pauses(now: Clause, action: Action, several: bool) -> Groups:
    """Return an action as often as it is said, with pauses in between."""
    now.refuse(now.has("EACH") and len(action.sides) != 2 and not several, "has 'each' for one thing; say it for each")
    if not now.pause or several:
        return [[action]]
    times = int(action.amounts.get("times", 0))
    now.refuse(not times, "has a pause between nothing; say what comes before and behind it")
    return _apart([[_once(action)]] * times, now.pause)


def _in_turn(now: Clause, action: Action) -> Groups:
    """Return an action hand by hand."""
    by_hand = _by_hand(now, action)
    times = action.amounts.get("times")
    seconds = action.amounts.get("seconds")
    pair = now.kind == "ONE_TWO"
    each = by_hand or pair or now.has("EACH")
    once = action.amounts if by_hand else {"times": 1.0}
    unclear = seconds and (times or each or now.pause or action.verb == "place")
    now.refuse(unclear, "has a time for hands in turn; say how often instead")
    either = now.last == "times" and now.text.startswith("alternat") and not now.has("EACH")
    now.refuse(either, "can count single moves or pairs; say how many for each hand")
    now.refuse(now.has("ONE_EACH") and times not in (None, 2.0), "says once for each of two hands, and another count")
    rights = now.words.get("LEFT_AND_RIGHT", [""])[0].startswith("right")
    order = BOTH[::-1] if rights else BOTH
    count = (1 if by_hand else int(times or 1)) * 2 if each else int(times or 2)
    if seconds:
        count = max(2, round(seconds * action.speed / ONE_GESTURE))
        once = {"times": 1.0, "seconds": seconds / count}
    once = {} if action.verb == "place" else once
    return _apart([[replace(action, sides=(order[n % 2],), amounts=dict(once))] for n in range(count)], now.pause)


def _at_once(group: list[Action], action: Action) -> bool:
    """Return whether "and" means at the same time: other hands, or hands and a walk without an end."""
    (other,) = group if len(group) == 1 else (action,)
    counted = "times" in (action if action.moves_trunk else other).amounts
    boxed = {action.verb, other.verb} <= {"punch", "hook", "uppercut"}
    if len(group) > 1 or boxed or (counted and action.moves_trunk != other.moves_trunk):
        return False
    if other.moves_base != action.moves_base:
        base = other if other.moves_base else action
        return base.verb == "walk" and not base.amounts
    return not other.moves_base and not set(other.sides) & set(action.sides)


def _together(groups: Groups, more: Groups) -> Groups:
    """Return groups with actions at the same time as the last group."""
    if len(more) > 1:
        raise SourceError("two things one after the other during another are not clear; say them in order")
    group = [action for action in groups[-1] if not _holds(action)]
    for action in (action for row in more for action in row if not _holds(action)):
        for other in group:
            _check_both(action, other)
        group.append(action)
    for base in (action for action in group if action.verb in ("walk", "wait") and "seconds" in action.amounts):
        seconds = {"seconds": base.amounts["seconds"]}
        group = [replace(a, amounts=seconds) if a.verb in GESTURES and not a.amounts else a for a in group]
    return [*groups[:-1], group]


def _holds(action: Action) -> bool:
    """Return whether an action only leaves the hands where they are."""
    return action.verb == "wait" and action.way == "hold" and not action.amounts


def _check_both(action: Action, other: Action) -> None:
    """Raise a SourceError if two actions cannot be done at the same time."""
    if other.moves_base == action.moves_base and (action.moves_base or set(other.sides) & set(action.sides)):
        who = "the robot" if action.moves_base else f"the {action.sides[0]} hand"
        raise SourceError(f"{who} cannot {other.verb} and {action.verb} at the same time")


def _once(action: Action) -> Action:
    return replace(action, amounts={**action.amounts, "times": 1.0})


def _apart(groups: Groups, pause: float) -> Groups:
    """Return groups with a pause [s] between them."""
    wait = [[Action(verb="wait", amounts={"seconds": pause})]] if pause else []
    return [part for n, group in enumerate(groups) for part in ([*wait, group] if n else [group])]
