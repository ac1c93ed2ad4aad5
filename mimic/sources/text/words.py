"""A sentence -> words that `sentence.lark` knows: mistyped words corrected, words that carry no motion dropped."""

from __future__ import annotations

import re
from functools import cache
from importlib.resources import files
from typing import Any

from lark import Lark
from lark.lexer import PatternRE

from mimic.errors import SourceError

VERBS = {
    "STEP", "WALK", "MOVE", "STOP", "WAIT", "HOLD", "TURN", "SPIN", "WAVE", "PUNCH", "JAB", "CROSS", "HOOK", "UPPERCUT",
    "CYCLE", "RAISE", "LOWER", "OPEN", "CLOSE", "PUT", "EXTEND", "STRETCH", "SWITCH",
    "CROUCH", "SQUAT", "BOW", "LEAN",
}  # fmt: skip
SHORTEST = 4  # letters of a word in which one may be wrong; two may have changed places in any
_REWRITTEN = (  # phrases that mean others
    (r"\bback and forth\b", "forward and back"),
    (r"\bdo not\b", "don't"),
    (r"\bforward, march\b", "forward march"),
    (r"\bshadow ?(ing )?box(ing)?\b", r"\1punch in turn"),
    (r"\bretreat(ing)?\b", r"walk\1 back"),
    (r"\b(half|quarter)( of)? an? ", r"\1 "),
    (r"\ban?(other)? (?=(second|minute|met(re|er)|foot)\b)", "1 "),
    (r"\b(every|per) (?=second\b)", r"\1 1 "),
    (
        r"\b(jab|cross|hook|uppercut|punch|box|spin|wave|step)s? "
        r"(?=((left|right) )?(jab|cross|hook|uppercut)s?\b|\1\b)",
        r"\1, ",
    ),
    (r"\bone two (?=one two\b)", "one two, "),
    (r"\bthrow (?:an? )?(left|right)(?= (?:and|then|twice)\b|[,;.!?]|$)", r"\1 punch"),
    (r"(?<!left )(?<!right )\b(hand|arm|paw) (left|right) (?=(up|down|out|forward|to)\b)", r"\2 \1 "),
    (r"\b(hold|keep) (that|this)\b(?! (pose|position|posture|still))", r"\1 it"),
    (r"\b(two|three|four|five|six|seven|eight|nine|ten|\d+) each\b", r"\1 times each"),
)


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
    terminals = [terminal for terminal in grammar().terminals if kinds is None or terminal.name in kinds]
    text = " ".join(terminal.pattern.to_regexp() for terminal in terminals)
    text = re.sub(r"\(\?<?[=!](?:[^()]|\([^()]*\))*\)|\\\w", " ", text)
    found = re.findall(r"\b([a-z]+?)(s\?)?(?![a-z'])", text)
    return {word + ending for word, plural in found for ending in ("", "s" * bool(plural)) if len(word + ending) > 1}


@cache
def _english() -> set[str]:
    """Return common English words that are one letter from a word of the phrasebook."""
    return set(files("mimic.sources.text").joinpath("english.txt").read_text("utf-8").split())


@cache
def _known() -> tuple[dict[str, str], set[str]]:
    """Return the verbs by their forms on -ing, and all words that can be meant."""
    verbs = vocabulary({*VERBS, "ALTERNATE", "_DO"}) - vocabulary({"FILLER", "HAND", "_THEN", "SECONDS", "_ING"})
    gerunds = {form + "ing": verb for verb in verbs for form in (verb, verb.removesuffix("e"), verb + verb[-1])}
    return gerunds, vocabulary() | gerunds.keys()


def _meant(word: str) -> str:
    """Return the one known word that is one edit away from an unknown one, or the word itself.

    The first letter is right, or changed places with the second.
    """
    known = _known()[1]
    if len(word) < 3 or not word.isalpha() or word in known or word in _english():
        return word
    swaps = {word[:n] + word[n + 1] + word[n] + word[n + 2 :] for n in range(len(word) - 1)} & known
    parts = [(word[:n], word[n:]) for n in range(1, len(word) + 1)]
    letters = ["", *"abcdefghijklmnopqrstuvwxyz"]
    edits = {a + letter + b[cut:] for a, b in parts for letter in letters for cut in (0, 1)} & known
    near = swaps or (edits if len(word) >= SHORTEST else set())
    return min(near) if len(set(map(_kinds, near))) == 1 else word


def _kinds(word: str) -> tuple[str, ...]:
    """Return what a word is in the grammar."""
    return tuple(token.type for token in grammar().lex(word))


def prepared(sentence: str) -> tuple[str, dict[str, str]]:
    """Return a sentence in words of the grammar, and the mistyped words with what was read for them.

    Raises:
        SourceError: If it has a number that could be read in two ways.
    """
    text = sentence.lower().replace("’", "'")
    text = re.sub(r"(?<=\w)-(?=[a-z])|(?<=\d)(?=[a-z°])|\s+", " ", text)
    if found := re.search(r"\d,\d|\d\s*[-–]\s*\d|[-–−]\s*\d|\d\s*%", text):
        raise SourceError(f"'{found.group().strip()}' is not a number of the phrasebook; write 45, 1.5 or three")
    text = re.sub(r":|\s[-–—]+\s|—|–", ",", text)
    read = {word: _meant(word) for word in re.findall(r"[a-z']+", text)}
    gerunds = _known()[0]
    split = {word: f"ing {gerunds[meant]}" if meant in gerunds else meant for word, meant in read.items()}
    text = re.sub(r"[a-z']+", lambda found: split[found[0]], text)
    for phrase, meaning in _REWRITTEN:
        text = re.sub(phrase, meaning, text)
    text = re.sub(rf"(?<![\w'])(?:{grammar().get_terminal('FILLER').pattern.to_regexp()})", " ", text)
    text = re.sub(rf"\band after (?=(?:{'|'.join(set(gerunds.values()))})\b)", "then ", text)
    text = _after_what_is_done(" ".join(text.split()), gerunds)
    if found := re.search(r"\bstop ing (?!move)\w+", text):
        raise SourceError(f"'{found[0].replace(' ing', '')}': nothing goes on that could stop; say what to do instead")
    return re.sub(r"^([\s,;.!?]|(and|but|so)\b)+(ing )?|^ing |(?<=[,;.!?])\s*,|[\s,]+$", "", text), {
        word: meant for word, meant in read.items() if word != meant
    }


def _after_what_is_done(text: str, gerunds: dict[str, str]) -> str:
    """Return "after have turned" as "after ing turn"; behind a clause that says that, "after ing turn," is "then"."""
    done = {form.removesuffix("ing") + "ed": verb for form, verb in gerunds.items()}
    perfect = rf"\b(after|before) (?:have |has |having )?({'|'.join(done)})\b"
    text = re.sub(perfect, lambda found: f"{found[1]} ing {done[found[2]]}", text)
    return re.sub(r"\b([a-z]+)\b(.*?),? (?:and )?after ing \1,", r"\1\2, then", text)
