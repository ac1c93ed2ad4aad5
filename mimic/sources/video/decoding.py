"""Upright RGB frames of a video file with corrected times, decoded in a background thread."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

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

_AHEAD = 8
"""Frames decoded ahead."""
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
    end_ms: float
    """Time stamp at which the file says that it ends [ms]; 0 where it does not."""

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
    first, others, container, count = _opened(path, damaged)
    end = (container.start_time or 0) + (container.duration or 0)
    with closing(_ahead(others)) as frames:
        yield Video(first.size, count, chain([first], frames), damaged, end / 1e3)


def _ahead(frames: Generator[Frame]) -> Generator[Frame]:
    """Yield frames that a thread decodes, some of them before they are asked for."""
    with ThreadPoolExecutor(1) as pool:
        waiting = deque(pool.submit(next, frames, None) for _ in range(_AHEAD))
        try:
            while (frame := waiting.popleft().result()) is not None:
                waiting.append(pool.submit(next, frames, None))
                yield frame
        finally:
            pool.submit(frames.close)


def check_video(path: Path) -> None:
    """Raise a SourceError if no picture can be read from a file."""
    with open_video(path):
        pass


def _opened(path: Path, damaged: list[float]) -> tuple[Frame, Generator[Frame], InputContainer, int | None]:
    """Return the first frame of the largest picture stream, the others, the file, and how many its header announces.

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
        return next(frames), frames, container, stream.frames or None
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
                rgb = np.ascontiguousarray(np.rot90(picture.to_ndarray(format="rgb24"), round(picture.rotation / 90)))
                ticks = picture.dts if ordered or picture.pts is None else picture.pts
                stamp_ms = stamp_ms if ticks is None else tick_ms * ticks
                size = size or picture_size(rgb, stream.sample_aspect_ratio, picture.rotation)
                stride = max(1, min(rgb.shape[:2]) // 96)
                small = cv2.resize(rgb[::stride, ::stride], _THUMBNAIL, interpolation=cv2.INTER_AREA).astype(np.int16)
                change = 0.0 if previous is None else float(np.abs(small - previous).mean())
                yield Frame(stamp_ms, square(rgb, size), change, size)
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
