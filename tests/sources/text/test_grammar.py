from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mimic.errors import SourceError
from mimic.io.keyframes import KeyFrames
from mimic.robot.arm_mapping import posture
from mimic.robot.description import load_description
from mimic.robot.reach import Reach
from mimic.sources.text.feasibility import violations
from mimic.sources.text.grammar import plan_by_grammar
from mimic.sources.text.meaning import parse, vocabulary


@pytest.fixture(scope="module")
def reach() -> Reach:
    return Reach(load_description("cyberdog2"))


@pytest.fixture(scope="module")
def plan(reach):
    def say(sentence: str) -> KeyFrames:
        motion = plan_by_grammar(sentence, reach)
        assert violations(motion, reach, 120.0) == []
        return motion

    return say


def headings(motion: KeyFrames) -> list[float]:
    return [float(np.degrees(frame.heading)) for frame in motion.frames]


def test_the_paper_s_sentence_steps_stops_and_waves_the_left_hand(plan, reach):
    motion = plan("step forward, then stop and wave the left hand up and down")
    assert motion.frames[0].velocity[0] > 0
    assert all(frame.velocity == (0.0, 0.0) for frame in motion.frames[1:])
    home = reach.description.poses["upright"][3:6]
    assert all(np.allclose(frame.q[3:], home) for frame in motion.frames)
    heights = [reach.toes(frame.q)[0, 0] for frame in motion.frames[2:]]
    assert np.ptp(heights) > 0.1
    assert motion.planner == "grammar"


@pytest.mark.parametrize(
    ("sentence", "seconds"),
    [
        ("step forward", 1.75),
        ("take two steps back", 0.5 / 0.15 + 0.75),
        ("step forward 3 times", 3.75),
        ("walk for 4 seconds", 4.0),
        ("step forward, then step back", 1.75 + 0.25 / 0.15 + 1.65),
        ("start walking, then stop after 3 seconds", 3.5),
        ("walk two metres, then stop after 3 seconds", 8.75 + 3.0 + 0.5),
        ("punch every second for five seconds", 5.0),
        ("jab, jab, cross", 1.5 + 0.7 + 1.5),
        ("walk 0.5 metres at 0.2 m/s", 2.5),
        ("hold for 2.5 s", 2.5),
        ("raise both hands in 2 seconds", 2.0),
        ("raise both hands for 2 seconds", 2.8),
        ("wave for 5 seconds", 5.0),
        ("turn left 60 degrees", 2.0),
        ("raise the left hand; lower it", 1.6),
    ],
)
def test_a_sentence_takes_the_time_it_says(sentence, seconds, plan):
    assert plan(sentence).seconds == pytest.approx(seconds)


def test_backwards_is_backwards(plan):
    assert plan("walk backwards").frames[0].velocity[0] < 0
    assert plan("step back").frames[0].velocity[0] < 0


def test_slow_and_quick_change_the_pace(plan):
    assert plan("raise both hands slowly").seconds > plan("raise both hands").seconds
    assert plan("raise both hands quickly").seconds < plan("raise both hands").seconds
    assert plan("walk slowly").frames[0].velocity[0] < plan("walk").frames[0].velocity[0]


def test_turns_add_up_and_keep_their_side(plan):
    motion = plan("turn left 45 degrees, then turn right 90 degrees")
    assert headings(motion) == pytest.approx([45, -45])


def test_while_does_both_at_once(plan):
    motion = plan("walk forward while waving the right hand 3 times")
    assert all(frame.velocity[0] > 0 for frame in motion.frames)
    assert len(motion.frames) >= 6
    motion = plan("raise the left hand while turning left 60 degrees")
    assert motion.seconds == pytest.approx(2.0)
    assert headings(motion)[-1] == pytest.approx(60)


def test_a_step_while_waving_ends_before_the_wave(plan):
    motion = plan("step forward while waving the left hand 3 times")
    assert motion.frames[0].velocity[0] > 0
    assert motion.frames[-1].velocity[0] == 0


@pytest.mark.parametrize(("side", "moved"), [("left", (True, False)), ("right", (False, True)), ("both", (True, True))])
@pytest.mark.parametrize("verb", ["wave", "raise", "lower", "punch", "open"])
def test_only_the_side_that_was_named_moves(verb, side, moved, plan, reach):
    home = reach.description.poses["upright"][:6]
    motion = plan(f"{verb} the {side} arm" if side != "both" else f"{verb} both arms")
    q = np.stack([frame.q for frame in motion.frames])
    for part, does in zip((slice(0, 3), slice(3, 6)), moved, strict=True):
        assert (np.abs(q[:, part] - home[part]).max() > 0.05) == does


@pytest.mark.parametrize(
    ("typed", "meant"),
    [("rigth", "right"), ("foward", "forward"), ("punhc", "punch"), ("degress", "degrees"), ("wvae", "wave")],
)
def test_a_word_one_letter_from_one_word_is_read_as_that_and_said(typed, meant, plan):
    says = {"right": "turn {}", "forward": "walk {}", "degrees": "turn left 45 {}"}.get(meant, "{}")
    motion = plan(says.format(typed))
    assert motion.typed == ((typed, meant),)
    assert [frame.what for frame in motion.frames] == [frame.what for frame in plan(says.format(meant)).frames]


@pytest.mark.parametrize("word", ["talk", "have", "lunch", "not", "no", "jump", "sitting", "shake", "kneel"])
def test_an_english_word_is_never_taken_for_another_one(word, plan):
    with pytest.raises(SourceError, match=word):
        plan(f"wave, then {word}")


@pytest.mark.parametrize(
    ("sentence", "axis", "side"), [("hook with the right hand", 1, 1), ("uppercut with the left hand", 0, 0)]
)
def test_a_hook_comes_from_the_side_and_an_uppercut_from_below(sentence, axis, side, plan, reach):
    p = np.stack([reach.toes(frame.q)[side] for frame in plan(sentence).frames])
    guard = reach.toes(posture("guard", reach))[side]
    out = -(p[:, 1] - guard[1]) if axis == 1 else -(p[:, 0] - guard[0])
    assert np.argmax(out) == 1
    assert out[1] > 0.05
    assert out[2] < 0
    np.testing.assert_allclose(p[-1], guard, atol=1e-6)


def test_a_punch_goes_out_and_comes_back(plan, reach):
    motion = plan("punch with the right hand twice")
    out = [np.allclose(frame.q[3:], posture("forward", reach)[3:], atol=1e-6) for frame in motion.frames]
    assert out == [False, True, False, True, False]


def test_hands_stay_where_the_clause_before_left_them(plan, reach):
    motion = plan("raise the left hand, then hold for 1 second, then raise the right hand")
    np.testing.assert_allclose(motion.frames[-1].q, posture("up", reach), atol=1e-6)


@pytest.mark.parametrize(
    ("sentence", "message"),
    [
        ("jump", "has no word 'jump'"),
        ("wave the lft hand", "'lft' (near: "),
        ("don't raise the left hand", "only what not to do"),
        ("raise both hands without moving the left one", "said of something that the sentence asks for"),
        ("walk forward, turn left and come back", "'come back' does not say how"),
        ("come back", "'come back' does not say how far"),
        ("turn around and step back", "can mean backward or the way back"),
        ("lower both arms, then back up", "can mean the hands or the way back"),
        ("", "no verb"),
        ("please the robot", "no verb"),
        ("slowly", "no verb"),
        ("step left", "does not step sideways"),
        ("turn", "say where to turn"),
        ("turn both", "'both' behind 'turn'"),
        ("walk at 2 m/s", "up to 0.3 m/s"),
        ("wave the hand 5", "behind '5': "),
        ("hold seconds", "'seconds' behind 'hold'"),
        ("wave 1000 times", "more than"),
        ("wave 90 times, then wave 90 times", "more than"),
        ("turn up", "not something"),
        ("turn left, turn right, turn back", "not something"),
        ("raise both arms and do it all again", "up already"),
        ("don't move your arms", "only what not to do"),
    ],
)
def test_what_is_not_understood_is_reported_with_what_would_be(sentence, message, plan):
    with pytest.raises(SourceError) as error:
        plan(sentence)
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("sentence", "word"),
    [
        ("raise your left hand 45 degrees", "45 degrees"),
        ("lower the left hand twice", "2 times"),
        ("turn left three times", "3 times"),
        ("wave the left hand left", "more than one hand"),
        ("punch up", "'up'"),
        ("raise the left hand halfway", "'halfway'"),
        ("wave, but not with the left hand", "'not'"),
        ("turn -45 degrees", "'-4'"),
        ("walk 1,5 m", "'1,5'"),
        ("take 2-3 steps", "'2-3'"),
        ("walk 1 metre forward and back", "'back'"),
        ("turn left 45 degrees, then right", "'right'"),
        ("turn left 45 degrees 30 degrees", "45 and 30"),
        ("walk slowly at 0.1 m/s", "two speeds"),
        ("lift your left leg", "'leg'"),
        ("point left", "'point left'"),
        ("open your hand", "fingers"),
        ("walk forward while turning left", "at the same time"),
        ("raise the left hand while waving the left hand", "at the same time"),
        ("wave after stepping forward and turning right", "'turn' behind 'wave after"),
        ("raise your left hand, rest, raise it again", "up already"),
        ("repeat twice", "nothing to repeat"),
        ("wave, step forward, and repeat three times", "3 or 4 times in all"),
        ("wave, step forward, again", "all or the last"),
        ("stop waving", "nothing goes on"),
        ("raise both hands, not the left one", "'not'"),
        ("walk twice as far", "compares with nothing"),
        ("wave your left hand and punch, jumping", "'jump"),
        ("walk to me", "'me'"),
        ("wave for", "behind 'for': "),
        ("step forward 1.5 times", "1.5 times"),
    ],
)
def test_what_a_verb_does_not_use_is_an_error_and_never_dropped(sentence, word, plan):
    with pytest.raises(SourceError, match=r".") as error:
        plan(sentence)
    assert word.replace(" ", "") in str(error.value).replace(" ", "")


@pytest.mark.parametrize(
    ("sentence", "same"),
    [
        ("step forward and back twice", "step forward. step back. step forward. step back"),
        ("step back and forth twice", "step forward and back twice"),
        ("walk forward two metres and come back", "walk forward two metres, then walk back two metres"),
        ("walk 1 m, turn around and return to the start", "walk 1 m, turn around, walk 1 m"),
        ("do nothing for 3 seconds", "wait 3 seconds"),
        ("strike a T-pose, then lower your arms", "open both arms, then lower both arms"),
        ("shadow box for 6 seconds", "alternate punches for 6 seconds"),
        ("wave only after you have turned left", "turn left, then wave"),
        ("turn left, and after you have turned, wave", "turn left, then wave"),
        ("don't move your left arm, wave with the right", "wave with the right"),
        ("raise the right hand without moving the left one", "raise the right hand"),
        ("punch left and right twice", "punch left, then right, then left, then right"),
        ("wave the left hand and the right hand three times each", "wave both hands three times"),
        ("turn left and right twice", "turn left, then right, then left, then right"),
        ("walk forward and back slowly", "walk forward slowly, then walk back slowly"),
        ("walk forward and wave for 5 seconds", "walk forward for 5 seconds while waving for 5 seconds"),
        ("punch left and right, two each", "punch left twice, then punch right twice"),
        ("punch twice, one for each hand", "punch left, then punch right"),
        ("punch four times, alternating hands", "punch left, right, left, right"),
        ("throw four alternating punches", "punch left, right, left, right"),
        ("alternate left and right punches, two each", "punch left, right, left, right"),
        ("alternate right and left punches, one each", "punch right, then left"),
        ("wave twice with each hand", "wave the left hand twice, then the right hand twice"),
        ("wave before and after turning left", "wave, turn left, wave"),
        ("raise your left hand, then put it back down", "raise your left hand, then lower the left hand"),
        ("step forward twice with a pause of 2 seconds in between", "step forward, wait 2 s, step forward"),
        (
            "punch left and right twice, pausing 1 s in between",
            "punch left, wait 1 s, punch right, wait 1 s, punch left, wait 1 s, punch right",
        ),
        ("raise your hand and lower it after 3 seconds", "raise your hand, wait 3 s, then lower it"),
        ("move your left arm and your right arm up", "move both arms up"),
        ("raise your left hand and wave", "raise your left hand, then wave the left hand"),
        ("take two steps forward, then two back", "step forward twice, then step back twice"),
        ("turn left at half speed", "turn left in 6 seconds"),
        ("do a quick one-two punch", "punch left quickly, then punch right quickly"),
        ("throw two one-two punches", "punch left, right, left, right"),
        ("alternate left and right punches for 6 seconds", "alternate left and right punches in 6 seconds"),
        ("don't move for 5 seconds", "stand for 5 seconds"),
        ("open both arms and hold the pose for 2 seconds", "open both arms, wait 2 s"),
        ("face the other way", "turn around"),
        ("raise both hands as high as you can", "raise both hands"),
        ("raise the left arm to the side at shoulder height", "raise the left arm to the side"),
        ("raise both hands, then lower them both", "raise both hands, then lower both hands"),
        ("punch left, then wave, and do it all again", "punch left, then wave, punch left, then wave"),
        ("turn left 30 degrees, punch, then turn back", "turn left 30 degrees, punch, then turn right 30 degrees"),
        ("rotate 1.5 turns clockwise", "turn right 540 degrees"),
        ("walk another metre", "walk 1 m"),
        ("wave, do that again", "wave, then wave"),
        ("turn right, first wave", "wave, then turn right"),
        ("wave both hands, one at a time", "wave the left hand once, then the right hand once"),
        ("walk forward one metre, raising both arms", "raise both arms while walking forward one metre"),
        (
            "step forward, raising your right hand, and step back, lowering it",
            "raise the right hand while stepping forward, then lower the right hand while stepping back",
        ),
        ("for ten seconds walk forward", "walk forward for ten seconds"),
        ("step in, then step out", "step forward, then step back"),
        ("walk half a metre, then twice as far back", "walk 0.5 m, then walk back 1 m"),
        ("walk forward one metre and half of that back", "walk 1 m, then walk back 0.5 m"),
        ("step forward four times, then half as far back", "step forward four times, then step back twice"),
        (
            "wave your right hand for six seconds, then do the same with the left",
            "wave your right hand for 6 s, then wave your left hand for 6 s",
        ),
        ("about face and march back three paces", "turn around, then step forward three times"),
        ("walk 1 m, turn around and walk back", "walk 1 m, turn around, walk forward 1 m"),
        ("squat down and stay there for 4 s, then back up", "crouch, stop for 4 s, then stand up"),
        ("bow and hold for 3 s", "lean forward, wait 3 s"),
        ("two jabs and a cross, three times", "two jabs, a cross, two jabs, a cross, two jabs, a cross"),
        ("duck twice and throw a right", "duck twice, then punch with the right hand"),
        ("raise the left hand, keep it there while turning right", "raise the left hand, then turn right"),
        ("can the doggy wave to grandma?", "wave"),
        ("jab, then step back with your guard up", "jab, then step back, keeping your guard up"),
        ("bend forward from the waist, arms hanging", "lean forward, then lower both arms"),
        ("arm left up, wait 1 s, switch", "raise the left hand, wait 1 s, then switch"),
        ("walk at a slow pace", "walk slowly"),
        ("punch left and finish with a right hook", "punch left, then a right hook"),
        ("wave the left hand, switch, wave", "wave the left hand, then wave the right hand"),
        ("wave the left hand, then switch hands", "wave the left hand, then wave the right hand"),
        ("raise one hand, then switch", "raise the right hand, then raise the left hand while lowering the right hand"),
        (
            "one hand up, the other down, then swap",
            "raise the right hand, then lower the left hand, then raise the left hand while lowering the right hand",
        ),
        ("ten punches, switching hands every time", "punch with alternating hands ten times"),
        ("raise your arms, lower them, repeat", "raise your arms, lower your arms, raise your arms, lower your arms"),
        ("wave, step forward, three times in total", "wave, step forward, wave, step forward, wave, step forward"),
        ("wave twice, two more times", "wave twice, wave twice, wave twice"),
        ("jab jab cross", "punch left, punch left, punch right"),
        ("box box box", "punch, punch, punch"),
        ("puppy, I want you go forward one meter", "walk forward 1 m"),
        ("one-two", "jab, then cross"),
        ("double jab, then hook", "punch left twice, then a left hook"),
        ("raise the guard", "guard up"),
        ("spin", "turn left 360 degrees"),
        ("wafe and stpe", "wave and step"),
        ("hey doggy, put ur paws up, thank you very much", "put your hands up"),
        ("turn left a little bit", "turn left 30 degrees"),
        ("turn a full 360 to the right", "turn right 360 degrees"),
        ("and now walk towards me at top speed for 2 s", "walk forward fast for 2 s"),
        ("bend your knees twice", "squat twice"),
        ("raise your right hand and lower it again, twice", "right hand up, down, up, down"),
        ("open your arms, then close them, twice", "open your arms, close them, open your arms, close them"),
        ("arms forward, then down twice, then repeat everything", "arms forward, then down, four times"),
        ("wave, three times, while walking forward", "wave three times while walking forward"),
        ("step forward, twice, raising your left hand", "step forward twice, raising your left hand"),
        ("forward, march!", "walk forward"),
    ],
)
def test_two_sentences_with_one_meaning_make_the_same_motion(sentence, same, plan):
    one, other = plan(sentence), plan(same)
    assert [f.duration for f in one.frames] == pytest.approx([f.duration for f in other.frames])
    np.testing.assert_allclose([f.q for f in one.frames], [f.q for f in other.frames])
    assert [(*f.velocity, f.heading) for f in one.frames] == [(*f.velocity, f.heading) for f in other.frames]
    assert [f.trunk for f in one.frames] == [f.trunk for f in other.frames]


@pytest.mark.parametrize(
    "sentence",
    [
        "step forward and wave three times",
        "step forward, then back three times",
        "punch left, right twice",
        "step forward, step back, and punch three times",
        "step forward, step back, three times",
        "walk forward and back for 3 seconds",
        "walk two metres forward and back",
        "turn left and raise your left hand in 2 seconds",
        "raise the left hand, then the right hand, each for 2 seconds",
        "raise the left hand, then the right hand, with a pause of 1 second in between",
        "alternate left and right punches four times",
        "throw three punches, one with each hand",
        "wave with your left hand up",
        "walk, and after 3 seconds wave",
        "walk twice as fast",
        "turn left, no, right",
        "raise the left hand, then lower it three times while walking forward",
        "walk forward while raising both hands, then lower them three times",
        "raise the left hand and lower it, three times, while walking forward",
    ],
)
def test_an_amount_that_could_belong_to_two_actions_is_refused(sentence, plan):
    with pytest.raises(SourceError, match=r"^[^\n]+$"):
        plan(sentence)


def test_each_key_frame_says_how_its_part_of_the_sentence_was_understood(plan):
    motion = plan("turn left 45 and walk forward 1 m while waving both hands three times")
    assert list(dict.fromkeys(frame.what for frame in motion.frames)) == [
        "turn left 45° in 1.5 s",
        "walk forward 1 m in 4.75 s while wave with both hands 3 times",
    ]


def test_the_same_thing_said_twice_is_read_back_twice(plan):
    understood = dict.fromkeys(frame.what for frame in plan("turn left, then left again").frames)
    assert list(understood) == ["turn left 90° in 3 s", "turn left 90° in 3 s, again"]


def test_hands_in_turn_take_the_time_that_is_said(plan):
    motion = plan("alternate left and right punches for 6 seconds")
    assert motion.seconds == pytest.approx(6)
    assert [frame.what.split()[3] for frame in motion.frames[::3]] == ["left", "right", "left", "right"]


def test_it_and_the_other_are_the_hands_that_moved_before(plan, reach):
    motion = plan("raise the left hand; lower it; raise the other one")
    up, down = posture("up", reach), posture("down", reach)
    np.testing.assert_allclose(motion.frames[-1].q, np.concatenate([down[:3], up[3:]]), atol=1e-6)


@given(st.lists(st.sampled_from([*sorted(vocabulary()), ",", "2", "45", "0.5"]), max_size=12))
@settings(max_examples=150, deadline=None, derandomize=True)
def test_any_order_of_known_words_is_understood_or_refused_in_one_line(words):
    try:
        groups, message = parse(" ".join(words)), ""
    except SourceError as error:
        groups, message = [], str(error)
    assert bool(groups) != bool(message)
    assert "\n" not in message


@pytest.mark.parametrize(("side", "turned"), [("", 2 * np.pi), (" to the right", -2 * np.pi)])
def test_a_walk_in_a_circle_turns_once_all_the_way_round(side, turned, plan):
    (frame,) = plan(f"walk in a circle{side}").frames
    assert frame.heading == pytest.approx(turned)
    assert frame.velocity[0] > 0.2


@pytest.mark.parametrize(
    ("sentence", "lowest", "furthest", "at_end"),
    [
        ("crouch", -0.07, 0.0, (-0.07, 0.0)),
        ("crouch a little, then stand up straight", -0.035, 0.0, (0.0, 0.0)),
        ("squat three times", -0.07, 0.0, (0.0, 0.0)),
        ("take a bow", 0.0, 20.05, (0.0, 0.0)),
        ("lean forward 10 degrees while waving", 0.0, 10.0, (0.0, 10.0)),
    ],
)
def test_the_trunk_crouches_and_bows(reach, sentence, lowest, furthest, at_end):
    frames = plan_by_grammar(sentence, reach).frames
    heights, leans = np.array([frame.trunk for frame in frames]).T
    assert heights.min() == pytest.approx(lowest, abs=1e-6)
    assert np.degrees(leans).max() == pytest.approx(furthest, abs=0.01)
    assert (heights[-1], np.degrees(leans[-1])) == pytest.approx(at_end, abs=0.01)


def test_a_lean_beyond_what_the_robot_does_is_refused(reach):
    with pytest.raises(SourceError, match="30° are too far; the robot leans by 20°"):
        plan_by_grammar("lean forward 30 degrees", reach)
