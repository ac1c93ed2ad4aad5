"""Pose from a camera (or a file in real time), in a child process that processes only the newest frame.

Two threads share the process: one reads frames and keeps only the newest, the other runs the detector on it. The parent
receives small rows through a pipe, so the detector never blocks the control loop and no backlog builds up.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import chain
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from queue import Empty, Queue
from typing import TYPE_CHECKING, Any

import numpy as np

from mimic.config.pose import LiveSettings, PoseSettings
from mimic.errors import SourceError
from mimic.io.reading import existing
from mimic.records import BoolArray, FloatArray
from mimic.sources.video.decoding import Frame, check_video, open_video, picture_size, square
from mimic.sources.video.left_right import LiveSides, other_side
from mimic.sources.video.pose_models.blazepose import NOBODY, BlazePose, Everybody
from mimic.sources.video.pose_models.pose_model import pose_model
from mimic.sources.video.quiet import quiet_stderr
from mimic.sources.video.screening import person_rows
from mimic.sources.video.shots import clothes_colour

if TYPE_CHECKING:
    from mimic.sources.video.depth import LiveDepth
    from mimic.sources.video.people import People

OPEN_TIMEOUT = 60.0
"""Time limit for the first frame of a camera [s]."""
LOOK_EVERY = 3.0
"""Time between two looks for several people [s]; one takes as long as some frames."""
LATEST_LOOKS = 10
"""Several people are said by this many latest looks."""
LOW_PRIORITY = 10
"""Niceness of the camera process when the control loop has priority."""
PREVIEW_WIDTH = 320
"""Width of preview pictures [px]."""
PREVIEW_INTERVAL = 0.1
"""Shortest time between two of them [s]."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CameraFrame:
    """Detections in one frame; the arrays are one row of a pose track."""

    t: float
    """Arrival of the frame, on the monotonic clock [s]."""
    landmarks: FloatArray
    """Mid-hip -> landmark (33, 3), camera axes [m]; NaN if no person was detected."""
    image: FloatArray
    """Image coordinates (33, 2), fractions of width and height."""
    score: FloatArray
    """Visibility (33,)."""
    valid: BoolArray
    """Which landmarks are usable (33,); none if no person was detected."""
    size: tuple[int, int]
    """Width and height of the picture [px]."""
    number: int
    """Frames before it; those that are no rows were dropped in favour of newer ones."""
    swapped: bool
    """Whether the left and right of the detector were swapped."""
    detector_s: float
    """Time that the detector took [s]."""
    depth_spread: FloatArray
    """Standard deviation of the depth of left and right wrist (2,) [m]; NaN if it was not estimated."""
    people: tuple[str, ...]
    """What is to be said about several people in view so far."""
    jpeg: bytes | None
    """Preview picture; None in most rows."""


@dataclass(slots=True, eq=False)
class CameraStream:
    """An open camera; it yields one row per processed frame."""

    name: str
    _pipe: Connection
    _process: Any

    def begin(self) -> None:
        """Start playback of a file; a camera is already running."""
        self._pipe.send("begin")

    def rows(self) -> Iterator[CameraFrame]:
        """Yield rows until the file ends or the stream is closed; of several waiting rows, only the newest.

        Raises:
            SourceError: If the camera fails.
        """
        preview = None
        while True:
            try:
                item = self._pipe.recv()
                preview = getattr(item, "jpeg", None) or preview
                if isinstance(item, CameraFrame) and self._pipe.poll():  # a newer one has arrived
                    continue
            except (EOFError, OSError):
                return
            if isinstance(item, str):
                raise SourceError(item)
            if item is None:
                return
            yield replace(item, jpeg=preview)
            preview = None


@contextmanager
def open_camera(
    camera: str, pose: PoseSettings, live: LiveSettings, *, previews: bool = False, low_priority: bool = False
) -> Iterator[CameraStream]:
    """Open a camera by number or device, or a video file to be played in real time.

    Args:
        camera: ``0``, ``/dev/video0``, or the path of a video.
        pose: Minimum visibility of a landmark.
        live: Requested picture size of the camera.
        previews: Whether some rows carry a preview picture.
        low_priority: Whether other processes, such as the control loop of a robot, have priority.

    Raises:
        SourceError: If it cannot be opened, or delivers no picture.
        AssetError: If there is no model to detect with.
    """
    device = _is_device(camera)
    pose_model()  # its errors are raised here
    context = get_context("spawn")
    parent_end, child_end = context.Pipe()
    process = context.Process(
        target=_run_camera, args=(camera, device, pose, live, (previews, low_priority), child_end), daemon=True
    )
    process.start()
    child_end.close()
    try:
        if not parent_end.poll(OPEN_TIMEOUT):
            raise SourceError(f"no picture from {camera} within {OPEN_TIMEOUT:g} s; is another program using it?")
        try:
            answer = parent_end.recv()
        except EOFError:
            raise SourceError(f"the camera process of {camera} ended before its first picture") from None
        if answer is not True:
            raise SourceError(str(answer))
        yield CameraStream(camera, parent_end, process)
    finally:
        process.terminate()
        process.join()
        parent_end.close()


def check_camera(camera: str) -> None:
    """Open a camera, or a video in its place, and close it again.

    Raises:
        SourceError: If it is neither, or delivers no picture.
    """
    if _is_device(camera):
        _opened(camera, None)[0].release()
    else:
        check_video(Path(camera))


def _is_device(camera: str) -> bool:
    """Return whether it is a camera.

    Raises:
        SourceError: If it is no file either.
    """
    device = camera.isdigit() or camera.startswith("/dev/")
    if not device and existing(camera, "camera and no file '{}'; give a number such as 0, or a video").is_dir():
        raise SourceError(f"{camera} is a folder; give the number of a camera, such as 0, or a video")
    return device


def _opened(camera: str, picture: tuple[int, int] | None) -> tuple[Any, np.ndarray]:
    """Return an open camera and its first picture, RGB.

    Args:
        camera: Its number or device.
        picture: Width and height asked of it [px]; None for its own.

    Raises:
        SourceError: If there is none, or it delivers no picture.
    """
    import cv2

    with quiet_stderr():
        capture = cv2.VideoCapture(int(camera) if camera.isdigit() else camera)
        if picture is not None:
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, picture[0])
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, picture[1])
            capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        ok, first = capture.read() if capture.isOpened() else (False, None)
    if not ok or first is None:
        capture.release()
        raise SourceError(f"cannot read a picture from {camera}; is it a camera, and not used by another program?")
    return capture, _rgb(first)


def _rgb(bgr: np.ndarray) -> np.ndarray:
    import cv2

    return cv2.cvtColor(square(bgr, picture_size(bgr)), cv2.COLOR_BGR2RGB)


_Newest = Queue[tuple[int, float, np.ndarray] | None]
"""Holds only the newest frame: its number, its arrival and the picture; None at the end."""


def _keep_newest(pictures: Iterator[np.ndarray], latest: _Newest) -> None:
    for number, rgb in enumerate(pictures):
        with suppress(Empty):
            latest.get_nowait()
        latest.put((number, time.monotonic(), rgb))
    latest.put(None)


def _run_camera(
    camera: str, device: bool, pose: PoseSettings, live: LiveSettings, options: tuple[bool, bool], pipe: Connection
) -> None:
    """Body of the camera process; its first message is True, or the reason why it cannot start."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process handles Ctrl-C
    previews, low_priority = options
    if low_priority:
        os.nice(LOW_PRIORITY)
    from mimic.sources.video.depth import LiveDepth
    from mimic.sources.video.people import People

    latest: _Newest = Queue(1)
    depth = LiveDepth() if pose.depth else None
    model = pose_model()
    hint = "let one person stand before the camera"
    try:
        with ExitStack() as stack:
            if device:
                capture, first = _opened(camera, live.camera_size)
                pictures = _read_camera(capture)
            else:
                video = stack.enter_context(open_video(Path(camera)))
                frame = next(video.frames)
                first = frame.rgb
                pictures = _play_file(chain([frame], video.frames), pipe)
            detect = stack.enter_context(BlazePose(model))
            everybody = stack.enter_context(Everybody(model))
            people = People(everybody, None, camera, hint, latest=LATEST_LOOKS)
            detect(people.show(0.0, first))  # warm-up: the first detection is slow
            pipe.send(True)
            threading.Thread(target=_keep_newest, args=(pictures, latest), daemon=True).start()
            _detect(latest, detect, people, depth, pose, pipe, previews)
    except SourceError as reason:
        pipe.send(str(reason))


def _read_camera(capture: Any) -> Iterator[np.ndarray]:
    """Yield frames as they arrive; stop after a second of failed reads."""
    failures = 0
    while failures < 30:
        ok, bgr = capture.read()
        failures = 0 if ok else failures + 1
        if ok:
            yield _rgb(bgr)
        else:
            time.sleep(1 / 30)


def _play_file(frames: Iterator[Frame], pipe: Connection) -> Iterator[np.ndarray]:
    """Yield the frames of a file in real time, by their time stamps, once the parent asks for them."""
    try:
        pipe.recv()
    except (EOFError, OSError):
        return
    begun = None
    for frame in frames:
        begun = begun or time.monotonic() - frame.stamp_ms / 1e3
        time.sleep(max(0.0, begun + frame.stamp_ms / 1e3 - time.monotonic()))
        yield frame.rgb


def _detect(
    latest: _Newest,
    detect: Any,
    people: People,
    depth: LiveDepth | None,
    pose: PoseSettings,
    pipe: Connection,
    previews: bool,
) -> None:
    """Detect the person in the newest frame and send a row, until there are no more frames."""
    import cv2

    sides = LiveSides()
    last_preview = -np.inf
    began = None
    looked = 0.0
    while (item := latest.get()) is not None:
        number, t, rgb = item
        started = time.monotonic()
        began = began or t
        if t - began > looked + LOOK_EVERY:
            looked = t - began
            people.look(looked, rgb)
        found = detect(rgb)
        landmarks, image, score = found or NOBODY
        swapped = found is not None and sides.decide(t, landmarks)
        if swapped:
            landmarks, image, score = (column[other_side()] for column in (landmarks, image, score))
        people.saw(image, clothes_colour(rgb, image))
        person = bool(person_rows(score[None], pose.min_visibility)[0])
        size = (rgb.shape[1], rgb.shape[0])
        spread = np.full(2, np.nan)
        if person and depth is not None:
            landmarks, spread = depth.see(t, landmarks, image, score, size)
        jpeg = None
        if previews and t - last_preview >= PREVIEW_INTERVAL:
            small = cv2.resize(rgb, (PREVIEW_WIDTH, round(PREVIEW_WIDTH * rgb.shape[0] / rgb.shape[1])))
            small = cv2.cvtColor(small, cv2.COLOR_RGB2BGR)
            jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 75])[1].tobytes()
            last_preview = t
        row = CameraFrame(
            t=t,
            landmarks=landmarks,
            image=image,
            score=score,
            valid=(score >= pose.min_visibility) & person,
            size=size,
            number=number,
            swapped=bool(swapped),
            detector_s=time.monotonic() - started,
            depth_spread=spread,
            people=tuple(people.sentences()),
            jpeg=jpeg,
        )
        try:
            pipe.send(row)
        except (BrokenPipeError, OSError):
            return
    pipe.send(None)
