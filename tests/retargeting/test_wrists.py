import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mimic.config.retarget import RetargetSettings
from mimic.errors import ContractError, SourceError
from mimic.records import LANDMARKS, PoseTrack
from mimic.retargeting.wrists import (
    HEADING_KNOWN,
    arm_length,
    camera_axis,
    depth_note,
    pose_report,
    torso_heading,
    torso_vectors,
    wrist_track,
)

TRUTH = Path(__file__).parents[2] / ".." / "shared" / "data" / "videos" / "rendered" / "boxing.npz"
TURNS = RetargetSettings(turns=True)

FORWARD, LEFT, UP = np.eye(3)


def track(points: Mapping[str, np.ndarray], t: np.ndarray, **changes: Any) -> PoseTrack:
    """A track in which only the named landmarks are seen."""
    landmarks = np.full((len(t), 33, 3), np.nan)
    valid = np.zeros((len(t), 33), dtype=bool)
    for name, place in points.items():
        landmarks[:, LANDMARKS.index(name)] = place
        valid[:, LANDMARKS.index(name)] = True
    values: dict[str, Any] = {
        "t": t,
        "landmarks": landmarks,
        "image": landmarks[..., :2],
        "score": valid.astype(float),
        "valid": valid,
    }
    values["swapped"] = np.zeros(len(t), dtype=bool)
    return PoseTrack(**(values | changes))


def person(
    heading_deg: float | np.ndarray = 0.0, *, left=0.5 * LEFT, right=-0.25 * UP, rows: int = 90, size: float = 1.0
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Points of someone whose arms point there in their own axes, seen by a camera in front of heading 0."""
    heading = np.radians(np.broadcast_to(heading_deg, rows))
    c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
    # Facing the camera, the person's left is the right of the image; turning left turns the belly that way.
    forward, leftward = np.hstack([s, 0 * s, -c]), np.hstack([c, 0 * c, s])
    upward = np.broadcast_to([0.0, -1.0, 0.0], (rows, 3))

    def at(x: float, y: float, z: float) -> np.ndarray:
        return size * (x * forward + y * leftward + z * upward)

    points = {
        "left_shoulder": at(0, 0.18, 0.5),
        "right_shoulder": at(0, -0.18, 0.5),
        "left_hip": at(0, 0.1, 0),
        "right_hip": at(0, -0.1, 0),
    }
    points["left_wrist"] = points["left_shoulder"] + at(*left)
    points["right_wrist"] = points["right_shoulder"] + at(*right)
    return points, np.arange(rows) / 30


@pytest.mark.parametrize("heading", [0.0, 35.0, -70.0, 120.0, 180.0])
@pytest.mark.parametrize("way", [FORWARD, LEFT, UP], ids=["forward", "left", "up"])
def test_an_arm_points_the_same_way_whatever_the_person_faces(heading, way):
    wrists = wrist_track(track(*person(heading, left=0.5 * way)))
    np.testing.assert_allclose(wrists.p_SH[:, 0], np.tile(way, (90, 1)), atol=1e-9)
    np.testing.assert_allclose(wrists.p_SH[:, 1], np.tile(-0.5 * UP, (90, 1)), atol=1e-9)
    np.testing.assert_allclose(np.cos(wrists.heading - np.radians(heading)), 1.0)


@pytest.mark.parametrize("settings", [RetargetSettings(), TURNS])
def test_after_a_cut_to_another_camera_the_arm_points_where_it_did_and_the_robot_does_not_turn(settings):
    heading = np.where(np.arange(90) < 40, 0.0, 70.0)
    wrists = wrist_track(track(*person(heading, left=0.5 * FORWARD), shot=(heading > 0).astype(float)), settings)
    np.testing.assert_allclose(wrists.p_SH[:, 0], np.tile(FORWARD, (90, 1)), atol=1e-9)
    np.testing.assert_allclose(wrists.heading, wrists.heading[0], atol=1e-9)


def test_a_child_and_an_adult_give_the_same_vectors():
    adult, child = (wrist_track(track(*person(20, size=size))) for size in (1.0, 0.6))
    np.testing.assert_allclose(child.p_SH, adult.p_SH, atol=1e-9)
    assert child.arm_length == pytest.approx(0.6 * adult.arm_length)


def test_one_arm_length_serves_both_arms_and_ignores_a_single_wild_row():
    points, t = person(left=0.5 * LEFT, right=-0.3 * UP)
    points["left_wrist"] = points["left_wrist"].copy()
    points["left_wrist"][40] += 3.0
    wrists = wrist_track(track(points, t))
    assert wrists.arm_length == pytest.approx(0.5)
    np.testing.assert_allclose(np.linalg.norm(wrists.p_SH[0], axis=-1), [1.0, 0.6])


def test_noise_in_the_depth_of_the_shoulders_does_not_shake_the_arm():
    """A torso frame for each row would turn the arm by as much as the shoulder line turns."""
    points, t = person(left=0.5 * LEFT)
    noise = np.random.default_rng(0).normal(0, 0.1, len(t))[:, None] * [0, 0, 1]
    for name in ("left_shoulder", "left_wrist"):
        points[name] = points[name] + noise
    still = wrist_track(track(points, t))
    assert still.p_SH[:, 0].std(axis=0).max() < 1e-9
    assert abs(np.degrees(still.heading[0])) < 3


def test_without_turns_the_heading_is_one_value_and_with_them_it_follows_slowly():
    slow = 60 * np.sin(2 * np.pi * 0.05 * np.arange(600) / 30)
    fast = 60 * np.sin(2 * np.pi * 2.0 * np.arange(600) / 30)
    pose = track(*person(slow, rows=600))
    assert np.ptp(torso_heading(pose)) == 0.0
    inner = slice(60, -60)
    np.testing.assert_allclose(np.degrees(torso_heading(pose, TURNS))[inner], slow[inner], atol=6)
    assert np.ptp(np.degrees(torso_heading(track(*person(fast, rows=600)), TURNS))[inner]) < 1


def test_turning_all_the_way_round_has_no_jump():
    pose = track(*person(np.linspace(0, 540, 900), rows=900))
    heading = torso_heading(pose, TURNS)
    assert np.abs(np.diff(heading)).max() < np.radians(2)
    assert np.degrees(heading[-1] - heading[0]) == pytest.approx(540, abs=30)


def test_a_person_who_turns_away_is_advised_to_follow_the_turns():
    turning = np.r_[np.zeros(300), np.linspace(0, 110, 100), np.full(200, 110)]
    pose = track(*person(turning, rows=600), warnings=("from the source",))
    assert [("turned by more than 45°" in w) for w in wrist_track(pose).warnings] == [False, True]
    assert wrist_track(pose, TURNS).warnings == ("from the source",)
    assert wrist_track(track(*person(20))).warnings == ()


def test_an_arm_that_is_not_seen_is_a_gap_of_that_arm_only():
    points, t = person()
    seen = track(points, t)
    valid = seen.valid.copy()
    valid[10:20, LANDMARKS.index("left_wrist")] = False
    valid[30:40, LANDMARKS.index("right_shoulder")] = False
    landmarks = seen.landmarks.copy()
    landmarks[10:20, LANDMARKS.index("left_wrist")] = 99.0
    wrists = wrist_track(track(points, t, valid=valid, landmarks=landmarks))
    expected = np.ones((90, 2), dtype=bool)
    expected[10:20, 0] = expected[30:40, 1] = False
    np.testing.assert_array_equal(wrists.valid, expected)
    np.testing.assert_array_equal(np.isfinite(wrists.p_SH).all(axis=-1), expected)
    assert wrists.arm_length == pytest.approx(0.5)


def test_hips_out_of_the_picture_change_nothing():
    points, t = person(25)
    shoulders_only = {name: place for name, place in points.items() if "hip" not in name}
    np.testing.assert_allclose(
        wrist_track(track(shoulders_only, t)).p_SH, wrist_track(track(points, t)).p_SH, atol=1e-9
    )


def test_a_clip_without_an_arm_is_refused():
    points, t = person()
    with pytest.raises(SourceError, match="no frame shows a shoulder and its wrist"):
        wrist_track(track({name: place for name, place in points.items() if "wrist" not in name}, t))


def test_a_track_without_wrists_is_refused_by_name():
    bare = PoseTrack(
        t=np.zeros(1),
        landmarks=np.zeros((1, 2, 3)),
        image=np.zeros((1, 2, 2)),
        score=np.ones((1, 2)),
        valid=np.ones((1, 2), dtype=np.bool_),
        swapped=np.zeros(1, dtype=np.bool_),
        names=("left_shoulder", "right_shoulder"),
    )
    with pytest.raises(ContractError, match="left_wrist"):
        wrist_track(bare)


def test_rows_can_be_turned_one_at_a_time():
    rows = np.random.default_rng(1).normal(size=(20, 2, 3))
    heading = np.linspace(-2, 2, 20)
    together = torso_vectors(rows, heading)
    for i in range(20):
        np.testing.assert_allclose(torso_vectors(rows[i], heading[i]), together[i])
    np.testing.assert_allclose(np.linalg.norm(together, axis=-1), np.linalg.norm(rows, axis=-1))


def test_the_quantile_decides_how_far_an_arm_length_is():
    p_SH = np.linspace(0, 1, 101)[:, None, None] * np.array([[1.0, 0, 0], [0, 0, 1.0]])
    assert arm_length(p_SH, np.ones((101, 2), dtype=bool), 1.0) == 1.0
    assert arm_length(p_SH, np.ones((101, 2), dtype=bool), 0.5) == pytest.approx(0.5)


@pytest.mark.parametrize("settings", [RetargetSettings(heading=20.0), RetargetSettings(heading=20.0, turns=True)])
def test_a_heading_that_is_given_replaces_the_one_that_is_seen(settings):
    c, s = np.cos(np.radians(30)), np.sin(np.radians(30))
    wrists = wrist_track(track(*person(-10, left=0.5 * FORWARD)), settings)  # reaches to its right, if it faces 20
    np.testing.assert_allclose(wrists.p_SH[:, 0], np.tile([c, -s, 0], (90, 1)), atol=1e-9)


def test_a_heading_that_is_given_is_the_middle_of_turns():
    angle = 25 * np.sin(2 * np.pi * np.arange(900) / 900)
    settings = dataclasses.replace(TURNS, heading=-40.0)
    seen = torso_heading(track(*person(angle + 5, rows=900)), settings)
    assert np.degrees(np.median(seen)) == pytest.approx(-40)
    assert np.degrees(np.ptp(seen)) == pytest.approx(50, abs=4)


def test_the_note_says_how_well_depth_is_known_where_it_was_estimated():
    points, t = person(10)
    spread = np.where(np.arange(90)[:, None] < 45, 0.05, 0.15) * np.ones(2)
    report = pose_report(track(points, t, depth_spread=spread))
    assert "±11 cm" in report["unseen"]
    assert "50% of it is doubtful" in report["unseen"]
    without = pose_report(track(points, t))
    assert "It sees only" in without["unseen"]


@pytest.mark.parametrize(
    ("heading", "axis", "words"),
    [
        (0, (-1, 0, 0), ("in front of", "reaching forward and back")),
        (90, (0, 1, 0), ("beside", "reaching to the left and right")),
        (-90, (0, -1, 0), ("beside", "reaching to the left and right")),
        (180, (1, 0, 0), ("behind", "reaching forward and back")),
        (45, (-np.sqrt(0.5), np.sqrt(0.5), 0), ("in front of", "diagonal")),
    ],
)
def test_the_camera_axis_names_the_motion_that_is_barely_visible(heading, axis, words):
    pose = track(*person(heading))
    np.testing.assert_allclose(camera_axis(pose), axis, atol=1e-9)
    assert all(word in depth_note(camera_axis(pose)) for word in (*words, HEADING_KNOWN))


def test_the_report_counts_frames_and_arms():
    points, t = person(10)
    valid = track(points, t).valid.copy()
    valid[:9] = False
    valid[:45, LANDMARKS.index("right_wrist")] = False
    report = pose_report(track(points, t, valid=valid, swapped=np.arange(90) < 3))
    assert report["frames"] == 90
    assert report["frames_with_person"] == 81
    assert report["frames_exchanged"] == 3


@pytest.mark.skipif(not TRUTH.is_file(), reason="the shared test data is not beside the repository (../shared/data)")
def test_a_boxer_who_is_turned_to_the_right_punches_at_a_camera_on_the_left():
    """Exact joints of a rendered boxer; the longest reaches are punches."""
    truth = np.load(TRUTH)
    rename = {
        f"{part}{side[0].upper()}": f"{side}_{part}"
        for part in ("shoulder", "wrist", "hip")
        for side in ("left", "right")
    }
    points = {rename[str(n)]: truth["joints"][:, i] for i, n in enumerate(truth["names"]) if str(n) in rename}
    wrists = wrist_track(track(points, truth["t"]))
    assert np.degrees(wrists.heading[0]) == pytest.approx(-20, abs=1)
    for side in (0, 1):
        reach = np.linalg.norm(wrists.p_SH[:, side], axis=-1)
        forward, left, _ = wrists.p_SH[reach.argmax(), side]
        assert reach.max() > 0.95
        assert forward > 0.8
        assert 0 < left < 0.6


def hidden(pose: PoseTrack, name: str, *spans: tuple[float, float]) -> PoseTrack:
    """The pose with a landmark hidden during some times."""
    valid = pose.valid.copy()
    for start, end in spans:
        valid[(pose.t >= start) & (pose.t < end), LANDMARKS.index(name)] = False
    return dataclasses.replace(pose, valid=valid)


def test_an_arm_that_is_hidden_is_reported_with_the_times():
    pose = hidden(track(*person(rows=300)), "left_wrist", (1.0, 3.0), (5.0, 8.0))
    (warning,) = wrist_track(pose).warnings
    share = pose.valid[:, LANDMARKS.index("left_wrist")].mean()
    assert f"the left arm is visible in {share:.0%} of the frames, hidden at 1.0–3.0 s, 5.0–8.0 s;" in warning


def test_an_arm_that_is_seen_most_of_the_time_is_not_reported():
    assert wrist_track(hidden(track(*person(rows=300)), "left_wrist", (1.0, 2.5))).warnings == ()


def test_an_arm_that_is_never_seen_is_reported():
    (warning,) = wrist_track(hidden(track(*person(rows=300)), "right_wrist", (0.0, 99.0))).warnings
    assert warning == "the right arm is never visible"


def test_only_the_longest_of_many_times_are_named():
    spans = [(n + 0.0, n + 0.5) for n in range(9)]
    (warning,) = wrist_track(hidden(track(*person(rows=300)), "left_wrist", *spans)).warnings
    assert warning.count("–") == 4
    assert "and 5 shorter times" in warning
