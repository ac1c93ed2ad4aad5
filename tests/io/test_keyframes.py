from __future__ import annotations

import numpy as np
import pytest

from mimic.errors import SourceError
from mimic.io.keyframes import (
    MOST_FRAMES,
    KeyFrame,
    KeyFrames,
    frames_from,
    plain_frame,
    read_keyframes,
    save_keyframes,
)

GOOD = {
    "what": "an arm",
    "duration": 0.5,
    "velocity": [0.1, 0.0],
    "heading_deg": 90,
    "left_deg": [0, 45, -70],
    "right_deg": [1.5, 2.5, -60.0],
}


def test_plain_data_becomes_key_frames_in_radians():
    (frame,), wrong = frames_from({"frames": [GOOD]})
    assert not wrong
    assert frame.velocity == (0.1, 0.0)
    assert frame.heading == pytest.approx(np.pi / 2)
    np.testing.assert_allclose(np.degrees(frame.q), [0, 45, -70, 1.5, 2.5, -60])
    assert plain_frame(frame) == GOOD


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"duration": None}, "duration is None; expected a number"),
        ({"duration": "1 s"}, "duration is '1 s'; expected a number"),
        ({"duration": True}, "expected a number"),
        ({"duration": float("nan")}, "expected finite numbers"),
        ({"duration": float("inf")}, "expected finite numbers"),
        ({"velocity": 0.2}, "velocity is 0.2; expected a list of 2, each a number"),
        ({"left_deg": [0, 45]}, "expected a list of 3, each a number"),
        ({"left_deg": [0, 45, [1]]}, "expected a list of 3, each a number"),
        ({"speed": 3}, "'speed', which is unknown"),
    ],
)
def test_each_fault_is_reported_with_its_frame(change, message):
    frames, wrong = frames_from([GOOD, {**GOOD, **change}])
    assert frames == ()
    assert len(wrong) == 1
    assert "frame 2" in wrong[0]
    assert message in wrong[0]


def test_missing_fields_are_all_reported_at_once():
    _, wrong = frames_from([{"what": "nothing"}])
    assert [text.split()[-1] for text in wrong] == ["duration", "velocity", "heading_deg", "left_deg", "right_deg"]


@pytest.mark.parametrize("data", [None, [], "frames", {"frames": {}}, {"motion": [GOOD]}, 3])
def test_what_has_no_frames_is_reported(data):
    assert "expected a list of frames" in frames_from(data)[1][0]


def test_too_many_frames_are_refused_before_they_are_looked_at():
    assert frames_from([None] * 10**6)[1] == [f"there are 1000000 frames; at most {MOST_FRAMES} are played"]


def test_a_motion_survives_its_file_and_the_file_can_be_read_by_a_person(tmp_path):
    frames, _ = frames_from([GOOD, {**GOOD, "what": "ärmel: hoch # nicht", "duration": 1.25}])
    motion = KeyFrames(frames=frames, sentence="wave: 'now'", planner="grammar")
    path = tmp_path / "motion.yaml"
    save_keyframes(motion, path)
    again = read_keyframes(path)
    assert (again.sentence, again.planner, again.seconds) == (motion.sentence, motion.planner, 1.75)
    assert [frame.what for frame in again.frames] == [frame.what for frame in motion.frames]
    np.testing.assert_allclose(again.frames[1].q, motion.frames[1].q, atol=1e-4)
    text = path.read_text()
    assert "left_deg: [0.0, 45.0, -70.0]" in text
    assert "mimic THIS_FILE --sim" in text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("frames: [", "is not valid YAML"),
        ("!!python/object/apply:os.system ['touch hacked']", "is not valid YAML"),
        ("frames:\n- duration: 1\n", "frame 1 lacks velocity"),
        ("just words", "expected a list of frames"),
        ("#" * 1_000_001, "bytes; a motion in key frames has at most"),
    ],
)
def test_a_file_that_is_none_is_refused(text, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(SourceError, match=message):
        read_keyframes(tmp_path / "a.yaml")
    assert not (tmp_path / "hacked").exists()


def test_a_frame_keeps_its_numbers_when_it_is_written():
    frame = KeyFrame(duration=0.1234, velocity=(0.3, 0.0), heading=-1.0, q=np.linspace(-1, 1, 6))
    (again,), _ = frames_from([plain_frame(frame)])
    np.testing.assert_allclose(again.q, frame.q, atol=1e-4)
    assert again.heading == pytest.approx(frame.heading, abs=1e-4)


HOSTILE = {
    "aliases": "a: &a [x,x,x,x,x,x,x,x,x]\n"
    + "".join(f"{n}: &{n} [{','.join([f'*{m}'] * 9)}]\n" for m, n in zip("abcdefgh", "bcdefghi", strict=True)),
    "an alias to itself": "frames: &f [*f]",
    "depth": "frames: " + "[" * 100_000,
    "many items": "frames: [" + "1," * 400_000 + "1]",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_yaml_that_expands_is_refused_in_one_line(name, tmp_path):
    path = tmp_path / "motion.yaml"
    path.write_text(HOSTILE[name])
    with pytest.raises(SourceError, match=r"YAML alias|nested more than 10 levels") as error:
        read_keyframes(path)
    assert len(str(error.value)) < 300
    assert "\n" not in str(error.value)
