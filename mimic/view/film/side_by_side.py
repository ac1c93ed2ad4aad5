"""Human and robot side by side as a film, and single pictures of the robot."""

from __future__ import annotations

import json
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np

from mimic.robot.description import RobotDescription
from mimic.robot.model import load_model
from mimic.store import plain, written_whole
from mimic.types import PHASES, SIDES, FloatArray, PoseTrack, Provenance, RunLog, TargetTrack
from mimic.view import footage, skeleton
from mimic.view.footage import Progress
from mimic.view.offscreen import Offscreen
from mimic.view.robot_shapes import in_world, placed
from mimic.view.skeleton import soft
from mimic.view.timing import followed, frame_times, front, nearest, shared_time

_DISTANCE, _LOOK_HEIGHT = 1.3, 0.41
"""Of the camera from the robot, and the height it looks at, so that raised front legs stay in the picture [m]."""
_SIDEWAYS, _DOWN = np.radians(22.0), np.radians(10.0)
"""The camera stands to the robot's left of straight ahead, and looks down a little [rad]."""
_WANTED_RADIUS = 0.03
"""Of the ball where a toe should be [m]."""
_CLAMPED = 0.005
"""What was asked for is drawn where clamping moved it farther than this [m]."""
_EARLY = 1e-3
"""A video frame may be shown this much before its time, so that rounding delays none by a frame of the film [s]."""

_PHASE_TITLES = {
    "lie": "lying",
    "stand_up": "standing up",
    "blend": "to the first target",
    "hold": "holding",
    "sit_down": "sitting down",
    "damp": "damped",
}


class RobotFilm:
    """Pictures of a run's robot at any tick, from a camera that follows it."""

    def __init__(
        self,
        log: RunLog,
        description: RobotDescription,
        *,
        width: int,
        height: int,
        targets: TargetTrack | None = None,
        supersample: float | None = None,
    ) -> None:
        """Prepare drawing.

        Raises:
            NoOffscreenGL: If there is no OpenGL without a window.
        """
        self._log, self._radius = log, description.toe_radius
        self._aimed = log.aimed
        model = load_model(description)
        self._qpos = placed(log, model)
        self._wanted, self._reached = in_world(self._qpos, log.p_BE_des), in_world(self._qpos, log.p_BE)
        self._asked = None if targets is None else self._asked_for(targets)
        self._path, self._front = followed(log, self._qpos[:, :3]), front(log)
        options = {} if supersample is None else {"supersample": supersample}
        self._screen = Offscreen(model, width, height, **options)

    def _asked_for(self, targets: TargetTrack) -> FloatArray:
        """Return where the toes would be without clamping, world axes (ticks, 2, 3) [m]; NaN where nothing moved."""
        rows = nearest(targets.t, shared_time(self._log))
        asked = np.where(targets.moved[rows, :, None] > _CLAMPED, targets.wanted[rows], np.nan)
        return in_world(self._qpos, asked)

    def picture(self, tick: int) -> np.ndarray:
        """Return the robot at a tick (H, W, 3), RGB, with the wanted toes as balls that one sees through."""
        screen = self._screen
        lookat = np.array([*self._path[tick], _LOOK_HEIGHT])
        azimuth = self._front + np.pi + _SIDEWAYS
        screen.pose(self._qpos[tick], lookat, distance=_DISTANCE, azimuth=azimuth, elevation=-_DOWN)
        tracking = self._aimed[tick]
        for i, side in enumerate(SIDES):
            red, green, blue = (c / 255 for c in skeleton.COLOURS[side])
            screen.add_ball(self._reached[tick, i], 1.06 * self._radius, (red, green, blue, 1.0))
            if tracking and np.isfinite(self._wanted[tick, i]).all():
                screen.add_ball(self._wanted[tick, i], _WANTED_RADIUS, (red, green, blue, 0.45))
            if tracking and self._asked is not None and np.isfinite(self._asked[tick, i]).all():
                screen.add_ball(self._asked[tick, i], 0.012, (1.0, 1.0, 1.0, 0.8))
        return screen.picture()

    def close(self) -> None:
        """Give the graphics memory back."""
        self._screen.close()

    def __enter__(self) -> RobotFilm:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def render_frame(
    log: RunLog,
    description: RobotDescription,
    tick: int,
    *,
    width: int = 640,
    height: int = 640,
    targets: TargetTrack | None = None,
) -> np.ndarray:
    """Return a fine picture (height, width, 3), RGB, of the robot at a tick of a log.

    Raises:
        NoOffscreenGL: If there is no OpenGL without a window.
    """
    with RobotFilm(log, description, width=width, height=height, targets=targets, supersample=2.0) as film:
        return film.picture(tick)


def save_video(
    path: Path,
    *,
    log: RunLog,
    description: RobotDescription,
    targets: TargetTrack | None = None,
    pose: PoseTrack | None = None,
    video: Path | None = None,
    fps: int = 30,
    height: int = 480,
    made_by: Provenance | None = None,
    progress: Progress | None = None,
) -> None:
    """Write an H.264 film (.mp4) of the whole run, complete or not at all.

    With a video, the person is on the left, with the skeleton of ``pose`` over it, and waits in the first frame while
    the robot on the right stands up; both sides then move at the same time.

    Args:
        path: Where the film goes.
        log: What the robot did.
        targets: Also shows, as small white balls, where the toes would be without clamping.
        video: The video that ``pose`` was made from; without it, the robot is alone.
        fps: Frames per second of the film.
        height: Of the film [px].
        made_by: Stored as JSON in the film's comment.
        progress: Called after each frame with the frames done and their number.

    Raises:
        NoOffscreenGL: If there is no OpenGL without a window.
        SourceError: If the video cannot be decoded.
    """
    height -= height % 2
    clock = shared_time(log)
    moments = clock[0] + np.arange(max(1, round((clock[-1] - clock[0]) * fps))) / fps
    ticks = nearest(clock, moments)
    people = None if video is None else _people(video, pose, moments, height)

    def frames() -> Iterator[np.ndarray]:
        with RobotFilm(log, description, width=height, height=height, targets=targets) as film:
            for done, tick in enumerate(ticks, start=1):
                robot = film.picture(int(tick))
                _caption(robot, log, int(tick), float(clock[tick]))
                yield robot if people is None else np.hstack([next(people), robot])
                if progress is not None:
                    progress(done, len(ticks))

    with written_whole(path) as part:
        footage.encode_h264(frames(), part, fps=Fraction(fps), comment=json.dumps(plain(made_by)) if made_by else "")


def _people(video: Path, pose: PoseTrack | None, moments: FloatArray, height: int) -> Iterator[np.ndarray]:
    """Yield the video frame that is on at each moment [s], with the skeleton drawn over it."""
    t = frame_times(footage.frame_stamps(video), pose)
    on = np.clip(np.searchsorted(t, moments + _EARLY, side="right") - 1, 0, len(t) - 1)
    frames = footage.read_frames(video, height=height)
    at, picture = -1, None
    for row in on:
        while at < row:
            _, picture = next(frames)
            at += 1
            if at == row and pose is not None:
                _draw_skeleton(picture, pose, int(nearest(pose.t, t[row : row + 1])[0]))
        assert picture is not None
        yield picture


def _draw_skeleton(picture: np.ndarray, pose: PoseTrack, row: int) -> None:
    """Draw the person of a row of the track over a picture (H, W, 3)."""
    import cv2

    height, width = picture.shape[:2]
    points = pose.image[row : row + 1] * (width, height)
    seen = skeleton.visible(points, pose.valid[row : row + 1])
    thick = max(2, round(height / 120))
    for side, pairs in skeleton.bones(pose.names).items():
        for begin, end in skeleton.segments(points, seen, pairs).ends:
            cv2.line(picture, _pixel(begin), _pixel(end), skeleton.COLOURS[side], thick, cv2.LINE_AA)
    for side, (wrist, known) in skeleton.wrists(pose, points).items():
        if pose.valid[row, pose.index(f"{side}_wrist")] and known[0]:
            cv2.circle(picture, _pixel(wrist[0]), 2 * thick, skeleton.COLOURS[side], -1, cv2.LINE_AA)


def _pixel(point: FloatArray) -> tuple[int, int]:
    return round(float(point[0])), round(float(point[1]))


def _caption(picture: np.ndarray, log: RunLog, tick: int, moment: float) -> None:
    """Write time, phase and toe error into a picture of the robot."""
    phase = PHASES[log.phase[tick]]
    white: skeleton.Colour = (240, 243, 246)
    words: list[tuple[str, skeleton.Colour]] = [(f"{moment:.1f} s", white)]
    if phase == "track":
        error = 100 * np.linalg.norm(log.p_BE[tick] - log.p_BE_des[tick], axis=-1)
        words.append(("toe error", white))
        words += [(f"{e:.1f} cm", soft(skeleton.COLOURS[side])) for e, side in zip(error, SIDES, strict=True)]
    else:
        words.append((_PHASE_TITLES[phase], white))
    _write(picture, words)


def _write(picture: np.ndarray, words: list[tuple[str, skeleton.Colour]]) -> None:
    """Write words in their colours on a dark bar along the bottom of a picture."""
    import cv2

    height = picture.shape[0]
    scale, line = height / 900, max(1, round(height / 480))
    edge = round(height * 0.03)
    x, y = edge, height - edge
    bar = picture[height - 2 * edge - round(22 * scale) :]
    bar[:] = (0.35 * bar + 0.65 * np.array([30, 34, 40])).astype(np.uint8)
    for text, colour in words:
        cv2.putText(picture, text, (x, y), cv2.FONT_HERSHEY_DUPLEX, scale, colour, line, cv2.LINE_AA)
        x += cv2.getTextSize(text, cv2.FONT_HERSHEY_DUPLEX, scale, line)[0][0] + edge
