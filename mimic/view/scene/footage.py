"""Encodes the human video for a scene in a background thread, during pose estimation or simulation."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mimic.view.film.footage import Progress, encode_av1, read_frames

VIDEO_WIDTH = 640
"""Maximum width of the video in a scene [px]."""

_REPORT_EVERY = 0.1
"""Interval of progress reports while a caller waits [s]."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Clip:
    """An encoded video."""

    path: Path
    """AV1 in MP4, one frame per decoded frame of the source."""
    size: tuple[int, int]
    """Width and height of the upright picture [px]."""


class Footage(AbstractContextManager["Footage"]):
    """A video that is being encoded for a scene; the ``with`` block ends the thread and removes the file."""

    def __init__(self, video: Path) -> None:
        """Start to decode and encode ``video``; returns at once.

        Both run in C++ without Python's global lock, in parallel with other work.
        """
        import av  # noqa: F401  # imported here, because imports in the thread could run in parallel with others

        os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")  # read when OpenCV is imported
        import cv2  # noqa: F401

        self.video = video
        self._folder = tempfile.TemporaryDirectory(prefix="mimic-footage-")
        self._done = 0
        self._size = (0, 0)
        self._cancelled = False
        self._thread = ThreadPoolExecutor(1, f"footage of {video.name}")
        self._encoded = self._thread.submit(encode_av1, self._pictures(), self._path)

    @property
    def _path(self) -> Path:
        return Path(self._folder.name) / "video.mp4"

    def clip(self, progress: Progress | None = None, total: int | None = None) -> Clip:
        """Wait until the video is encoded and return it; the file exists until `close`.

        Args:
            progress: Called at intervals with the number of encoded frames and ``total``.
            total: Number of frames, if known.

        Raises:
            SourceError: If the video cannot be decoded.
        """
        while wait([self._encoded], _REPORT_EVERY).not_done:
            if progress is not None:
                progress(self._done, total)
        self._encoded.result()
        if progress is not None:
            progress(self._done, total)
        return Clip(path=self._path, size=self._size)

    def close(self) -> None:
        """Stop encoding and remove the file."""
        self._cancelled = True
        self._thread.shutdown()
        self._folder.cleanup()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _pictures(self) -> Iterator[np.ndarray]:
        for rgb in read_frames(self.video, width=VIDEO_WIDTH):
            if self._cancelled:
                return
            self._done += 1
            self._size = rgb.shape[1], rgb.shape[0]
            yield rgb
