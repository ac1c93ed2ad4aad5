"""The robot is seen from where the camera saw the person."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mimic.records import PoseTrack, TargetTrack
from mimic.view.scene.viewpoint import SIDEWAYS, seen_from


def turned(pose: PoseTrack, angle: float) -> PoseTrack:
    """The person of the track, turned to their left by an angle [rad]; camera axes are x right, y down, z away."""
    c, s = np.cos(angle), np.sin(angle)
    return replace(pose, landmarks=pose.landmarks @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]))


@pytest.mark.parametrize("angle", [0.0, 0.5, -1.2, 2.8])
def test_a_person_who_turned_left_is_seen_from_the_right(pose: PoseTrack, targets: TargetTrack, angle: float):
    assert seen_from(turned(pose, angle), targets) == pytest.approx(-angle)
    assert seen_from(turned(pose, angle), None) == pytest.approx(-angle)


def test_a_mirrored_motion_is_seen_from_the_other_side(pose: PoseTrack, targets: TargetTrack):
    mirrored = replace(targets, report={"mirror": True})
    assert seen_from(turned(pose, 0.5), mirrored) == pytest.approx(0.5)


def test_without_a_camera_depth_is_made_visible(pose: PoseTrack, targets: TargetTrack):
    assert seen_from(None, targets) == SIDEWAYS
    assert seen_from(replace(pose, size=(0, 0)), targets) == SIDEWAYS
