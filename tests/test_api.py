"""The public library: what ``import mimic`` gives, and that it is cheap."""

from __future__ import annotations

import inspect
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import mimic
from mimic.config.play import RunSettings
from mimic.records import CommandTrack

CLIP = Path(__file__).parents[1] / "examples" / "videos" / "waving.npz"
FUNCTIONS = ("calibrate", "evaluate", "load_motion", "load_policy", "load_robot", "play", "retarget", "track_video")


def test_importing_mimic_loads_no_other_library():
    code = "import sys, mimic\nprint([m for m in ('numpy', 'mujoco', 'rich', 'cyclopts', 'rerun') if m in sys.modules])"
    told = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert told.strip() == "[]"


def test_the_library_runs_without_the_libraries_of_the_command_line():
    code = (
        "import sys, mimic\n"
        "for name in mimic.__all__: getattr(mimic, name)\n"
        "import mimic.flows.robot.robot_run, mimic.flows.robot.commissioning, mimic.flows.batch, "
        "mimic.flows.robot.emulate, mimic.flows.motions.camera\n"
        "print([m for m in ('rich', 'cyclopts') if m in sys.modules])"
    )
    told = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert told.strip() == "[]"


@pytest.mark.parametrize("name", sorted(set(mimic.__all__) - {"__version__"}))
def test_every_public_name_exists_and_says_what_it_is(name):
    thing = getattr(mimic, name)
    assert inspect.getdoc(thing)
    if name in FUNCTIONS:
        text = inspect.getdoc(thing) or ""
        assert "Args:" in text
        assert "Raises:" in text
        assert all(p.annotation is not inspect.Parameter.empty for p in inspect.signature(thing).parameters.values())


def test_an_unknown_name_lists_what_there_is():
    with pytest.raises(AttributeError, match="track_video"):
        mimic.nothing_like_this


@pytest.mark.slow
def test_an_own_array_of_toe_positions_is_played_and_saved(tmp_path):
    robot, policy = mimic.load_robot(), mimic.load_policy()
    neutral = np.array(policy.contract.neutral_toes).reshape(1, 2, 3)
    t = robot.dt * np.arange(50)
    sway = 0.04 * np.sin(2 * np.pi * t)[:, None, None] * np.array([0.0, 0.0, 1.0])
    track = CommandTrack(t=t, v=np.zeros((50, 2)), heading=np.zeros(50), p_BE=neutral + sway)
    run = mimic.play(track, policy=policy, settings=RunSettings(hold_last=0.0))
    assert run.result.fell_at is None
    assert run.metrics["standing_share"] > 0.9
    saved = run.save(tmp_path / "run")
    assert {p.name for p in saved.folder.iterdir()} >= {"log.parquet", "commands.parquet", "metrics.json", "scene.rrd"}


def test_a_policy_is_found_by_its_name_from_any_folder(tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("stand_track", "stand_track.onnx", "policies/stand_track.onnx"):
        assert mimic.load_policy(name).contract.task == "stand_track"
    with pytest.raises(mimic.MimicError, match="stand_track, sit_down"):
        mimic.load_policy("elsewhere/stand_track.onnx")


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first three seconds of a clip's truth."""
    path = tmp_path_factory.mktemp("clip") / "waving.npz"
    with np.load(CLIP) as whole:
        np.savez(path, t=whole["t"][:90], names=whole["names"], joints=whole["joints"][:90])
    return path


@pytest.fixture(scope="module")
def waved(clip) -> mimic.Run:
    return mimic.play(clip, settings=mimic.RunSettings(hold_last=0.0))


def test_a_file_is_played_by_its_name(waved):
    assert waved.motion is not None
    assert waved.metrics["toe_error_cm"]["mean"] < 5.0


def test_arrays_of_a_file_are_the_file(clip):
    with np.load(clip) as file:
        arrays = dict(file)
    loaded = mimic.load_motion(clip).commands
    assert np.array_equal(mimic.load_motion(arrays).commands.p_BE, loaded.p_BE)


def test_a_saved_run_is_read_again_with_its_figures(waved, tmp_path):
    waved.save(tmp_path / "run")
    found = mimic.load_run(tmp_path / "run")
    assert found.run.metrics == waved.metrics
    assert found.run.events == waved.events
    assert found.run.motion is not None
    assert np.array_equal(found.run.motion.commands.p_BE, waved.motion.commands.p_BE)


def test_a_saved_run_of_another_robot_is_read_as_its(clip, tmp_path):
    description = mimic.load_robot("go2")
    targets = mimic.load_motion(clip, description=description).targets
    run = mimic.play(targets, robot="go2", settings=mimic.RunSettings(hold_last=0.0))
    run.save(tmp_path / "run")
    assert mimic.load_run(tmp_path / "run").run.description.name == "go2"


def test_a_folder_without_a_run_is_named(tmp_path):
    with pytest.raises(mimic.MimicError, match=r"there is no log\.parquet in"):
        mimic.load_run(tmp_path)


def test_metrics_that_mimic_did_not_write_and_a_long_sentence_are_refused(waved, tmp_path):
    waved.save(tmp_path / "run")
    (tmp_path / "run" / "metrics.json").write_text("{}")
    with pytest.raises(mimic.MimicError, match="has no events, interrupted"):
        mimic.load_run(tmp_path / "run")
    with pytest.raises(mimic.MimicError, match="to play a sentence"):
        mimic.play(20 * "wave the left hand, then ")


def test_one_group_of_settings_or_single_ones_do(clip):
    whole = mimic.InputSettings(retarget=mimic.RetargetSettings(mirror=True))
    one, other, third = (
        mimic.load_motion(clip, whole),
        mimic.load_motion(clip, mimic.RetargetSettings(mirror=True)),
        mimic.load_motion(clip, mirror=True),
    )
    assert np.array_equal(one.commands.p_BE, other.commands.p_BE)
    assert np.array_equal(one.commands.p_BE, third.commands.p_BE)
    assert not np.array_equal(one.commands.p_BE, mimic.load_motion(clip).commands.p_BE)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: mimic.load_motion(CLIP, raet=0.2), "there is no setting 'raet'; settings are .*rate"),
        (lambda: mimic.load_motion(CLIP, rate=5.0), "rate is 5 s; it must be from 0.05 to 1 s"),
        (
            lambda: mimic.load_motion(CLIP, mimic.RunSettings()),
            "settings is a RunSettings; expected InputSettings",
        ),
        (lambda: mimic.load_motion(CLIP, reporter=True), "reporter is True; expected an object with note, warn"),
        (lambda: mimic.load_motion(["a", "b"]), "load_motion: source is a list; expected str or Path or Mapping or nd"),
        (lambda: mimic.load_motion(np.zeros((50, 2, 3))), r"toes is played as CommandTrack\(t=t"),
        (lambda: mimic.load_motion({"t": np.arange(9)}), r"holds t; expected an array 'points' \(T, N, 3\)"),
        (
            lambda: mimic.retarget(np.zeros((50, 2, 3))),
            "track is a ndarray; expected PoseTrack or WristTrack",
        ),
        (lambda: mimic.play(5), "given is a int; expected a file, arrays as in an .npz, a Motion"),
        (lambda: mimic.play("wave the left hand"), r"to play a sentence: play\(motion_from_text"),
        (
            lambda: mimic.play(CLIP, settings=mimic.RetargetSettings()),
            "settings is a RetargetSettings; expected RunSett",
        ),
        (lambda: mimic.play(None), "given is a NoneType; expected a file"),
        (lambda: mimic.play(CLIP, policy=5), "play: policy is a int; expected Policy or str or Path or None"),
        (lambda: mimic.load_motion(None), "load_motion: source is a NoneType; expected str"),
        (lambda: mimic.load_motion(CLIP, description="go2"), "description is a str; expected RobotDescription or None"),
        (lambda: mimic.motion_from_text(None), "motion_from_text: sentence is a NoneType; expected str"),
        (lambda: mimic.track_video(None), "track_video: video is a NoneType"),
        (lambda: mimic.load_robot(None), "load_robot: name is a NoneType"),
        (lambda: mimic.load_policy(5), "load_policy: policy is a int"),
        (lambda: mimic.load_run(None), "load_run: folder is a NoneType"),
        (lambda: mimic.read_log(None), "read_log: path is a NoneType"),
        (lambda: mimic.read_effects(5), "read_effects: path is a int"),
        (lambda: mimic.calibrate([1]), "log is a list; expected .* or a sequence of str or Path or JointLog"),
        (lambda: mimic.calibrate("a.csv", 5), "model is a int; expected str or Path or MachineModel or None"),
        (lambda: mimic.predict_log("a.csv", whole=1), "whole is a int; expected bool"),
        (lambda: mimic.evaluate(settings=mimic.RunSettings()), "evaluate: settings is a RunSettings"),
        (lambda: mimic.Policy(None, mimic.load_robot()), "Policy: path is a NoneType; expected Path"),
        (lambda: mimic.RunSettings(policy=5), "policy is 5; expected text"),
        (lambda: mimic.RunSettings(hold_position=None), "hold-position is None; expected True or False"),
    ],
)
def test_what_does_not_fit_says_how(call, said):
    with pytest.raises(mimic.MimicError, match=said):
        call()


def test_an_argument_that_is_not_there_is_said_as_python_says_it():
    with pytest.raises(TypeError, match=r"play\(\) got an unexpected keyword argument 'rob'"):
        mimic.play(CLIP, rob="go2")


def test_a_motion_and_a_run_show_at_most_ten_short_lines(waved):
    for thing in (waved, waved.motion, waved.motion.targets, waved.log, waved.health):
        lines = repr(thing).splitlines()
        assert 2 <= len(lines) <= 10
        assert max(map(len, lines)) <= 100
    assert "toe error" in repr(waved)
    assert "RunLog" in repr(waved.log)
    assert f"{len(waved.log.t)} rows" in repr(waved.log)
