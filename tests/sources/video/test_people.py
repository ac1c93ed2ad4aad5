"""Who is in view and who is followed, on people that are known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from mimic.config.pose import PoseSettings
from mimic.errors import ConfigError, SourceError
from mimic.records import LANDMARKS
from mimic.sources.video.people import LOST, People, Person, chosen, describe, distinct, person_of, recognised, squares
from mimic.sources.video.video import track_video

RED, BLUE = np.array([45.0, 55.0, 35.0]), np.array([40.0, 10.0, -45.0])


def person(x: float, size: float = 1.0, colour: np.ndarray | None = None) -> Person:
    """Somebody whose trunk is 0.3 of the picture times ``size``."""
    image = np.full((33, 2), (x, 0.3))
    for name, across, down in (("shoulder", 0.05, 0.0), ("hip", 0.03, 0.3), ("ankle", 0.03, 0.6)):
        for side, sign in (("left", 1.0), ("right", -1.0)):
            image[LANDMARKS.index(f"{side}_{name}")] += size * np.array([sign * across, down])
    return person_of(image, 4 / 3, colour)


def test_people_are_told_apart_from_left_to_right_and_the_background_is_left_out():
    found = distinct([person(0.8), person(0.2), person(0.81, 0.9), person(0.5, 0.1)])
    assert [round(float(one.middle[0]), 2) for one in found] == [round(0.2 * 4 / 3, 2), round(0.8 * 4 / 3, 2)]


@pytest.mark.parametrize(("choice", "place"), [("left", 0), ("right", 2), ("largest", 1), (1, 0), (2, 1), (3, 2)])
def test_one_is_chosen_by_place_or_size(choice, place):
    people = [person(0.2), person(0.5, 1.4), person(0.8)]
    assert chosen(people, choice) is people[place]


def test_people_are_known_again_by_place_and_clothes():
    known = [person(0.3, colour=RED), person(0.6, colour=BLUE)]
    assert recognised([person(0.35, colour=RED), person(0.62, colour=BLUE)], known) == [0, 1]
    assert recognised([person(0.4, colour=BLUE), person(0.5, colour=RED)], known) == [1, 0]  # they crossed
    assert recognised([person(0.58)], known) == [1]  # the other one is hidden, the clothes are not seen
    assert recognised([person(0.3, colour=BLUE)], known[:1]) == [None]
    assert recognised([], known) == []


def test_who_was_lost_is_known_by_their_clothes_only():
    lost = replace(person(0.2, colour=RED), missed=LOST)
    assert recognised([person(0.9, colour=RED)], [lost]) == [0]
    assert recognised([person(0.2, colour=BLUE)], [lost]) == [None]


def test_several_people_are_said_with_the_times_and_who_is_followed():
    one, two = [person(0.2)], [person(0.2), person(0.8)]
    looks = [(0.0, one), (1.5, two), (3.0, two), (4.5, one)]
    (said,) = describe(looks, None)
    assert said.startswith(
        "up to 2 people are in view between 2 and 3 s; the detector follows one of them: --person left"
    )
    (said,) = describe(looks, "left")
    assert said.endswith("--person left is followed")
    assert describe(looks[:2], None) == []  # once may be an error
    (said,) = describe([(0.0, [*two, person(0.5)]), *looks], None)
    assert said.startswith("up to 2 people")
    assert describe([(1.5 * i, one) for i in range(5)], None) == []


def test_before_a_camera_the_latest_looks_count_and_a_second_person_is_said_late_too():
    image = np.full((33, 2), (0.2, 0.3))
    image[LANDMARKS.index("left_hip"), 1] = 0.6
    found = [(image, np.ones(33))]
    picture = np.zeros((48, 48, 3), dtype=np.uint8)
    people = People(lambda rgb: found, None, "0", latest=10)
    for t in range(100):
        people.look(3.0 * t, picture)
    assert people.sentences() == []
    found.append((image + (0.6, 0.0), np.ones(33)))
    people.look(300.0, picture)
    people.look(303.0, picture)
    (said,) = people.sentences()
    assert said.startswith("up to 2 people are in view between 300 and 303 s")


@pytest.mark.parametrize(("width", "height"), [(1920, 1080), (1080, 1920), (910, 480), (640, 480)])
def test_squares_cover_a_picture_and_overlap_by_half(width, height):
    found = squares(width, height)
    starts = [x + y for x, y, _ in found]
    side, longest = min(width, height), max(width, height)
    assert {own for *_, own in found} == {side}
    assert (starts[0], starts[-1]) == (0, longest - side)
    assert max(np.diff(starts)) <= side / 2 + 1
    assert squares(500, 480) == []


@pytest.mark.parametrize("number", [0, 6])
def test_numbers_that_nobody_has_are_refused(number):
    with pytest.raises(ConfigError, match="person is"):
        PoseSettings(person=number)


def frames(path: Path, width: int) -> list[np.ndarray]:
    """The first 60 frames, 480 pixels high."""
    capture, found = cv2.VideoCapture(str(path)), []
    while len(found) < 60 and (read := capture.read())[0]:
        found.append(cv2.resize(read[1], (width, 480)))
    return found


def side_by_side(path: Path, left: list[np.ndarray], right: list[np.ndarray]) -> Path:
    size = (left[0].shape[1] + right[0].shape[1], 480)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 30.0, size)
    for pair in zip(left, right, strict=True):
        writer.write(np.hstack(pair))
    writer.release()
    return path


@pytest.fixture(scope="module")
def two(clip: Callable[[str], Path], tmp_path_factory) -> Path:
    """A signer on the left and a rendered boxer on the right, for two seconds."""
    left, right = frames(clip("real/01_asl_walk.mkv"), 640), frames(clip("rendered/boxing.mp4"), 640)
    return side_by_side(tmp_path_factory.mktemp("people") / "two.mp4", left, right)


@pytest.mark.slow
def test_somebody_far_away_beside_somebody_near_is_seen_and_can_be_followed(clip, tmp_path):
    """A man whose trunk is a third as high as the signer's; in the whole picture the detector finds only her."""
    left, right = frames(clip("real/multiview/cam02.mp4"), 270), frames(clip("real/01_asl_walk.mkv"), 640)
    pose = track_video(side_by_side(tmp_path / "far.mp4", left, right), PoseSettings(person="left"))
    x = pose.image[:, [pose.index("left_shoulder"), pose.index("right_shoulder")], 0].mean(axis=1)
    assert np.isfinite(x).all()
    assert x.max() < 270 / 910
    assert any("2 people are in view" in text and "--person left is followed" in text for text in pose.warnings)


@pytest.mark.slow
@pytest.mark.parametrize(("choice", "low", "high"), [("left", 0.15, 0.35), (2, 0.65, 0.85)])
def test_the_chosen_person_is_followed_in_every_frame(two, choice, low, high):
    pose = track_video(two, PoseSettings(person=choice))
    x = pose.image[:, [pose.index("left_shoulder"), pose.index("right_shoulder")], 0].mean(axis=1)
    assert np.isfinite(x).all()
    assert low < x.min() <= x.max() < high
    assert any("up to 2 people are in view" in warning for warning in pose.warnings)


@pytest.mark.slow
def test_where_the_chosen_person_is_gone_there_are_gaps_and_nobody_else(clip, tmp_path):
    left, right = (frames(clip(name), 320) for name in ("rendered/wave.mp4", "rendered/boxing.mp4"))
    nobody = [np.full_like(left[0], 90)] * 30
    settings = PoseSettings(person="left", min_person_share=0.1)
    pose = track_video(side_by_side(tmp_path / "gone.mp4", left[:30] + nobody, right), settings)
    x = pose.image[:, [pose.index("left_shoulder"), pose.index("right_shoulder")], 0].mean(axis=1)
    assert np.isfinite(x[:30]).mean() > 0.9
    assert np.nanmax(x) < 0.5
    assert np.isnan(x[40:]).all()
    assert any("that person was not found; these are gaps" in text for text in pose.warnings)


@pytest.mark.slow
def test_who_stands_at_the_place_of_the_chosen_person_after_a_cut_is_a_gap(clip, tmp_path):
    one, other = (frames(clip(f"real/{name}.mkv"), 640) for name in ("01_asl_walk", "03_asl_please"))
    cut = side_by_side(tmp_path / "cut.mp4", one[:36] + other[36:], other[:36] + one[36:])
    pose = track_video(cut, PoseSettings(person="left"))
    seen = np.isfinite(pose.landmarks[:, 0, 0])
    assert seen[:36].all()
    left = pose.image[36:][seen[36:], pose.index("nose"), 0] < 0.5
    assert not left.any()


@pytest.mark.slow
def test_a_third_person_of_two_is_refused(two):
    with pytest.raises(SourceError, match="shows 2 people at most"):
        track_video(two, PoseSettings(person=3))
