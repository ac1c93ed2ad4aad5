"""What is checked first of a video and of a camera."""

from pathlib import Path

import numpy as np
import pytest

import mimic
from mimic.config.pose import LiveSettings
from mimic.errors import SourceError
from mimic.flows.motions.camera import follow_camera
from mimic.flows.motions.motion import InputSettings, motion_from_text
from mimic.flows.reporter import SilentReporter
from mimic.io import store


class Notes(SilentReporter):
    """Keeps what is said."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []

    def note(self, text: str) -> None:
        self.lines.append(text)


def test_no_pose_model_is_downloaded_for_a_file_that_is_no_video(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))  # nothing is here yet
    broken, notes = tmp_path / "broken.mp4", Notes()
    broken.write_text("no video")
    with pytest.raises(SourceError, match="no picture can be read"):
        mimic.track_video(broken, cache=False, reporter=notes)
    assert notes.lines == []


@pytest.mark.parametrize(
    ("camera", "message"), [("nowhere", "there is no camera"), ("broken.mp4", "no picture can be read from")]
)
def test_no_pose_model_is_downloaded_for_a_camera_that_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, camera: str, message: str
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    Path("broken.mp4").write_text("no video")
    notes = Notes()
    with (
        pytest.raises(SourceError, match=message),
        follow_camera(camera, InputSettings(), LiveSettings(), description=mimic.load_robot(), reporter=notes),
    ):
        pass
    assert notes.lines == []


def test_toes_that_were_made_for_another_robot_are_refused(tmp_path: Path) -> None:
    targets = motion_from_text("wave the left hand").targets
    assert targets is not None
    assert targets.robot == "cyberdog2"
    path = tmp_path / "targets.parquet"
    store.save(targets, path, made_by=store.provenance())
    assert mimic.load_motion(path).targets is not None
    with pytest.raises(SourceError, match=r"made for the cyberdog2, and the robot is a go2; play what they were made"):
        mimic.load_motion(path, description=mimic.load_robot("go2"))


@pytest.mark.slow
def test_a_walk_that_is_played_again_is_asked_for_the_same_speed():
    run = mimic.play(motion_from_text("step forward"))
    again = mimic.play(run.motion)
    assert run.result.log.v_des[:, 0].max() > 0.1
    np.testing.assert_array_equal(again.result.log.v_des, run.result.log.v_des)
