"""A video file becomes a person's track: one row for every frame, at its true time, gaps marked."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from mimic.errors import SourceError
from mimic.settings import PoseSettings
from mimic.sources.blazepose import BlazePose
from mimic.sources.decoding import open_video, true_times
from mimic.sources.screening import jump_share, person_rows, shot_starts, upside_down
from mimic.sources.sides import decide_sides, exchange_sides
from mimic.sources.smoothing import smooth
from mimic.store import plain, sha256_of
from mimic.types import BoolArray, FloatArray, IntArray, PoseTrack

log = logging.getLogger(__name__)

ALGORITHM = 1
"""Raised whenever the same video and settings give another track, so that stored tracks are made anew."""

FREQUENT_SWAPS = 0.05
"""Left and right exchanged in more frames than this is worth a warning."""
PARTLY_SEEN = 0.8
"""A person in fewer frames than this is worth a warning."""

_DEFAULT = PoseSettings()


@dataclass(frozen=True, slots=True, eq=False)
class _Watched:
    """What the detector saw, frame by frame, before anything is decided about it."""

    name: str
    t: FloatArray
    landmarks: FloatArray
    image: FloatArray
    score: FloatArray
    change: FloatArray
    size: tuple[int, int]
    announced: int | None
    repaired: int


def track_video(
    path: Path,
    settings: PoseSettings = _DEFAULT,
    *,
    progress: Callable[[int, int | None], None] | None = None,
) -> PoseTrack:
    """Return the landmarks of the person in a video, one row for every decoded frame.

    Left and right are decided over the whole clip, noise is smoothed without lag, and what makes the motion doubtful
    (cuts, jumps, missing frames, frequent exchanges of left and right) is in the warnings of the track.

    Args:
        path: A file that FFmpeg reads (mp4, mkv, mov, gif, …).
        settings: How a video becomes landmarks.
        progress: Called after each frame with the frames done and the number that the file announces, if it does.

    Raises:
        SourceError: If the file gives no picture, is shorter than a sampling step, or shows no person.
    """
    watched = _watch(Path(path), progress)
    person = _person_share(watched, settings)
    t, shots = watched.t, shot_starts(watched.change)
    swapped = decide_sides(t, watched.landmarks, shots)
    landmarks, image, score = (
        exchange_sides(column, swapped) for column in (watched.landmarks, watched.image, watched.score)
    )
    valid: BoolArray = score >= settings.min_visibility
    jumps = jump_share(t, landmarks, image, valid, watched.size, settings.max_jump)
    warnings = [
        *_about_file(watched),
        *_about_picture(t, shots, person, jumps, settings),
        *_about_sides(swapped, upside_down(image, valid)),
    ]
    for warning in warnings:
        log.info("%s: %s", watched.name, warning)
    return PoseTrack(
        t=t,
        landmarks=smooth(t, landmarks, shots, settings.cutoff_hz),
        image=smooth(t, image, shots, settings.cutoff_hz),
        score=score,
        valid=valid,
        size=watched.size,
        swapped=swapped,
        warnings=tuple(warnings),
    )


def pose_cache_key(path: Path, settings: PoseSettings = _DEFAULT) -> str:
    """Return a key (SHA-256) that is the same as long as :func:`track_video` would give the same track.

    It covers the bytes of the file (not its name), the settings, the detector's version and this code's.
    """
    parts = [sha256_of(path), plain(settings), f"mediapipe {version('mediapipe')}", ALGORITHM]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _watch(path: Path, progress: Callable[[int, int | None], None] | None) -> _Watched:
    """Run the detector over every frame."""
    stamps, change, rows = [], [], []
    nothing = np.full((33, 3), np.nan), np.full((33, 2), np.nan), np.zeros(33)
    with open_video(path) as video, BlazePose() as detect:
        for frame in video:
            stamps.append(frame.stamp_ms)
            change.append(frame.change)
            rows.append(detect(frame.rgb) or nothing)
            if progress is not None:
                progress(len(rows), video.announced)
    t, repaired = true_times(np.array(stamps))
    landmarks, image, score = (np.array(column) for column in zip(*rows, strict=True))
    return _Watched(path.name, t, landmarks, image, score, np.array(change), video.size, video.announced, repaired)


def _person_share(watched: _Watched, settings: PoseSettings) -> float:
    """Return the share of frames with a person.

    Raises:
        SourceError: If the clip is too short, or has too few such frames.
    """
    t = watched.t
    if t[-1] < settings.min_duration:
        raise SourceError(
            f"{watched.name} has {len(t)} frame{'s' * (len(t) > 1)} in {t[-1]:.2f} s, shorter than a sampling step; "
            f"a motion needs at least {settings.min_duration:g} s: give a longer video"
        )
    share = float(person_rows(watched.score, settings.min_visibility).mean())
    if share < settings.min_person_share:
        raise SourceError(
            f"{watched.name} shows no person: both shoulders and a wrist are seen in {share:.0%} of its frames, "
            f"{settings.min_person_share:.0%} are needed; film one person whose shoulders and arms stay in the picture"
        )
    return share


def _about_file(watched: _Watched) -> Iterator[str]:
    frames, announced = len(watched.t), watched.announced
    if announced is not None and frames < announced:
        yield f"the file announces {announced} frames and only {frames} could be decoded: its end may be missing"
    if watched.repaired:
        yield f"{watched.repaired} of {frames} time stamps do not increase; those frames were placed between the others"


def _about_picture(
    t: FloatArray, shots: IntArray, person: float, jumps: float, settings: PoseSettings
) -> Iterator[str]:
    if person < PARTLY_SEEN:
        yield f"a person with both shoulders and a wrist is seen in only {person:.0%} of the frames"
    if len(shots):
        at = ", ".join(f"{t[row]:.2f} s" for row in shots[:5]) + ", …" * (len(shots) > 5)
        yield f"the picture cuts at {at}; perhaps to another person: give a clip without cuts"
    if jumps > settings.max_jump_share:
        yield (
            f"the person or a wrist jumps in {jumps:.0%} of the frames: the clip is cut, shows several people, or its "
            "arms are hard to see; give a clip of one person, without cuts, from the front or three quarters"
        )


def _about_sides(swapped: BoolArray, inverted: bool) -> Iterator[str]:
    if swapped.mean() > FREQUENT_SWAPS:
        yield (
            f"the detector exchanged left and right in {swapped.sum()} of {len(swapped)} frames; this was put right, "
            "but a wrong side may remain: film from the front or three quarters, in good light"
        )
    if inverted:
        yield "the shoulders are below the hips: up in the image counts as up; turn the video upright"
