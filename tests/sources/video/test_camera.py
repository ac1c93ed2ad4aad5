"""A file in place of a camera, read by a real process."""

from __future__ import annotations

import itertools
import time
from pathlib import Path

import numpy as np
import pytest

from mimic.config.pose import LiveSettings, PoseSettings
from mimic.errors import SourceError
from mimic.records import LANDMARKS
from mimic.sources.video.camera import CameraFrame, open_camera

WAVING = Path(__file__).parents[3] / "examples" / "videos" / "waving.mp4"


@pytest.fixture(scope="module")
def rows() -> list[CameraFrame]:
    """The first rows of a clip; the caller pauses after the first one."""
    with open_camera(str(WAVING), PoseSettings(), LiveSettings(), previews=True) as stream:
        stream.begin()
        seen = stream.rows()
        found = [next(seen)]
        time.sleep(0.5)  # the caller is busy
        return found + [next(seen) for _ in range(5)]


@pytest.mark.slow
def test_a_person_is_detected_with_position_and_time(rows):
    assert all(row.valid[LANDMARKS.index("left_wrist")] for row in rows)
    assert all(row.landmarks.shape == (33, 3) and np.isfinite(row.landmarks).all() for row in rows)
    assert rows[0].size == (640, 480)
    assert all(later.t > earlier.t for earlier, later in itertools.pairwise(rows))
    assert all(row.detector_s > 0 for row in rows)


@pytest.mark.slow
def test_a_busy_caller_gets_the_newest_row_and_the_number_of_dropped_ones(rows):
    assert rows[1].t > rows[0].t
    assert rows[1].number > rows[0].number + 1


@pytest.mark.slow
def test_some_rows_carry_a_preview_picture(rows):
    assert rows[0].jpeg is not None
    assert rows[0].jpeg[:2] == b"\xff\xd8"


@pytest.mark.slow
def test_a_file_does_not_play_before_begin():
    with open_camera(str(WAVING), PoseSettings(), LiveSettings()) as stream:
        time.sleep(0.3)
        begin = time.monotonic()
        stream.begin()
        assert next(stream.rows()).t >= begin


@pytest.mark.parametrize("camera", ["nowhere.mp4", "97"])
def test_a_missing_camera_is_reported(camera):
    with (
        pytest.raises(SourceError, match=r"there is no camera|cannot read a picture from"),
        open_camera(camera, PoseSettings(), LiveSettings()),
    ):
        pass


def test_a_file_that_is_not_a_video_is_reported(tmp_path):
    (tmp_path / "a.mp4").write_text("no video")
    with (
        pytest.raises(SourceError, match="no picture can be read from"),
        open_camera(str(tmp_path / "a.mp4"), PoseSettings(), LiveSettings()),
    ):
        pass
