"""Squats and bows of a person, and what the robot's trunk is asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mimic.config.retarget import RetargetSettings
from mimic.records import LANDMARKS, PoseTrack
from mimic.retargeting.targets import target_track
from mimic.retargeting.trunk import LiveTrunk, person_trunk, trunk_goals
from mimic.retargeting.wrists import wrist_track
from mimic.robot.reach import Reach

T = np.arange(0.0, 6.0, 1 / 30)
LEG = 0.83
TRUNK = 0.5


def moved(begin: float, end: float) -> np.ndarray:
    """Share of a motion (T,) that comes and goes between two times."""
    inside = np.clip((T - begin) / (end - begin), 0.0, 1.0)
    return np.sin(np.pi * inside) ** 2


def person(squat: np.ndarray, lean: np.ndarray, *, facing: float = 0.0) -> PoseTrack:
    """A person whose hips come lower by a share of the leg (T,), and who leans (T,) [rad]; camera axes."""
    ahead = np.array([np.sin(facing), 0.0, -np.cos(facing)])
    left = np.array([np.cos(facing), 0.0, np.sin(facing)])
    up = np.array([0.0, -1.0, 0.0])
    along = np.cos(lean)[:, None] * up + np.sin(lean)[:, None] * ahead
    points = np.full((len(T), len(LANDMARKS), 3), np.nan)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        shoulder = TRUNK * along + 0.18 * sign * left
        points[:, LANDMARKS.index(f"{side}_shoulder")] = shoulder
        points[:, LANDMARKS.index(f"{side}_elbow")] = shoulder + 0.3 * ahead
        points[:, LANDMARKS.index(f"{side}_wrist")] = shoulder + 0.5 * ahead
        points[:, LANDMARKS.index(f"{side}_hip")] = 0.1 * sign * left
        points[:, LANDMARKS.index(f"{side}_ankle")] = 0.1 * sign * left - LEG * (1 - squat)[:, None] * up
    valid = np.isfinite(points).all(axis=-1)
    image = np.where(valid[..., None], [0.5, 0.5], np.nan)
    swapped = np.zeros(len(T), dtype=bool)
    return PoseTrack(t=T, landmarks=points, image=image, score=valid.astype(float), valid=valid, swapped=swapped)


@pytest.mark.parametrize("facing", [0.0, 0.6, -1.2])
def test_a_squat_and_a_bow_are_seen_wherever_the_person_faces(facing):
    squat = 0.4 * moved(1.0, 2.5)
    lean = 0.3 * moved(3.0, 5.0)
    found = person_trunk(person(squat, lean, facing=facing), np.full(len(T), facing))
    np.testing.assert_allclose(found[:, 0], -squat, atol=0.03)
    np.testing.assert_allclose(found[:, 1], lean, atol=0.03)


def test_a_detector_that_leans_everybody_does_not_lean_the_robot():
    found = person_trunk(person(np.zeros(len(T)), np.full(len(T), 0.25)), np.zeros(len(T)))
    np.testing.assert_allclose(found, 0.0, atol=1e-6)


def test_who_leans_back_does_not_lean_the_robot_forward():
    found = person_trunk(person(np.zeros(len(T)), -0.6 * moved(2.0, 4.0)), np.zeros(len(T)))
    np.testing.assert_allclose(found[85:95, 1], 0.0, atol=0.02)


def test_before_a_camera_a_squat_and_a_bow_are_seen_as_they_come():
    squat = 0.4 * moved(2.0, 3.5)
    lean = 0.3 * moved(4.0, 5.8)
    seen = person(squat, lean)
    live = LiveTrunk()
    rows = [
        live.see(t, landmarks, valid, 0.0) for t, landmarks, valid in zip(T, seen.landmarks, seen.valid, strict=True)
    ]
    height, leant = np.array(rows).T
    assert height.min() == pytest.approx(-0.4, abs=0.05)
    assert leant.max() == pytest.approx(0.3, abs=0.06)
    assert T[np.argmin(height)] - 2.75 < 0.2


def test_without_feet_nothing_is_known():
    seen = person(np.zeros(len(T)), np.zeros(len(T)))
    valid = seen.valid.copy()
    valid[:, LANDMARKS.index("left_ankle")] = False
    assert np.isnan(person_trunk(replace(seen, valid=valid), np.zeros(len(T)))).all()


def test_a_deep_squat_is_as_low_as_the_robot_goes_and_small_sways_are_none(description):
    numbers = description.trunk_numbers
    asked = trunk_goals(np.array([[0.0, 0.0], [-0.04, 0.09], [-0.5, 1.0], [np.nan, np.nan], [0.1, -0.5]]), description)
    np.testing.assert_allclose(asked[2], [numbers.height[0], numbers.pitch[1]])
    np.testing.assert_allclose(asked[[0, 1, 3, 4]], 0.0, atol=1e-12)
    assert not trunk_goals(np.array([[-0.5, 1.0]]), replace(description, trunk_numbers=None)).any()


def test_the_robot_is_asked_to_squat_when_the_person_does_unless_that_is_switched_off(description):
    wrists = wrist_track(person(0.5 * moved(1.0, 3.0), np.zeros(len(T))))
    reach = Reach(description)
    targets = target_track(wrists, reach, RetargetSettings())
    assert targets.t[np.argmin(targets.trunk[:, 0])] == pytest.approx(2.0, abs=0.1)
    assert targets.trunk[:, 0].min() == pytest.approx(description.trunk_numbers.height[0], rel=0.1)
    assert not target_track(wrists, reach, RetargetSettings(trunk=False)).trunk.any()
