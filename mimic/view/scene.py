"""A run as a Rerun scene: video with 2-D skeleton, the person in 3-D, the robot with its toes, and plots."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import rerun as rr

from mimic.robot.description import RobotDescription
from mimic.store import plain, written_whole
from mimic.types import FloatArray, PoseTrack, Provenance, RunLog, TargetTrack
from mimic.view import footage, layout, plots
from mimic.view.draw_person import draw_person
from mimic.view.draw_robot import draw_robot
from mimic.view.footage import Progress
from mimic.view.skeleton import feet_seen
from mimic.view.timing import frame_times, from_start, front, shared_time

VIDEO_WIDTH = 640
"""The video inside a scene is at most this wide [px]."""


def save_scene(
    path: Path,
    *,
    log: RunLog,
    description: RobotDescription,
    targets: TargetTrack | None = None,
    pose: PoseTrack | None = None,
    video: Path | None = None,
    made_by: Provenance | None = None,
    progress: Progress | None = None,
) -> None:
    """Write a scene that the Rerun viewer opens with everything in view; complete or not at all.

    Its timeline ``time`` is that of the video: zero is the first frame and the first tick of tracking, and the robot
    stands up before it, beside the first frame.

    Args:
        path: Where the scene goes (.rrd).
        log: What the robot did.
        targets: Also shows what clamping moved.
        pose: The person that was followed; drawn over the video and in three dimensions.
        video: The video that ``pose`` was made from.
        made_by: Stored as the recording's property ``provenance``.
        progress: Called after each video frame, the slow part, with the frames done and their number if it is known.

    Raises:
        SourceError: If the video cannot be decoded.
    """
    clock = shared_time(log)
    start = float(clock[0])
    with written_whole(path) as part, tempfile.TemporaryDirectory() as scratch:
        size = None if pose is None or 0 in pose.size else pose.size
        clip, stamps = None, np.zeros(0)
        if video is not None:
            clip = Path(scratch) / "video.mp4"
            stamps, size = _encode(video, clip, pose, progress)
        seen: layout.PersonView | None = None if pose is None else "whole" if feet_seen(pose) else "upper"
        shown = layout.blueprint(span=(start, float(clock[-1])), facing=front(log), video=size, person=seen)
        with rr.RecordingStream("mimic") as scene:
            scene.save(part, default_blueprint=shown)
            if made_by is not None:
                scene.send_property("provenance", rr.AnyValues(json=json.dumps(plain(made_by))))
            if clip is not None:
                _video(scene, clip, frame_times(stamps, pose), start)
            if pose is not None:
                draw_person(scene, pose, size, start)
            draw_robot(scene, log, description, targets)
            for curve in plots.curves(log, description, targets):
                style = rr.SeriesLines(colors=curve.colour, names=curve.name, widths=curve.width)
                scene.log(curve.path, style, static=True)
                scene.send_columns(
                    curve.path, indexes=[layout.time_column(curve.t)], columns=rr.Scalars.columns(scalars=curve.value)
                )
            scene.flush()
            scene.disconnect()


def _encode(
    video: Path, clip: Path, pose: PoseTrack | None, progress: Progress | None
) -> tuple[FloatArray, tuple[int, int]]:
    """Write the upright frames as AV1; return their stamps [s] and their size."""
    stamps: list[float] = []
    size = (0, 0)
    total = None if pose is None else len(pose.t)

    def pictures() -> Iterable[np.ndarray]:
        nonlocal size
        for stamp, rgb in footage.read_frames(video, width=VIDEO_WIDTH):
            stamps.append(stamp)
            size = rgb.shape[1], rgb.shape[0]
            yield rgb
            if progress is not None:
                progress(len(stamps), total)

    footage.encode_av1(pictures(), clip)
    return np.array(stamps), size


def _video(scene: rr.RecordingStream, clip: Path, t: FloatArray, start: float) -> None:
    asset = rr.AssetVideo(path=clip)
    scene.log(layout.VIDEO, asset, static=True)
    nanos = asset.read_frame_timestamps_nanos()
    t, rows = from_start(t[: len(nanos)], start)
    scene.send_columns(
        layout.VIDEO,
        indexes=[layout.time_column(t)],
        columns=rr.VideoFrameReference.columns_nanos(np.asarray(nanos)[rows]),
    )
