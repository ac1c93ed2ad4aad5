"""Upright RGB frames of a video file with corrected times, decoded in a background thread."""

from __future__ import annotations

import queue
import threading
from bisect import bisect_left
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mimic.errors import SourceError
from mimic.records import FloatArray

if TYPE_CHECKING:
    from av import Packet
    from av.container import InputContainer
    from av.video.stream import VideoStream

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
    size: tuple[int, int]
    """Width and height of the upright picture with square pixels [px]."""


@dataclass(frozen=True, slots=True, eq=False)
class Video:
    """An open video; iterate over it once."""

    size: tuple[int, int]
    """Width and height of the upright picture with square pixels [px]."""
    frame_count: int | None
    """Number of frames in the header, None if it has none. It may be wrong."""
    frames: Iterator[Frame]
    """The frames in order, decoded in a background thread."""
    damaged: list[float]
    """Times of the frames so far that could not be decoded [s]; those behind them are."""

    def __iter__(self) -> Iterator[Frame]:
        return self.frames


@contextmanager
def open_video(path: Path) -> Iterator[Video]:
    """Open a video file to read its frames once.

    Raises:
        SourceError: If there is no file, or no frame can be decoded from it.
    """
    if not path.is_file():
        raise SourceError(f"there is no file {path}; give the path of a video (mp4, mkv, mov, gif, …)")
    if path.stat().st_size == 0:
        raise SourceError(f"{path.name} is empty (0 bytes); record or copy the video again")
    damaged: list[float] = []
    first, others, count = _opened(path, damaged)
    stop = threading.Event()
    decoded: queue.Queue[Frame | Exception | None] = queue.Queue(_QUEUE_SIZE)
    thread = threading.Thread(target=_decode_into, args=(others, decoded, stop), name="decode", daemon=True)
    thread.start()
    try:
        yield Video(first.size, count, chain([first], _drain(decoded)), damaged)
    finally:
        stop.set()
        thread.join()
        others.close()


def check_video(path: Path) -> None:
    """Raise a SourceError if no picture can be read from a file."""
    with open_video(path):
        pass


def _opened(path: Path, damaged: list[float]) -> tuple[Frame, Generator[Frame], int | None]:
    """Return the first frame of the largest picture stream, the others, and how many the header announces, if any.

    Raises:
        SourceError: If there is no picture.
    """
    import av

    cover = av.stream.Disposition.attached_pic
    container = None
    try:
        container = av.open(str(path), metadata_errors="ignore")
        streams = [stream for stream in container.streams.video if not stream.disposition & cover]
        stream = max(streams, key=lambda one: one.width * one.height)
        frames = _frames(container, stream, damaged)
        return next(frames), frames, stream.frames or None
    except (av.FFmpegError, ValueError, StopIteration):
        if container is not None:
            container.close()
        raise SourceError(
            f"no picture can be read from {path.name} ({path.stat().st_size} bytes); expected a video "
            "with a picture track (mp4, mkv, mov, gif, …); check that a video player shows it"
        ) from None


def _frames(container: InputContainer, stream: VideoStream, damaged: list[float]) -> Generator[Frame]:
    """Yield the frames of a stream; what cannot be decoded is left out, and what is behind it is not."""
    import av
    import cv2

    stamp_ms = 0.0
    size = None
    previous = None
    tick_ms = 1e3 * float(stream.time_base or 0)
    ordered = "avi" in container.format.name  # it stores no times of presentation
    with container:
        for packet in _packets(container, stream):
            try:
                pictures = packet.decode()
            except av.FFmpegError:
                damaged.append(float((packet.pts or 0) * packet.time_base))
                continue
            for picture in pictures:
                bgr = np.ascontiguousarray(np.rot90(picture.to_ndarray(format="bgr24"), round(picture.rotation / 90)))
                ticks = picture.dts if ordered or picture.pts is None else picture.pts
                stamp_ms = stamp_ms if ticks is None else tick_ms * ticks
                size = size or picture_size(bgr, stream.sample_aspect_ratio, picture.rotation)
                stride = max(1, min(bgr.shape[:2]) // 96)
                small = cv2.resize(bgr[::stride, ::stride], _THUMBNAIL, interpolation=cv2.INTER_AREA).astype(np.int16)
                change = 0.0 if previous is None else float(np.abs(small - previous).mean())
                yield Frame(stamp_ms, cv2.cvtColor(square(bgr, size), cv2.COLOR_BGR2RGB), change, size)
                previous = small


def _packets(container: InputContainer, stream: VideoStream) -> Iterator[Packet[VideoStream]]:
    """Yield the packets of a stream; a damaged place in the container is passed over while anything follows it."""
    import av

    more = True
    while more:
        more = False
        try:
            for packet in container.demux(stream):
                yield packet
                more = True
            return
        except av.FFmpegError:
            continue


def picture_size(picture: np.ndarray, pixel: Fraction | None = None, rotation: int = 0) -> tuple[int, int]:
    """Return the width and height that show a picture with square pixels; none gets less of them.

    Args:
        picture: Upright (H, W, ...).
        pixel: Width over height of a pixel in the file; None, and a shape that no video has, counts as square.
        rotation: By which the picture of the file was turned [deg].
    """
    shape = float(pixel or 1.0) if 0.25 <= float(pixel or 1.0) <= 4.0 else 1.0
    ratio = 1.0 / shape if rotation % 180 else shape
    return round(picture.shape[1] * max(ratio, 1.0)), round(picture.shape[0] / min(ratio, 1.0))


def square(picture: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return a picture with the sides of `picture_size`, shrunk where one is longer than MAX_SIDE."""
    import cv2

    shrink = min(1.0, MAX_SIDE / max(size))
    wanted = round(size[0] * shrink), round(size[1] * shrink)
    same = wanted == (picture.shape[1], picture.shape[0])
    return picture if same else cv2.resize(picture, wanted, interpolation=cv2.INTER_LINEAR)


def _decode_into(frames: Iterator[Frame], decoded: queue.Queue[Any], stop: threading.Event) -> None:
    def put(item: Frame | Exception | None) -> None:
        while not stop.is_set():
            try:
                return decoded.put(item, timeout=0.1)
            except queue.Full:
                continue

    try:
        for frame in frames:
            put(frame)
            if stop.is_set():
                break
    except Exception as error:
        put(error)
    else:
        put(None)


def _drain(decoded: queue.Queue[Any]) -> Iterator[Frame]:
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
        tails[k : k + 1] = [stamp]
        last[k : k + 1] = [i]
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
