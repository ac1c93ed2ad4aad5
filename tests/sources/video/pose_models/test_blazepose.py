"""What the detector says of a picture, and that it keeps nothing of the picture before."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from mimic.sources.video.pose_models.blazepose import BlazePose
from mimic.sources.video.pose_models.pose_model import pose_model

WAVING = Path(__file__).parents[4] / "examples" / "videos" / "waving.mp4"


@pytest.fixture(scope="module")
def picture() -> np.ndarray:
    ok, bgr = cv2.VideoCapture(str(WAVING)).read()
    assert ok
    return cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)


def test_nobody_is_found_in_a_black_picture():
    with BlazePose(pose_model()) as detect:
        assert detect(np.zeros((48, 64, 3), np.uint8)) is None


def test_a_person_gives_33_landmarks_and_no_messages(picture, capfd):
    with BlazePose(pose_model()) as detect:
        found = detect(picture)
    assert found is not None
    world, image, visible = found
    assert (world.shape, image.shape, visible.shape) == ((33, 3), (33, 2), (33,))
    assert 0.2 < np.linalg.norm(world[11] - world[12]) < 0.6  # shoulders
    assert ((image[11:17] > 0) & (image[11:17] < 1)).all()
    assert visible[11:17].min() > 0.5
    assert capfd.readouterr() == ("", "")


def test_a_movement_is_seen_at_once(picture):
    """The detector's own filters would keep a part of where the person was."""
    moved = np.roll(picture, 12, axis=1)
    with BlazePose(pose_model()) as detect:
        for _ in range(6):
            still = detect(picture)
        first = detect(moved)
        for _ in range(6):
            settled = detect(moved)
    shift = [(a[1][11:17, 0] - still[1][11:17, 0]).mean() * picture.shape[1] for a in (first, settled)]
    assert shift[1] == pytest.approx(12, abs=1.0)
    assert shift[0] == pytest.approx(shift[1], abs=0.6)
