"""Settings of the input sources: video, recorded motion, sentences, camera."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from mimic.config.ranges import Limited, within
from mimic.frozen import frozen


@frozen
class PoseSettings(Limited):
    """How landmarks are found in a video."""

    min_visibility: float = within(0.5, 0.0, 1.0)
    """Minimum visibility of a detected landmark."""
    min_person_share: float = within(0.3, 0.0, 1.0)
    """Minimum share of frames that show both shoulders and a wrist: 0.60-1.00 on real clips, 0.02-0.11 on clips without
    a person."""
    person: Literal["left", "right", "largest"] | int | None = within(None, 1, 5)
    """Person to follow if a video shows several: position in the first frame, or number from the left."""
    cutoff_hz: float = within(6.0, 0.5, 30.0, "Hz")
    """Cut-off of the zero-phase Butterworth filter over the landmarks [Hz]."""
    depth: bool = True
    """Estimate the depth of the arms with a network; otherwise use the detector's."""
    also: Path | None = None
    """A second video of the same person at the same time, from another side: its picture shows the depth that the first
    one hardly sees. Both start within 2 s."""


@frozen
class MocapSettings(Limited):
    """What a file of recorded motion (.npz, .trc, .bvh, .c3d, .pkl, .pt) does not state."""

    names: tuple[str, ...] = ()
    """OURS=THEIRS for each point whose name mimic does not know, such as left_wrist=LWRA+LWRB (the mean of two)."""
    layout: str | None = None
    """Layout of points without names, such as coco17 or smpl24; default: from their number."""
    up: Literal["auto", "x", "y", "z", "-x", "-y", "-z"] = "auto"
    """Axis that points up; auto: that along the torso."""
    fps: float = within(0.0, 0.0, 10_000.0)
    """Frame rate [Hz]; 0 uses the times in the file."""


@frozen
class LanguageSettings(Limited):
    """How a sentence becomes key frames."""

    planner: Literal["auto", "llm", "grammar"] = "auto"
    """What reads the sentence; auto: llm if an endpoint or a model is given, else the built-in grammar."""
    llm_url: str | None = None
    """Endpoint with OpenAI's chat completions API, such as http://127.0.0.1:11434/v1; its key is read from
    OPENAI_API_KEY."""
    llm_model: str | None = None
    """Name of the language model."""
    llm_timeout: float = within(120.0, 0.1, 3600.0, "s")
    """Timeout of an answer [s]."""
    llm_tokens: int = within(8000, 100, 100_000)
    """Longest answer that is asked for [tokens]; fewer keep a small local model from rambling."""
    longest: float = within(60.0, 1.0, 600.0, "s")
    """Maximum length of the motion [s]."""


@frozen
class LiveSettings(Limited):
    """How the robot follows a camera in real time."""

    follow: bool = False
    """Turn and walk slowly with the person; otherwise the robot stays where it is."""
    lost_hold: float = within(0.5, 0.0, 10.0, "s")
    """How long the target of a lost hand is held before the arm goes down to hang [s]."""
    min_cutoff: float = within(1.5, 0.1, 30.0, "Hz")
    """Minimum cut-off of the One-Euro filter [Hz]; lower means less jitter and more lag."""
    beta: float = within(8.0, 0.0, 100.0)
    """Speed coefficient of the One-Euro filter: rise of the cut-off with the speed of the hand [Hz s/m]."""
    camera_size: tuple[int, int] = (640, 480)
    """Requested width and height of the camera picture [px]."""
