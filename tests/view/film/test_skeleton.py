from dataclasses import replace

import numpy as np

from mimic.records import PoseTrack
from mimic.view.film import skeleton


def test_person_stands_on_the_floor_facing_x_with_left_on_y(pose: PoseTrack) -> None:
    points = skeleton.standing_points(pose)
    left, right = points[0, pose.index("left_shoulder")], points[0, pose.index("right_shoulder")]
    np.testing.assert_allclose(left, [0.0, 0.2, 1.4], atol=1e-9)
    np.testing.assert_allclose(right, [0.0, -0.2, 1.4], atol=1e-9)
    np.testing.assert_allclose(points[0, pose.index("left_ankle")], [0.0, 0.1, 0.0], atol=1e-9)


def test_bones_are_drawn_only_where_both_ends_are_seen(pose: PoseTrack) -> None:
    seen = skeleton.visible(pose.landmarks, pose.valid)
    pairs = skeleton.bones(pose.names)
    left = skeleton.segments(pose.landmarks, seen, pairs["left"])
    right = skeleton.segments(pose.landmarks, seen, pairs["right"])
    np.testing.assert_array_equal(left.counts, 2)  # upper arm and forearm: knees and hands are not seen
    np.testing.assert_array_equal(right.counts, 1)
    assert left.ends.shape == (2 * len(pose.t), 2, 3)
    np.testing.assert_array_equal(left.ends[1], pose.landmarks[0, [pose.index("left_elbow"), pose.index("left_wrist")]])


def test_a_track_with_other_landmarks_has_the_bones_it_can() -> None:
    pairs = skeleton.bones(("left_shoulder", "left_elbow", "tail"))
    assert pairs == {"left": [(0, 1)], "right": [], "centre": []}


def test_wrists_say_where_they_are_seen(pose: PoseTrack) -> None:
    wrists = skeleton.wrists(pose, pose.landmarks)
    assert wrists["left"][1].all()
    assert not wrists["right"][1].any()


def test_head_is_unknown_without_ears(pose: PoseTrack) -> None:
    assert not skeleton.heads(pose, pose.landmarks)[1].any()


def test_a_wrist_is_paler_the_less_sure_it_is(pose: PoseTrack) -> None:
    score = pose.score.copy()
    score[:, pose.index("left_wrist")] = np.linspace(0.5, 1.0, len(pose.t))
    sure = skeleton.certainty(replace(pose, score=score))["left"]
    assert sure[0] == 0.0
    assert sure[-1] == 1.0
    whole, half, least = (skeleton.doubtful(skeleton.LEFT, value) for value in (1.0, 0.5, 0.0))
    assert whole == skeleton.LEFT
    assert sum(whole) < sum(half) < sum(least) < 3 * 255
