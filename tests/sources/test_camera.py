"""A file in place of a camera, watched by a real process."""

from __future__ import annotations

import itertools
import time
from pathlib import Path

import numpy as np
import pytest

from mimic.errors import SourceError
from mimic.settings import LiveSettings, PoseSettings
from mimic.sources.camera import Seen, watched
from mimic.types import LANDMARKS

WAVING = Path(__file__).parents[2] / "examples" / "videos" / "waving.mp4"


@pytest.fixture(scope="module")
def rows() -> list[Seen]:
    """The first rows of a clip, of which the first ones were waited for."""
    with watched(str(WAVING), PoseSettings(), LiveSettings(), pictures=True) as watch:
        watch.begin()
        seen = watch.rows()
        found = [next(seen)]
        time.sleep(0.5)  # whoever watches is busy
        return found + [next(seen) for _ in range(5)]


def test_a_person_is_seen_with_where_and_when(rows):
    assert all(row.valid[LANDMARKS.index("left_wrist")] for row in rows)
    assert all(row.landmarks.shape == (33, 3) and np.isfinite(row.landmarks).all() for row in rows)
    assert rows[0].size == (640, 480)
    assert all(later.t > earlier.t for earlier, later in itertools.pairwise(rows))
    assert all(row.took > 0 for row in rows)


def test_who_was_busy_gets_the_newest_row_and_is_told_what_was_dropped(rows):
    assert rows[1].t > rows[0].t
    assert rows[1].skipped > 0


def test_a_small_picture_goes_along_now_and_then(rows):
    assert rows[0].jpeg is not None
    assert rows[0].jpeg[:2] == b"\xff\xd8"


def test_nothing_plays_before_it_is_told_to():
    with watched(str(WAVING), PoseSettings(), LiveSettings()) as watch:
        time.sleep(0.3)
        begin = time.monotonic()
        watch.begin()
        assert next(watch.rows()).t >= begin


@pytest.mark.parametrize("camera", ["nowhere.mp4", "/dev/nowhere", "97"])
def test_a_camera_that_is_not_there_is_told(camera):
    with (
        pytest.raises(SourceError, match=r"there is no camera|no picture comes from"),
        watched(camera, PoseSettings(), LiveSettings()),
    ):
        pass


def test_a_file_that_is_no_video_is_told(tmp_path):
    (tmp_path / "a.mp4").write_text("no video")
    with (
        pytest.raises(SourceError, match="no picture comes from"),
        watched(str(tmp_path / "a.mp4"), PoseSettings(), LiveSettings()),
    ):
        pass
