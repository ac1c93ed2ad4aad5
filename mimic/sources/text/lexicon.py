"""The words of the phrasebook: what each one means, and how a sentence is cut into tokens.

A word that is not here is an error. So nothing that changes the meaning ("not", "halfway", "until") is skipped.
"""

from __future__ import annotations

import difflib
import re

from mimic.errors import SourceError

VERBS = {
    "step": ["step", "steps", "stepping"],
    "walk": ["walk", "walking", "walks", "go", "going", "march", "marching", "advance", "advancing"],
    "retreat": ["retreat", "retreating"],
    "move": ["move", "moving"],
    "stop": ["stop", "stopping", "stand", "standing", "halt", "freeze"],
    "turn": ["turn", "turning", "turns", "rotate", "rotating", "spin", "spinning", "face", "facing"],
    "wave": ["wave", "waving", "waves"],
    "raise": ["raise", "raising", "lift", "lifting"],
    "lower": ["lower", "lowering", "drop", "dropping"],
    "punch": ["punch", "punching", "punches", "box", "boxing", "jab", "jabs", "jabbing"],
    "open": ["open", "opening", "spread", "spreading"],
    "hold": ["hold", "holding", "keep", "keeping"],
    "wait": ["wait", "waiting", "pause", "pausing", "rest", "resting"],
    "place": ["put", "putting", "bring", "bringing"],
    "extend": ["stretch", "stretching", "extend", "extending", "reach", "reaching", "point", "pointing"],
}
"""For each verb its forms."""
VERB_OF = {form: verb for verb, forms in VERBS.items() for form in forms}
NOUNS = {"step", "steps", "turn", "turns", "wave", "waves", "punch", "punches", "jab", "jabs"}
"""Forms that can be counted: "two steps", "a left jab"."""

SPEEDS = {"slowly": 0.6, "slow": 0.6, "quickly": 1.5, "quick": 1.5, "fast": 1.5}
_SMALL = "zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen sixteen"
_SMALL += " seventeen eighteen nineteen"
_TENS = "twenty thirty forty fifty sixty seventy eighty ninety"
NUMBERS = {word: float(n) for n, word in enumerate(_SMALL.split())}
NUMBERS |= {word: 10.0 * n for n, word in enumerate(_TENS.split(), 2)}
TIMES = {"once": 1.0, "twice": 2.0, "thrice": 3.0}
UNITS: dict[str, tuple[str, float]] = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), ("seconds", 1.0)),
    **dict.fromkeys(("minute", "minutes"), ("seconds", 60.0)),
    **dict.fromkeys(("time", "times", "x"), ("times", 1.0)),
    **dict.fromkeys(("deg", "degree", "degrees", "°"), ("degrees", 1.0)),
    **dict.fromkeys(("rad", "radian", "radians"), ("degrees", 57.29577951)),
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), ("metres", 1.0)),
    **dict.fromkeys(("cm", "centimetre", "centimetres", "centimeter", "centimeters"), ("metres", 0.01)),
    **dict.fromkeys(("foot", "feet", "ft"), ("metres", 0.3048)),
    **dict.fromkeys(("inch", "inches"), ("metres", 0.0254)),
    "m/s": ("m/s", 1.0),
    "cm/s": ("m/s", 0.01),
}
SIDES = {"left": "left", "right": "right", "both": "both"}
WAYS = {
    **dict.fromkeys(("forward", "forwards", "ahead", "front"), "forward"),
    **dict.fromkeys(("backward", "backwards", "back"), "back"),
    **dict.fromkeys(("up", "upward", "upwards", "overhead", "raised", "lifted"), "up"),
    **dict.fromkeys(("down", "downward", "downwards", "lowered"), "down"),
    **dict.fromkeys(("sideways", "outward", "outwards"), "side"),
    "out": "out",
    "up-and-down": "up and down",
    "around": "around",
}
HANDS = {"hand": 1, "arm": 1, "fist": 1, "paw": 1, "hands": 2, "arms": 2, "fists": 2, "paws": 2}
"""Singular or plural."""
PRONOUNS = {"it", "them"}
SEPARATORS = {",", ";", ".", "!", "?", "then"}
JOINTS = {"and", "while", "as", "with", "before", "after"}
"""Words that join two actions; "with" only before a hand."""
FOR = {"for": "for", "in": "in", "within": "in", "over": "in"}
"""How a duration counts: what a posture is held for, or what a movement takes."""
FILLERS = {
    "the", "your", "its", "his", "her", "my", "please", "robot", "to", "of", "at", "by", "you", "now", "kindly", "also",
    "is", "are",
}  # fmt: skip
"""Words without a meaning of their own here."""
SUPPORT = {"do", "make", "take", "throw", "there", "that", "again", "still", "straight"}
"""Words that add nothing to an action, but are no action by themselves: "do that again" is an error."""
GREETINGS = {"hello", "hi", "goodbye", "bye", "me", "audience", "crowd", "camera", "everyone", "people"}
"""What only "wave" may be followed by."""
AUXILIARIES = {"start", "begin", "keep", "continue", "starting", "go"}
"""Dropped before a verb in -ing: "keep walking"."""

_PHRASES = (
    (r"\b(?:would|could|can|will) you(?: please| kindly)?\b|\bi(?:'d| would)? (?:want|like) you to\b", " "),
    (r"\bup and down\b", " up-and-down "),
    (r"\b(?:at the same time|simultaneously|at once|together)\b", " together "),
    (r"\b(?:after that|after this|afterwards?|next|finally|later|lastly)\b", " then "),
    (r"\bfirst\b", " "),
    (r"\bstay (?:where you are|still|there|in place)\b|\bremain (?:still|there)\b", " stop "),
    (r"\bhold still\b", " wait "),
    (r"\bsay (?:hello|hi|goodbye|bye)\b", " wave "),
    (r"\b(?:in front(?: of (?:you|me|yourself))?|to the front|out in front(?: of you)?)\b", " forward "),
    (r"\bto (?:the|your|both) sides?\b", " sideways "),
    (r"\b(?:by|at) your sides?\b", " down "),
    (r"\b(?:above|over) (?:your|the) head\b|\b(?:in|into) the air\b", " up "),
    (r"\b(?:to|toward|towards) the (?:sky|ceiling)\b", " up "),
    (r"\bwide open\b|\bopen wide\b", " open "),
    (r"\bspread (your |both |the )?(arms|hands) wide\b", r" spread \1\2 "),
    (r"\bfront (left |right )?(?:paw|leg)\b", r" \1hand "),
    (r"\bfront (?:paws|legs)\b", " hands "),
    (r"\b(left|right) (?:cross|straight)\b", r" \1 punch "),
    (r"\bone (hand|arm|fist|paw)\b", r" \1 "),
    (r"\b(?:the )?(left|right|other) one\b", r" \1 hand "),
    (r"\b(?:with )?(your |both |the )?(arms|hands) spread\b", r" with \1\2 sideways "),
    (r"\bcounter ?clockwise\b|\banti ?clockwise\b", " to-the-left "),
    (r"\bclockwise\b", " to-the-right "),
    (r"\ball the way (?:a?round)\b|\b(?:a )?(?:full|complete) (?:turn|circle|rotation)\b", " 360 degrees turned "),
    (r"\b(?:a )?half[ -]turn\b", " 180 degrees turned "),
    (r"\b(?:a )?quarter[ -]turn\b", " 90 degrees turned "),
    (r"\bturn(?:ing)? (?:a)?round\b", " turn 180 degrees "),
    (r"(^|[,;.!?]|\bthen|\band|\byou)\s+back up\b", r"\1 walk back "),
    (r"\b(?:met(?:re|er)s?|m) (?:per|a) second\b", " m/s "),
    (r"\b(?:centimet(?:re|er)s?|cm) (?:per|a) second\b", " cm/s "),
    (r"\bone and a half\b", " 1.5 "),
    (r"\b(?:a|one) (met(?:re|er)|second|minute|foot) and a half\b", r" 1.5 \1 "),
    (r"\b(\w+) and a half (?=met|sec|min|m\b|s\b|feet)", r" \1 half-more "),
    (r"\bhalf (?:a|an|of a)\b|\bhalf (?=met(?:re|er)|second|minute)", " 0.5 "),
    (r"\bright (?:now|away)\b", " now "),
    (r"\ba quarter of a\b", " 0.25 "),
    (r"\ba couple of\b|\ba couple\b", " 2 "),
)  # fmt: skip

_TOKEN = re.compile(r"\d+(?:\.\d+)?|\.\d+|c?m/s|[a-z]+(?:-[a-z]+)*|[,;.!?°]|\S")


def tokens_of(sentence: str) -> list[str]:
    """Return the words of a sentence; numbers in words become digits.

    Raises:
        SourceError: If a word or sign is unknown; it is named with the nearest known words.
    """
    text = " " + " ".join(sentence.lower().replace("’", "'").split()) + " "
    if found := re.search(r"\d,\d|\d\s*[-–]\s*\d|[-–−]\s*\d|\d\s*%", text):
        raise SourceError(f"'{found.group().strip()}' is not a number of the phrasebook; write 45, 1.5 or three")
    for pattern, replacement in _PHRASES:
        text = re.sub(pattern, replacement, text)
    tokens: list[str] = []
    for token in _TOKEN.findall(text):
        tokens += _split(token)
    tokens = _joined_numbers(tokens)
    unknown = list(dict.fromkeys(token for token in tokens if not is_number(token) and token not in KNOWN))
    if unknown:
        raise SourceError(_unknown(unknown))
    return tokens


def is_number(token: str) -> bool:
    """Return whether a token is a number in digits."""
    return token[:1].isdigit() or (len(token) > 1 and token[0] == ".")


def _split(token: str) -> list[str]:
    """Split words at hyphens unless they are known with it ("forty-five")."""
    return [token] if token in KNOWN or "-" not in token else token.split("-")


def _joined_numbers(tokens: list[str]) -> list[str]:
    """Replace numbers in words by digits: forty five, a hundred and eighty; "a" before a unit is 1."""
    found: list[str] = []
    at = 0
    while at < len(tokens):
        value, used = _number_at(tokens, at)
        if used:
            found.append(f"{value:g}")
            at += used
        elif tokens[at] in ("a", "an"):
            following = next((t for t in tokens[at + 1 :] if t not in SIDES and t not in SPEEDS), "")
            if following in UNITS or following in NOUNS:
                found.append("1")
            at += 1
        else:
            found.append(tokens[at])
            at += 1
    return found


def _number_at(tokens: list[str], at: int) -> tuple[float, int]:
    """Return the number that begins at a token, and how many tokens it takes; 0 for none."""
    start = at
    value, seen = 0.0, False
    word = tokens[at]
    if word in ("a", "one", "two", "three") and tokens[at + 1 : at + 2] == ["hundred"]:
        value, seen, at = 100.0 * (1.0 if word == "a" else NUMBERS[word]), True, at + 2
        if tokens[at : at + 1] == ["and"] and tokens[at + 1 : at + 2] and tokens[at + 1] in NUMBERS:
            at += 1
    elif word == "hundred":
        value, seen, at = 100.0, True, at + 1
    if at < len(tokens) and tokens[at] in NUMBERS:
        first = NUMBERS[tokens[at]]
        value, seen, at = value + first, True, at + 1
        if first >= 20 and at < len(tokens) and 0 < NUMBERS.get(tokens[at], 0.0) < 10:
            value, at = value + NUMBERS[tokens[at]], at + 1
    if not seen and is_number(word):
        value, seen, at = float(word), True, at + 1
    if seen and at < len(tokens) and tokens[at] == "half-more":
        value, at = value + 0.5, at + 1
    return value, (at - start if seen else 0)


def _unknown(words: list[str]) -> str:
    named = []
    for word in words[:6]:
        near = difflib.get_close_matches(word, sorted(KNOWN), n=3, cutoff=0.6)
        named.append(f"{word!r}" + (f" (near: {', '.join(near)})" if near else ""))
    return (
        f"the phrasebook has no word {', '.join(named)}; its verbs are {', '.join(VERBS)}; docs/manual/text.md has the "
        "phrasebook, or ask a language model with --planner llm"
    )


KNOWN = frozenset(
    {"a", "an", "hundred", "half-more", "together", "other", "turned", "to-the-left", "to-the-right"}
    | VERB_OF.keys()
    | SPEEDS.keys()
    | NUMBERS.keys()
    | TIMES.keys()
    | UNITS.keys()
    | SIDES.keys()
    | WAYS.keys()
    | HANDS.keys()
    | PRONOUNS
    | SEPARATORS
    | JOINTS
    | FOR.keys()
    | FILLERS
    | SUPPORT
    | GREETINGS
    | AUXILIARIES
)
"""Every word that is understood."""
