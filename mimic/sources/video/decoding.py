"""Upright RGB frames of a video file with corrected times, decoded in a background thread."""

from __future__ import annotations

import logging
import os
import queue
import threading
from bisect import bisect_left
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mimic.errors import SourceError
from mimic.records import FloatArray
from mimic.sources.video.quiet import quiet_stderr

log = logging.getLogger(__name__)

MAX_SIDE = 1280
"""Maximum side length of a frame for the detector, which crops the person to 256 x 256 [px].

Source: four 1080 x 1920 views of a real person against triangulation: the mean shoulder -> wrist error is 152 mm at
full size and at this size; at 640 px the detector swaps left and right more often.
"""

_QUEUE_SIZE = 8
_THUMBNAIL = (32, 24)


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One decoded frame."""

    stamp_ms: float
    """Presentation time stamp in the file [ms]."""
    rgb: np.ndarray
    """Upright picture (H, W, 3), no side longer than MAX_SIDE."""
    change: float
    """Mean absolute difference of the thumbnail from the previous frame [grey levels of 255]; 0 for the first."""


@dataclass(frozen=True, slots=True, eq=False)
class Video:
    """An open video; iterate over it once."""

    size: tuple[int, int]
    """Width and height of the upright picture with square pixels [px]."""
    frame_count: int | None
    """Number of frames in the header, None if it has none. It may be wrong."""
    frames: Iterator[Frame]
    """The frames in order, decoded in a background thread."""

    def __iter__(self) -> Iterator[Frame]:
        return self.frames


@contextmanager
def open_video(path: Path) -> Iterator[Video]:
    """Open a video file to read its frames once.

    Raises:
        SourceError: If there is no file, or no frame can be decoded from it.
    """
    # Silences FFmpeg's messages about the file; OpenCV reads the variable when it is first used.
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    import cv2

    if not path.is_file():
        raise SourceError(f"there is no file {path}; give the path of a video (mp4, mkv, mov, gif, …)")
    if path.stat().st_size == 0:
        raise SourceError(f"{path.name} is empty (0 bytes); record or copy the video again")
    with quiet_stderr():
        capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    stop = threading.Event()
    decoded: queue.Queue[Frame | Exception | None] = queue.Queue(_QUEUE_SIZE)
    thread: threading.Thread | None = None
    try:
        ok, first = capture.read() if capture.isOpened() else (False, None)
        if not ok or first is None:
            raise SourceError(
                f"no picture can be read from {path.name} ({path.stat().st_size} bytes); expected a video "
                "with a picture track (mp4, mkv, mov, gif, …); check that a video player shows it"
            )
        frame_count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        size = picture_size(capture, first)
        frame, thumbnail = _frame(first, capture.get(cv2.CAP_PROP_POS_MSEC), None, size)
        thread = threading.Thread(
            target=_decode_into, args=(capture, decoded, stop, thumbnail, size), name="decode", daemon=True
        )
        thread.start()
        yield Video(size, frame_count if frame_count > 0 else None, _drain(frame, decoded))
    finally:
        stop.set()
        if thread is not None:
            thread.join()
        capture.release()


def check_video(path: Path) -> None:
    """Raise a SourceError if no picture can be read from a file."""
    with open_video(path):
        pass


def picture_size(capture: Any, frame: np.ndarray) -> tuple[int, int]:
    """Return the width and height that show the frames of an open capture with square pixels; none gets less of them.

    A shape of the pixels that no video has counts as square.
    """
    import cv2

    shape = capture.get(cv2.CAP_PROP_SAR_NUM) or 1.0, capture.get(cv2.CAP_PROP_SAR_DEN) or 1.0
    turned = int(capture.get(cv2.CAP_PROP_ORIENTATION_META)) % 180 == 90
    pixel = shape[turned] / shape[not turned]
    pixel = pixel if 0.25 <= pixel <= 4.0 else 1.0
    return round(frame.shape[1] * max(pixel, 1.0)), round(frame.shape[0] / min(pixel, 1.0))


def square(bgr: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return a frame with the sides of `picture_size`, shrunk where one is longer than MAX_SIDE."""
    import cv2

    shrink = min(1.0, MAX_SIDE / max(size))
    wanted = round(size[0] * shrink), round(size[1] * shrink)
    same = wanted == (bgr.shape[1], bgr.shape[0])
    return bgr if same else cv2.resize(bgr, wanted, interpolation=cv2.INTER_LINEAR)


def _frame(
    bgr: np.ndarray, stamp_ms: float, previous: np.ndarray | None, size: tuple[int, int]
) -> tuple[Frame, np.ndarray]:
    """Return the frame, and its thumbnail for comparison with the next one."""
    import cv2

    height, width = bgr.shape[:2]
    stride = max(1, min(height, width) // 96)
    thumbnail = cv2.resize(bgr[::stride, ::stride], _THUMBNAIL, interpolation=cv2.INTER_AREA).astype(np.int16)
    change = 0.0 if previous is None else float(np.abs(thumbnail - previous).mean())
    return Frame(stamp_ms, cv2.cvtColor(square(bgr, size), cv2.COLOR_BGR2RGB), change), thumbnail


def _decode_into(
    capture: Any,
    decoded: queue.Queue[Any],
    stop: threading.Event,
    thumbnail: np.ndarray | None,
    size: tuple[int, int],
) -> None:
    import cv2

    def put(item: Frame | Exception | None) -> None:
        while not stop.is_set():
            try:
                return decoded.put(item, timeout=0.1)
            except queue.Full:
                continue

    try:
        while not stop.is_set():
            ok, bgr = capture.read()
            if not ok:
                break
            # After read() this is the time of this frame, also with a variable frame rate.
            frame, thumbnail = _frame(bgr, capture.get(cv2.CAP_PROP_POS_MSEC), thumbnail, size)
            put(frame)
    except Exception as error:
        put(error)
    else:
        put(None)


def _drain(first: Frame, decoded: queue.Queue[Any]) -> Iterator[Frame]:
    yield first
    while (item := decoded.get()) is not None:
        if isinstance(item, Exception):
            raise item
        yield item


def missing_bytes(path: Path) -> int:
    """Return how many bytes the outermost elements of an MP4, MOV, MKV, WebM or AVI announce beyond the file's end.

    0 where none do. The number of frames in a header says less: it counts those before an edit list or a late start.
    """
    size = end = path.stat().st_size
    with open(path, "rb") as file:
        head = file.read(4096)
        if head[:4] == b"RIFF":
            end = 8 + int.from_bytes(head[4:8], "little")
        elif head[:4] == b"\x1a\x45\xdf\xa3":  # EBML, then the segment
            header, at = _ebml_size(head, 4)
            length, at = _ebml_size(head, at + (header or 0) + 4)
            end = size if length is None else at + length
        elif head[4:8] in (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip"):
            end = 0
            while end + 8 <= size:
                file.seek(end)
                box = file.read(16)
                length = int.from_bytes(box[8:16] if box[:4] == b"\0\0\0\1" else box[:4], "big")
                end = end + length if length >= 8 else size
    return max(0, end - size)


def _ebml_size(data: bytes, at: int) -> tuple[int | None, int]:
    """Return the size that stands at a place, None where it is unknown, and the place after it."""
    if at >= len(data) or not data[at]:
        return None, at
    count = 9 - data[at].bit_length()
    ones = (1 << 7 * count) - 1
    value = int.from_bytes(data[at : at + count], "big") & ones
    return None if value == ones else value, at + count


def true_times(stamps_ms: FloatArray) -> tuple[FloatArray, int]:
    """Return strictly increasing times since the first frame, and how many stamps had to be replaced.

    The longest increasing subsequence of stamps is kept; the others are spaced evenly between their kept neighbours.

    Args:
        stamps_ms: Time stamps in the file (T,) [ms].

    Returns:
        Times (T,) [s], the first one 0, and the number of replaced stamps.
    """
    stamps = np.asarray(stamps_ms, dtype=np.float64)
    tails: list[float] = []
    last: list[int] = []
    predecessor = np.full(len(stamps), -1)
    for i, stamp in enumerate(stamps):
        k = bisect_left(tails, stamp)
        if k < len(tails) and tails[k] == stamp:
            continue  # repeated: the first one is kept
        predecessor[i] = last[k - 1] if k else -1
        tails[k : k + 1], last[k : k + 1] = [stamp], [i]
    good: list[int] = []
    i = last[-1] if last else -1
    while i >= 0:
        good.append(i)
        i = int(predecessor[i])
    good.reverse()
    step = float(np.median(np.diff(stamps[good]) / np.diff(good))) if len(good) > 1 else 0.0
    rows = np.arange(len(stamps))
    t = np.interp(rows, good, stamps[good])
    t += step * (np.minimum(rows - good[0], 0) + np.maximum(rows - good[-1], 0))
    return (t - t[0]) / 1e3, len(stamps) - len(good)
