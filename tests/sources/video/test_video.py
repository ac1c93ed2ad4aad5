"""Real and rendered clips through the detector, against what is known about them."""

from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

from mimic.config.pose import PoseSettings
from mimic.errors import SourceError
from mimic.records import PoseTrack
from mimic.sources.video.video import pose_cache_key, track_video

Clip = Callable[[str], Path]
Tracked = Callable[[str], PoseTrack]


def places(pose: PoseTrack, *names: str) -> np.ndarray:
    return pose.landmarks[:, [pose.index(name) for name in names]]


def arms(pose: PoseTrack) -> np.ndarray:
    """Shoulder -> wrist, left and right (T, 2, 3), camera axes [m]."""
    return places(pose, "left_wrist", "right_wrist") - places(pose, "left_shoulder", "right_shoulder")


def agreement(truth: np.ndarray, measured: np.ndarray) -> tuple[float, float]:
    """Correlation, and gain of measured over truth."""
    return float(np.corrcoef(truth, measured)[0, 1]), float(np.polyfit(truth, measured, 1)[0])


def at_times(pose: PoseTrack, t: np.ndarray) -> np.ndarray:
    """Shoulder -> wrist at other times."""
    columns = arms(pose).reshape(len(pose.t), -1)
    return np.stack([np.interp(t, pose.t, c) for c in columns.T], axis=1).reshape(-1, 2, 3)


@pytest.mark.parametrize(("name", "least_up"), [("boxing", 0.85), ("wave", 0.97)])
@pytest.mark.parametrize("side", [0, 1], ids=["left", "right"])
@pytest.mark.slow
def test_wrists_follow_the_rendered_truth_in_the_image_plane(clip: Clip, tracked: Tracked, name, least_up, side):
    pose = tracked(f"rendered/{name}.mp4")
    truth = np.load(clip(f"rendered/{name}.npz"))
    joint = {str(n): truth["joints"][:, i] for i, n in enumerate(truth["names"])}
    wanted = joint["wrist" + "LR"[side]] - joint["shoulder" + "LR"[side]]
    np.testing.assert_allclose(pose.t, truth["t"], atol=1e-6)
    across, gain = agreement(wanted[:, 0], arms(pose)[:, side, 0])
    up, _ = agreement(wanted[:, 1], arms(pose)[:, side, 1])
    assert across >= 0.93
    assert 0.8 <= gain <= 1.1
    assert up >= least_up


@pytest.mark.slow
def test_a_real_view_with_swapped_sides_agrees_with_triangulation(clip: Clip, tracked: Tracked):
    pose = tracked("real/multiview/cam02.mp4")
    world = np.load(clip("real/multiview/triangulated_blazepose.npz"))["xyz"]
    calibration = ElementTree.parse(clip("real/multiview/Calib.qca.txt"))
    turn = next(c for c in calibration.iter("camera") if c.get("serial") == "cam02").find("transform")
    assert turn is not None
    axes = np.array([[float(turn.get(f"r{i}{j}", "nan")) for j in (1, 2, 3)] for i in (1, 2, 3)])
    seen = world @ (np.diag([1.0, -1.0, -1.0]) @ axes).T  # the calibration's camera looks along -z with y up
    wrists, shoulders, hips = (
        [pose.index(f"{s}_{p}") for s in ("left", "right")] for p in ("wrist", "shoulder", "hip")
    )
    from_hip = seen[:, wrists] - seen[:, hips].mean(axis=1, keepdims=True)
    from_shoulder = seen[:, wrists] - seen[:, shoulders]
    assert np.isfinite(from_hip).all(axis=-1).sum() > 150
    assert np.nanmean(np.linalg.norm(places(pose, "left_wrist", "right_wrist") - from_hip, axis=-1)) < 0.200
    assert np.nanmean(np.linalg.norm(arms(pose) - from_shoulder, axis=-1)) < 0.200
    assert pose.swapped.sum() == 31
    assert any("swapped left and right in 31 of 100" in w for w in pose.warnings)
    assert any("a wrist jumps in" in w for w in pose.warnings)
    assert not any("cuts" in w for w in pose.warnings)


@pytest.mark.slow
def test_dropped_frames_give_the_same_curve_at_the_true_times(tracked: Tracked):
    whole, dropped = tracked("real/01_asl_walk.mkv"), tracked("nasty/vfr_dropped_frames.mp4")
    assert len(dropped.t) == 53
    assert dropped.t[-1] == pytest.approx(whole.t[-1], abs=0.002)
    assert np.diff(dropped.t).max() > 0.16
    error = np.linalg.norm(arms(dropped) - at_times(whole, dropped.t), axis=-1)
    assert np.quantile(error, 0.95) < 0.030


@pytest.mark.parametrize(
    ("name", "frames"),
    [
        ("real/01_asl_walk.mkv", 89),
        ("real/02_asl_book.mkv", 109),
        ("real/11_seated_standup_walks_out.mp4", 187),
        ("nasty/tiny_96x72.mp4", 89),
        ("nasty/gif_320.gif", 29),
        ("nasty/mirrored.mp4", 89),
        ("nasty/upside_down.mp4", 89),
    ],
)
@pytest.mark.slow
def test_a_person_is_tracked_in_every_frame(tracked: Tracked, name, frames):
    pose = tracked(name)
    assert len(pose.t) == frames
    assert (np.diff(pose.t) > 0).all()
    assert pose.valid[:, [pose.index("left_shoulder"), pose.index("right_shoulder")]].mean() > 0.95
    assert np.isfinite(pose.landmarks).all()
    assert not any("cuts" in w or "jumps" in w for w in pose.warnings)


@pytest.mark.slow
def test_one_frame_less_than_announced_is_no_alarm(tracked: Tracked):
    """The header announces 110 frames, and 109 are decoded."""
    assert len(tracked("real/02_asl_book.mkv").t) == 109
    assert not any("no picture" in w for w in tracked("real/02_asl_book.mkv").warnings)
    assert tracked("real/01_asl_walk.mkv").warnings == ()


@pytest.mark.slow
def test_a_truncated_file_is_read_to_its_end_and_reported(clip: Clip, tmp_path):
    whole = clip("real/03_asl_please.mkv").read_bytes()
    path = tmp_path / "part.mkv"
    path.write_bytes(whole[: len(whole) // 2])
    pose = track_video(path)
    assert 10 < len(pose.t) < 73
    assert any("of the file have no picture" in w for w in pose.warnings)


@pytest.mark.slow
def test_a_mirrored_clip_exchanges_the_arms(tracked: Tracked):
    plain, mirrored = arms(tracked("real/01_asl_walk.mkv")), arms(tracked("nasty/mirrored.mp4"))
    error = (mirrored - plain[:, ::-1] * (-1, 1, 1))[..., :2]
    assert np.linalg.norm(error, axis=-1).mean() < 0.050


@pytest.mark.slow
def test_an_upside_down_clip_is_tracked_as_it_is_shown(clip: Clip):
    detector = PoseSettings(depth=False)
    turned, upright = (track_video(clip(name), detector) for name in ("nasty/upside_down.mp4", "real/01_asl_walk.mkv"))
    error = (arms(turned) - arms(upright) * (-1, -1, 1))[..., :2]
    assert np.linalg.norm(error, axis=-1).mean() < 0.030
    assert any("below the hips" in w for w in turned.warnings)


@pytest.mark.slow
def test_a_cut_to_another_person_is_reported_with_its_time(tracked: Tracked):
    pose = tracked("nasty/cut_two_people.mp4")
    assert any("a cut at 2.43 s with another person after it" in w for w in pose.warnings)
    assert pose.shot.tolist() == [float(t > 2.42) for t in pose.t]


@pytest.mark.slow
def test_a_fade_through_black_is_reported_and_begins_a_new_part(clip: Clip, tmp_path):
    def frames(name: str) -> list[np.ndarray]:
        capture, found = cv2.VideoCapture(str(clip(name))), []
        while (read := capture.read())[0]:
            found.append(read[1])
        return found

    first, second = frames("real/01_asl_walk.mkv")[:45], frames("real/03_asl_please.mkv")[:45]
    dimmed = [(frame * (1 - i / 10)).astype(np.uint8) for i, frame in enumerate(first[-10:])]
    risen = [(frame * (i / 10)).astype(np.uint8) for i, frame in enumerate(second[:10])]
    path = tmp_path / "faded.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 30.0, first[0].shape[1::-1])
    for frame in [*first[:-10], *dimmed, *5 * [np.zeros_like(first[0])], *risen, *second[10:]]:
        writer.write(frame)
    writer.release()
    pose = track_video(path)
    assert any("a fade through black at 1.7" in w for w in pose.warnings)
    assert set(pose.shot) == {0.0, 1.0}
    assert pose.t[np.flatnonzero(pose.shot)[0]] == pytest.approx(1.7, abs=0.1)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("nasty/one_frame.mp4", "shorter than a sampling step"),
        ("nasty/empty.mp4", "is empty"),
        ("nasty/text.mp4", "no picture can be read"),
        ("nasty/audio_only.mp4", "no picture can be read"),
    ],
)
@pytest.mark.slow
def test_what_cannot_give_a_motion_is_refused_in_one_line(clip: Clip, capfd, name, reason):
    with pytest.raises(SourceError, match=reason) as refusal:
        track_video(clip(name))
    assert Path(name).name in str(refusal.value)
    assert "\n" not in str(refusal.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_a_video_without_a_person_is_refused(clip: Clip, tmp_path: Path) -> None:
    video, path = cv2.VideoCapture(str(clip("real/15_no_person_bottles.mp4"))), tmp_path / "bottles.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 30.0, (640, 360))
    for _ in range(120):
        writer.write(video.read()[1])
    writer.release()
    with pytest.raises(SourceError, match=r"bottles\.mp4.*shows no person"):
        track_video(path)


def noise(path: Path, frames: int, rate: float = 25.0) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate, (64, 48))
    random = np.random.default_rng(0)
    for _ in range(frames):
        writer.write(random.integers(0, 255, (48, 64, 3), dtype=np.uint8))
    writer.release()
    return path


def test_a_video_of_a_frame_a_second_is_refused(tmp_path):
    with pytest.raises(SourceError, match=r"slow\.mp4 has a frame every 1 s; one every 0\.5 s is required"):
        track_video(noise(tmp_path / "slow.mp4", 3, 1.0))


def test_progress_counts_every_frame_before_the_verdict(tmp_path):
    calls = []
    with pytest.raises(SourceError, match="shows no person"):
        track_video(noise(tmp_path / "noise.mp4", 8), progress=lambda done, total: calls.append((done, total)))
    assert calls == [(i, 8) for i in range(1, 9)]


def test_the_cache_key_follows_content_and_settings_and_not_the_name(tmp_path):
    first, copy, other = (tmp_path / n for n in ("a.mp4", "b.mp4", "c.mp4"))
    first.write_bytes(b"one")
    copy.write_bytes(b"one")
    other.write_bytes(b"two")
    assert pose_cache_key(first) == pose_cache_key(copy)
    assert pose_cache_key(first) != pose_cache_key(other)
    assert pose_cache_key(first) != pose_cache_key(first, PoseSettings(cutoff_hz=5.0))
