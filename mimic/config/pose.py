"""Settings of the input sources: video, recorded motion, sentences, camera."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from mimic.config.ranges import check_range


@dataclass(frozen=True, kw_only=True, slots=True)
class PoseSettings:
    """How landmarks are found in a video."""

    min_visibility: float = 0.5
    """Minimum visibility of a detected landmark."""
    min_person_share: float = 0.3
    """Minimum share of frames that show both shoulders and a wrist: 0.60-1.00 on real clips, 0.02-0.11 on clips without
    a person."""
    person: Literal["left", "right", "largest"] | int | None = None
    """Person to follow if a video shows several: position in the first frame, or number from the left."""
    cutoff_hz: float = 6.0
    """Cut-off of the zero-phase Butterworth filter over the landmarks [Hz]."""
    depth: bool = True
    """Estimate the depth of the arms with a network; otherwise use the detector's."""
    also: Path | None = None
    """A second video of the same person at the same time, from another side: its picture shows the depth that the first
    one hardly sees. Both start within 2 s."""

    def __post_init__(self) -> None:
        check_range("min-visibility", self.min_visibility, 0.0, 1.0)
        check_range("min-person-share", self.min_person_share, 0.0, 1.0)
        check_range("cutoff-hz", self.cutoff_hz, 0.5, 30.0, "Hz")
        if isinstance(self.person, int):
            check_range("person", self.person, 1, 5)


@dataclass(frozen=True, kw_only=True, slots=True)
class MocapSettings:
    """What a file of recorded motion (.npz, .trc, .bvh, .c3d, .pkl, .pt) does not state."""

    names: tuple[str, ...] = ()
    """OURS=THEIRS for each point whose name mimic does not know, such as left_wrist=LWRA+LWRB (the mean of two)."""
    layout: str | None = None
    """Layout of points without names, such as coco17 or smpl24; default: from their number."""
    up: Literal["auto", "x", "y", "z", "-x", "-y", "-z"] = "auto"
    """Axis that points up; auto: that along the torso."""
    fps: float = 0.0
    """Frame rate [Hz]; 0 uses the times in the file."""

    def __post_init__(self) -> None:
        check_range("fps", self.fps, 0.0, 10_000.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class LanguageSettings:
    """How a sentence becomes key frames."""

    planner: Literal["auto", "llm", "grammar"] = "auto"
    """What reads the sentence; auto: llm if an endpoint or a model is given, else the built-in grammar."""
    llm_url: str | None = None
    """Endpoint with OpenAI's chat completions API, such as http://127.0.0.1:11434/v1; its key is read from
    OPENAI_API_KEY."""
    llm_model: str | None = None
    """Name of the language model."""
    llm_timeout: float = 120.0
    """Timeout of an answer [s]."""
    llm_tokens: int = 8000
    """Longest answer that is asked for [tokens]; fewer keep a small local model from rambling."""
    longest: float = 60.0
    """Maximum length of the motion [s]."""

    def __post_init__(self) -> None:
        check_range("llm-timeout", self.llm_timeout, 0.1, 3600.0, "s")
        check_range("llm-tokens", self.llm_tokens, 100, 100_000)
        check_range("longest", self.longest, 1.0, 600.0, "s")


@dataclass(frozen=True, kw_only=True, slots=True)
class LiveSettings:
    """How the robot follows a camera in real time."""

    follow: bool = False
    """Turn and walk slowly with the person; otherwise the robot stays where it is."""
    lost_hold: float = 0.5
    """How long the target of a lost hand is held before the arm goes down to hang [s]."""
    min_cutoff: float = 1.5
    """Minimum cut-off of the One-Euro filter [Hz]; lower means less jitter and more lag."""
    beta: float = 8.0
    """Speed coefficient of the One-Euro filter: rise of the cut-off with the speed of the hand [Hz s/m]."""
    camera_size: tuple[int, int] = (640, 480)
    """Requested width and height of the camera picture [px]."""

    def __post_init__(self) -> None:
        check_range("lost-hold", self.lost_hold, 0.0, 10.0, "s")
        check_range("min-cutoff", self.min_cutoff, 0.1, 30.0, "Hz")
        check_range("beta", self.beta, 0.0, 100.0)
