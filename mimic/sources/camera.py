"""A camera, or a file in its place, watched by a process of its own: the newest frame becomes a row, older ones are dropped.

Two threads share the process: one takes frames and keeps only the newest, the other one runs the detector on it. Rows are
small and go to whoever watches through a pipe, so that vision never holds up the robot's loop and no backlog can grow.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from mimic.errors import SourceError
from mimic.settings import LiveSettings, PoseSettings
from mimic.sources.quiet import quiet_stderr
from mimic.sources.screening import person_rows
from mimic.sources.sides import LiveSides, exchange_sides
from mimic.types import BoolArray, FloatArray

START = 60.0
"""A camera that shows no frame by then will not [s]."""
MODEST = 10
"""Niceness of a process that gives way."""
PREVIEW_WIDTH, PREVIEW_SECONDS = 320, 0.1
"""Pictures that go along for showing: so wide [px], one in so long [s]."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Seen:
    """What one frame showed; arrays are of one row of a pose track."""

    t: float
    """When the frame was there, on the monotonic clock [s]."""
    landmarks: FloatArray
    """Mid-hip -> landmark (33, 3), camera axes [m]; NaN where nothing was seen."""
    image: FloatArray
    """Place in the image (33, 2), fraction of width and height."""
    score: FloatArray
    """Visibility (33,)."""
    valid: BoolArray
    """Which landmarks may be used (33,); none where no person is."""
    size: tuple[int, int]
    """Width and height of the picture [px]."""
    skipped: int
    """Frames that were dropped since the one before, because a newer one was there."""
    swapped: bool
    """Whether left and right of the detector were exchanged."""
    took: float
    """Of the detector [s]."""
    jpeg: bytes | None = None
    """A small picture, now and then."""


@dataclass(slots=True, eq=False)
class Watch:
    """An opened camera; rows come out of it, the newest last."""

    name: str
    _pipe: Connection
    _process: Any

    def begin(self) -> None:
        """Let a file begin to play; a camera runs already."""
        self._pipe.send("begin")

    def rows(self) -> Iterator[Seen]:
        """Yield what is seen until a file is over or the watch is closed; of rows that wait only the newest.

        Raises:
            SourceError: If the camera fails.
        """
        dropped, picture = 0, None
        while True:
            try:
                item = self._pipe.recv()
                picture = item.jpeg or picture if isinstance(item, Seen) else picture
                if isinstance(item, Seen) and self._pipe.poll():  # a newer one is there
                    dropped += item.skipped + 1
                    continue
            except (EOFError, OSError):
                return
            if isinstance(item, str):
                raise SourceError(item)
            if item is None:
                return
            yield replace(item, skipped=item.skipped + dropped, jpeg=picture)
            dropped, picture = 0, None


@contextmanager
def watched(
    camera: str, pose: PoseSettings, live: LiveSettings, *, pictures: bool = False, modest: bool = False
) -> Iterator[Watch]:
    """Open a camera by its number or device, or a video file that is played in real time, ready to be watched.

    Args:
        camera: ``0``, ``/dev/video0``, or the path of a video.
        pose: Least visibility.
        live: Size asked of the camera.
        pictures: Whether small pictures go along.
        modest: Whether the process gives way to others, such as the loop of a robot.

    Raises:
        SourceError: If it cannot be opened, or gives no picture.
    """
    device = camera.isdigit() or camera.startswith("/dev/")
    if not device and not Path(camera).is_file():
        raise SourceError(f"there is no camera and no file {camera!r}; give a number such as 0, or a video")
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_watch, args=(camera, device, pose, live, (pictures, modest), theirs), daemon=True)
    process.start()
    theirs.close()
    try:
        if not ours.poll(START):
            raise SourceError(f"{camera} shows no picture after {START:g} s; is it used by another program?")
        try:
            answer = ours.recv()
        except EOFError:
            raise SourceError(f"the process that watches {camera} ended before its first picture") from None
        if answer is not True:
            raise SourceError(str(answer))
        yield Watch(camera, ours, process)
    finally:
        process.terminate()
        process.join()
        ours.close()


class _Newest:
    """The newest frame and how many were dropped before it was taken."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._item: tuple[float, np.ndarray] | None = None
        self._dropped, self._over = 0, False

    def put(self, t: float, bgr: np.ndarray) -> None:
        with self._condition:
            self._dropped += self._item is not None
            self._item = t, bgr
            self._condition.notify()

    def end(self) -> None:
        with self._condition:
            self._over = True
            self._condition.notify()

    def take(self) -> tuple[float, np.ndarray, int] | None:
        """Return the newest frame as soon as there is one; None at the end."""
        with self._condition:
            self._condition.wait_for(lambda: self._item is not None or self._over)
            if self._item is None:
                return None
            (t, bgr), dropped = self._item, self._dropped
            self._item, self._dropped = None, 0
            return t, bgr, dropped


def _watch(
    camera: str, device: bool, pose: PoseSettings, live: LiveSettings, how: tuple[bool, bool], pipe: Connection
) -> None:
    """Watch in a process of its own; the first thing sent is True, or why not."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the one who watches decides
    pictures, modest = how
    if modest:
        os.nice(MODEST)
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    import cv2

    from mimic.sources.blazepose import BlazePose

    with quiet_stderr():
        capture = cv2.VideoCapture(int(camera)) if camera.isdigit() else cv2.VideoCapture(camera)
        if device:
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, live.camera_size[0])
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, live.camera_size[1])
            capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        ok, first = capture.read() if capture.isOpened() else (False, None)
    if not ok or first is None:
        pipe.send(f"no picture comes from {camera}; is it a camera or a video, and free?")
        return
    newest, go = _Newest(), threading.Event()
    with BlazePose() as detect:
        detect(cv2.cvtColor(first, cv2.COLOR_BGR2RGB))  # the first one takes longer
        pipe.send(True)
        if not device:
            threading.Thread(target=_wait_for_begin, args=(pipe, go), daemon=True).start()
        grab = _grab_camera if device else _play_file
        threading.Thread(target=grab, args=(capture, first, newest, go), daemon=True).start()
        _detect(newest, detect, pose, pipe, pictures)


def _wait_for_begin(pipe: Connection, go: threading.Event) -> None:
    try:
        pipe.recv()
    except (EOFError, OSError):
        return
    go.set()


def _grab_camera(capture: Any, first: np.ndarray, newest: _Newest, go: threading.Event) -> None:
    """Take frames as they come; a camera that fails for a second is over."""
    bad = 0
    while bad < 30:
        ok, bgr = capture.read()
        if ok:
            newest.put(time.monotonic(), bgr)
            bad = 0
        else:
            bad += 1
            time.sleep(1 / 30)
    newest.end()


def _play_file(capture: Any, first: np.ndarray, newest: _Newest, go: threading.Event) -> None:
    """Show the frames of a file when they are due, by its own time stamps."""
    import cv2

    go.wait()
    start, stamp, bgr, zero = time.monotonic(), 0.0, first, float(capture.get(cv2.CAP_PROP_POS_MSEC))
    while True:
        time.sleep(max(0.0, start + stamp - time.monotonic()))
        newest.put(time.monotonic(), bgr)
        ok, bgr = capture.read()
        if not ok:
            break
        stamp = max(stamp, (float(capture.get(cv2.CAP_PROP_POS_MSEC)) - zero) / 1e3)
    newest.end()


def _detect(newest: _Newest, detect: Any, pose: PoseSettings, pipe: Connection, pictures: bool) -> None:
    """Send a row for each newest frame until there are no more."""
    import cv2

    sides, shown = LiveSides(), -np.inf
    while (item := newest.take()) is not None:
        t, bgr, skipped = item
        begin = time.monotonic()
        found = detect(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB))
        nothing = np.full((33, 3), np.nan), np.full((33, 2), np.nan), np.zeros(33)
        landmarks, image, score = found or nothing
        swapped = found is not None and sides.decide(t, landmarks)
        if swapped:
            landmarks, image, score = (
                exchange_sides(a[None], np.ones(1, dtype=np.bool_))[0] for a in (landmarks, image, score)
            )
        person = bool(person_rows(score[None], pose.min_visibility)[0])
        jpeg = None
        if pictures and t - shown >= PREVIEW_SECONDS:
            small = cv2.resize(bgr, (PREVIEW_WIDTH, round(PREVIEW_WIDTH * bgr.shape[0] / bgr.shape[1])))
            jpeg, shown = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 75])[1].tobytes(), t
        row = Seen(
            t=t,
            landmarks=landmarks,
            image=image,
            score=score,
            valid=(score >= pose.min_visibility) & person,
            size=(bgr.shape[1], bgr.shape[0]),
            skipped=skipped,
            swapped=bool(swapped),
            took=time.monotonic() - begin,
            jpeg=jpeg,
        )
        try:
            pipe.send(row)
        except (BrokenPipeError, OSError):
            return
    pipe.send(None)
