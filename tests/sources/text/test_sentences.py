"""200 natural sentences, measured on the key frames of the phrasebook; and whether the checks can fail."""

from __future__ import annotations

import dataclasses
from collections import Counter

import pytest

from lab.sentences.checks import MORE, SENTENCES, Sentence, does, sentences
from mimic.errors import SourceError
from mimic.io.keyframes import KeyFrames
from mimic.robot.description import load_description
from mimic.robot.reach import Reach
from mimic.sources.text.grammar import plan_by_grammar


@pytest.fixture(scope="module")
def reach() -> Reach:
    return Reach(load_description("cyberdog2"))


@pytest.fixture(scope="module")
def planned(reach) -> list[tuple[Sentence, KeyFrames | None]]:
    """Each sentence with its motion; None where it was refused."""
    found = []
    for sentence in sentences():
        try:
            found.append((sentence, plan_by_grammar(sentence.text, reach)))
        except SourceError:
            found.append((sentence, None))
    return found


def test_there_are_200_sentences_and_half_are_held_out():
    assert Counter(sentence.held_out for sentence in sentences()) == {True: 100, False: 100}
    assert len({sentence.text.lower() for sentence in sentences()}) == 200


@pytest.mark.parametrize("held_out", [False, True])
def test_three_fifths_of_each_half_are_executed(held_out, planned):
    assert sum(motion is not None for sentence, motion in planned if sentence.held_out == held_out) >= 60


def test_none_is_silently_wrong(planned, reach):
    assert [s.text for s, motion in planned if motion is not None and not does(motion, s, reach)] == []


@pytest.mark.slow
@pytest.mark.parametrize("held_out", [False, True])
def test_of_more_sentences_none_is_wrong_and_three_quarters_of_the_possible_are_executed(held_out, reach):
    outcomes = Counter()
    for sentence in (s for s in sentences(MORE) if s.held_out == held_out):
        try:
            outcomes["right" if does(plan_by_grammar(sentence.text, reach), sentence, reach) else sentence.text] += 1
        except SourceError:
            outcomes["refused" if "no" in sentence.readings else f"refused: {sentence.text}"] += 1
    assert outcomes.keys() == {"right", "refused"}
    assert outcomes["right"] >= 60


def mirrored(motion: KeyFrames) -> KeyFrames:
    """Left for right: hands and turns."""
    mirror = [-1, 1, 1, -1, 1, 1]
    frames = (
        dataclasses.replace(frame, q=frame.q[[3, 4, 5, 0, 1, 2]] * mirror, heading=-frame.heading)
        for frame in motion.frames
    )
    return dataclasses.replace(motion, frames=tuple(frames))


def without_its_last_part(motion: KeyFrames) -> KeyFrames:
    parts = list(dict.fromkeys(frame.what for frame in motion.frames))
    return dataclasses.replace(motion, frames=tuple(frame for frame in motion.frames if frame.what != parts[-1]))


def twice(motion: KeyFrames) -> KeyFrames:
    end = motion.frames[-1].heading
    again = (dataclasses.replace(frame, heading=frame.heading + end) for frame in motion.frames)
    return dataclasses.replace(motion, frames=(*motion.frames, *again))


def a_fifth_more(motion: KeyFrames) -> KeyFrames:
    """Each turn and walk is 20 % longer."""
    frames = (
        dataclasses.replace(f, heading=1.2 * f.heading, velocity=(1.2 * f.velocity[0], 0.0)) for f in motion.frames
    )
    return dataclasses.replace(motion, frames=tuple(frames))


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (mirrored, "punch twice with the right, then once with the left"),
        (mirrored, "Raise your left hand, then your right hand."),
        (mirrored, "turn right by ninety degrees"),
        (without_its_last_part, "Raise your left hand, then your right hand."),
        (without_its_last_part, "step forward. Wave. Step back."),
        (twice, "raise the left hand up and down three times"),
        (twice, "wave both arms five times"),
        (twice, "turn right by ninety degrees"),
        (a_fifth_more, "Rotate 30 degrees to the left"),
        (a_fifth_more, "walk forward 1.2m"),
        (a_fifth_more, "one step forward, two steps back"),
    ],
)
def test_the_checks_reject_a_motion_that_does_something_else(spoil, sentence, planned, reach):
    (given, motion), *_ = [item for item in planned if item[0].text.lower() == sentence.lower()]
    assert motion is not None
    assert does(motion, given, reach)
    assert not does(spoil(motion), given, reach)


def test_the_checks_see_the_order(planned, reach):
    for text, other in [
        ("Raise your left hand, then your right hand.", "raise the right hand, then the left hand"),
        ("wave the left hand after stepping forward", "wave the left hand, then step forward"),
        ("wave the left hand after stepping forward", "wave the left hand while stepping forward"),
    ]:
        (given, _), *_ = [item for item in planned if item[0].text == text]
        assert not does(plan_by_grammar(other, reach), given, reach)


@pytest.mark.parametrize("name", ["people.txt", "people_2.txt"])
def test_of_thirty_sentences_of_many_kinds_of_people_22_are_executed_and_none_is_wrong(name, reach):
    outcomes = Counter()
    for sentence in sentences(SENTENCES.with_name(name)):
        try:
            outcomes["right" if does(plan_by_grammar(sentence.text, reach), sentence, reach) else sentence.text] += 1
        except SourceError:
            outcomes["refused"] += 1
    assert outcomes.keys() == {"right", "refused"}
    assert outcomes["right"] >= 22
