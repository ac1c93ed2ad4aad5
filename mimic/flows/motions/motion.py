"""Any source of motion -> a Motion that can be played: videos, recorded motion, key frames, records, sentences.

A new source is a reader in `mimic.sources` and a row in SOURCES.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from mimic.config.play import DEFAULT_ROBOT
from mimic.config.pose import LanguageSettings, MocapSettings, PoseSettings
from mimic.config.retarget import RetargetSettings
from mimic.errors import AssetError, ConfigError, SourceError
from mimic.flows.provenance import provenance
from mimic.flows.reporter import Reporter, reporting
from mimic.frozen import frozen, frozen_arrays
from mimic.io import store
from mimic.io.assets import manual, user_cache
from mimic.io.reading import check_clock, existing
from mimic.records import CommandTrack, PoseTrack, TargetTrack, WristTrack
from mimic.records.table import ShownAsTable
from mimic.sources.not_read import NOT_READ

if TYPE_CHECKING:
    from mimic.io.keyframes import KeyFrames
    from mimic.robot.description import RobotDescription
    from mimic.robot.reach import Reach


@frozen
class InputSettings:
    """How an input becomes commands."""

    pose: PoseSettings = field(default_factory=PoseSettings)
    stored: MocapSettings = field(default_factory=MocapSettings)
    retarget: RetargetSettings = field(default_factory=RetargetSettings)
    language: LanguageSettings = field(default_factory=LanguageSettings)


AnySettings = InputSettings | PoseSettings | MocapSettings | RetargetSettings | LanguageSettings


def input_settings(given: AnySettings | None, changes: Mapping[str, Any]) -> InputSettings:
    """Return the settings of an input, of which one group or single settings may be given by name.

    Raises:
        ConfigError: If there is no such setting, or it is out of range.
    """
    settings = InputSettings()
    if isinstance(given, InputSettings):
        settings = given
    elif given is not None:
        part = next((f.name for f in fields(settings) if type(getattr(settings, f.name)) is type(given)), None)
        if part is None:
            raise ConfigError(f"settings is a {type(given).__name__}; expected InputSettings or a part of it")
        change: dict[str, Any] = {part: given}
        settings = replace(settings, **change)
    parts = {name.name: f.name for f in fields(settings) for name in fields(getattr(settings, f.name))}
    for name, value in changes.items():
        if name not in parts:
            raise ConfigError(f"there is no setting {name!r}; settings are {', '.join(parts)}")
        settings = replace(settings, **{parts[name]: replace(getattr(settings, parts[name]), **{name: value})})
    return settings


@frozen_arrays
class Motion(ShownAsTable):
    """What the robot is asked to do, whatever it was made from."""

    commands: CommandTrack
    """One row for each control step."""
    targets: TargetTrack | None = None
    """The toe targets behind the commands and how they were clamped; None where only commands were stored."""
    pose: PoseTrack | None = None
    """The person, where there is one."""
    video: Path | None = None
    """The video in which the person was seen."""
    script: KeyFrames | None = None
    """The key frames, where it was made from such."""


@frozen_arrays
class _Loading:
    """What every reader needs besides the file."""

    settings: InputSettings
    reporter: Reporter
    description: RobotDescription | None
    """Robot whose workspace the targets are clamped to; None for the shipped one."""

    def reach(self) -> Reach:
        from mimic.robot.description import load_description
        from mimic.robot.reach import Reach

        return Reach(self.description or load_description(DEFAULT_ROBOT))


@dataclass(frozen=True, slots=True)
class Source:
    """A kind of file that can be played."""

    name: str
    endings: tuple[str, ...]
    """Lower-case file endings, with their dot."""
    read: Callable[[Path, _Loading], Motion]
    """Reads a file of this kind."""
    in_folders: Callable[[Path], bool] = lambda path: True
    """Whether a file with such an ending, found in a folder, is meant to be played."""


Arrays = Mapping[str, Any] | np.ndarray
"""What `load_motion` takes in place of a file: the arrays of an .npz by name, or its points alone (T, N, 3)."""


def load_motion(
    source: str | Path | Arrays,
    settings: AnySettings | None = None,
    *,
    description: RobotDescription | None = None,
    reporter: Reporter | None = None,
    **changes: Any,
) -> Motion:
    """Load a motion from a file or from arrays.

    The ending of the file names its reader (see SOURCES); a file with any other ending is read as a video.

    Args:
        source: A video of one person, recorded motion (.npz, .trc, .bvh, .c3d, .pkl, .pt), key frames (.yaml), or a
            record that mimic wrote (.parquet); or what an .npz would hold: a dict of its arrays, or its points
            (T, N, 3), whose rate is then a setting (``fps=30``).
        settings: How the input becomes commands; InputSettings, or one part of it such as RetargetSettings.
        description: Robot whose workspace the targets are clamped to; by default the shipped CyberDog 2.
        reporter: Receives notes, warnings and progress.
        changes: Single settings by name, such as ``rate=0.2``.

    Returns:
        The motion, with commands at the robot's control rate (50 Hz), toe targets in base axes [m].

    Raises:
        SourceError: If there is no such file, or it holds no motion that can be played.
        AssetError: If a record cannot be read.
        ConfigError: If there is no such setting.
    """
    if isinstance(source, np.ndarray):
        if source.shape[1:] == (2, 3):
            raise SourceError(
                "an array (T, 2, 3) of toes is played as CommandTrack(t=t, v=v, heading=heading, p_BE=array)"
            )
        source = {"points": source}
    if isinstance(source, Mapping):
        with TemporaryDirectory() as folder:
            file = Path(folder) / "arrays.npz"
            np.savez(file, **source)
            return load_motion(file, settings, description=description, reporter=reporter, **changes)
    path = existing(source)
    if path.is_dir():
        raise SourceError(f"{path} is a folder; expected a file. To play all files of a folder: mimic batch {path}")
    loading = _Loading(
        settings=input_settings(settings, changes), reporter=reporting(reporter), description=description
    )
    ending = path.suffix.lower()
    reader = next((kind for kind in SOURCES if ending in kind.endings), None)
    if reader is None and ending in NOT_READ:
        raise SourceError(
            f"{path.name} is not read; export its motion as {NOT_READ[ending]}. See {manual('motion-formats.md')}"
        )
    if (reader or VIDEO) is not VIDEO:
        refuse_second_video(loading.settings, f"{path.name} is no video")
    return (reader or VIDEO).read(path, loading)


def refuse_second_video(settings: InputSettings, why: str) -> None:
    """Raise a ConfigError if a second video is given where there is no first one."""
    if settings.pose.also is not None:
        raise ConfigError(f"--also gives the second of two videos; {why}: leave it out")


def motion_from_text(
    sentence: str,
    settings: AnySettings | None = None,
    *,
    description: RobotDescription | None = None,
    reporter: Reporter | None = None,
    **changes: Any,
) -> Motion:
    """Plan a motion from a sentence, such as "step forward, then wave the left hand".

    Raises:
        SourceError: If the sentence is not understood, or the robot cannot do what it asks.
        ConfigError, MissingExtra: If a language model is asked for and not named, or its client is not installed.
    """
    from mimic.sources.text.planner import describe, plan, uses_model

    settings = input_settings(settings, changes)
    reporter = reporting(reporter)
    refuse_second_video(settings, "a sentence is none")
    loading = _Loading(settings=settings, reporter=reporter, description=description)
    reach = loading.reach()
    if uses_model(settings.language):
        reporter.note(f"planner      asking {settings.language.llm_model or 'a language model'}")
    script = plan(sentence, reach, settings.language)
    reporter.note(f"planner      {script.planner}: {len(script.frames)} key frames, {script.seconds:.1f} s")
    for line in describe(script):
        reporter.note(line)
    return _of_script(script, reach, loading)


def track_video(
    video: str | Path,
    settings: PoseSettings | None = None,
    *,
    cache: bool = True,
    reporter: Reporter | None = None,
) -> PoseTrack:
    """Find the person's 33 landmarks in every frame of a video.

    Args:
        video: A video file of one person.
        settings: How frames become landmarks; may name a second video of the same moment.
        cache: Reuse the track of an earlier call with the same video (by content) and settings.
        reporter: Receives progress.

    Returns:
        Landmarks relative to the middle of the hips [m], camera axes (x right, y down, z away), NaN where nothing was
        seen; one row for each decoded frame.

    Raises:
        SourceError: If the file is no video, or shows no person.
        AssetError: If the models of the pose estimator are not here and cannot be downloaded.
    """
    from mimic.sources.video.decoding import check_video
    from mimic.sources.video.video import pose_cache_key
    from mimic.sources.video.video import track_video as track

    path = existing(video)
    settings = settings or PoseSettings()
    reporter = reporting(reporter)
    if settings.also is not None:
        return _track_two(path, existing(settings.also), replace(settings, also=None), cache, reporter)
    if path.is_dir():
        raise SourceError(f"{path} is a folder; expected a video")
    cached = user_cache("pose") / f"{pose_cache_key(path, settings)}.parquet" if cache else None
    if cached is not None and cached.is_file():
        reporter.note(f"pose         reused from an earlier run on the same video ({cached})")
        return store.load(cached, PoseTrack)
    fetch_pose_model(reporter, partial(check_video, path))
    with reporter.progress("pose") as progress:
        found = track(path, settings, progress=progress)
    if cached is not None:
        store.save(found, cached, made_by=provenance(settings, {"video": path}))
    return found


def _track_two(path: Path, other: Path, settings: PoseSettings, cache: bool, reporter: Reporter) -> PoseTrack:
    """Return the track of a video, with what a second one of the same moment adds."""
    from mimic.sources.video.two_views import merge_views

    first, second = (track_video(video, settings, cache=cache, reporter=reporter) for video in (path, other))
    merged, fit = merge_views(first, second, (path.name, other.name))
    order = "before" if fit.delay > 0 else "after"
    reporter.note(
        f"two views    {other.name} starts {abs(fit.delay):.2f} s {order} {path.name}, "
        f"from a camera {fit.angle_deg:.0f}° to its side"
    )
    return merged


def retarget(
    track: PoseTrack | WristTrack,
    settings: RetargetSettings | None = None,
    *,
    description: RobotDescription | None = None,
    reporter: Reporter | None = None,
) -> TargetTrack:
    """Scale a person's wrists into the robot's workspace, sample, clamp and limit them.

    Args:
        track: Landmarks of a person, or wrist vectors from the shoulders in torso axes.
        settings: Sampling interval, scale, mirroring.
        description: The robot; by default the shipped CyberDog 2.
        reporter: Receives warnings.

    Returns:
        Toe targets in the robot's base axes [m], reachable inside its joint and speed limits; ``report`` tells how much
        was moved.

    Raises:
        SourceError: If the track shows no usable arm.
    """
    loading = _Loading(
        settings=InputSettings(retarget=settings or RetargetSettings()),
        reporter=reporting(reporter),
        description=description,
    )
    motion = _of_record(track, loading)
    assert motion.targets is not None
    return motion.targets


def as_motion(
    commands: Motion | CommandTrack | TargetTrack | WristTrack | PoseTrack,
    *,
    description: RobotDescription | None = None,
    reporter: Reporter | None = None,
) -> Motion:
    """Return a motion of whatever can be played, retargeted with default settings where that is needed."""
    if isinstance(commands, Motion):
        return commands
    loading = _Loading(settings=InputSettings(), reporter=reporting(reporter), description=description)
    return _of_record(commands, loading)


def is_video(path: Path) -> bool:
    """Return whether a file is read as a video: by its ending, or because no other kind has that ending."""
    return next((kind for kind in SOURCES if path.suffix.lower() in kind.endings), VIDEO) is VIDEO


def playable(path: Path) -> bool:
    """Return whether a file in a folder is meant to be played."""
    ending = path.suffix.lower()
    return any(ending in kind.endings and kind.in_folders(path) for kind in SOURCES)


def _of_record(record: CommandTrack | TargetTrack | WristTrack | PoseTrack, loading: _Loading) -> Motion:
    if not isinstance(record, CommandTrack | TargetTrack | WristTrack | PoseTrack):
        raise SourceError(
            f"given is a {type(record).__name__}; expected a file, arrays as in an .npz, a Motion, or a CommandTrack, "
            "TargetTrack, WristTrack or PoseTrack"
        )
    if isinstance(record, PoseTrack):
        return _of_pose(record, loading)
    if isinstance(record, WristTrack):
        return _of_wrists(record, loading)
    robot = DEFAULT_ROBOT if loading.description is None else loading.description.name
    if record.robot not in ("", robot):
        raise SourceError(
            f"these toes were made for the {record.robot}, and the robot is a {robot}; play what they were made from"
        )
    check_clock(record.t, "the motion", SourceError, apart=SPARSE)
    asked = [record.p_BE.reshape(-1, 6), record.heading[:, None]]
    if isinstance(record, CommandTrack):
        asked.append(record.v)
    unknown = np.flatnonzero(~np.isfinite(np.hstack(asked)).all(axis=1))
    if len(unknown):
        raise SourceError(f"row {unknown[0] + 1} of the motion holds a number that is not finite; fill such gaps")
    if (away := float(np.max(np.abs(record.p_BE), initial=0.0))) > FARTHEST:
        raise SourceError(f"toes are {away:.3g} m from the base of the robot; give the positions in metres")
    return Motion(commands=record) if isinstance(record, CommandTrack) else _of_targets(record)


def _of_targets(targets: TargetTrack) -> Motion:
    from mimic.retargeting.commands import command_track

    return Motion(commands=command_track(targets), targets=targets)


def _of_wrists(wrists: WristTrack, loading: _Loading) -> Motion:
    from mimic.retargeting.targets import target_track

    check_clock(wrists.t, "the motion", SourceError)
    targets = target_track(wrists, loading.reach(), loading.settings.retarget)
    for text in (*_implausible(wrists), *targets.warnings):
        loading.reporter.warn(text)
    return _of_targets(targets)


ACROSS = 0.4
"""A hand whose median is farther across [arm lengths] is in the place of the other hand, or given in other axes."""
SPARSE = (0.002, 10.0)
"""Plausible times between two commands or targets [s]."""
FARTHEST = 2.0
"""Farthest that a toe can be from the base [m]."""
LONGEST = (0.15, 1.6)
"""Plausible lengths of an arm [m]."""
FASTEST = 20.0
"""Speed that a hand seldom passes [arm lengths/s]: 12 m/s."""


def _implausible(wrists: WristTrack) -> Iterator[str]:
    """Say which unit or clock of the wrists cannot be true, whatever they were read from.

    Raises:
        SourceError: If they are in no arm lengths, or of a body that has no arms' length.
    """
    reach = np.linalg.norm(wrists.p_SH[wrists.valid], axis=-1)
    across = wrists.p_SH[..., 1].T
    longest = float(np.quantile(reach, 0.98)) if len(reach) else 1.0
    if not 0.2 <= longest <= 2.0:
        raise SourceError(
            f"the wrists are up to {longest:.3g} arm lengths from their shoulders; expected about 1: divide them by "
            "the length of the arm"
        )
    if not LONGEST[0] <= wrists.arm_length <= LONGEST[1] and np.isfinite(wrists.arm_length):
        raise SourceError(
            f"the arms are {wrists.arm_length:.3g} m long; expected {LONGEST[0]:g} to {LONGEST[1]:g} m: give the "
            "positions in metres, or film arms that stretch"
        )
    left, right = (
        np.median(own[seen]) if seen.any() else 0.0 for own, seen in zip(across, wrists.valid.T, strict=True)
    )
    if left < -ACROSS and right > ACROSS:
        yield "each hand is mostly on the side of the other one: if the sides are exchanged, exchange left and right"
    elif min(left, right) > ACROSS or max(left, right) < -ACROSS:
        yield "both hands are mostly on one side: if y is up or down in the data, turn it to x forward, y left, z up"
    step = np.linalg.norm(np.diff(wrists.p_SH, axis=0), axis=-1) / np.diff(wrists.t)[:, None]
    known = step[np.isfinite(step)]
    speed = float(np.quantile(known, 0.9)) if len(known) else 0.0
    if speed > FASTEST:
        yield f"the hands move at {speed:.0f} arm lengths a second: the times or the frame rate are too short"


def _of_pose(pose: PoseTrack, loading: _Loading, *, video: Path | None = None) -> Motion:
    from mimic.retargeting.wrists import pose_report, wrist_track

    motion = _of_wrists(wrist_track(pose, loading.settings.retarget), loading)
    assert motion.targets is not None
    figures = pose_report(pose, loading.settings.retarget)
    if not any(pose.size):  # no camera
        del figures["unseen"]
    targets = replace(motion.targets, report={**motion.targets.report, "pose": figures})
    slow_down = targets.report["slow_down"]
    if slow_down != 1.0:
        pose = replace(pose, t=slow_down * pose.t)  # in the time of the targets, so that pictures stay together
    return replace(motion, targets=targets, pose=pose, video=video)


def _of_script(script: KeyFrames, reach: Reach, loading: _Loading) -> Motion:
    from mimic.retargeting.keyframes import keyframe_commands

    _refuse_slow_down(loading, "of key frames; change their durations, or say in the sentence how long it takes")
    commands, targets = keyframe_commands(script, reach, loading.settings.retarget)
    return Motion(commands=commands, targets=targets, script=script)


def _refuse_slow_down(loading: _Loading, what: str) -> None:
    """Raise a ConfigError if a motion that was timed already is to be slowed down."""
    if loading.settings.retarget.slow_down != 1.0:
        raise ConfigError(f"--slow-down stretches the motion of a person; this is a motion {what}")


def _read_video(path: Path, loading: _Loading) -> Motion:
    pose = track_video(path, loading.settings.pose, reporter=loading.reporter)
    return _of_pose(pose, loading, video=path)


def _read_mocap(path: Path, loading: _Loading) -> Motion:
    from mimic.sources.mocap.load import track_mocap

    return _of_pose(track_mocap(path, loading.settings.stored, loading.settings.pose), loading)


def _read_keyframes(path: Path, loading: _Loading) -> Motion:
    from mimic.io.keyframes import read_keyframes
    from mimic.sources.text.planner import check

    script = read_keyframes(path)
    reach = loading.reach()
    check(script, reach, loading.settings.language, f"{path.name} asks for what this robot cannot do")
    return _of_script(script, reach, loading)


def _read_record(path: Path, loading: _Loading) -> Motion:
    record = store.header(path)["record"]
    if record in ("CommandTrack", "TargetTrack"):
        _refuse_slow_down(loading, "that was retargeted before; slow down what it was made from")
    if record not in RECORDS:
        raise SourceError(f"{path} holds a {record}, which cannot be played; expected one of {', '.join(RECORDS)}")
    return _of_record(store.load(path, RECORDS[record]), loading)


def _holds_playable_record(path: Path) -> bool:
    try:
        return store.header(path)["record"] in RECORDS
    except AssetError:
        return False


def fetch_pose_model(reporter: Reporter, check: Callable[[], None]) -> None:
    """Download the models of the pose estimator where they are not on this computer yet.

    Args:
        reporter: Receives notes.
        check: Called before a download; raises a SourceError if there is no picture to use them on.

    Raises:
        SourceError: From ``check``.
        AssetError: If that is not possible.
    """
    from mimic.sources.video.pose_models.pose_model import is_here, pose_model

    if is_here():
        return
    check()
    reporter.note("pose model   not on this computer yet: downloading the package that carries it (once, 36 MB)")
    reporter.note(f"pose model   kept in {pose_model()}")


RECORDS = {kind.__name__: kind for kind in (CommandTrack, PoseTrack, TargetTrack, WristTrack)}
"""Records that can be played."""

VIDEO = Source("video", (".mp4", ".mkv", ".mov", ".m4v", ".avi", ".webm", ".mpg", ".mpeg", ".wmv", ".gif"), _read_video)
"""Videos; a single file may have any other ending, too."""

SOURCES: tuple[Source, ...] = (
    VIDEO,
    Source("recorded motion", (".npz", ".trc", ".bvh", ".c3d", ".pkl", ".pt"), _read_mocap),
    Source("key frames", (".yaml", ".yml"), _read_keyframes),
    Source("record of mimic", (".parquet",), _read_record, _holds_playable_record),
)
"""All kinds of files that can be played; a new kind is a row here."""
