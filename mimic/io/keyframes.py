"""A motion as a few key frames, and the YAML file that a person may edit.

sentence: step forward, then wave
planner: phrasebook
frames:
- what: both hands up
  duration: 0.8                 # s, from the frame before to this one
  velocity: [0.0, 0.0]          # m/s forward and left, on the way
  heading_deg: 0.0              # left of the heading at the start, when the frame is reached
  left_deg: [0.0, 45.0, -70.0]  # abad, hip, knee of the front left leg, when the frame is reached
  right_deg: [0.0, 45.0, -70.0]
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mimic.errors import SourceError
from mimic.store import written_whole
from mimic.types import FloatArray

MOST_FRAMES = 100
"""Key frames of a motion at most."""
LARGEST = 1_000_000
"""A file or an answer with more characters is not read."""
FIELDS = {"duration": 0, "velocity": 2, "heading_deg": 0, "left_deg": 3, "right_deg": 3}
"""What a key frame must have: how many numbers each is, 0 being one by itself."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class KeyFrame:
    """What is reached, and how one gets there from the frame before."""

    duration: float
    """From the frame before [s]."""
    velocity: tuple[float, float]
    """On the way, forward and left in the heading frame [m/s]."""
    heading: float
    """When it is reached, left of the heading at the start [rad]."""
    q: FloatArray
    """Front legs when it is reached: abad, hip, knee, left before right (6,) [rad]."""
    what: str = ""
    """In words."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class KeyFrames:
    """A motion; it begins with the front legs as they are when the robot stands."""

    frames: tuple[KeyFrame, ...]
    sentence: str = ""
    """What was asked for."""
    planner: str = ""
    """Who made it: phrasebook, the name of a language model, or a person."""

    @property
    def seconds(self) -> float:
        """How long it takes [s]."""
        return sum(frame.duration for frame in self.frames)


def frames_from(data: Any) -> tuple[tuple[KeyFrame, ...], list[str]]:
    """Return the key frames of plain data, and what is wrong with it; with a complaint there are none.

    Args:
        data: A list of mappings, or a mapping whose ``frames`` is one, as JSON and YAML give them.
    """
    rows = data.get("frames") if isinstance(data, Mapping) else data
    if not isinstance(rows, list) or not rows:
        return (), [f"expected a list of frames under 'frames', got {_short(rows)}"]
    if len(rows) > MOST_FRAMES:
        return (), [f"there are {len(rows)} frames; at most {MOST_FRAMES} are played"]
    complaints: list[str] = []
    frames = []
    for number, row in enumerate(rows, 1):
        values, wrong = _numbers(row, f"frame {number}")
        complaints += wrong
        if not wrong:
            frames.append(
                KeyFrame(
                    duration=values["duration"][0],
                    velocity=(values["velocity"][0], values["velocity"][1]),
                    heading=math.radians(values["heading_deg"][0]),
                    q=np.radians([*values["left_deg"], *values["right_deg"]]),
                    what=" ".join(str(row.get("what", "")).split())[:200],
                )
            )
    return (tuple(frames), []) if not complaints else ((), complaints)


def _numbers(row: Any, where: str) -> tuple[dict[str, list[float]], list[str]]:
    if not isinstance(row, Mapping):
        return {}, [f"{where} is {_short(row)}; expected a mapping with {', '.join(FIELDS)}"]
    wrong = [f"{where} has {_short(name)}, which is not known" for name in row if name not in (*FIELDS, "what")]
    values = {}
    for name, count in FIELDS.items():
        if name not in row:
            wrong.append(f"{where} lacks {name}")
            continue
        given = row[name] if count else [row[name]]
        good = isinstance(given, list) and len(given) == max(count, 1)
        if not good or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in given):
            expected = f"{count} numbers in a list" if count else "a number"
            wrong.append(f"{where}: {name} is {_short(row[name])}; expected {expected}")
        elif not all(abs(v) < 1e9 for v in given):  # NaN fails too
            wrong.append(f"{where}: {name} is {_short(row[name])}; expected finite numbers")
        else:
            values[name] = [float(v) for v in given]
    return values, wrong


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "…"


def plain_frame(frame: KeyFrame) -> dict[str, Any]:
    """Return a key frame as JSON and YAML hold it."""
    degrees = np.degrees(frame.q).round(2).tolist()
    return {
        "what": frame.what,
        "duration": round(frame.duration, 3),
        "velocity": [round(v, 3) for v in frame.velocity],
        "heading_deg": round(math.degrees(frame.heading), 2),
        "left_deg": degrees[:3],
        "right_deg": degrees[3:],
    }


def save_keyframes(motion: KeyFrames, path: Path) -> None:
    """Write a motion as YAML, complete or not at all."""
    import yaml

    class Dumper(yaml.SafeDumper):
        """Short lists stay on one line."""

    def short(dumper: yaml.SafeDumper, values: list[Any]) -> yaml.Node:
        return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=isinstance(values[0], float))

    Dumper.add_representer(list, short)
    data = {
        "sentence": motion.sentence,
        "planner": motion.planner,
        "frames": [plain_frame(frame) for frame in motion.frames],
    }
    head = (
        "# Play it: mimic THIS_FILE --sim. duration [s] from the frame before; velocity [m/s] forward, left; heading and\n"
        "# joints (abad, hip, knee of a front leg) [deg] are reached at its end.\n"
    )
    text = yaml.dump(data, Dumper=Dumper, sort_keys=False, allow_unicode=True, width=120)
    with written_whole(path) as part:
        part.write_text(head + text, encoding="utf-8")


def read_keyframes(path: Path) -> KeyFrames:
    """Read a motion from YAML; what it says is not yet held against the robot.

    Raises:
        SourceError: If it is no YAML, or lacks something; all that is wrong is told at once.
    """
    import yaml

    if path.stat().st_size > LARGEST:
        raise SourceError(f"{path.name} has {path.stat().st_size} bytes; a motion in key frames has at most {LARGEST}")
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise SourceError(f"{path.name} is no YAML: {' '.join(str(error).split())}") from None
    frames, wrong = frames_from(data)
    if wrong:
        raise SourceError(f"{path.name} cannot be played: {told(wrong)}")
    facts = data if isinstance(data, Mapping) else {}
    return KeyFrames(frames=frames, sentence=str(facts.get("sentence", "")), planner=str(facts.get("planner", "")))


def told(complaints: list[str], most: int = 8) -> str:
    """Return complaints in a line."""
    return "; ".join(complaints[:most]) + (f"; and {len(complaints) - most} more" if len(complaints) > most else "")
