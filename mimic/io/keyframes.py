"""A motion as a few key frames, stored as a YAML file that can be edited by hand.

sentence: step forward, then wave
planner: grammar
frames:
- what: both hands up
  duration: 0.8                 # s, from the previous frame to this one
  velocity: [0.0, 0.0]          # m/s forward and left, until the frame is reached
  heading_deg: 0.0              # left of the heading at the start, when the frame is reached
  left_deg: [0.0, 45.0, -70.0]  # abad, hip, knee of the front left leg, when the frame is reached
  right_deg: [0.0, 45.0, -70.0]
  height: -0.05                 # m, of the hips above how the robot stands by itself; this and the next may be left out
  lean_deg: 10.0                # to the belly, beyond how it stands by itself
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mimic.config.text_file import read_text
from mimic.config.values import expected, fitted
from mimic.errors import SourceError
from mimic.io.store import written_whole
from mimic.records import FloatArray

MOST_FRAMES = 100
"""Maximum number of key frames of a motion."""
LARGEST = 1_000_000
"""Maximum size of a file or an answer [characters]."""
DEEPEST = 10
"""Deepest nesting of a file."""
MOST_SHOWN = 8
"""Errors that are told."""
MOST_ITEMS = 20_000
"""Most items of a file."""
_PAIR = tuple[float, float]
_LEG = tuple[float, float, float]
FIELDS = {"duration": float, "velocity": _PAIR, "heading_deg": float, "left_deg": _LEG, "right_deg": _LEG}
"""Required fields of a key frame."""
TRUNK = {"height": float, "lean_deg": float}
"""Fields that may be left out: the robot then stands as it does by itself."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class KeyFrame:
    """A posture and heading to reach, and the duration and velocity on the way there."""

    duration: float
    """Time from the previous frame [s]."""
    velocity: tuple[float, float]
    """Velocity on the way, forward and left in the heading frame [m/s]."""
    heading: float
    """Heading at the key frame, positive to the left of the initial heading [rad]."""
    q: FloatArray
    """Front-leg joints at the key frame: abad, hip, knee, left before right (6,) [rad]."""
    trunk: tuple[float, float] = (0.0, 0.0)
    """Height of the hips [m] and lean [rad] at the key frame, from how the robot stands by itself."""
    what: str = ""
    """Description in words."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class KeyFrames:
    """A motion in key frames; it begins in the standing posture."""

    frames: tuple[KeyFrame, ...]
    sentence: str = ""
    """The sentence that describes the motion."""
    planner: str = ""
    """Origin of the motion: grammar, the name of a language model, or a person."""
    typed: tuple[tuple[str, str], ...] = ()
    """Words of the sentence that were read as others, each with what was read."""

    @property
    def seconds(self) -> float:
        """Duration of the motion [s]."""
        return sum(frame.duration for frame in self.frames)


def frames_from(data: Any) -> tuple[tuple[KeyFrame, ...], list[str]]:
    """Parse plain data; return the key frames and the errors. With errors, there are no key frames.

    Args:
        data: A list of mappings, or a mapping with such a list under ``frames``, as from JSON or YAML.
    """
    rows = data.get("frames") if isinstance(data, Mapping) else data
    if not isinstance(rows, list) or not rows:
        return (), [f"expected a list of frames under 'frames', got {_short(rows)}"]
    if len(rows) > MOST_FRAMES:
        return (), [f"there are {len(rows)} frames; at most {MOST_FRAMES} are played"]
    errors: list[str] = []
    frames = []
    for number, row in enumerate(rows, 1):
        values, row_errors = _numbers(row, f"frame {number}")
        errors += row_errors
        if not row_errors:
            frames.append(
                KeyFrame(
                    duration=values["duration"],
                    velocity=values["velocity"],
                    heading=math.radians(values["heading_deg"]),
                    q=np.radians([*values["left_deg"], *values["right_deg"]]),
                    trunk=(values["height"], math.radians(values["lean_deg"])),
                    what=" ".join(str(row.get("what", "")).split())[:200],
                )
            )
    return (tuple(frames), []) if not errors else ((), errors)


def _numbers(row: Any, where: str) -> tuple[dict[str, Any], list[str]]:
    if not isinstance(row, Mapping):
        return {}, [f"{where} is {_short(row)}; expected a mapping with {', '.join(FIELDS)}"]
    errors = [f"{where} has {_short(name)}, which is unknown" for name in row if name not in (*FIELDS, *TRUNK, "what")]
    errors += [f"{where} lacks {name}" for name in FIELDS if name not in row]
    values: dict[str, Any] = dict.fromkeys(TRUNK, 0.0)
    for name, hint in (FIELDS | TRUNK).items():
        if name not in row:
            continue
        try:
            values[name] = fitted(row[name], hint)
        except TypeError:
            errors.append(f"{where}: {name} is {_short(row[name])}; expected {expected(hint)}")
            continue
        if not (np.abs(values[name]) < 1e9).all():  # NaN fails too
            errors.append(f"{where}: {name} is {_short(row[name])}; expected finite numbers")
    return values, errors


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "…"


def plain_frame(frame: KeyFrame) -> dict[str, Any]:
    """Return a key frame as plain data for JSON and YAML."""
    degrees = np.degrees(frame.q).round(2).tolist()
    height, lean = frame.trunk
    trunk = {"height": round(height, 3), "lean_deg": round(math.degrees(lean), 2)} if height or lean else {}
    return {
        "what": frame.what,
        "duration": round(frame.duration, 3),
        "velocity": [round(v, 3) for v in frame.velocity],
        "heading_deg": round(math.degrees(frame.heading), 2),
        "left_deg": degrees[:3],
        "right_deg": degrees[3:],
        **trunk,
    }


def save_keyframes(motion: KeyFrames, path: Path) -> None:
    """Write a motion as YAML, complete or not at all."""
    import yaml

    class Dumper(yaml.SafeDumper):
        """Keeps lists of numbers on one line."""

    def short(dumper: yaml.SafeDumper, values: list[Any]) -> yaml.Node:
        return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=isinstance(values[0], float))

    Dumper.add_representer(list, short)
    data = {
        "sentence": motion.sentence,
        "planner": motion.planner,
        "frames": [plain_frame(frame) for frame in motion.frames],
    }
    head = (
        "# Play it: mimic THIS_FILE --sim. duration [s] from the previous frame; velocity [m/s] forward, "
        "left;\n# heading and joints (abad, hip, knee of a front leg) [deg] at the end of the frame.\n"
    )
    text = yaml.dump(data, Dumper=Dumper, sort_keys=False, allow_unicode=True, width=120)
    with written_whole(path) as part:
        part.write_text(head + text, encoding="utf-8")


def read_keyframes(path: Path) -> KeyFrames:
    """Read a motion from YAML; feasibility on the robot is not checked here.

    Raises:
        SourceError: If it is not valid YAML or a field is missing or invalid; the message lists all errors.
    """
    import yaml

    if path.stat().st_size > LARGEST:
        raise SourceError(f"{path.name} has {path.stat().st_size} bytes; a motion in key frames has at most {LARGEST}")
    try:
        text = read_text(path)
        _check_size(text, path.name)
        data = yaml.safe_load(text)
    except (yaml.YAMLError, UnicodeDecodeError, ValueError, RecursionError) as error:
        raise SourceError(f"{path.name} is not valid YAML: {' '.join(str(error).split())}") from None
    frames, errors = frames_from(data)
    if errors:
        raise SourceError(f"{path.name} cannot be played: {one_line(errors)}")
    header = data if isinstance(data, Mapping) else {}
    return KeyFrames(frames=frames, sentence=str(header.get("sentence", "")), planner=str(header.get("planner", "")))


def _check_size(text: str, name: str) -> None:
    """Refuse what a motion never has and what makes YAML expand: aliases, deep nesting, many items."""
    import yaml

    depth = 0
    for count, event in enumerate(yaml.parse(text, Loader=yaml.SafeLoader)):
        if isinstance(event, yaml.AliasEvent):
            raise SourceError(f"{name} has the YAML alias *{event.anchor}; a motion in key frames has none")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST or count > MOST_ITEMS:
            raise SourceError(
                f"{name} is nested more than {DEEPEST} levels deep or has more than {MOST_ITEMS} items; expected a "
                f"list of at most {MOST_FRAMES} key frames"
            )


def one_line(errors: list[str]) -> str:
    """Return errors as one line of text."""
    more = len(errors) - MOST_SHOWN
    return "; ".join(errors[:MOST_SHOWN]) + (f"; and {more} more" if more > 0 else "")
