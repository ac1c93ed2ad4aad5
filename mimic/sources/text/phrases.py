"""Words -> phrases: the words that belong to one action, collected."""

from __future__ import annotations

from dataclasses import dataclass, field

from mimic.errors import SourceError
from mimic.sources.text import lexicon as words


@dataclass(slots=True)
class Phrase:
    """The words that belong to one action, as they are collected."""

    joint: str
    """How it is joined to the phrase before."""
    verb: str = ""
    word: str = ""
    said_sides: list[str] = field(default_factory=list)
    nouns: list[str] = field(default_factory=list)
    pronoun: str = ""
    other: bool = False
    ways: list[str] = field(default_factory=list)
    amounts: dict[str, float] = field(default_factory=dict)
    number: float | None = None
    duration: str = ""
    speed: float | None = None
    together: bool = False
    turned: bool = False
    greeting: str = ""
    text: list[str] = field(default_factory=list)

    @property
    def empty(self) -> bool:
        """Whether nothing was said yet."""
        return not (self.verb or self.names_hand or self.ways or self.amounts or self.speed or self.together) and (
            self.number is None and not self.greeting
        )

    @property
    def names_hand(self) -> bool:
        """Whether it says which hands."""
        return bool(self.nouns or self.said_sides or self.pronoun or self.other)

    @property
    def bare(self) -> bool:
        """Whether it only adds an amount or a pace to the action before."""
        return not (self.verb or self.names_hand or self.ways or self.greeting)

    def quoted(self) -> str:
        """Return its words in quotes."""
        return "'" + " ".join(self.text) + "'"


def phrases(tokens: list[str]) -> list[Phrase]:
    """Return the phrases of a sentence in the order in which they are said.

    Raises:
        SourceError: If a word is unknown or belongs to no phrase.
    """
    found: list[Phrase] = []
    now = Phrase("then")
    joint = "then"
    for at, token in enumerate(tokens):
        following = tokens[at + 1] if at + 1 < len(tokens) else ""
        if token in words.SEPARATORS:
            found, now, joint = _closed(found, now), Phrase("then"), _stronger(joint if now.empty else "", "then")
            now.joint = "," if token == "," and joint == "then" else joint
            joint = now.joint
            continue
        if token in words.JOINTS and _joins(token, now, tokens, at):
            before = now.joint if now.empty else ""
            found = _closed(found, now)
            if before == "then" and found and token not in ("and", "with"):
                raise SourceError(f"{token!r} at the beginning of a part is not something the phrasebook does")
            now = Phrase(_stronger(before, "while" if token in ("as", "with") else token))
            continue
        if token in words.AUXILIARIES and following in words.VERB_OF and following.endswith("ing"):
            continue
        if token in words.VERB_OF:
            now, found = _verb(token, now, found)
        else:
            _add(now, token, following)
        now.text.append(token)
        joint = now.joint
    return _closed(found, now)


def _joins(token: str, now: Phrase, tokens: list[str], at: int) -> bool:
    """Return whether a joining word begins a new phrase here."""
    rest = [t for t in tokens[at + 1 :] if t not in words.FILLERS]
    if token == "with":
        until = next(
            (n for n, t in enumerate(rest) if t in words.SEPARATORS | words.JOINTS or t in words.VERB_OF), len(rest)
        )
        hand = any(t in words.HANDS for t in rest[:until])
        return hand and any(t in words.WAYS for t in rest[:until])
    if token == "and":
        sides = now.said_sides and not now.nouns and rest[:1] and rest[0] in words.SIDES
        if sides and any(t in words.HANDS for t in rest[1:2]):
            now.said_sides.append("and")
            return False
    if token == "after" and rest and words.is_number(rest[0]):
        raise SourceError("'after' and a time is not something the phrasebook does; say 'wait 3 seconds, then'")
    return True


_STRENGTH = ("", "and", ",", "then", "before", "after", "while")


def _stronger(one: str, other: str) -> str:
    return max(one, other, key=_STRENGTH.index)


def _closed(found: list[Phrase], now: Phrase) -> list[Phrase]:
    if now.empty and words.SUPPORT & set(now.text):
        raise SourceError(f"{now.quoted()} does not say what to do; begin with one of {', '.join(words.VERBS)}")
    return found if now.empty else [*found, now]


def _verb(token: str, now: Phrase, found: list[Phrase]) -> tuple[Phrase, list[Phrase]]:
    """Add a verb: to the phrase that has none, or as a phrase of its own."""
    verb = words.VERB_OF[token]
    counted = now.number is not None and token in words.NOUNS
    if counted and verb == "step" and now.verb in ("walk", "retreat", "step", "move"):
        now.amounts["times"], now.number = whole(now.number, token), None
        if now.verb == "retreat":
            now.ways.append("back")
        now.verb = "step"
        return now, found
    if counted and verb == now.verb:
        now.amounts["times"], now.number = whole(now.number, token), None
        return now, found
    if now.verb == "stop" and token.endswith("ing"):
        if verb in ("walk", "move", "step", "turn"):
            return now, found
        raise SourceError(f"'stop {token}' is not something the phrasebook does; say what to do instead")
    if now.verb:
        if not token.endswith("ing"):
            raise SourceError(f"{token!r} follows {now.quoted()} without 'then', 'and' or 'while' between them")
        found, now = _closed(found, now), Phrase("while")
    elif now.ways and not counted and verb != "turn":
        raise SourceError(f"{now.quoted()} stands before the verb {token!r}; put it after the verb")
    if counted and verb == "turn":
        raise SourceError(f"'{now.number:g} {token}' is not something the phrasebook does; say how many degrees")
    if counted:
        now.amounts["times"], now.number = whole(now.number, token), None
    if verb == "retreat":
        now.ways.append("back")
        verb = "walk"
    now.verb, now.word = verb, token
    return now, found


def whole(number: float | None, what: str) -> float:
    """Return a number that is a count.

    Raises:
        SourceError: If it is none.
    """
    if number is None or number != int(number) or number < 1:
        raise SourceError(f"{number:g} {what} is not a count; expected 1, 2, 3, …")
    return number


def _add(now: Phrase, token: str, following: str) -> None:
    """Add a word that is not a verb to a phrase."""
    if words.is_number(token):
        if now.number is not None:
            raise SourceError(f"two numbers follow one another, {now.number:g} and {token}; say what each one counts")
        now.number = float(token)
    elif token in words.TIMES:
        set_amount(now, "times", words.TIMES[token])
    elif token in words.UNITS:
        if now.number is None:
            raise SourceError(f"{token!r} in {now.quoted()} has no number")
        name, factor = words.UNITS[token]
        set_amount(now, name, now.number * factor)
        now.number = None
    elif token in words.FOR:
        now.duration = words.FOR[token] if words.is_number(following) else "no time"
    elif token in words.SPEEDS:
        if now.speed is not None:
            raise SourceError(f"{now.quoted()} has two paces; say one")
        now.speed = words.SPEEDS[token]
    elif token in words.SIDES:
        now.said_sides.append(words.SIDES[token])
    elif token in ("to-the-left", "to-the-right"):
        now.said_sides.append(token.removeprefix("to-the-"))
    elif token in words.WAYS:
        now.ways.append(words.WAYS[token])
    elif token in words.HANDS:
        now.nouns.append(token)
    elif token in words.PRONOUNS:
        now.pronoun = token
    elif token == "other":
        now.other = True
    elif token == "together":
        now.together = True
    elif token == "turned":
        now.turned = True
        if not now.verb:
            now.verb = now.word = "turn"
    elif token in words.GREETINGS:
        now.greeting = token


def set_amount(now: Phrase, name: str, value: float) -> None:
    """Note an amount; a phrase has one of each kind.

    Raises:
        SourceError: If it has one already.
    """
    if name in now.amounts:
        raise SourceError(f"{now.quoted()} has two amounts in {name}: {now.amounts[name]:g} and {value:g}; say one")
    now.amounts[name] = value
