from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mimic.errors import SourceError
from mimic.records import PoseTrack, RunLog, TargetTrack
from mimic.robot.description import RobotDescription
from mimic.view.scene.scene import save_scene
from mimic.view.scene.timing import shared_time


def columns_of(scene: Path) -> dict[str, list[dict[str, Any]]]:
    """Return what the file holds, for each entity: name of the column -> its values, of each chunk."""
    from rerun.chunk import RrdReader

    held: dict[str, list[dict[str, Any]]] = {}
    for chunk in RrdReader(scene).stream().to_chunks():
        held.setdefault(chunk.entity_path, []).append(chunk.to_record_batch().to_pydict())
    return held


def times(held: dict[str, list[dict[str, Any]]], entity: str) -> np.ndarray:
    """Return the times at which an entity changes, sorted [s]."""
    rows = [value for chunk in held[entity] for value in chunk.get("time", [])]
    return np.sort([value.total_seconds() for value in rows])


@pytest.fixture(scope="module")
def scene(
    log: RunLog,
    description: RobotDescription,
    targets: TargetTrack,
    pose: PoseTrack,
    video: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:
    path = tmp_path_factory.mktemp("scene") / "scene.rrd"
    save_scene(path, log=log, description=description, targets=targets, pose=pose, video=video)
    return path


def test_scene_holds_video_person_robot_and_plots(scene: Path) -> None:
    held = columns_of(scene)
    expected = {
        "/video",
        "/video/skeleton/left",
        "/person/left",
        "/person/right",
        "/robot/links/base",
        "/robot/links/FL_knee",
        "/robot/links/FL_knee/capsule",
        "/robot/toes/left/target",
        "/robot/toes/right/actual",
        "/robot/eye",
        "/robot/floor",
        "/plots/toe_error/left",
        "/plots/toe_up/right_target",
        "/plots/knee_torque/rear_left",
        "/plots/standing/height_m",
    }
    assert expected <= set(held), expected - set(held)


def test_robot_and_video_share_a_clock(scene: Path, log: RunLog, pose: PoseTrack) -> None:
    held = columns_of(scene)
    clock = shared_time(log)
    np.testing.assert_allclose(times(held, "/robot/links/base"), clock, atol=1e-6)
    waiting_then_playing = [clock[0], *pose.t]
    np.testing.assert_allclose(times(held, "/video"), waiting_then_playing, atol=1e-6)
    np.testing.assert_allclose(times(held, "/person/left"), waiting_then_playing, atol=1e-6)


def test_phases_are_said_in_words_from_when_they_begin(scene: Path, log: RunLog) -> None:
    held = columns_of(scene)
    words = [word for chunk in held["/phase"] for row in chunk.get("TextDocument:text", []) for word in row]
    assert [word.split(" (")[0] for word in words] == ["standing up", "to the first target", "following", "holding"]
    np.testing.assert_allclose(times(held, "/phase"), shared_time(log)[[0, 20, 25, 75]], atol=1e-6)


def test_a_second_timeline_counts_the_frames_of_the_video(scene: Path, pose: PoseTrack) -> None:
    held = columns_of(scene)
    numbers = [value for chunk in held["/person/left"] for value in chunk.get("frame", [])]
    assert sorted(numbers)[1:] == list(range(len(pose.t)))
    assert all(
        "frame" in chunk
        for name in ("/video", "/robot/links/base", "/plots/toe_error/left")
        for chunk in held[name]
        if "time" in chunk
    )


def test_target_toes_wait_until_the_robot_stands(scene: Path, log: RunLog) -> None:
    held = columns_of(scene)
    assert times(held, "/robot/toes/left/target")[0] == pytest.approx(shared_time(log)[20])


def test_links_in_the_scene_are_where_the_log_says(scene: Path, log: RunLog) -> None:
    chunk = next(c for c in columns_of(scene)["/robot/links/base"] if "Transform3D:translation" in c)
    stored = np.array(chunk["Transform3D:translation"])[:, 0]
    np.testing.assert_allclose(stored, log.p_WB[: len(stored)], atol=1e-5)


def test_robot_alone_makes_a_scene(log: RunLog, description: RobotDescription, tmp_path: Path) -> None:
    save_scene(tmp_path / "robot.rrd", log=log, description=description)
    held = columns_of(tmp_path / "robot.rrd")
    assert "/robot/links/base" in held
    assert not any(entity.startswith(("/video", "/person")) for entity in held)


def test_person_without_a_video_keeps_the_flat_skeleton(
    log: RunLog, description: RobotDescription, pose: PoseTrack, tmp_path: Path
) -> None:
    save_scene(tmp_path / "person.rrd", log=log, description=description, pose=pose)
    assert "/video/skeleton/left" in columns_of(tmp_path / "person.rrd")


def test_nothing_is_left_of_a_scene_that_fails(
    log: RunLog, description: RobotDescription, video: Path, tmp_path: Path
) -> None:
    def stop(done: int, total: int | None) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        save_scene(tmp_path / "scene.rrd", log=log, description=description, video=video, progress=stop)
    with pytest.raises(SourceError, match="there is no file"):
        save_scene(tmp_path / "scene.rrd", log=log, description=description, video=tmp_path / "none.mp4")
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_takes_no_more_is_an_error_of_the_system(log, description, tmp_path, monkeypatch) -> None:
    def broken(self: object, **_: object) -> None:
        raise RuntimeError("File-writer thread shut down prematurely")

    monkeypatch.setattr("rerun.RecordingStream.flush", broken)
    with pytest.raises(OSError, match="could not be written"):
        save_scene(tmp_path / "robot.rrd", log=log, description=description)
    assert not list(tmp_path.iterdir())
