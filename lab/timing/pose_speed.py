"""Frames per second of video -> wrist track at 720p, and the ratio to the detector alone.

    python -m lab.timing.pose_speed [VIDEO] [--rounds 3]

The video (default: an example clip) is scaled to 1280x720 H.264 in a temporary file. "BlazePose alone" is the time for
loading the detector and inside it, for the same frames. Rounds alternate, and the best of each counts, so that other
work on the machine disturbs both alike.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from fractions import Fraction
from itertools import islice
from pathlib import Path

import av
from rich.console import Console
from rich.table import Table

from mimic.retargeting.wrists import wrist_track
from mimic.sources.video.decoding import open_video
from mimic.sources.video.pose_models.blazepose import BlazePose
from mimic.sources.video.pose_models.pose_model import pose_model
from mimic.sources.video.video import track_video

EXAMPLES = Path(__file__).parents[2] / "examples" / "videos"
SIZE = (1280, 720)


def scaled(source: Path, target: Path) -> Path:
    """Write the clip at 1280x720 and 30 fps."""
    with av.open(str(source)) as reader, av.open(str(target), "w") as writer:
        stream = writer.add_stream("libx264", rate=30, options={"preset": "veryfast", "crf": "20"})
        stream.width, stream.height = SIZE
        stream.pix_fmt = "yuv420p"
        for i, frame in enumerate(reader.decode(video=0)):
            picture = frame.reformat(*SIZE, format="yuv420p")
            picture.pts, picture.time_base = i, Fraction(1, 30)
            writer.mux(stream.encode(picture))
        writer.mux(stream.encode())
    return target


def whole(path: Path) -> tuple[int, float]:
    """Frames, and seconds from the file to the wrist track."""
    start = time.perf_counter()
    track = wrist_track(track_video(path))
    return len(track.t), time.perf_counter() - start


def detector(path: Path) -> float:
    """Seconds for loading the detector and inside it, for the same frames while nothing else runs."""
    model = pose_model()
    start = time.perf_counter()
    with BlazePose(model) as detect:
        seconds = time.perf_counter() - start
        with open_video(path) as video:
            while frames := list(islice(video, 30)):
                start = time.perf_counter()
                for frame in frames:
                    detect(frame.rgb)
                seconds += time.perf_counter() - start
    return seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("video", nargs="?", type=Path, help="default: the first of examples/videos")
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    source = arguments.video or next(iter(sorted(EXAMPLES.glob("*.mp4"))), None)
    if source is None:
        parser.error("examples/videos has no clip; name a video")
    with tempfile.TemporaryDirectory() as folder:
        path = scaled(source, Path(folder) / "720p.mp4")
        whole(path)  # imports and caches are not what is measured
        runs = [(whole(path), detector(path)) for _ in range(arguments.rounds)]
    frames = runs[0][0][0]
    best, alone = min(run[0][1] for run in runs), min(run[1] for run in runs)
    table = Table(title=f"{source.name} at {SIZE[0]}x{SIZE[1]}, {frames} frames, {os.cpu_count()} cores")
    for column in ("", "ms a frame", "frames/s"):
        table.add_column(column, justify="right" if column else "left")
    for name, seconds in (("video -> wrists", best), ("BlazePose alone", alone)):
        table.add_row(name, f"{1e3 * seconds / frames:.1f}", f"{frames / seconds:.0f}")
    table.add_row("ratio", f"{best / alone:.2f}", "")
    Console().print(table)


if __name__ == "__main__":
    main()
