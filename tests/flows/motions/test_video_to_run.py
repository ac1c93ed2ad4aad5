"""The whole way through the command line, on something small."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mimic import __version__
from mimic.cli import main
from mimic.config.play import RAMP, TRIM, RunSettings
from mimic.config.retarget import RetargetSettings
from mimic.io import store
from mimic.io.assets import shipped
from mimic.metrics import PARTS
from mimic.policy.runtime import load_policy
from mimic.records import PHASES, JointSamples, PoseTrack, RunLog, TargetTrack, WristTrack
from mimic.retargeting.targets import target_track
from mimic.robot.description import load_description
from mimic.robot.reach import Reach

TESTS = Path(__file__).parents[2]
SEEDED, SHORT = (["--config", str(TESTS / name)] for name in ("seeded.toml", "short.toml"))
WAVING = Path(__file__).parents[3] / "examples" / "videos" / "waving.mp4"
FILES = {"targets.parquet", "health.parquet", "log.parquet", "joints.parquet", "metrics.json", "scene.rrd"}


@pytest.fixture(scope="module")
def workplace(tmp_path_factory):
    """A folder of the module's own, with its own cache and without a display."""
    folder = tmp_path_factory.mktemp("flow")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
        patch.delenv("DISPLAY", raising=False)
        patch.delenv("WAYLAND_DISPLAY", raising=False)
        yield folder


@pytest.fixture(scope="module")
def targets(workplace) -> Path:
    """Targets of a person who moves both arms for almost a second."""
    t = np.arange(0.0, 0.95, 1 / 30)
    left = np.stack([0.6 + 0.2 * np.sin(4 * t), 0.1 + 0 * t, 0.3 * np.cos(4 * t)], -1)
    arms = np.stack([left, left * [1, -1, 1]], 1)
    wrists = WristTrack(t=t, p_SH=arms, heading=0 * t, valid=np.ones((len(t), 2), dtype=bool))
    path = workplace / "targets.parquet"
    store.save(
        target_track(wrists, Reach(load_description("cyberdog2")), RetargetSettings()), path, made_by=store.provenance()
    )
    return path


@pytest.fixture(scope="module")
def played(targets, workplace) -> tuple[int, Path]:
    """Exit status and run folder of these targets."""
    command = [str(targets), "--sim", "--no-view", "-o", str(workplace / "run"), *SEEDED]
    return main(command), workplace / "run"


def test_a_run_ends_well_and_leaves_its_files(played):
    status, run = played
    assert status == 0
    assert {path.name for path in run.iterdir()} == FILES
    assert all(path.stat().st_size for path in run.iterdir())


def test_every_file_names_version_settings_and_inputs(played, targets):
    _, run = played
    tasks = {"policy": "stand_track", "sit_down": "sit_down"}
    inputs = {name: store.sha256_of(shipped("policies", f"{task}.onnx")) for name, task in tasks.items()}
    inputs["source"] = store.sha256_of(targets)
    heads = [store.header(run / name)["provenance"] for name in sorted(FILES) if name.endswith(".parquet")]
    heads.append(json.loads((run / "metrics.json").read_text())["provenance"])
    for head in heads:
        assert head["version"] == __version__
        assert head["inputs"] == inputs
        assert head["settings"]["run"] == store.plain(RunSettings(seed=4, hold_last=0.5))
        assert set(head["settings"]) == {"language", "pose", "retarget", "robot", "run", "stored"}


def test_the_log_holds_the_whole_run_at_50_hz_and_its_joints_at_400_hz(played, targets):
    _, run = played
    log, joints = store.load(run / "log.parquet", RunLog), store.load(run / "joints.parquet", JointSamples)
    wanted = store.load(targets, TargetTrack)
    settings = RunSettings(hold_last=0.5)
    besides = RAMP + TRIM + settings.stand_up + settings.blend + settings.hold_last + settings.sit_down
    assert len(log.t) == len(wanted.t) + round(besides / 0.02)
    assert np.allclose(np.diff(log.t), 0.02)
    assert np.allclose(np.diff(joints.t), 0.0025)
    assert len(joints.t) == 8 * len(log.t)
    sits = log.phase == PHASES.index("sit_down")  # a policy that remembers less, whose observation is shorter
    lies = log.phase == PHASES.index("lie")  # no policy runs yet
    assert np.isnan(log.observation[lies]).all()
    assert np.isfinite(log.observation[~sits & ~lies]).all()
    width = load_policy(None, load_description("cyberdog2"), task="sit_down").contract.observation_size
    assert np.isfinite(log.observation[sits][:, :width]).all()


def test_the_toes_that_were_asked_for_are_the_targets(played, targets):
    log = store.load(played[1] / "log.parquet", RunLog)
    rows = log.phase == PHASES.index("track")
    assert np.array_equal(log.p_BE_des[rows], store.load(targets, TargetTrack).p_BE)


def test_the_targets_in_the_run_folder_are_those_that_were_played(played, targets):
    one, other = (store.load(path, TargetTrack) for path in (played[1] / "targets.parquet", targets))
    assert np.array_equal(one.p_BE, other.p_BE)
    assert one.report == other.report


def test_the_robot_ends_lying_on_its_feet(played):
    log = store.load(played[1] / "log.parquet", RunLog)
    rows = log.phase == PHASES.index("sit_down")
    assert rows[-1]
    assert log.p_WB[rows, 2].max() > 0.4
    assert 0.08 < log.p_WB[-1, 2] < 0.14
    assert -log.v_WB[rows, 2].min() < 1.9  # it drops to its knees first


def test_metrics_show_that_the_robot_stood(played):
    metrics = json.loads((played[1] / "metrics.json").read_text())
    assert metrics["falls"] == 0
    assert metrics["standing_share"] > 0.9
    assert metrics["toe_error_cm"]["mean"] > 0
    assert metrics["interrupted"] is False


def test_the_targets_of_a_run_are_played_again_the_same_with_the_same_seed(played, workplace):
    again = workplace / "again"
    assert main([str(played[1] / "targets.parquet"), "--sim", "--no-view", "-o", str(again), *SEEDED]) == 0
    one, other = (store.load(run / "log.parquet", RunLog) for run in (played[1], again))
    assert np.array_equal(one.q, other.q)
    assert np.array_equal(one.action, other.action, equal_nan=True)


def test_a_run_folder_is_not_written_over(played, targets, capsys):
    before = (played[1] / "log.parquet").read_bytes()
    assert main([str(targets), "--sim", "--no-view", "-o", str(played[1])]) == 2
    assert "is not empty" in capsys.readouterr().err
    assert (played[1] / "log.parquet").read_bytes() == before


@pytest.mark.slow
def test_runs_without_a_name_are_numbered(targets, workplace):
    copy = workplace / "arms.parquet"
    copy.write_bytes(targets.read_bytes())
    for _ in range(2):
        assert main([str(copy), "--sim", "--no-view", *SHORT]) == 0
    assert sorted(path.name for path in (workplace / "runs").iterdir()) == ["arms", "arms-2"]


@pytest.mark.slow
def test_a_video_becomes_targets_and_then_a_run_and_its_pose_is_found_once(workplace, short_clip, capsys):
    assert main(["retarget", str(short_clip), "-o", "waving.parquet", "--rate", "0.1"]) == 0
    assert "reused" not in capsys.readouterr().out
    targets = store.load(workplace / "waving.parquet", TargetTrack)
    assert np.ptp(targets.p_BE[..., 0], axis=0).max() > 0.03
    head = store.header(workplace / "waving.parquet")["provenance"]
    assert head["inputs"] == {"source": store.sha256_of(short_clip)}

    status = main([str(short_clip), "--sim", "--no-view", "-o", "waving"])
    assert "reused" in capsys.readouterr().out
    assert status in (0, 3)
    names = {path.name for path in (workplace / "waving").iterdir()}
    assert FILES | {"pose.parquet"} == names
    assert np.array_equal(store.load(workplace / "waving" / "targets.parquet", TargetTrack).p_BE, targets.p_BE)
    pose = store.load(workplace / "waving" / "pose.parquet", PoseTrack)
    assert pose.t[-1] == pytest.approx(targets.t[-1], abs=0.05)


@pytest.mark.slow
def test_the_toes_of_the_shipped_policy_are_where_the_video_is(workplace):
    run = workplace / "in-time"
    assert main([str(WAVING.with_suffix(".npz")), "--sim", "--no-view", "-o", str(run)]) == 0
    metrics = json.loads((run / "metrics.json").read_text())
    assert metrics["lag_s"] <= 0.021
    assert metrics["toe_error_cm"]["mean"] < 0.2


def test_the_table_and_the_file_say_what_was_wanted_and_reached(played, workplace, targets, capsys):
    found = json.loads((played[1] / "metrics.json").read_text())["wanted_to_reached_cm"]
    assert 0.0 < found["apart"] < 10.0
    assert sum(found[part] for part in PARTS) == pytest.approx(found["apart"])
    capsys.readouterr()
    assert main([str(targets), "--sim", "--no-view", "-o", str(workplace / "table"), *SEEDED]) == 0
    assert f"{found['apart']:.1f} cm apart" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--slow-down", "0.5"], "it must be from 1 to 10"),
        (["--slow-down", "2"], "retargeted before"),
        (["--slow-down", "soon"], "soon"),
    ],
)
def test_what_cannot_be_slowed_down_says_so_in_a_line(arguments, words, targets, workplace, capsys):
    assert main([str(targets), "--sim", "--no-view", "-o", str(workplace / "never"), *arguments]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not (workplace / "never").exists()


@pytest.mark.slow
def test_person_and_robot_are_slowed_down_together(workplace):
    run = workplace / "slow"
    source = str(WAVING.with_suffix(".npz"))
    assert main([source, "--sim", "--no-view", "--slow-down", "1.5", "-o", str(run)]) == 0
    pose, targets = store.load(run / "pose.parquet", PoseTrack), store.load(run / "targets.parquet", TargetTrack)
    assert targets.report["slow_down"] == 1.5
    assert pose.t[-1] == pytest.approx(targets.t[-1], abs=0.02)
    assert pose.t[-1] == pytest.approx(1.5 * np.load(source)["t"][-1], abs=0.02)


@pytest.mark.parametrize(
    ("option", "words"),
    [
        (["--slow-down", "2"], "in real time"),
        (["--person", "left"], "of a video file"),
    ],
)
def test_what_a_camera_cannot_do_is_said_in_a_line(workplace, monkeypatch, capsys, option, words):
    monkeypatch.chdir(workplace)
    assert main(["--camera", "0", "--sim", *option]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
