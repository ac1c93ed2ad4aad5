from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mimic.records import PoseTrack, RunLog, TargetTrack
from mimic.robot.description import RobotDescription
from mimic.sources.video.decoding import open_video
from mimic.view.film.footage import read_frames
from mimic.view.film.offscreen import NoOffscreenGL
from mimic.view.film.side_by_side import RobotFilm, save_video, text_band, write_texts
from mimic.view.scene.timing import shared_time

HEIGHT, FPS = 64, 10


@pytest.fixture(scope="module")
def still(log: RunLog, description: RobotDescription) -> np.ndarray:
    """Return a picture of the robot standing, or skip where nothing can be drawn."""
    try:
        with RobotFilm(log, description, width=160, height=120) as film:
            return film.picture(60)
    except NoOffscreenGL as error:
        pytest.skip(str(error))


def test_picture_shows_the_robot_and_the_colours_of_its_sides(still: np.ndarray) -> None:
    assert still.shape == (120, 160, 3)
    dark = (still.max(axis=2) < 90).sum()
    assert 0.02 < dark / (120 * 160) < 0.5
    red, green, blue = np.moveaxis(still.astype(int), -1, 0)
    x = np.arange(160)[None, :] * np.ones((120, 1))
    left, right = (green > red + 60) & (blue > red + 40), (red > green + 60) & (blue > green + 20)
    assert left.any()
    assert right.any()
    assert x[left].mean() > x[right].mean(), "the robot faces the camera: its left is on the right of the picture"


def test_without_shadows_the_floor_beside_the_robot_is_lighter(
    still: np.ndarray, log: RunLog, description: RobotDescription
) -> None:
    with RobotFilm(log, description, width=160, height=120, shadows=False) as film:
        lit = film.picture(60).astype(int)
    brighter = (lit - still).min(axis=2) > 20
    assert 50 < brighter.sum() < 0.2 * brighter.size
    assert (still - lit).max() < 20


def test_film_shows_the_person_waiting_and_then_in_step(
    still: np.ndarray,
    log: RunLog,
    description: RobotDescription,
    targets: TargetTrack,
    pose: PoseTrack,
    video: Path,
    tmp_path: Path,
) -> None:
    done: list[tuple[int, int | None]] = []
    path = tmp_path / "film.mp4"
    save_video(
        path,
        log=log,
        description=description,
        targets=targets,
        pose=pose,
        video=video,
        fps=FPS,
        height=HEIGHT,
        progress=lambda *step: done.append(step),
    )
    frames = list(read_frames(path))
    clock = shared_time(log)
    assert len(frames) == len(done) == done[-1][1] == round((clock[-1] - clock[0]) * FPS)
    assert frames[0].shape == (HEIGHT, 96 + HEIGHT, 3)
    edge = frames[0][HEIGHT - text_band(HEIGHT) + 1, 96 + 2 :]
    assert edge.std(axis=0).max() < 2  # the text has a band of its own: nothing of the robot is under it
    with open_video(path) as film:
        np.testing.assert_allclose(np.diff([frame.stamp_ms for frame in film]), 1e3 / FPS, atol=1)
    grey = np.array([rgb[:6, :10].mean() for rgb in frames])
    moments = clock[0] + np.arange(len(frames)) / FPS
    shown = np.searchsorted(pose.t, moments + 1e-3, side="right") - 1
    np.testing.assert_allclose(grey, 10 + 10 * np.maximum(shown, 0), atol=4)


def test_from_behind_the_sides_are_where_they_are_of_a_person_from_behind(
    still: np.ndarray, log: RunLog, description: RobotDescription, pose: PoseTrack
) -> None:
    behind = replace(pose, landmarks=pose.landmarks * [-1.0, 1.0, -1.0])
    with RobotFilm(log, description, width=160, height=120, pose=behind) as film:
        picture = film.picture(60)
    red, green, blue = np.moveaxis(picture.astype(int), -1, 0)
    x = np.arange(160)[None, :] * np.ones((120, 1))
    left, right = (green > red + 60) & (blue > red + 40), (red > green + 60) & (blue > green + 20)
    assert x[left].mean() < x[right].mean()


def test_film_is_h264_that_every_browser_plays(
    still: np.ndarray, log: RunLog, description: RobotDescription, tmp_path: Path
) -> None:
    import av

    path = tmp_path / "robot.mp4"
    save_video(path, log=log, description=description, fps=FPS, height=HEIGHT + 1)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.pix_fmt) == ("h264", "yuv420p")
        assert (stream.width, stream.height) == (HEIGHT, HEIGHT)


def test_nothing_is_left_of_a_film_that_fails(
    still: np.ndarray, log: RunLog, description: RobotDescription, tmp_path: Path
) -> None:
    def stop(done: int, total: int | None) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        save_video(tmp_path / "film.mp4", log=log, description=description, height=HEIGHT, progress=stop)
    assert list(tmp_path.iterdir()) == []


def test_error_names_what_was_tried(
    monkeypatch: pytest.MonkeyPatch, log: RunLog, description: RobotDescription
) -> None:
    monkeypatch.setattr("mimic.view.film.offscreen._backends", lambda: ["none"])
    monkeypatch.setattr("mimic.view.film.offscreen._context_of", _fails)
    with pytest.raises(NoOffscreenGL, match=r"none: no driver.*apt-get"):
        RobotFilm(log, description, width=32, height=32)


def _fails(backend: str, width: int, height: int) -> None:
    raise OSError("no driver\nand a long explanation")


def test_a_caption_fits_into_a_picture_of_the_default_size():
    picture = np.zeros((480, 480, 3), np.uint8)
    texts = ["12.3 s", "frame 123 of 1499", "tracks the targets", "toe error", "1.2 cm", "13.4 cm"]
    write_texts(picture, [(text, (255, 255, 255)) for text in texts])
    bright = np.flatnonzero((picture[480 - text_band(480) :] > 150).any((0, 2)))
    assert bright[0] >= 10
    assert 400 < bright[-1] <= 470
