"""A sentence -> groups of actions: groups one after the other, the actions of a group at the same time.

Every word is used or the sentence is refused: an amount, side or direction that its verb does not take is an error.

Longer than 350 lines: one class, whose methods share what was said before.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from mimic.errors import SourceError
from mimic.sources.text import lexicon as words
from mimic.sources.text.phrases import Phrase, phrases, set_amount, whole

BASE = ("step", "walk", "turn", "stop", "wait")
"""Verbs of the base; all others move hands."""
_OPPOSITE = {"left": "right", "right": "left"}
_AMOUNTS = {
    "step": ("times", "seconds", "metres", "m/s"),
    "walk": ("seconds", "metres", "m/s"),
    "turn": ("degrees", "seconds"),
    "stop": ("seconds",),
    "wait": ("seconds",),
    "wave": ("times", "seconds"),
    "punch": ("times", "seconds"),
    "cycle": ("times", "seconds"),
    "place": ("seconds",),
}
"""Amounts that a verb takes."""
_BARE_DEGREES = 10.0
"""A number without a unit after "turn" is degrees from here on: "turn left 45"."""


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


def parse(sentence: str) -> list[list[Action]]:
    """Return what a sentence asks for.

    Raises:
        SourceError: If a word is unknown, or anything said is not used by the action to which it belongs.
    """
    found = phrases(words.tokens_of(sentence))
    if not found:
        raise SourceError(f"the sentence has no verb; say what to do with one of {', '.join(words.VERBS)}")
    return _groups(_Resolver().actions(found))


class _Resolver:
    """Turns phrases into actions in the order in which they are said; knows which hands moved last."""

    def __init__(self) -> None:
        self.hands: tuple[str, ...] = ()
        self.before: tuple[Phrase, Action] | None = None

    def actions(self, phrases: list[Phrase]) -> list[tuple[str, Action, bool]]:
        """Return each action with how it is joined, and whether it is said to be at the same time."""
        merged: list[Phrase] = []
        for phrase in phrases:
            if phrase.bare and merged and phrase.joint in ("then", ",", "and"):
                self._merge(merged[-1], phrase)
            else:
                merged.append(phrase)
        found: list[tuple[str, Action, bool]] = []
        at = 0
        while at < len(merged):
            phrase = merged[at]
            following = merged[at + 1] if at + 1 < len(merged) else None
            if following is not None and _raises_and_lowers(phrase, following):
                following = replace(following, verb="raise", word="raise", ways=["up and down"], joint=phrase.joint)
                phrase, at = following, at + 1
            found.append((phrase.joint, self._action(phrase), phrase.together))
            at += 1
        return found

    def _merge(self, onto: Phrase, phrase: Phrase) -> None:
        for name, value in phrase.amounts.items():
            set_amount(onto, name, value)
        if phrase.number is not None:
            raise SourceError(f"the number {phrase.number:g} has no unit; say seconds, times, steps, degrees or metres")
        onto.duration = phrase.duration or onto.duration
        onto.together = onto.together or phrase.together
        if phrase.speed is not None:
            if onto.speed is not None:
                raise SourceError(f"{onto.quoted()} has two paces; say one")
            onto.speed = phrase.speed

    def _action(self, phrase: Phrase) -> Action:
        self._complete(phrase)
        if phrase.number is not None:
            self._bare_number(phrase)
        if phrase.turned and phrase.verb != "turn":
            raise SourceError(f"{phrase.quoted()}: only the whole robot turns")
        if phrase.duration == "no time":
            raise SourceError(
                f"{phrase.quoted()}: 'for', 'in', 'within' and 'over' need a time, such as 'for 3 seconds'"
            )
        if phrase.greeting and phrase.verb != "wave":
            raise SourceError(f"{phrase.greeting!r} only goes with 'wave', not with {phrase.word!r}")
        action = self._base(phrase) if phrase.verb in BASE else self._of_hands(phrase)
        self._check_amounts(action, phrase)
        if not action.moves_base:
            self.hands = action.sides
        self.before = phrase, action
        return action

    def _complete(self, phrase: Phrase) -> None:
        """Find the verb of a phrase without one: "left hand up", "then the right"; tell moving a hand from walking."""
        hand = bool(phrase.nouns or phrase.pronoun or phrase.other)
        if phrase.verb == "move":
            phrase.verb = "place" if hand else "walk"
        elif phrase.verb == "hold":
            phrase.verb = "place" if phrase.ways else "wait"
            if phrase.verb == "wait":  # "hold it", "hold your arms there": nothing moves
                phrase.nouns, phrase.pronoun, phrase.said_sides, phrase.other = [], "", [], False
        if phrase.verb:
            return
        if phrase.nouns and phrase.ways:
            phrase.verb = phrase.word = "place"
            return
        if self.before is None:
            raise SourceError(f"{phrase.quoted()} has no verb; begin with one of {', '.join(words.VERBS)}")
        said, action = self.before
        sided = bool(phrase.said_sides) or hand
        fits = (
            (not action.moves_base and sided and not phrase.ways)
            or (action.verb == "turn" and bool(phrase.said_sides) and not hand and not phrase.ways)
            or (action.verb in ("walk", "step") and bool(phrase.ways) and not sided)
        )
        if not fits:
            raise SourceError(f"{phrase.quoted()} has no verb; begin with one of {', '.join(words.VERBS)}")
        if said.amounts and not phrase.amounts and phrase.number is None:
            raise SourceError(f"{phrase.quoted()} does not say how far, how long or how often; say it for each")
        if action.verb == "wave" and not (said.nouns or phrase.nouns):
            raise SourceError("'wave left and right' can mean two things; say with which hand, or with both hands")
        phrase.verb, phrase.word = said.verb, said.word
        phrase.ways = phrase.ways or (list(said.ways) if not action.moves_base else [])

    def _bare_number(self, phrase: Phrase) -> None:
        if phrase.verb == "turn" and "degrees" not in phrase.amounts and (phrase.number or 0) >= _BARE_DEGREES:
            phrase.amounts["degrees"], phrase.number = phrase.number or 0.0, None
            return
        raise SourceError(
            f"the number {phrase.number:g} in {phrase.quoted()} has no unit; say seconds, times, steps, degrees, "
            "metres or m/s"
        )

    def _base(self, phrase: Phrase) -> Action:
        verb, sides = phrase.verb, phrase.said_sides
        if phrase.nouns or phrase.pronoun or phrase.other:
            raise SourceError(f"{phrase.quoted()}: to {phrase.word} is not something a hand does")
        if verb == "turn":
            return self._turn(phrase)
        if sides:
            raise SourceError(f"the robot does not {phrase.word} sideways; turn {sides[0]} first")
        if verb in ("stop", "wait") and (phrase.ways or phrase.speed):
            raise SourceError(f"{phrase.quoted()}: to {phrase.word} takes a time and nothing else")
        ways = set(phrase.ways)
        if not ways <= {"forward", "back"} or len(ways) > 1:
            raise SourceError(f"to {phrase.word} {' '.join(phrase.ways)!r} is not something the robot does")
        if phrase.speed is not None and "m/s" in phrase.amounts:
            raise SourceError(f"{phrase.quoted()} has two speeds; say one")
        return Action(
            verb=verb,
            way=next(iter(ways), "forward" if verb in ("walk", "step") else ""),
            amounts=phrase.amounts,
            speed=phrase.speed or 1.0,
        )

    def _turn(self, phrase: Phrase) -> Action:
        sides = [side for side in phrase.said_sides if side in _OPPOSITE]
        degrees = phrase.amounts.get("degrees")
        if [way for way in phrase.ways if way != "around"]:
            raise SourceError(f"to turn {' '.join(phrase.ways)!r} is not something the robot does")
        if phrase.ways and degrees is None:
            raise SourceError("'around' does not say how far; say turn around, or a number of degrees")
        if len(sides) != len(phrase.said_sides) or len(sides) > 1 or not (sides or degrees in (180.0, 360.0)):
            raise SourceError("say where to turn, to one side: turn left, or turn right 60 degrees")
        if degrees is not None and degrees <= 0:
            raise SourceError(f"{degrees:g} degrees is no turn; say left or right and a positive angle")
        return Action(
            verb="turn", sides=(sides[0] if sides else "left",), amounts=phrase.amounts, speed=phrase.speed or 1.0
        )

    def _of_hands(self, phrase: Phrase) -> Action:
        sides, way, verb = self._sides(phrase), "", phrase.verb
        ways = set(phrase.ways)
        if verb in ("place", "extend") and not (phrase.nouns or phrase.pronoun or phrase.other):
            raise SourceError(
                f"{phrase.quoted()} does not say what to {phrase.word}; say left hand, right hand or both hands"
            )
        if phrase.word in ("open", "opening") and {"hand", "hands", "fist", "fists"} & set(phrase.nouns):
            raise SourceError("the robot has no fingers to open; say open the left arm, right arm or both arms")
        if verb in ("wave", "punch"):
            if not ways <= ({"up and down"} if verb == "wave" else {"forward"}):
                raise SourceError(f"to {phrase.word} {' '.join(phrase.ways)!r} is not something the phrasebook does")
        elif ways == {"up and down"} and verb in ("raise", "place"):
            verb = "cycle"
        else:
            way, repeated = _posture(phrase), phrase.amounts.get("times", 1.0) != 1.0
            verb = "place"
            if repeated and phrase.verb == "raise" and way == "up":
                verb = "cycle"
        amounts = dict(phrase.amounts)
        if verb == "place":
            amounts = {name: value for name, value in amounts.items() if (name, value) != ("times", 1.0)}
        return Action(
            verb=verb, sides=sides, way=way, amounts=amounts, stays=phrase.duration != "in", speed=phrase.speed or 1.0
        )

    def _sides(self, phrase: Phrase) -> tuple[str, ...]:
        """Return the hands that a phrase names."""
        said = phrase.said_sides
        both = "both" in said or "and" in said
        if phrase.pronoun or phrase.other:
            if said or phrase.nouns != (phrase.nouns if phrase.other else []) or not self.hands:
                raise SourceError(f"{phrase.quoted()} does not say which hand; say left, right or both")
            if phrase.pronoun and phrase.pronoun == "it" and len(self.hands) > 1:
                raise SourceError("'it' is one hand, and both moved before; say left, right or both")
            if not phrase.other:
                return self.hands
            if len(self.hands) != 1:
                raise SourceError("'the other' is not clear where both hands moved; say left or right")
            (hand,) = self.hands
            return (_OPPOSITE[hand],)
        if both:
            if [side for side in said if side in _OPPOSITE] not in ([], ["left", "right"], ["right", "left"]):
                raise SourceError(f"{phrase.quoted()} names its hands twice; say left, right or both")
            return ("left", "right")
        if len(said) > 1 or len(phrase.nouns) > 1:
            raise SourceError(f"{phrase.quoted()} names more than one hand; join them with 'and' or 'then'")
        if said:
            return (said[0],)
        if phrase.nouns:
            if words.HANDS[phrase.nouns[0]] == 2:
                return ("left", "right")
            if phrase.verb in ("lower", "place") and self.hands:
                return self.hands
            return ("right",)
        if phrase.verb in ("wave", "punch"):
            return ("right",)
        raise SourceError(f"{phrase.quoted()} does not say which hand; say left hand, right hand or both hands")

    def _check_amounts(self, action: Action, phrase: Phrase) -> None:
        for name, value in action.amounts.items():
            if name not in _AMOUNTS[action.verb]:
                raise SourceError(
                    f"{phrase.quoted()}: {phrase.word or action.verb!r} does not use {value:g} {name}; it takes "
                    f"{', '.join(_AMOUNTS[action.verb])}"
                )
            if not value > 0:
                raise SourceError(f"{phrase.quoted()}: {value:g} {name} is too little; expected more than 0")
            if name == "times":
                whole(value, "times")
        if {"metres", "seconds", "m/s"} <= action.amounts.keys() or {"times", "metres"} <= action.amounts.keys():
            raise SourceError(f"{phrase.quoted()} says too much at once: {', '.join(action.amounts)}")


def _raises_and_lowers(phrase: Phrase, following: Phrase) -> bool:
    """Return whether two phrases are "raise and lower the left hand"."""
    alone = phrase.verb == "raise" and not (phrase.names_hand or phrase.ways or phrase.amounts or phrase.speed)
    return alone and following.joint == "and" and following.verb == "lower" and not following.ways


def _posture(phrase: Phrase) -> str:
    """Return the posture that a verb and its directions mean."""
    ways = set(phrase.ways)
    if "forward" in ways or "side" in ways:
        ways -= {"out"}
    if len(ways) > 1 and ways != {"up", "out"} and ways != {"up", "side"}:
        raise SourceError(f"{phrase.quoted()} has two directions; say one of up, down, forward, to the side")
    way = next(iter(ways), "") if len(ways) < 2 else "up and out"
    if phrase.verb == "open":
        found = {"": "open", "out": "open", "side": "open", "up": "high and open", "up and out": "high and open"}
    elif phrase.verb == "raise":
        found = {"": "up", "up": "up", "forward": "forward", "side": "open", "out": "open"}
    elif phrase.verb == "lower":
        found = {"": "down", "down": "down"}
    elif phrase.verb == "extend":
        found = {"forward": "forward", "side": "open", "up": "up", "down": "down"}
        if phrase.word in ("extend", "extending", "point", "pointing"):
            found[""] = "forward"
    else:
        found = {"up": "up", "down": "down", "forward": "forward", "side": "open", "out": "open"}
    if way not in found:
        known = ", ".join(sorted({name for name in found if name}))
        raise SourceError(f"{phrase.quoted()}: {phrase.word!r} needs one of these directions: {known}")
    return found[way]


# ---------------------------------------------------------------------- actions to groups


def _groups(actions: list[tuple[str, Action, bool]]) -> list[list[Action]]:
    groups: list[list[Action]] = []
    waiting = ""
    """The joining word with which the sentence began, until its main action comes: "before turning left, wave"."""
    last = ""
    """The joining word of the action before."""
    closed = False
    """Whether the sentence began with "before" and has its main action."""
    for joint, action, together in actions:
        if closed or (
            not waiting
            and joint in (",", "and")
            and last in ("before", "after", "while")
            and (joint, last) != ("and", "before")
        ):
            raise SourceError(f"what comes behind {last!r} and two actions is not clear; say 'then', or two sentences")
        if waiting:
            if joint not in (",", "then"):
                raise SourceError(f"put a comma behind what follows {waiting!r} at the beginning, and one action there")
            if waiting == "before":
                groups.insert(0, [action])
            elif waiting == "after":
                groups.append([action])
            else:
                _join(groups[-1], action)
            closed, last, waiting = waiting == "before", waiting if waiting != "after" else "", ""
            continue
        if joint in ("before", "after", "while") and not groups:
            waiting = joint
            groups.append([action])
        elif joint == "after":
            if len(groups) > 1 or len(groups[0]) > 1:
                raise SourceError("'after' comes behind more than one action; say them in their order, with 'then'")
            groups.insert(0, [action])
        elif joint == "while" or (together and joint == "and"):
            _join(groups[-1], action)
        elif joint == "and" and _at_once(groups[-1], action):
            groups[-1].append(action)
        elif together and len(action.sides) < 2:
            raise SourceError("'at the same time' needs two actions joined by 'and'")
        else:
            groups.append([action])
        last = joint
    if waiting:
        raise SourceError(f"the sentence says nothing to do {waiting} that")
    return groups


def _join(group: list[Action], action: Action) -> None:
    """Add an action at the same time."""
    for other in group:
        if other.moves_base and action.moves_base:
            raise SourceError(
                f"to {other.verb} and to {action.verb} at the same time is not something the phrasebook does"
            )
        if not other.moves_base and not action.moves_base and set(other.sides) & set(action.sides):
            raise SourceError(f"the {action.sides[0]} hand cannot {other.verb} and {action.verb} at the same time")
    group.append(action)


def _at_once(group: list[Action], action: Action) -> bool:
    """Return whether "and" means at the same time: other hands, or hands and a walk without an end."""
    if len(group) > 1 or action.verb == group[0].verb == "punch":
        return False
    (other,) = group
    if other.moves_base != action.moves_base:
        base = other if other.moves_base else action
        return base.verb == "walk" and not base.amounts
    return not other.moves_base and not set(other.sides) & set(action.sides)
