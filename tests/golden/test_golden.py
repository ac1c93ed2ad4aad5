"""Today's behaviour, held: what a restructuring must leave as it is.

    python tests/golden/test_golden.py [PART ...]    # writes the files beside this one, after a change on purpose

Names and options are held as plain text, one a line, to be edited by hand. Numbers are sampled and rounded. The 200
sentences are held by tests/sources/text/test_sentences.py, the first 50 steps of a policy by its own ONNX file.
"""

from __future__ import annotations

import io
import json
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from cyclopts import App

import mimic
from mimic.cli import HELP
from mimic.config.sysid import CalibrateSettings, LogMotion, LogSettings

HERE = Path(__file__).parent
VIDEOS = HERE.parents[1] / "examples" / "videos"
CLIPS = ("ballet", "boxing", "waving")
SENTENCES = (
    "wave the left hand three times",
    "step forward, then raise both hands",
    "turn right 90 degrees slowly",
    "punch twice with the right, then once with the left",
)
ROWS = 6
"""Rows of each array that are held."""

BEFORE_CHAOS = 4.0
"""Time of a run that is held [s]. A foot that lands later or earlier by a rounding of another processor lets two runs
part: 1e-6 in the actions makes 1e-3 rad after 2.5 s on the policy, which begins at 2.6 s."""

LEFT_OUT = ("observation", "t_host")
"""Arrays that are large, or differ from run to run."""

SEARCH = CalibrateSettings(baseline=("coulomb", "viscous"), effects=("spring",), most_effects=1, threads=1)
PENDULUM = """<mujoco model="pendulum"><worldbody><body name="rod">
<joint name="pivot" type="hinge" axis="0 1 0" range="-90 90" armature="0.01"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/></body></worldbody><actuator>
<position name="pivot" joint="pivot" kp="20" kv="0.5" forcerange="-10 10"/></actuator></mujoco>"""
HIDDEN = {
    "coulomb": {"level": 0.4},
    "viscous": {"coefficient": 0.2},
    "spring": {"stiffness": 2.0, "moment": 0.1},
}
"""Effects hidden in a pendulum, in the units of the catalogue. The last is searched for; the others are in the
baseline."""


def public_names() -> list[str]:
    """Return the public names of the library."""
    return sorted(mimic.__all__)


def options() -> list[str]:
    """Return each command with the names of its options, a line each; the bare command is called `mimic`."""
    from mimic.cli.app import DEFAULTS, app
    from mimic.cli.play import play

    if not app.default_command:
        app.default(play)

    def commands(group: App, words: tuple[str, ...]) -> Iterator[tuple[str, App]]:
        yield " ".join(words), group
        for name in group:
            if not name.startswith("-"):
                yield from commands(group[name], (*words, name))

    lines = []
    for words, command in commands(app, ("mimic",)):
        if command.default_command is not None:
            found = command.assemble_argument_collection(default_parameter=DEFAULTS)
            names = (
                next((n for n in argument.names if n.startswith("--")), argument.name)
                for argument in found
                if argument.parse
            )
            lines += [words, *(f"    {name}" for name in names if name != "*")]
    return lines


def drawn_help() -> list[str]:
    """Return the help of the bare command as its parser draws it in 80 columns."""
    from rich.console import Console

    from mimic.cli.app import app
    from mimic.cli.play import play

    if not app.default_command:
        app.default(play)
    screen = io.StringIO()
    app.help_print([], console=Console(file=screen, width=80, color_system=None))
    return [line.rstrip() for line in screen.getvalue().splitlines()]


def policy_actions() -> dict[str, Any]:
    """Return what the shipped policies answer to made-up observations."""
    rng = np.random.default_rng(0)
    answers = {}
    for name in ("stand_track", "sit_down"):
        policy = mimic.load_policy(name)
        seen = rng.normal(0.0, 0.3, (ROWS, policy.contract.observation_size))
        answers[name] = [policy.act(row).round(5).tolist() for row in seen]
    return answers


def sentences() -> dict[str, Any]:
    """Return the commands that sentences become."""
    return {sentence: sampled(mimic.motion_from_text(sentence).commands) for sentence in SENTENCES}


def motions() -> dict[str, Any]:
    """Return commands and targets of the stored motion behind each clip, and a run; needs no pose model."""
    made = {}
    for clip in CLIPS:
        motion = mimic.load_motion(VIDEOS / f"{clip}.npz")
        made[clip] = {"commands": sampled(motion.commands), "targets": sampled(motion.targets)}
        if clip == "waving":
            made[clip]["run"] = sampled(mimic.play(motion).log, BEFORE_CHAOS)
    return made


def videos() -> dict[str, Any]:
    """Return the toe targets of two seconds of a clip as the pose model sees them."""
    with tempfile.TemporaryDirectory() as folder:
        short = Path(folder) / "waving.mp4"
        with av.open(str(VIDEOS / "waving.mp4")) as whole, av.open(str(short), "w") as part:
            video = whole.streams.video[0]
            copy = part.add_stream_from_template(video)
            for packet in whole.demux(video):
                if packet.dts is not None and packet.dts * video.time_base < 2.0:
                    packet.stream = copy
                    part.mux(packet)
        return {"waving": sampled(mimic.retarget(mimic.track_video(short, cache=False)))}


def calibrations() -> dict[str, Any]:
    """Return what is found in a log of a pendulum with hidden effects."""
    with tempfile.TemporaryDirectory() as folder:
        model, file = Path(folder) / "pendulum.xml", Path(folder) / "hidden.toml"
        model.write_text(PENDULUM, encoding="utf-8")
        for name, values in HIDDEN.items():
            numbers = "\n".join(f"{key} = {value}" for key, value in values.items())
            with file.open("a", encoding="utf-8") as effects:
                effects.write(f'[[effect]]\nname = "{name}"\njoints = ["pivot"]\n{numbers}\n')
        log = mimic.simulate_log(file, model, LogMotion(seconds=10.0), LogSettings(timestep=0.001))
        found = mimic.calibrate(log, model, SEARCH)
    return {e.name: {k: float(v[0]) for k, v in e.values.items()} for e in found.effects}


def sampled(record: Any, seconds: float = float("inf")) -> dict[str, Any]:
    """Return length, a few rows and the mean of each array of a record up to a time [s]; times are held, too."""
    names = [f.name for f in fields(record) if "axes" in f.metadata and f.name not in LEFT_OUT]
    end = np.searchsorted(record.t, seconds)
    rows = np.linspace(0, end - 1, ROWS).round().astype(int)
    held: dict[str, Any] = {"length": len(record.t)}
    for name in names:
        numbers = np.asarray(getattr(record, name), dtype=float)[:end]
        if np.isfinite(numbers).any():
            mean = np.nanmean(np.abs(numbers))
            held[name] = [np.round(numbers[rows], 5).reshape(-1).tolist(), round(float(mean), 6)]
    return held


def differences(now: Any, held: Any, absolute: float, relative: float = 0.0, where: str = "") -> list[str]:
    """Return where two nested values differ by more than allowed, a line each."""
    if isinstance(held, dict) and isinstance(now, dict) and held.keys() == now.keys():
        return [d for key in held for d in differences(now[key], held[key], absolute, relative, f"{where}/{key}")]
    if isinstance(held, list) and isinstance(now, list) and len(held) == len(now):
        pairs = enumerate(zip(now, held, strict=True))
        return [d for i, (a, b) in pairs for d in differences(a, b, absolute, relative, f"{where}[{i}]")]
    if isinstance(held, (int, float)) and isinstance(now, (int, float)):
        same = (now != now and held != held) or abs(now - held) <= absolute + relative * abs(held)
        return [] if same else [f"{where}: {now}, held is {held}"]
    return [] if now == held else [f"{where}: {str(now)[:80]}, held is {str(held)[:80]}"]


TEXTS: dict[str, Callable[[], list[str]]] = {"public_names": public_names, "options": options, "help": drawn_help}
FILES = {"help": HELP}
"""Where a text is held that is not beside this file."""
NUMBERS: dict[str, tuple[Callable[[], dict[str, Any]], float, float]] = {
    "policy_actions": (policy_actions, 1e-4, 0.0),
    "sentences": (sentences, 1e-5, 0.0),
    "motions": (motions, 2e-3, 2e-3),
    "videos": (videos, 2e-3, 0.0),
    "calibrations": (calibrations, 2e-3, 0.02),
}
"""What is held, and the absolute and the relative difference that another processor may make."""


@pytest.mark.parametrize("part", list(TEXTS))
def test_names_are_those_that_are_held(part: str) -> None:
    held = FILES.get(part, HERE / f"{part}.txt")
    assert TEXTS[part]() == held.read_text(encoding="utf-8").splitlines()


@pytest.mark.parametrize(
    "part", [pytest.param(p, marks=[] if p in ("policy_actions", "sentences") else pytest.mark.slow) for p in NUMBERS]
)
def test_numbers_are_those_that_are_held(part: str) -> None:
    make, absolute, relative = NUMBERS[part]
    held = json.loads((HERE / f"{part}.json").read_text(encoding="utf-8"))
    assert differences(make(), held, absolute, relative) == []


def write(part: str) -> None:
    """Write the file of a part anew."""
    if part in TEXTS:
        FILES.get(part, HERE / f"{part}.txt").write_text("\n".join(TEXTS[part]()) + "\n", encoding="utf-8")
    else:
        lines = (f"{json.dumps(k)}: {json.dumps(v, separators=(',', ':'))}" for k, v in NUMBERS[part][0]().items())
        (HERE / f"{part}.json").write_text("{" + ",\n".join(lines) + "}\n", encoding="utf-8")


if __name__ == "__main__":
    for part in sys.argv[1:] or [*TEXTS, *NUMBERS]:
        write(part)
