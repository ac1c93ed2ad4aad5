"""Upright, scaled frames of the human video, and their encoding for scenes and films."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import cast

import numpy as np

from mimic.errors import SourceError
from mimic.records import FloatArray

Progress = Callable[[int, int | None], None]
"""Called with the steps done and the total, if known."""

_AV1 = {"preset": "12", "crf": "35", "g": "60"}
"""Encoder options; among presets 10 to 13, preset 12 takes 0.6 of the time of preset 10 at the same error.

Source: the boxing clip at 640 x 480, error of every 20th frame against the source (PSNR 39.2 dB; preset 10 with
quality 40: 39.0 dB).
"""


def frame_stamps(path: Path) -> FloatArray:
    """Return the time stamps of the frames in the file (F,) [s].

    Raises:
        SourceError: If no frame can be decoded.
    """
    return np.array([stamp for stamp, _ in _frames(path, lambda _: None)])


def read_frames(
    path: Path, *, width: int | None = None, height: int | None = None
) -> Iterator[tuple[float, np.ndarray]]:
    """Yield the time stamp [s] and the upright picture (H, W, 3), RGB, of each frame.

    Args:
        width: Maximum width; narrower pictures keep their size.
        height: Exact height. Both sides are even, as encoders require.

    Raises:
        SourceError: If no frame can be decoded.
    """
    import cv2

    def picture(bgr: np.ndarray) -> np.ndarray:
        scale = height / bgr.shape[0] if height else min(1.0, (width or bgr.shape[1]) / bgr.shape[1])
        size = tuple(max(2, 2 * round(scale * side / 2)) for side in bgr.shape[1::-1])
        if size != bgr.shape[1::-1]:
            bgr = cv2.resize(bgr, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
        return cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)

    for stamp, rgb in _frames(path, picture):
        assert rgb is not None
        yield stamp, rgb


def _frames(
    path: Path, picture: Callable[[np.ndarray], np.ndarray | None]
) -> Iterator[tuple[float, np.ndarray | None]]:
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # read by OpenCV when first used
    import cv2

    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    try:
        some = False
        while True:
            ok, bgr = capture.read()
            if not ok:
                break
            some = True
            yield capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3, picture(bgr)
        if not some:
            raise SourceError(f"no picture can be read from {path}; give the video of the run")
    finally:
        capture.release()


def encode_av1(frames: Iterable[np.ndarray], path: Path) -> None:
    """Write pictures (H, W, 3), RGB, as AV1 that the Rerun viewer decodes by itself; the frame rate has no meaning."""
    os.environ.setdefault("SVT_LOG", "1")  # errors only
    _encode(frames, path, codec="libsvtav1", fps=Fraction(30), options=_AV1)


def encode_h264(frames: Iterable[np.ndarray], path: Path, *, fps: Fraction, comment: str = "") -> None:
    """Write pictures (H, W, 3), RGB, as an H.264 film that every browser plays."""
    _encode(frames, path, codec="libx264", fps=fps, options={"preset": "veryfast", "crf": "20"}, comment=comment)


def _encode(
    frames: Iterable[np.ndarray], path: Path, *, codec: str, fps: Fraction, options: dict[str, str], comment: str = ""
) -> None:
    import av
    import cv2
    from av.video.stream import VideoStream

    with av.open(str(path), "w", options={"movflags": "+faststart"}) as container:
        if comment:
            container.metadata["comment"] = comment
        stream: VideoStream | None = None
        for index, rgb in enumerate(frames):
            if stream is None:
                stream = cast(VideoStream, container.add_stream(codec, rate=fps, options=options))
                stream.height, stream.width = rgb.shape[:2]
                stream.pix_fmt = "yuv420p"
            # OpenCV converts several times faster than FFmpeg's scaler; both as BT.601 in limited range.
            planes = np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2YUV_I420), dtype=np.uint8)
            frame = av.VideoFrame.from_ndarray(planes, format="yuv420p")
            frame.pts = index
            frame.time_base = 1 / fps
            container.mux(stream.codec_context.encode(frame))
        if stream is not None:
            container.mux(stream.codec_context.encode(None))
