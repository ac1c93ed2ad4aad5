"""Cuts, fades and changes of person, on rows of a person who is known."""

from __future__ import annotations

import numpy as np
import pytest

from mimic.records import LANDMARKS, PoseTrack
from mimic.sources.video.shots import Change, clothes_colour, describe, find_changes, is_black

SIZE = (640, 480)
ROWS, AT = 90, 45
BLUE, RED, PALE_BLUE = (40.0, 10.0, -45.0), (45.0, 55.0, 35.0), (48.0, 8.0, -42.0)


class Clip:
    """A person who stands in front of a camera for three seconds, as find_changes gets it."""

    def __init__(self) -> None:
        self.t = np.arange(ROWS) / 30
        self.change, self.black = np.full(ROWS, 1.0), np.zeros(ROWS, dtype=bool)
        self.image, self.clothes = np.full((ROWS, 33, 2), 0.5), np.tile(BLUE, (ROWS, 1))
        self.person = np.ones(ROWS, dtype=bool)
        self.place(slice(None), 0.5, 1.0)

    def place(self, rows: slice, x: float, size: float) -> None:
        """Put the middle of the shoulders at x, with a trunk of ``size`` times 150 px."""
        for name, across, down in (("shoulder", 40.0, 0.0), ("hip", 25.0, 150.0)):
            for side, sign in (("left", 1.0), ("right", -1.0)):
                point = np.array([640 * x + sign * size * across, 150 + size * down]) / SIZE
                self.image[rows, LANDMARKS.index(f"{side}_{name}")] = point

    def changes(self) -> tuple[Change, ...]:
        score = np.ones((ROWS, 33))
        track = PoseTrack(
            t=self.t, landmarks=np.zeros((ROWS, 33, 3)), image=self.image, score=score, valid=score > 0.5,
            swapped=np.zeros(ROWS, dtype=bool), size=SIZE,
        )  # fmt: skip
        return find_changes(track, self.person, self.clothes, self.change, self.black)


def test_a_person_who_stands_or_walks_is_one_person():
    clip = Clip()
    assert clip.changes() == ()
    for row in range(ROWS):  # 2.4 m/s across the picture, nearer and nearer
        clip.place(slice(row, row + 1), 0.1 + 0.8 * row / ROWS, 0.8 + 0.5 * row / ROWS)
    assert clip.changes() == ()


def test_a_cut_says_whether_the_clothes_are_other_ones():
    clip = Clip()
    clip.change[AT] = 22.0
    assert clip.changes() == (Change(AT, "cut", False),)
    clip.clothes[AT:] = PALE_BLUE  # another light
    assert clip.changes() == (Change(AT, "cut", False),)
    clip.clothes[AT:] = RED
    assert clip.changes() == (Change(AT, "cut", True),)
    assert "a cut at 1.50 s with another person after it" in next(describe(clip.changes(), clip.t))


def test_a_last_frame_without_a_picture_is_no_cut():
    clip = Clip()
    clip.change[-1], clip.black[-1] = 60.0, True
    clip.person[-1] = False
    assert clip.changes() == ()


def test_who_turns_and_shows_a_back_of_another_colour_is_the_same_person():
    clip = Clip()
    clip.person[AT : AT + 12] = False  # 0.4 s in which the detector is lost
    clip.clothes[AT:] = RED
    assert clip.changes() == ()
    clip.place(slice(AT, None), 0.65, 1.0)
    assert clip.changes() == (Change(AT + 12, "person", True),)


def test_what_is_found_and_lost_in_turn_is_no_other_person():
    clip = Clip()
    clip.person[AT : AT + 4] = False
    clip.place(slice(AT, None), 0.9, 0.5)
    assert [change.kind for change in clip.changes()] == ["person"]
    clip.person[AT + 5 :: 2] = False
    assert clip.changes() == ()


def test_a_fade_through_black_is_a_change_and_a_dark_start_or_end_is_none():
    clip = Clip()
    clip.black[:5] = clip.black[-5:] = True
    assert clip.changes() == ()
    clip.black[AT - 4 : AT] = True
    clip.person[AT - 6 : AT + 2] = False
    clip.clothes[AT - 10 : AT + 10] = (10.0, 0.0, 0.0)  # dimmed
    assert clip.changes() == (Change(AT, "fade", False),)
    clip.clothes[AT + 10 :] = RED
    assert clip.changes() == (Change(AT, "fade", True),)
    assert "a fade through black at 1.50 s" in next(describe(clip.changes(), clip.t))


def test_another_person_in_the_same_picture_is_found_by_place_size_and_clothes():
    clip = Clip()
    clip.place(slice(AT, None), 0.5 + 0.5 * 150 / 640, 1.0)
    assert clip.changes() == ()  # half a trunk away, else alike: a glitch of the detector
    clip.clothes[AT:] = RED
    assert clip.changes() == (Change(AT, "person", True),)
    clip.clothes[:] = BLUE
    clip.place(slice(AT, None), 0.5 + 0.5 * 150 / 640, 1.5)
    assert clip.changes() == (Change(AT, "person", True),)
    clip.place(slice(AT, None), 0.9, 1.0)  # 1.7 trunks in one frame
    assert clip.changes() == (Change(AT, "person", True),)
    assert "changes at 1.50 s" in next(describe(clip.changes(), clip.t))


def test_a_jump_for_a_frame_or_two_is_no_other_person():
    clip = Clip()
    clip.place(slice(AT, AT + 2), 0.9, 0.6)
    clip.clothes[AT : AT + 2] = RED
    assert clip.changes() == ()


@pytest.mark.parametrize(("clothes", "found"), [(BLUE, ()), (RED, (Change(60, "person", True),))])
def test_who_comes_back_in_the_same_clothes_is_the_same_person(clothes, found):
    clip = Clip()
    clip.person[30:60] = False
    clip.place(slice(60, None), 0.8, 1.2)
    clip.clothes[60:] = clothes
    assert clip.changes() == found


def test_a_clip_without_anybody_has_no_changes():
    clip = Clip()
    clip.image[:], clip.clothes[:], clip.person[:] = np.nan, np.nan, False
    assert clip.changes() == ()


def test_clothes_are_read_from_the_trunk_only():
    picture = np.full((480, 640, 3), 255, dtype=np.uint8)
    clip = Clip()
    picture[150:300, 270:370] = (0, 0, 200)
    blue = clothes_colour(picture, clip.image[0])
    assert blue[2] < -60
    assert np.isnan(clothes_colour(picture, clip.image[0] + 2.0)).all()
    assert np.isnan(clothes_colour(picture, np.full((33, 2), np.nan))).all()


def test_a_black_picture_is_black_and_a_dark_room_and_another_are_not():
    noise = np.random.default_rng(0).integers(0, 255, (480, 640, 3), dtype=np.uint8)
    assert is_black(np.zeros((480, 640, 3), dtype=np.uint8))
    assert not is_black(noise)
    room = np.zeros((480, 640, 3), dtype=np.uint8)
    room[:, 400:] = 40
    assert not is_black(room)
