"""Pose track of the person in a video file: one row per frame at its true time, with gaps marked."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from mimic.config.pose import PoseSettings
from mimic.errors import SourceError
from mimic.io.reading import STEPS
from mimic.io.store import plain, sha256_of
from mimic.records import BoolArray, FloatArray, PoseTrack
from mimic.sources.video.decoding import Video, open_video, true_times
from mimic.sources.video.left_right import decide_sides, swap_sides
from mimic.sources.video.people import People
from mimic.sources.video.pose_models.blazepose import NOBODY, BlazePose, Everybody
from mimic.sources.video.pose_models.pose_model import BUNDLE, pose_model
from mimic.sources.video.screening import MOST_JUMPS, SHORTEST, is_invented, jump_share, person_rows, posture
from mimic.sources.video.shots import clothes_colour, describe, find_changes, is_black

log = logging.getLogger(__name__)

ALGORITHM = 18
"""Version of the algorithm; a change that alters tracks raises it, so that cached tracks are computed again."""

MAX_SWAP_SHARE = 0.05
"""A larger share of frames with swapped left and right gives a warning."""

LACKING = 0.5
"""Time at the end of a file without a picture that is reported [s]."""

_DEFAULT = PoseSettings()


@dataclass(frozen=True, slots=True, eq=False)
class _Detections:
    """Raw output of the detector, frame by frame."""

    track: PoseTrack
    change: FloatArray
    black: BoolArray
    clothes: FloatArray
    said: list[str]
    """What is to be said about the file and about several people in view."""


def track_video(
    path: Path,
    settings: PoseSettings = _DEFAULT,
    *,
    progress: Callable[[int, int | None], None] | None = None,
) -> PoseTrack:
    """Return the landmarks of the person in a video, one row for every decoded frame.

    Swapped sides are corrected over the whole clip, noise is smoothed without lag, and the depth of the arms is
    estimated from their motion in the picture. The warnings of the track list
    what makes the motion doubtful: cuts, jumps, missing frames, frequent swaps of left and right.

    Args:
        path: A file that FFmpeg reads (mp4, mkv, mov, gif, …).
        settings: Settings of pose estimation.
        progress: Called after each frame with the frames done and the number of frames in the header, if any.

    Raises:
        SourceError: If the file contains no picture, is shorter than a sampling step, or shows no person.
        AssetError: If there is no model to detect with.
    """
    path = Path(path)
    found = _detect(path, settings, progress)
    from mimic.sources.video.depth import with_depth  # SciPy takes a second: the detector need not wait for it
    from mimic.sources.video.heading import with_heading
    from mimic.sources.video.smoothing import smooth

    raw = found.track
    person = person_rows(raw.score, settings.min_visibility)
    _check_person(raw, person, path.name, settings)
    changes = find_changes(raw, person, found.clothes, found.change, found.black)
    other = np.zeros(len(raw.t), dtype=np.bool_)
    for row in (change.row for change in changes if change.other_person and settings.person is not None):
        lost = np.flatnonzero(np.isnan(raw.landmarks[row:, 0, 0]))  # then whoever is found was recognised
        other[row : row + lost[0] if len(lost) else None] = True
    raw = _without(raw, other)
    shots = np.array([change.row for change in changes], dtype=np.int64)
    swapped = decide_sides(raw.t, raw.landmarks, shots)
    landmarks, image, score = (swap_sides(column, swapped) for column in (raw.landmarks, raw.image, raw.score))
    track = replace(
        raw,
        landmarks=landmarks,
        image=image,
        score=score,
        valid=score >= settings.min_visibility,
        swapped=swapped,
        shot=np.searchsorted(shots, np.arange(len(raw.t)), "right").astype(np.float64),
    )
    warnings = (*found.said, *describe(changes, raw.t), *doubts(track))
    for warning in warnings:
        log.info("%s: %s", path.name, warning)
    landmarks, image = (smooth(raw.t, column, shots, settings.cutoff_hz) for column in (landmarks, image))
    track = replace(track, landmarks=landmarks, image=image, warnings=warnings)
    return with_heading(with_depth(track)) if settings.depth else track


def pose_cache_key(path: Path, settings: PoseSettings = _DEFAULT) -> str:
    """Return a key (SHA-256) that stays the same while `track_video` gives the same track.

    It covers the content of the file (not its name), the settings, the model, and the versions of the detector and of
    this code.
    """
    parts = [
        sha256_of(path),
        plain(replace(settings, also=None)),
        BUNDLE,
        f"mediapipe {version('mediapipe')}",
        ALGORITHM,
    ]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _detect(path: Path, settings: PoseSettings, progress: Callable[[int, int | None], None] | None) -> _Detections:
    """Run the detector over every frame."""
    stamps = []
    change = []
    black = []
    clothes = []
    rows = []
    model = pose_model()
    with open_video(path) as video, BlazePose(model) as detect, Everybody(model) as everybody:
        people = People(everybody, settings.person, path.name)
        if settings.person is not None:
            with open_video(path) as beginning:
                people.choose(_timed(beginning))
        for frame in video:
            stamps.append(frame.stamp_ms)
            change.append(frame.change)
            shown = people.show((frame.stamp_ms - stamps[0]) / 1e3, frame.rgb)
            if people.astray:
                detect.forget()
            landmarks, image, score = detect(shown) or NOBODY
            height, width = frame.rgb.shape[:2]
            rows.append((landmarks, people.in_picture(image, width, height), score))
            black.append(is_black(frame.rgb))
            clothes.append(clothes_colour(frame.rgb, rows[-1][1]))
            people.saw(rows[-1][1], clothes[-1])
            if progress is not None:
                progress(len(rows), video.frame_count)
    t, repaired = true_times(np.array(stamps))
    landmarks, image, score = (np.array(column) for column in zip(*rows, strict=True))
    nothing = np.zeros(len(t), dtype=np.bool_)
    track = PoseTrack(
        t=t, landmarks=landmarks, image=image, score=score, valid=score > 0.0, size=video.size, swapped=nothing
    )
    said = [*_file_warnings(video, np.array(stamps), repaired), *people.sentences()]
    track = _without(track, ~people.followed_rows())
    return _Detections(track, np.array(change), np.array(black), np.array(clothes), said)


def _without(track: PoseTrack, rows: BoolArray) -> PoseTrack:
    """Return a track with gaps in the rows (T,) that show somebody else."""
    landmarks, image = (np.where(rows[:, None, None], np.nan, column) for column in (track.landmarks, track.image))
    return replace(track, landmarks=landmarks, image=image, score=np.where(rows[:, None], 0.0, track.score))


def _timed(video: Video) -> Iterator[tuple[float, np.ndarray]]:
    """Yield the time since the first frame [s] and the picture of each frame."""
    first = None
    for frame in video:
        first = frame.stamp_ms if first is None else first
        yield (frame.stamp_ms - first) / 1e3, frame.rgb


def _check_person(track: PoseTrack, rows: BoolArray, name: str, settings: PoseSettings) -> None:
    """Check that a clip shows a person in enough rows (T,).

    Raises:
        SourceError: If the clip is too short, or has too few such frames.
    """
    t = track.t
    if t[-1] < SHORTEST:
        raise SourceError(
            f"{name} has {len(t)} frame{'s' * (len(t) > 1)} in {t[-1]:.2f} s, shorter than a sampling step; "
            f"use a video of at least {SHORTEST:g} s"
        )
    apart = float(np.median(np.diff(t)))
    if apart > STEPS[1]:
        raise SourceError(
            f"{name} has a frame every {apart:g} s; one every {STEPS[1]:g} s is required: film more frames a second"
        )
    if is_invented(track, rows):
        raise SourceError(
            f"{name} shows no person to follow: what is found has limbs and a size that change from frame to frame; "
            "film one whole person, without cuts, in a picture that is not squeezed"
        )
    share = float(rows.mean())
    if share < settings.min_person_share:
        raise SourceError(
            f"{name} shows no person: both shoulders and a wrist are visible in {share:.0%} of its frames, "
            f"at least {settings.min_person_share:.0%} are required; "
            "film one person whose shoulders and arms stay in the picture"
        )


def _file_warnings(video: Video, stamps_ms: FloatArray, repaired: int) -> Iterator[str]:
    lacking = (video.end_ms - stamps_ms.max()) / 1e3
    if lacking > LACKING:
        yield f"the last {lacking:.1f} s of the file have no picture; if it was cut off, copy it again"
    if lost := video.damaged:
        yield (
            f"{len(lost)} frames are damaged and left out, at {min(lost):.2f} to {max(lost):.2f} s; what is between "
            "their neighbours is not what the person did: copy the file again"
        )
    if repaired:
        yield f"{repaired} of {len(stamps_ms)} time stamps do not increase; these frames got interpolated times"


def doubts(track: PoseTrack) -> Iterator[str]:
    """Yield what makes a clip or a camera doubtful: jumps, exchanged sides, posture."""
    swapped = track.swapped
    jumps = jump_share(track)
    swaps = int(swapped.sum())
    if swaps > MAX_SWAP_SHARE * len(swapped):
        yield (
            f"the detector swapped left and right in {swaps} of {len(swapped)} frames; this was corrected, but errors "
            "may remain: film closer and in good light"
        )
    if jumps > MOST_JUMPS:
        yield (
            f"the person or a wrist jumps in {jumps:.0%} of the frames, as where arms are hard to see or several "
            "people are; use a clip of one person from the front or a three-quarter view"
        )
    if said := posture(track):
        yield said
