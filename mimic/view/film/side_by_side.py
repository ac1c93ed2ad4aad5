"""Film of human and robot side by side."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import AbstractContextManager
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from mimic.dynamics.robot_model import load_model
from mimic.io.store import plain, written_whole
from mimic.records import PHASES, SIDES, FloatArray, PoseTrack, Provenance, RunLog, TargetTrack
from mimic.robot.description import RobotDescription
from mimic.view.film import footage, skeleton
from mimic.view.film.footage import Progress
from mimic.view.film.offscreen import Offscreen
from mimic.view.film.skeleton import soft
from mimic.view.scene.robot_shapes import TARGET_RADIUS, in_world, qpos_at_ticks
from mimic.view.scene.timing import (
    PHASE_TITLES,
    camera_path,
    frame_numbers,
    initial_heading,
    nearest,
    shared_time,
)
from mimic.view.scene.viewpoint import seen_from

_DISTANCE = 2.988
"""Distance of the camera [upright heights]; raised front legs stay in the picture."""
_LOOK_HEIGHT = 0.9423
"""Height that it looks at [upright heights]."""
_DOWN = np.radians(10.0)
"""Angle of the camera, downward [rad]."""


METRES_PER_NEWTON = 0.08
"""Length of the arrow of a pull."""


class RobotFilm(AbstractContextManager["RobotFilm"]):
    """Renders the robot of a run at any tick, from a camera that follows it; a ``with`` block releases its memory."""

    def __init__(
        self,
        log: RunLog,
        description: RobotDescription,
        *,
        width: int,
        height: int,
        targets: TargetTrack | None = None,
        pose: PoseTrack | None = None,
        pull: tuple[FloatArray, FloatArray] | None = None,
        shadows: bool = True,
    ) -> None:
        """Prepare rendering.

        Args:
            log: Log of the robot.
            description: The robot.
            width: Width of the pictures [px].
            height: Height of the pictures [px].
            targets: The targets; how the person is turned follows from them.
            pose: The person; the robot is seen from where the camera saw them.
            pull: Where a hand pulls at each tick (T, 3), world axes [m], and how strongly (T, 3) [N]; an arrow.
            shadows: Whether the robot casts one.

        Raises:
            NoOffscreenGL: If off-screen rendering is not available.
        """
        self._log = log
        self._radius = description.toe_radius
        self._tall = description.pose_height["upright"]
        self._aimed = log.aimed
        self._pull = pull
        model = load_model(description)
        self._qpos = qpos_at_ticks(log, model)
        self._target = in_world(self._qpos, log.p_BE_des)
        self._actual = in_world(self._qpos, log.p_BE)
        self._path = camera_path(log, self._qpos[:, :3])
        self._azimuth = initial_heading(log) + seen_from(pose, targets) + np.pi
        self._screen = Offscreen(model, width, height, shadows=shadows)

    def picture(self, tick: int) -> np.ndarray:
        """Return a picture of the robot at a tick (H, W, 3), RGB, with toe targets as transparent balls."""
        screen = self._screen
        lookat = np.array([*self._path[tick], _LOOK_HEIGHT * self._tall])
        screen.pose(self._qpos[tick], lookat, distance=_DISTANCE * self._tall, azimuth=self._azimuth, elevation=-_DOWN)
        tracking = self._aimed[tick]
        for i, side in enumerate(SIDES):
            red, green, blue = (c / 255 for c in skeleton.COLOURS[side])
            screen.add_ball(self._actual[tick, i], 1.06 * self._radius, (red, green, blue, 1.0))
            if tracking and np.isfinite(self._target[tick, i]).all():
                screen.add_ball(self._target[tick, i], TARGET_RADIUS, (red, green, blue, 0.45))
        if self._pull is not None:
            at, force = (values[tick] for values in self._pull)
            screen.add_arrow(at, at + METRES_PER_NEWTON * force, 0.012, (0.95, 0.75, 0.1, 1.0))
        return screen.picture()

    def __exit__(self, *_: object) -> None:
        self._screen.close()


def save_video(
    path: Path,
    *,
    log: RunLog,
    description: RobotDescription,
    targets: TargetTrack | None = None,
    pose: PoseTrack | None = None,
    video: Path | None = None,
    pull: tuple[FloatArray, FloatArray] | None = None,
    fps: int = 30,
    height: int = 480,
    made_by: Provenance | None = None,
    progress: Progress | None = None,
) -> None:
    """Write an H.264 film (.mp4) of the whole run; the file is complete or not written at all.

    With a video, the person is on the left, overlaid with the skeleton of ``pose``. The left side shows the first frame
    while the robot on the right stands up; then both sides play synchronously.

    Args:
        path: File to write.
        log: Log of the robot.
        targets: As of `RobotFilm`.
        video: The video of ``pose``; without both, the film shows only the robot.
        pull: The pull of a hand, see `RobotFilm`; drawn and written.
        fps: Frames per second of the film.
        height: Height of the film [px].
        made_by: Stored as JSON in the film's comment.
        progress: Called after each frame with the frames done and the total.

    Raises:
        NoOffscreenGL: If off-screen rendering is not available.
        SourceError: If the video cannot be decoded.
    """
    height -= height % 2
    clock = shared_time(log)
    times = clock[0] + np.arange(max(1, round((clock[-1] - clock[0]) * fps))) / fps
    ticks = nearest(clock, times)
    errors = 100 * np.linalg.norm(log.p_BE - log.p_BE_des, axis=-1)
    newtons = None if pull is None else np.linalg.norm(pull[1], axis=1)
    video_frames = None if video is None or pose is None else _video_frames(video, pose, times, height)
    frame_texts = [f"frame {n} of {len(pose.t)}" for n in frame_numbers(clock, pose.t)] if pose is not None else []

    band = text_band(height)
    shown: dict[str, Any] = {"width": height, "height": height - band, "targets": targets, "pose": pose, "pull": pull}

    def frames() -> Iterator[np.ndarray]:
        with RobotFilm(log, description, **shown) as film:
            for done, tick in enumerate(ticks, start=1):
                robot = np.pad(film.picture(int(tick)), ((0, band), (0, 0), (0, 0)))
                said = frame_texts[tick : tick + 1]
                said += [] if newtons is None else [f"pull {newtons[tick]:.1f} N"]
                _caption(robot, log, int(tick), float(clock[tick]), said, errors[tick])
                yield robot if video_frames is None else np.hstack([next(video_frames), robot])
                if progress is not None:
                    progress(done, len(ticks))

    with written_whole(path) as part:
        footage.encode_h264(frames(), part, fps=Fraction(fps), comment=json.dumps(plain(made_by)) if made_by else "")


def _video_frames(video: Path, pose: PoseTrack, times: FloatArray, height: int) -> Iterator[np.ndarray]:
    """Yield the video frame at each of the times [s], overlaid with the skeleton."""
    frames = footage.read_frames(video, height=height)
    at = -1
    picture = None
    for row in frame_numbers(times, pose.t):
        while at < row:
            picture = next(frames)
            at += 1
            if at == row:
                _draw_skeleton(picture, pose, at)
        assert picture is not None
        yield picture


def _draw_skeleton(picture: np.ndarray, pose: PoseTrack, row: int) -> None:
    """Draw the skeleton of a row of the track over a picture (H, W, 3)."""
    import cv2

    height, width = picture.shape[:2]
    points = pose.image[row : row + 1] * (width, height)
    seen = skeleton.visible(points, pose.valid[row : row + 1])
    thick = max(2, round(height / 120))
    for side, pairs in skeleton.bones(pose.names).items():
        for begin, end in skeleton.segments(points, seen, pairs).ends:
            cv2.line(picture, _pixel(begin), _pixel(end), skeleton.COLOURS[side], thick, cv2.LINE_AA)
    certain = skeleton.certainty(pose)
    for side, (wrist, _) in skeleton.wrists(pose, points).items():
        if seen[0, pose.index(f"{side}_wrist")]:
            colour = skeleton.doubtful(skeleton.COLOURS[side], float(certain[side][row]))
            cv2.circle(picture, _pixel(wrist[0]), 2 * thick, colour, -1, cv2.LINE_AA)


def _pixel(point: FloatArray) -> tuple[int, int]:
    return round(float(point[0])), round(float(point[1]))


def _caption(picture: np.ndarray, log: RunLog, tick: int, moment: float, said: list[str], error: FloatArray) -> None:
    """Write time, what is said of it, phase and toe error (2,) [cm] into a picture of the robot."""
    phase = PHASES[log.phase[tick]]
    white: skeleton.Colour = (240, 243, 246)
    texts = [(text, white) for text in (f"{moment:.1f} s", *said, PHASE_TITLES[phase])]
    if phase == "track":
        texts.append(("toe error", white))
        texts += [(f"{e:.1f} cm", soft(skeleton.COLOURS[side])) for e, side in zip(error, SIDES, strict=True)]
    write_texts(picture, texts)


def text_band(height: int) -> int:
    """Return the height [px] of the band of text at the bottom of a picture of this height."""
    return 2 * round(height * 0.03) + round(22 * height / 900)


def write_texts(picture: np.ndarray, texts: list[tuple[str, skeleton.Colour]]) -> None:
    """Write coloured text on a dark band at the bottom of a picture, smaller where it would not fit."""
    import cv2

    height, width = picture.shape[:2]
    scale = height / 900
    line = max(1, round(height / 480))
    edge = round(height * 0.03)
    room = width - edge * (len(texts) + 1)
    while scale > 0.1 and room < sum(
        cv2.getTextSize(text, cv2.FONT_HERSHEY_DUPLEX, scale, line)[0][0] for text, _ in texts
    ):
        scale *= 0.95
    x = edge
    y = height - edge
    bar = picture[height - text_band(height) :]
    bar[:] = (0.35 * bar + 0.65 * np.array([30, 34, 40])).astype(np.uint8)
    for text, colour in texts:
        cv2.putText(picture, text, (x, y), cv2.FONT_HERSHEY_DUPLEX, scale, colour, line, cv2.LINE_AA)
        x += cv2.getTextSize(text, cv2.FONT_HERSHEY_DUPLEX, scale, line)[0][0] + edge
