"""A person who is seen by a camera that flattens them: whose shoulders have less depth than they should."""

from __future__ import annotations

import numpy as np
import pytest

from mimic.records import LANDMARKS
from mimic.sources.video.heading import FOCAL, WIDTH, with_heading

SIZE = (640, 480)
NO_CUTS = np.zeros(0, dtype=np.int64)
SHOULDERS, HIPS, WRISTS = (
    [LANDMARKS.index(f"{side}_{part}") for side in ("left", "right")] for part in ("shoulder", "hip", "wrist")
)


def seen(heading: float, depth: float = 1.0, aside: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Landmarks, image and validity of somebody turned to their left by so much [deg], whose depth is shrunk."""
    landmarks = np.zeros((30, 33, 3))
    turned = np.radians(heading)
    for sign, left in ((1.0, 0), (-1.0, 1)):
        line = np.array([np.cos(turned), 0.0, depth * np.sin(turned)])
        landmarks[:, HIPS[left]] = 0.10 * sign * line
        landmarks[:, SHOULDERS[left]] = 0.175 * sign * line - [0.0, 0.5, 0.0]
        landmarks[:, WRISTS[left]] = landmarks[:, SHOULDERS[left]] + [0.0, 0.2, -0.4]
    middle = SIZE[0] / 2 + FOCAL * SIZE[0] * np.tan(np.radians(aside))
    image = (np.array([middle, 240.0]) + 300.0 * landmarks[..., :2] * [WIDTH / 0.7, 1.0]) / SIZE
    return landmarks, image, np.ones((30, 33), dtype=bool)


def heading_of(landmarks: np.ndarray) -> float:
    x, _, z = (landmarks[:, SHOULDERS[0]] - landmarks[:, SHOULDERS[1]]).mean(axis=0)
    return float(np.degrees(np.arctan2(z, x)))


@pytest.mark.parametrize("heading", [-150.0, -40.0, 0.0, 30.0, 140.0])
def test_who_is_seen_as_they_stand_stays_so(heading):
    landmarks, image, valid = seen(heading)
    found = with_heading(landmarks, image, valid, SIZE, NO_CUTS)
    assert heading_of(found) == pytest.approx(heading, abs=0.5)


@pytest.mark.parametrize("heading", [-40.0, 35.0])
def test_who_is_seen_too_flat_is_turned_outward_with_their_arms(heading):
    landmarks, image, valid = seen(heading, depth=0.3)
    found = with_heading(landmarks, image, valid, SIZE, NO_CUTS)
    assert abs(heading_of(landmarks)) < abs(heading_of(found)) < abs(heading)
    np.testing.assert_allclose(
        found[:, WRISTS] - found[:, SHOULDERS], landmarks[:, WRISTS] - landmarks[:, SHOULDERS], atol=1e-12
    )
    before, after = (np.linalg.norm(p[:, SHOULDERS[0]] - p[:, SHOULDERS[1]], axis=-1) for p in (landmarks, found))
    np.testing.assert_allclose(before, after)


def test_who_stands_beside_the_middle_is_seen_along_another_line():
    landmarks, image, valid = seen(20.0, aside=15.0)
    assert heading_of(with_heading(landmarks, image, valid, SIZE, NO_CUTS)) < 20.0 - 5.0


def test_each_shot_has_a_turn_of_its_own_and_nobody_has_none():
    (a, image_a, valid), (b, image_b, _) = seen(35.0, depth=0.3), seen(-35.0, depth=0.3)
    both = with_heading(
        np.concatenate([a, b]), np.concatenate([image_a, image_b]), np.concatenate([valid, valid]), SIZE, np.array([30])
    )
    assert heading_of(both[:30]) == pytest.approx(-heading_of(both[30:]))
    np.testing.assert_array_equal(with_heading(a, image_a, ~valid, SIZE, NO_CUTS), a)
