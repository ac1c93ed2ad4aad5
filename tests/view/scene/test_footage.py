import threading
from pathlib import Path

import numpy as np
import pytest

from mimic.errors import SourceError
from mimic.records import PoseTrack, RunLog
from mimic.robot.description import RobotDescription
from mimic.view.film.footage import read_frames
from mimic.view.scene.footage import Footage
from mimic.view.scene.scene import save_scene


def test_the_clip_has_every_frame_of_the_video(video: Path) -> None:
    import av

    with Footage(video) as footage:
        clip = footage.clip()
        assert clip.size == (96, 64)
        with av.open(str(clip.path)) as container:
            assert sum(1 for _ in container.decode(video=0)) == len(list(read_frames(video)))


def test_the_file_is_gone_when_the_footage_is_closed(video: Path) -> None:
    with Footage(video) as footage:
        path = footage.clip().path
    assert not path.exists()
    assert not path.parent.exists()


def test_a_video_that_cannot_be_decoded_is_reported_when_the_clip_is_asked_for(tmp_path: Path) -> None:
    (tmp_path / "text.mp4").write_text("no video")
    with Footage(tmp_path / "text.mp4") as footage, pytest.raises(SourceError, match=r"text\.mp4"):
        footage.clip()


def test_closing_early_ends_the_thread(video: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    decoded, go_on = threading.Event(), threading.Event()

    def endless(*_: object, **__: object) -> object:
        while True:
            decoded.set()
            go_on.wait(10.0)
            yield np.zeros((64, 96, 3), dtype=np.uint8)

    monkeypatch.setattr("mimic.view.scene.footage.read_frames", endless)
    footage = Footage(video)
    decoded.wait(10.0)
    go_on.set()
    footage.close()
    assert footage._encoded.done()


def test_a_scene_is_the_same_with_footage_that_was_started_before(
    log: RunLog, pose: PoseTrack, video: Path, description: RobotDescription, tmp_path: Path
) -> None:
    with Footage(video) as footage:
        shown = {"log": log, "description": description, "pose": pose}
        save_scene(tmp_path / "before.rrd", footage=footage, **shown)
        save_scene(tmp_path / "itself.rrd", video=video, **shown)
    sizes = [(tmp_path / f"{name}.rrd").stat().st_size for name in ("before", "itself")]
    assert sizes[0] == pytest.approx(sizes[1], rel=0.02)
