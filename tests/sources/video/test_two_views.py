"""One person filmed by two cameras: a person made here, and the calibrated cameras of the shared data."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mimic.errors import SourceError
from mimic.records import LANDMARKS, PoseTrack
from mimic.sources.video.two_views import ALIKE, UNLIKE, merge_views

T = np.arange(0.0, 4.0, 1 / 30)
WRISTS, SHOULDERS = (
    [LANDMARKS.index(f"{side}_{part}") for side in ("left", "right")] for part in ("wrist", "shoulder")
)


def person(t: np.ndarray, seed: int = 1) -> np.ndarray:
    """Somebody who faces the first camera and swings both arms, mid-hip -> landmark (T, 33, 3) [m]."""
    rng = np.random.default_rng(seed)
    xyz = np.zeros((len(t), 33, 3))
    for side, across in (("left", 1.0), ("right", -1.0)):
        rates, phases = rng.uniform(0.3, 1.1, (2, 2)), rng.uniform(0, 6, (2, 2))
        upper, fore = (
            0.28 * np.stack([across * np.sin(a) * np.cos(b), np.cos(a), -np.sin(a) * np.sin(b)], -1)
            for a, b in (
                (1.2 + 0.9 * np.sin(2 * np.pi * rates[i, 0] * t + phases[i, 0]), 0.8 + np.sin(rates[i, 1] * t))
                for i in range(2)
            )
        )
        shoulder = np.array([0.19 * across, -0.5, 0.0])
        places = {"hip": [0.1 * across, 0.0, 0.0], "shoulder": shoulder, "elbow": shoulder + upper}
        for part, place in {**places, "wrist": shoulder + upper + fore}.items():
            xyz[:, LANDMARKS.index(f"{side}_{part}")] = place
    return xyz


def seen_by(camera: Rotation, t: np.ndarray, xyz: np.ndarray, scale: float = 1.0) -> PoseTrack:
    """What a camera makes of it that sees a third of the depth of arms."""
    own = scale * camera.apply(xyz.reshape(-1, 3)).reshape(xyz.shape)
    for side, shoulder in enumerate(SHOULDERS):
        arm = [LANDMARKS.index(f"{('left', 'right')[side]}_{part}") for part in ("elbow", "wrist")]
        own[:, arm, 2] = own[:, [shoulder], 2] + 0.35 * (own[:, arm, 2] - own[:, [shoulder], 2])
    shape = xyz.shape[:2]
    return PoseTrack(
        t=t - t[0], landmarks=own, image=np.full((*shape, 2), 0.5), score=np.ones(shape), valid=np.ones(shape, bool),
        size=(640, 480), swapped=np.zeros(len(t), bool), shot=np.zeros(len(t)), depth_spread=np.full((len(t), 2), 0.12),
    )  # fmt: skip


def arms(xyz: np.ndarray) -> np.ndarray:
    return xyz[:, WRISTS] - xyz[:, SHOULDERS]


def off(track: PoseTrack, rows: slice | np.ndarray = slice(None)) -> float:
    """How far its arms are from the truth [m]."""
    return float(np.sqrt(np.mean(np.sum((arms(track.landmarks) - arms(TRUE))[rows] ** 2, axis=-1))))


SIDE = Rotation.from_euler("xy", [12, -80], degrees=True)
TRUE = person(T)
FRONT = seen_by(Rotation.identity(), T, TRUE)


def test_a_second_view_from_the_side_shows_the_depth_that_the_first_one_lacks():
    merged, fit = merge_views(FRONT, seen_by(SIDE, T, TRUE, 1.1), ("front.mp4", "side.mp4"))
    assert off(merged) < 0.4 * off(FRONT)
    assert fit.angle_deg == pytest.approx(80, abs=12)
    assert fit.delay == pytest.approx(0.0, abs=0.03)
    assert np.cbrt(np.linalg.det(fit.turn)) == pytest.approx(1 / 1.1, abs=0.1)
    assert (merged.depth_spread < FRONT.depth_spread).all()
    np.testing.assert_array_equal(merged.image, FRONT.image)


@pytest.mark.parametrize("delay", [-1.3, 0.6])
def test_the_second_clip_may_start_before_or_after_the_first_one(delay):
    later = np.arange(0.0, 3.7, 1 / 25) - delay
    merged, fit = merge_views(FRONT, seen_by(SIDE, later, person(later)), ("front.mp4", "side.mp4"))
    assert fit.delay == pytest.approx(delay, abs=0.03)
    both = (later[0] < T) & (later[-1] > T)
    assert off(merged, both) < 0.5 * off(FRONT, both)
    alone = (later[0] - 0.05 > T) | (later[-1] + 0.05 < T)
    np.testing.assert_allclose(arms(merged.landmarks[alone]), arms(FRONT.landmarks[alone]), atol=0.02)


def test_an_arm_that_one_view_does_not_show_comes_from_the_other_one():
    hidden, valid = np.array(FRONT.landmarks), np.array(FRONT.valid)
    hidden[30:60] = np.nan
    valid[30:60], valid[80:90, WRISTS[0]] = False, False
    gaps = replace(FRONT, landmarks=hidden, valid=valid, score=valid.astype(float))
    merged, _ = merge_views(gaps, seen_by(SIDE, T, TRUE), ("front.mp4", "side.mp4"))
    assert merged.valid[:, [*WRISTS, *SHOULDERS]].all()
    assert np.linalg.norm(arms(merged.landmarks) - arms(TRUE), axis=-1)[30:60].mean() < 0.2


def test_a_camera_beside_the_first_one_adds_nothing_and_a_note_says_so():
    beside = Rotation.from_euler("y", 6, degrees=True)
    merged, fit = merge_views(FRONT, seen_by(beside, T, TRUE), ("front.mp4", "beside.mp4"))
    assert fit.angle_deg < 15
    np.testing.assert_array_equal(merged.landmarks, FRONT.landmarks)
    assert any("beside.mp4 is not used" in text for text in merged.warnings)


def taken_for_another(rows: slice, parts: tuple[str, ...]) -> PoseTrack:
    """The view from the side in which somebody else's arm is taken for the left one."""
    side = seen_by(SIDE, T, TRUE)
    wrong = np.array(side.landmarks)
    strange = seen_by(SIDE, T, person(T, seed=5)).landmarks
    columns = [LANDMARKS.index(part) for part in parts]
    wrong[rows, columns] = strange[rows, columns]
    return replace(side, landmarks=wrong)


def test_an_arm_that_one_view_takes_for_another_one_hardly_turns_the_view():
    _, right = merge_views(FRONT, seen_by(SIDE, T, TRUE), ("front.mp4", "side.mp4"))
    wrong = taken_for_another(slice(40, 80), ("left_elbow", "left_wrist"))
    _, fit = merge_views(FRONT, wrong, ("front.mp4", "side.mp4"))
    assert fit.angle_deg == pytest.approx(right.angle_deg, abs=3)
    assert right.unlike < fit.unlike < ALIKE


def test_a_view_that_shows_arms_otherwise_is_not_used_and_a_note_says_so():
    wrong = taken_for_another(slice(None), ("left_wrist",))
    merged, fit = merge_views(FRONT, wrong, ("front.mp4", "side.mp4"))
    assert ALIKE < fit.unlike < UNLIKE
    np.testing.assert_array_equal(merged.landmarks, FRONT.landmarks)
    assert any("side.mp4 is not used: it shows arms" in text for text in merged.warnings)


def test_videos_of_different_motions_are_refused_in_one_line():
    with pytest.raises(SourceError, match=r"^front\.mp4 and other\.mp4 do not show the same motion") as error:
        merge_views(FRONT, seen_by(SIDE, T, person(T, seed=5)), ("front.mp4", "other.mp4"))
    assert "\n" not in str(error.value)


def test_a_view_with_a_cut_is_refused():
    cut = replace(seen_by(SIDE, T, TRUE), shot=(T > 2).astype(float))
    with pytest.raises(SourceError, match=r"side\.mp4 has a cut"):
        merge_views(FRONT, cut, ("front.mp4", "side.mp4"))


@pytest.mark.slow
def test_two_calibrated_views_of_a_real_person_lie_as_they_were_calibrated(tracked):
    first, second = (tracked(f"real/multiview/cam0{i}.mp4") for i in (1, 2))
    merged, fit = merge_views(first, second, ("cam01.mp4", "cam02.mp4"))
    assert fit.angle_deg == pytest.approx(49, abs=8)
    assert abs(fit.delay) < 0.05
    there = first.t + fit.delay
    shared = (there >= second.t[0]) & (there <= second.t[-1])  # where the second clip has begun and not ended
    both = first.valid[:, WRISTS] & second.valid[:, WRISTS] & shared[:, None]
    assert (merged.depth_spread < first.depth_spread)[both].all()
    assert both.mean() > 0.5
