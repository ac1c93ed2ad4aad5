"""A run as a Rerun scene: video with 2-D skeleton, the person in 3-D, the robot with its toes, and plots."""

from __future__ import annotations

import errno
import json
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import numpy as np
import rerun as rr

from mimic.io.store import plain, written_whole
from mimic.records import FloatArray, PoseTrack, Provenance, RunLog, TargetTrack
from mimic.robot.description import RobotDescription
from mimic.view.film.footage import Progress
from mimic.view.film.skeleton import feet_seen
from mimic.view.scene import layout, plots
from mimic.view.scene.footage import Clip, Footage
from mimic.view.scene.person import draw_person
from mimic.view.scene.robot_drawing import draw_robot
from mimic.view.scene.timing import hold_first_row, initial_heading, shared_time
from mimic.view.scene.viewpoint import seen_from


def save_scene(
    path: Path,
    *,
    log: RunLog,
    description: RobotDescription,
    targets: TargetTrack | None = None,
    pose: PoseTrack | None = None,
    video: Path | None = None,
    footage: Footage | None = None,
    made_by: Provenance | None = None,
    progress: Progress | None = None,
) -> None:
    """Write a scene for the Rerun viewer, layout included; the file is complete or not written at all.

    Its timeline ``time`` is that of the video: zero is the first frame and the first tick of tracking. At negative
    times the robot stands up, next to the first frame.

    Args:
        path: File to write (.rrd).
        log: Log of the robot.
        targets: Also shows by how much clamping moved them.
        pose: Pose track of the person; drawn over the video and in 3-D.
        video: The video that ``pose`` was made from.
        footage: The same video, if it is being encoded already; the caller closes it.
        made_by: Stored as the recording's property ``provenance``.
        progress: Called during video encoding, the slow part, with the frames done and the total if known.

    Raises:
        SourceError: If the video cannot be decoded.
    """
    clock = shared_time(log)
    start = float(clock[0])
    with written_whole(path) as part, ExitStack() as stack:
        if footage is None and video is not None:
            footage = stack.enter_context(Footage(video))
        clip = None if footage is None else footage.clip(progress, None if pose is None else len(pose.t))
        size = clip.size if clip is not None else None if pose is None or 0 in pose.size else pose.size
        seen: layout.PersonView | None = None if pose is None else "whole" if feet_seen(pose) else "upper"
        camera = initial_heading(log) + seen_from(pose, targets)
        shown = layout.blueprint(description, span=(start, float(clock[-1])), camera=camera, video=size, person=seen)
        frames = None if pose is None else pose.t
        with _recording() as scene:
            scene.save(part, default_blueprint=shown)
            if made_by is not None:
                scene.send_property("provenance", rr.AnyValues(json=json.dumps(plain(made_by))))
            if clip is not None and frames is not None:
                _video(scene, clip, frames, start)
            if pose is not None:
                draw_person(scene, pose, size, start)
            draw_robot(scene, log, description, frames)
            for curve in plots.curves(log, description, targets):
                style = rr.SeriesLines(colors=curve.colour, names=curve.name, widths=curve.width)
                values = rr.Scalars.columns(scalars=curve.value)
                layout.draw_over_time(scene, curve.path, style, layout.time_columns(curve.t, frames), values)
            scene.flush()
            scene.disconnect()


@contextmanager
def _recording() -> Iterator[rr.RecordingStream]:
    """Give a recording; where its file cannot be written on, raise OSError as for any other file."""
    scene = rr.RecordingStream("mimic")
    try:
        with scene:
            yield scene
    except RuntimeError as reason:
        if "File-writer" not in str(reason):
            raise
        with suppress(RuntimeError):
            scene.disconnect()  # not later, when another line has been said
        raise OSError(errno.EIO, f"the scene could not be written: {reason}") from None


def _video(scene: rr.RecordingStream, clip: Clip, t: FloatArray, start: float) -> None:
    asset = rr.AssetVideo(path=clip.path)
    nanos = asset.read_frame_timestamps_nanos()
    held, rows = hold_first_row(t[: len(nanos)], start)
    frames = rr.VideoFrameReference.columns_nanos(np.asarray(nanos)[rows])
    layout.draw_over_time(scene, layout.VIDEO, asset, layout.time_columns(held, t), frames)
