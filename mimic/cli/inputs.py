"""What is played, from whatever holds it: a video, stored motion, or targets and commands made before."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from mimic import store
from mimic.cli import COMMAND
from mimic.errors import AssetError, SourceError
from mimic.settings import LanguageSettings, PoseSettings, RetargetSettings, StoredSettings
from mimic.types import CommandTrack, PoseTrack, TargetTrack, WristTrack

if TYPE_CHECKING:
    from mimic.keyframes import KeyFrames
    from mimic.robot.reach import Reach

STORED = (".npz", ".trc", ".bvh")
"""Endings of files with points or a skeleton over time."""
SCRIPT = (".yaml", ".yml")
"""Endings of motions in key frames."""
RECORD = ".parquet"
"""Ending of our own records; the header says which one a file holds."""


@dataclass(frozen=True, kw_only=True, slots=True)
class InputSettings:
    """How an input becomes commands."""

    pose: PoseSettings = field(default_factory=PoseSettings)
    stored: StoredSettings = field(default_factory=StoredSettings)
    retarget: RetargetSettings = field(default_factory=RetargetSettings)
    language: LanguageSettings = field(default_factory=LanguageSettings)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Motion:
    """What is to be played, whatever it came from."""

    commands: CommandTrack
    targets: TargetTrack | None = None
    """The toes of the commands and how they were clamped; None where only commands were stored."""
    pose: PoseTrack | None = None
    """The person, where there is one."""
    video: Path | None = None
    """The video that the person was seen in."""
    script: KeyFrames | None = None
    """The key frames, where it was made from such."""


class Tell(Protocol):
    """Who is told what happens while an input is read."""

    def note(self, text: str) -> None:
        """Take a line that the user should read."""
        ...

    def warn(self, text: str) -> None:
        """Take a warning."""
        ...

    def progress(self, what: str) -> Any:
        """Return a context that gives a function of the steps done and in all."""
        ...


class Silent:
    """Tells nobody, and keeps the warnings."""

    def __init__(self) -> None:
        self.warnings: list[str] = []

    def note(self, text: str) -> None:
        """Drop it."""

    def warn(self, text: str) -> None:
        """Keep it."""
        self.warnings.append(text)

    @contextmanager
    def progress(self, what: str) -> Iterator[Callable[[int, int | None], None]]:
        """Drop the steps."""
        yield lambda done, total=None: None


class Aloud:
    """Tells the terminal."""

    def note(self, text: str) -> None:
        """Print it."""
        from mimic.cli.console import note

        note(text)

    def warn(self, text: str) -> None:
        """Print it."""
        from mimic.cli.console import warn

        warn(text)

    def progress(self, what: str) -> Any:
        """Return a progress bar."""
        from mimic.cli.console import progress_bar

        return progress_bar(what)


VIDEOS = (".mp4", ".mkv", ".mov", ".m4v", ".avi", ".webm", ".mpg", ".mpeg", ".wmv", ".gif")
"""Endings of videos that are looked for in a folder; a single file may have any."""
PLAYABLE = ("CommandTrack", "PoseTrack", "TargetTrack", "WristTrack")
"""Records that can be played."""


def playable(path: Path) -> bool:
    """Return whether a file in a folder is meant to be played."""
    ending = path.suffix.lower()
    if ending != RECORD:
        return ending in (*VIDEOS, *STORED, *SCRIPT)
    try:
        return store.header(path)["record"] in PLAYABLE
    except AssetError:
        return False


def load_motion(source: Path | str, settings: InputSettings, tell: Tell) -> Motion:
    """Return what a file, or a sentence, asks the robot to do.

    Raises:
        SourceError, AssetError: If a file cannot be read as what its ending says, or a sentence is not understood.
        ConfigError, MissingExtra: If a language model is asked for and not named, or its client not installed.
    """
    if isinstance(source, str):
        return _of_text(source, settings, tell)
    if not source.exists():
        raise SourceError(f"there is no file {source}")
    if source.is_dir():
        raise SourceError(f"{source} is a folder; expected a video file or stored motion; mimic batch plays a folder")
    ending = source.suffix.lower()
    if ending == RECORD:
        return _of_record(source, settings, tell)
    if ending in SCRIPT:
        from mimic.keyframes import read_keyframes
        from mimic.robot.reach import Reach
        from mimic.sources.language import check

        script, reach = read_keyframes(source), Reach()
        check(script, reach, settings.language, f"{source.name} asks for what this robot cannot do")
        return _of_script(script, reach, settings)
    if ending in STORED:
        from mimic.sources.stored import track_stored

        return _of_pose(track_stored(source, settings.stored, settings.pose), settings, tell, video=None)
    return _of_pose(pose_of(source, settings.pose, tell), settings, tell, video=source)


def _of_text(sentence: str, settings: InputSettings, tell: Tell) -> Motion:
    """Return what a sentence asks for, and tell who read it."""
    from mimic.robot.reach import Reach
    from mimic.sources.language import plan, uses_model

    reach = Reach()
    if uses_model(settings.language):
        tell.note(f"planner      asking {settings.language.llm_model or 'a language model'}")
    script = plan(sentence, reach, settings.language)
    tell.note(f"planner      {script.planner}: {len(script.frames)} key frames, {script.seconds:.1f} s")
    return _of_script(script, reach, settings)


def _of_script(script: KeyFrames, reach: Reach, settings: InputSettings) -> Motion:
    from mimic.retarget.keyframes import keyframe_commands

    commands, targets = keyframe_commands(script, reach, settings.retarget)
    return Motion(commands=commands, targets=targets, script=script)


def _of_record(source: Path, settings: InputSettings, tell: Tell) -> Motion:
    from mimic.retarget.commands import command_track

    record = store.header(source)["record"]
    if record == "CommandTrack":
        return Motion(commands=store.load(source, CommandTrack))
    if record == "TargetTrack":
        targets = store.load(source, TargetTrack)
        return Motion(commands=command_track(targets), targets=targets)
    if record == "WristTrack":
        return _of_wrists(store.load(source, WristTrack), settings, tell)
    if record == "PoseTrack":
        return _of_pose(store.load(source, PoseTrack), settings, tell, video=None)
    raise SourceError(f"{source} holds a {record}, which cannot be played; expected one of {', '.join(PLAYABLE)}")


def _of_pose(pose: PoseTrack, settings: InputSettings, tell: Tell, *, video: Path | None) -> Motion:
    from mimic.retarget.wrists import pose_report, wrist_track

    motion = _of_wrists(wrist_track(pose, settings.retarget), settings, tell)
    assert motion.targets is not None
    figures = dict(pose_report(pose, settings.retarget))
    if not any(pose.size):  # no camera
        figures = {name: value for name, value in figures.items() if name not in ("camera_axis", "unseen")}
    targets = replace(motion.targets, report={**motion.targets.report, "pose": figures})
    return replace(motion, targets=targets, pose=pose, video=video)


def _of_wrists(wrists: WristTrack, settings: InputSettings, tell: Tell) -> Motion:
    from mimic.retarget.commands import command_track
    from mimic.retarget.targets import target_track
    from mimic.robot.reach import Reach

    targets = target_track(wrists, Reach(), settings.retarget)
    for text in targets.warnings:
        tell.warn(text)
    return Motion(commands=command_track(targets), targets=targets)


def _pose_cache() -> Path:
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "mimic" / "pose"


def pose_of(video: Path, settings: PoseSettings, tell: Tell) -> PoseTrack:
    """Return the pose track of a video, stored by its content, and say when a stored one is used."""
    from mimic.sources.video import pose_cache_key, track_video

    cached = _pose_cache() / f"{pose_cache_key(video, settings)}.parquet"
    if cached.is_file():
        track = store.load(cached, PoseTrack)
        tell.note(f"pose         reused from an earlier run on the same video ({cached})")
        return track
    with tell.progress("pose") as progress:
        track = track_video(video, settings, progress=progress)
    made_by = store.provenance(command=COMMAND.get(), settings=settings, inputs={"video": video})
    store.save(track, cached, made_by=made_by)
    return track
