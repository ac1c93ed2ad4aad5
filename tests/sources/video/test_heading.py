"""A person who is seen by a camera that flattens them: whose shoulders have less depth than they should."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mimic.records import LANDMARKS, PoseTrack
from mimic.sources.video.heading import FOCAL, WIDTH, with_heading

SIZE = (640, 480)
SHOULDERS, HIPS, WRISTS = (
    [LANDMARKS.index(f"{side}_{part}") for side in ("left", "right")] for part in ("shoulder", "hip", "wrist")
)


def seen(heading: float, depth: float = 1.0, aside: float = 0.0) -> PoseTrack:
    """Somebody turned to their left by so much [deg], whose depth is shrunk."""
    landmarks = np.zeros((30, 33, 3))
    turned = np.radians(heading)
    for sign, left in ((1.0, 0), (-1.0, 1)):
        line = np.array([np.cos(turned), 0.0, depth * np.sin(turned)])
        landmarks[:, HIPS[left]] = 0.10 * sign * line
        landmarks[:, SHOULDERS[left]] = 0.175 * sign * line - [0.0, 0.5, 0.0]
        landmarks[:, WRISTS[left]] = landmarks[:, SHOULDERS[left]] + [0.0, 0.2, -0.4]
    middle = SIZE[0] / 2 + FOCAL * SIZE[0] * np.tan(np.radians(aside))
    image = (np.array([middle, 240.0]) + 300.0 * landmarks[..., :2] * [WIDTH / 0.7, 1.0]) / SIZE
    seen = np.ones((30, 33), dtype=bool)
    return PoseTrack(
        t=np.arange(30) / 30, landmarks=landmarks, image=image, score=seen.astype(float), valid=seen,
        swapped=np.zeros(30, dtype=bool), size=SIZE, shot=np.zeros(30),
    )  # fmt: skip


def heading_of(landmarks: np.ndarray) -> float:
    x, _, z = (landmarks[:, SHOULDERS[0]] - landmarks[:, SHOULDERS[1]]).mean(axis=0)
    return float(np.degrees(np.arctan2(z, x)))


@pytest.mark.parametrize("heading", [-150.0, -40.0, 0.0, 30.0, 140.0])
def test_who_is_seen_as_they_stand_stays_so(heading):
    assert heading_of(with_heading(seen(heading)).landmarks) == pytest.approx(heading, abs=0.5)


@pytest.mark.parametrize("heading", [-40.0, 35.0])
def test_who_is_seen_too_flat_is_turned_outward_with_their_arms(heading):
    flat = seen(heading, depth=0.3)
    landmarks, found = flat.landmarks, with_heading(flat).landmarks
    assert abs(heading_of(landmarks)) < abs(heading_of(found)) < abs(heading)
    np.testing.assert_allclose(
        found[:, WRISTS] - found[:, SHOULDERS], landmarks[:, WRISTS] - landmarks[:, SHOULDERS], atol=1e-12
    )
    before, after = (np.linalg.norm(p[:, SHOULDERS[0]] - p[:, SHOULDERS[1]], axis=-1) for p in (landmarks, found))
    np.testing.assert_allclose(before, after)


def test_who_stands_beside_the_middle_is_seen_along_another_line():
    assert heading_of(with_heading(seen(20.0, aside=15.0)).landmarks) < 20.0 - 5.0


def test_each_shot_has_a_turn_of_its_own_and_nobody_has_none():
    a, b = seen(35.0, depth=0.3), seen(-35.0, depth=0.3)
    names = ("landmarks", "image", "score", "valid", "swapped", "depth_spread")
    both = {name: np.concatenate([getattr(a, name), getattr(b, name)]) for name in names}
    found = with_heading(replace(a, t=np.arange(60) / 30, shot=np.repeat([0.0, 1.0], 30), **both)).landmarks
    assert heading_of(found[:30]) == pytest.approx(-heading_of(found[30:]))
    np.testing.assert_array_equal(with_heading(replace(a, valid=~a.valid)).landmarks, a.landmarks)
