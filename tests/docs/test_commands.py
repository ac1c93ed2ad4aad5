"""What the documentation shows can be typed: commands parse, and those that take seconds run; so do the snippets."""

from __future__ import annotations

import dataclasses
import importlib.util
import re
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cyclopts import App

from mimic.cli import main
from mimic.cli.app import DEFAULTS, app
from mimic.cli.play import play

ROOT = Path(__file__).parents[2]


def _documented() -> Any:
    spec = importlib.util.spec_from_file_location("documented", Path(__file__).with_name("documented.py"))
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    import sys

    sys.modules["documented"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


documented = _documented()
COMMANDS, SNIPPETS = documented.commands(), documented.snippets()
RUN = [c for c in COMMANDS if documented.reason_not_to_run(c.text, documented.NOT_RUN) is None]
RUN_SNIPPETS = [s for s in SNIPPETS if documented.reason_not_to_run(s.text, documented.NOT_RUN_SNIPPETS) is None]


def parse(words: list[str]) -> Any:
    """Return what a command would be called with; nothing is run."""
    if not app.default_command:
        app.default(play)
    _, bound, *_ = app.parse_args(words, exit_on_error=False, print_error=False)
    return bound


# ---------------------------------------------------------------------- parsed


def test_every_documented_command_of_mimic_parses() -> None:
    shown = [c for c in COMMANDS if c.text.startswith("mimic ") and not re.search(r"…", c.text)]
    assert len(shown) > 30, "too few commands were found; is the search for them right?"
    failures = []
    for command in shown:
        text = re.sub(r"( --config \S+)|( > .*)", "", command.text)  # no file of settings is here
        words = shlex.split(text.replace("[", "").replace("]", "").replace(" N ", " 2 "))[1:]
        try:
            parse(words)
        except Exception as error:
            failures.append(f"{command}: {str(error).strip()}")
    assert failures == []


def test_each_reason_not_to_run_is_needed() -> None:
    patterns = [*documented.NOT_RUN, *documented.NOT_RUN_SNIPPETS]
    shown = [*COMMANDS, *SNIPPETS]
    assert [p for p in patterns if not any(re.search(p, s.text, re.M) for s in shown)] == []


def _leaves(group: App, words: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], App]]:
    """Yield every command that does something, with the words that call it."""
    for name in group:
        if not name.startswith("-"):
            command = group[name]
            yield (*words, name), command
            yield from _leaves(command, (*words, name))


def _list_options() -> list[tuple[tuple[str, ...], str, int]]:
    """Return command, option and number of values (-1 for any) of each option that takes several."""
    if not app.default_command:
        app.default(play)
    found = []
    for words, command in [((), app), *_leaves(app)]:
        if command.default_command is None:
            continue
        for argument in command.assemble_argument_collection(default_parameter=DEFAULTS).filter_by(parse=True):
            count, takes_all = argument.token_count()
            names = [name for name in argument.names if name.startswith("--")]
            if names and (takes_all or count > 1):
                found.append((words, names[0], -1 if takes_all else count))
    return found


VALUES = {
    "--names": ("left_wrist=LWRA", "right_wrist=RWRA"),
    "--baseline": ("coulomb", "viscous"),
    "--effects": ("stribeck", "backlash"),
    "--camera-size": ("640", "480"),
    "--hidden": ("512", "256"),
    "--set": ("rewards.slip=-0.4", "seed=2"),
    "--fault": ("motor_dead:FL_knee@2", "motor_dead:FR_knee@3"),
}
"""Two values for each of these options; others take numbers or file names."""
REQUIRED = {
    "retarget": ["a.npz", "-o", "t.parquet"],
    "batch": ["folder", "-o", "out"],
    "view": ["runs/a"],
    "train": ["out"],
    "calibrate": ["log.parquet"],
    "simulate": ["-o", "log.parquet"],
    "replay": ["log.parquet"],
    "salvage": ["runs/a"],
    "scan": ["can0"],
    "zero": ["can0"],
    "check": ["can0"],
    "watch": ["cyberdog2"],
    "probe": ["can0", "-o", "log.parquet"],
}
"""What a command cannot be called without."""


def _plain(value: Any) -> Iterator[Any]:
    """Yield every list, tuple and set inside a value."""
    if dataclasses.is_dataclass(value):
        value = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    if isinstance(value, dict):
        for part in value.values():
            yield from _plain(part)
    elif isinstance(value, (list, tuple, set, frozenset)):
        yield [str(part) for part in value]


@pytest.mark.parametrize(("words", "option", "count"), _list_options(), ids=lambda value: str(value))
def test_an_option_takes_several_values_at_once_and_one_at_a_time(words, option, count) -> None:
    values = VALUES.get(option, ("1.0", "2.0", "3.0")[: count if count > 0 else 2])
    required = REQUIRED.get(words[-1] if words else "", [])
    at_once = [*words, *required, option, *values]
    assert list(values) in list(_plain(dict(parse(at_once).arguments)))
    if count < 0:
        one_at_a_time = [*words, *required, *(word for value in values for word in (option, value))]
        assert list(values) in list(_plain(dict(parse(one_at_a_time).arguments)))


def test_options_that_take_several_values_are_found() -> None:
    assert {"--names", "--baseline", "--effects"} <= {option for _, option, _ in _list_options()}


# ---------------------------------------------------------------------- run


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory, short_clip: Path) -> Path:
    """A folder with each file that the documented commands name; every video is short."""
    import mimic
    from mimic.config.sysid import LogMotion, LogSettings
    from mimic.io import store
    from mimic.records import LANDMARKS

    folder = tmp_path_factory.mktemp("prepared")
    (folder / "policies").symlink_to(ROOT / "policies")
    (folder / "examples" / "videos").mkdir(parents=True)
    for file in [*(ROOT / "examples").iterdir(), *(ROOT / "examples" / "videos").iterdir()]:
        if file.name != "videos":
            here = folder / file.relative_to(ROOT)
            here.symlink_to(short_clip if file.suffix == ".mp4" else file)
    for name in ("video.mp4", "clip.mp4"):
        shutil.copy(short_clip, folder / name)
    (folder / "folder").mkdir()
    shutil.copy(folder / "video.mp4", folder / "folder")
    pose = mimic.track_video(folder / "video.mp4", cache=False)
    made_by = store.provenance(command="tests")
    store.save(pose, folder / "track.parquet", made_by=made_by)
    store.save(mimic.retarget(pose), folder / "targets.parquet", made_by=made_by)
    points = np.nan_to_num(pose.landmarks)
    np.savez(folder / "motion.npz", points=points, fps=30, names=LANDMARKS)
    _write_trc(folder / "motion.trc", LANDMARKS, points)
    _write_bvh(folder / "motion.bvh")
    (folder / "runs" / "NAME").mkdir(parents=True)
    shutil.copy(ROOT / "examples" / "motions" / "step_and_wave.yaml", folder / "runs" / "NAME" / "motion.yaml")
    coarse = LogSettings(timestep=0.0025)
    mimic.simulate_log(motion=LogMotion(seconds=10.0), settings=coarse, out=folder / "second.parquet")
    shutil.copy(ROOT / "examples" / "hidden.toml", folder / "effects.toml")
    (folder / "calibration").mkdir()
    shutil.copy(ROOT / "examples" / "hidden.toml", folder / "calibration" / "effects.toml")
    return folder


def _write_trc(path: Path, names: tuple[str, ...], points: np.ndarray) -> None:
    head = "\t".join(["Frame#", "Time", *(f"{name}\t\t" for name in names)])
    axes = "\t\t" + "\t".join(f"{a}{i}" for i in range(1, len(names) + 1) for a in "XYZ")
    up = points * [1.0, -1.0, -1.0] * 1000.0  # camera axes, y down, to y up [mm]
    rows = ["\t".join([str(i + 1), f"{i / 30:.5f}", *(f"{v:.3f}" for v in row.ravel())]) for i, row in enumerate(up)]
    facts = "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames"
    values = f"30\t30\t{len(up)}\t{len(names)}\tmm\t30\t1\t{len(up)}"
    path.write_text("\n".join([f"PathFileType\t4\t(X/Y/Z)\t{path.name}", facts, values, head, axes, "", *rows]))


def _write_bvh(path: Path) -> None:
    """Write a person whose arms swing."""
    chains = [
        [("LeftArm", "14 50 0"), ("LeftForeArm", "28 0 0"), ("LeftHand", "25 0 0")],
        [("RightArm", "-14 50 0"), ("RightForeArm", "-28 0 0"), ("RightHand", "-25 0 0")],
        [("LeftUpLeg", "9 -4 0"), ("LeftLeg", "0 -40 0"), ("LeftFoot", "0 -40 0")],
        [("RightUpLeg", "-9 -4 0"), ("RightLeg", "0 -40 0"), ("RightFoot", "0 -40 0")],
    ]
    lines = ["HIERARCHY", "ROOT Hips", "{", "OFFSET 0 0 0"]
    lines += ["CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"]
    for chain in chains:
        for name, offset in chain:
            lines += [f"JOINT {name}", "{", f"OFFSET {offset}", "CHANNELS 3 Zrotation Xrotation Yrotation"]
        lines += ["End Site", "{", "OFFSET 0 1 0", "}", *["}"] * len(chain)]
    rows = []
    for i in range(45):
        swing = 40 * np.sin(i / 5)
        angles = np.zeros((12, 3))
        angles[[0, 3], 0] = swing, -swing
        rows.append(" ".join(f"{v:.4f}" for v in (0, 90, 0, 0, 0, 0, *angles.ravel())))
    path.write_text("\n".join([*lines, "}", "MOTION", "Frames: 45", "Frame Time: 0.0333333", *rows]) + "\n")


@pytest.mark.slow
@pytest.mark.parametrize("command", RUN, ids=str)
def test_a_documented_command_runs(command, prepared, tmp_path, monkeypatch) -> None:
    for file in prepared.iterdir():
        (tmp_path / file.name).symlink_to(file) if file.name != "runs" else shutil.copytree(file, tmp_path / "runs")
    for made in re.findall(r"(?:-o|--video) (\S+)", command.text):
        (tmp_path / made).unlink(missing_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.delenv("DISPLAY", raising=False)
    program, *words = shlex.split(command.text)
    assert program == "mimic", f"give a reason in documented.py why {command} cannot be run, or run it here"
    assert main(words) == 0


SURROUNDINGS = {
    "\\btargets\\b": 'import mimic\ntargets = mimic.load_motion("targets.parquet").targets\n',
    "JointLog\\(": "import numpy as np\nt = np.arange(100) / 200\nq = q_des = np.sin(t)[:, None] * [1, 2]\n",
    "stack\\(keypoints\\)": "import numpy as np\nkeypoints, scores = np.ones((9, 133, 3)), np.ones((9, 133))\n",
}
"""Pattern of a snippet -> the lines that it leaves to the reader."""


@pytest.mark.slow
@pytest.mark.parametrize("snippet", RUN_SNIPPETS, ids=str)
def test_a_documented_snippet_runs(snippet, prepared, tmp_path, monkeypatch) -> None:
    for file in prepared.iterdir():
        (tmp_path / file.name).symlink_to(file)
    monkeypatch.chdir(tmp_path)
    before = "".join(lines for pattern, lines in SURROUNDINGS.items() if re.search(pattern, snippet.text))
    for name in re.findall(r'(?:savez|write_log)\D*"([\w.]+)"', snippet.text):
        (tmp_path / name).unlink(missing_ok=True)
    exec(compile(before + snippet.text, snippet.page, "exec"), {})
