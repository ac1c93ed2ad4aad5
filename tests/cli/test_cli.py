from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mimic import __version__
from mimic.cli import main
from mimic.io import store
from mimic.records import PHASES, CommandTrack, JointSamples, RunLog, TargetTrack, WristTrack
from mimic.robot.description import load_description
from mimic.robot.reach import Reach

SHORT = ("--config", str(Path(__file__).parents[1] / "short.toml"))
HEAVY = ("numpy", "scipy", "mujoco", "cv2", "mediapipe", "torch", "pinocchio", "onnxruntime", "rerun", "pyarrow", "av")
HEAVY += ("openai", "ray", "yaml")


STANDING = {
    "left_shoulder": (0.0, 0.2, 1.4),
    "right_shoulder": (0.0, -0.2, 1.4),
    "left_wrist": (0.3, 0.2, 1.2),
    "right_wrist": (0.3, -0.2, 1.2),
    "left_hip": (0.0, 0.1, 0.9),
    "right_hip": (0.0, -0.1, 0.9),
}
"""Someone who faces +x, z up [m]."""


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    """An empty folder to work in, with a cache of its own."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    return folder


@pytest.fixture
def targets(here: Path, contract) -> Path:
    """A file of targets that stand still."""
    return write_targets(here / "targets.parquet", contract, 25)


def write_targets(path: Path, contract, rows: int, dt: float = 0.02) -> Path:
    toes = np.tile(np.array(contract.neutral_toes).reshape(2, 3), (rows, 1, 1))
    yes, no = np.ones((rows, 2), dtype=bool), np.zeros((rows, 2), dtype=bool)
    track = TargetTrack(
        t=dt * np.arange(rows),
        p_BE=toes,
        heading=np.zeros(rows),
        valid=yes,
        moved=np.zeros((rows, 2)),
        limited=no,
        wanted=toes,
    )
    store.save(track, path, made_by=store.provenance())
    return path


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# ---------------------------------------------------------------------- what needs no work


def in_a_process(code: str) -> list[str]:
    """Runs code in a new interpreter and returns the lines that it printed."""
    command = [sys.executable, "-c", code]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()


def test_no_heavy_library_is_loaded_to_answer():
    code = (
        "import sys\nfrom mimic.cli import main\n"
        "for line in ('--help', '--version', 'train --help', 'nowhere.mp4'): main(line.split())\n"
        f"print([m for m in {HEAVY} if m in sys.modules])"
    )
    assert in_a_process(code)[-1] == "[]"


def test_help_lists_the_commands_and_the_options(capsys):
    assert main(["--help"]) == 0
    shown = capsys.readouterr().out
    for word in (
        "evaluate",
        "retarget",
        "train",
        "view",
        "calibrate",
        "log",
        "--sim",
        "--rate",
        "--mirror",
        "--video",
        "--config",
    ):
        assert word in shown, word


@pytest.mark.parametrize("command", ["batch", "retarget", "evaluate", "train", "view", "calibrate", "log"])
def test_each_command_has_its_help(command, capsys):
    assert main([command, "--help"]) == 0
    assert command in capsys.readouterr().out


def test_version_is_that_of_the_package(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.strip() == __version__


def test_what_a_terminal_cannot_show_becomes_a_question_mark():
    command = [sys.executable, "-m", "mimic", "caf\u00e9 \u5317.mp4", "--sim"]
    shown = subprocess.run(command, capture_output=True, env=os.environ | {"PYTHONIOENCODING": "ascii"}, check=False)
    assert shown.returncode == 2
    assert b"caf? ?.mp4" in shown.stderr
    assert b"Error" not in shown.stderr


def test_a_process_ends_with_the_exit_status():
    ended = subprocess.run([sys.executable, "-m", "mimic", "nowhere.mp4", "--sim"], capture_output=True, text=True)
    assert ended.returncode == 2
    assert ended.stderr == "mimic: there is no file nowhere.mp4\n"


# ---------------------------------------------------------------------- user errors


def text_file(name: str, text: str = "this is not what you think\n") -> Callable[[Path], None]:
    return lambda here: (here / name).write_text(text) and None


def nothing(here: Path) -> None:
    """Leave the folder as it is."""


def full_folder(here: Path) -> None:
    (here / "full").mkdir()
    (here / "full" / "thing").write_text("keep me")


def wrists(here: Path) -> None:
    track = WristTrack(t=np.zeros(1), p_SH=np.zeros((1, 2, 3)), heading=np.zeros(1), valid=np.ones((1, 2), dtype=bool))
    store.save(track, here / "wrists.parquet", made_by=store.provenance())


def joints(here: Path) -> None:
    none = np.zeros((0, 12))
    samples = JointSamples(t=np.zeros(0), q=none, dq=none, tau=none, q_des=none)
    store.save(samples, here / "joints.parquet", made_by=store.provenance())


def commands(here: Path, rows: int = 25, speed: float = 0.2) -> None:
    neutral = Reach(load_description("cyberdog2")).toes(load_description("cyberdog2").poses["upright"])
    track = CommandTrack(
        t=0.02 * np.arange(rows),
        v=np.tile([speed, 0.0], (rows, 1)),
        heading=np.zeros(rows),
        p_BE=np.tile(neutral, (rows, 1, 1)),
    )
    store.save(track, here / "commands.parquet", made_by=store.provenance())


def fast_motion(here: Path) -> None:
    row = "{duration: 1, velocity: [2, 0], heading_deg: 0, left_deg: [0, 45, -70], right_deg: [0, 45, -70]}"
    (here / "fast.yaml").write_text(f"frames:\n- {row}\n")


def elbows(here: Path) -> None:
    (here / "elbow.toml").write_text('[[effect]]\nname = "stribeck"\njoints = ["FL_elbow"]\nlevel = 0.4\nspeed = 0.1\n')
    (here / "text.mp4").write_text("this is text\n")


def folder(here: Path) -> None:
    (here / "folder").mkdir()


def folders_of_files(here: Path) -> None:
    for name in ("folder.mp4", "folder.parquet", "folder.csv"):
        (here / name).mkdir()


BAD = [
    ("nowhere.mp4 --sim", nothing, "there is no file nowhere.mp4"),
    ("nowhere.parquet --sim", nothing, "there is no file nowhere.parquet"),
    ("targets.parquet", nothing, "add --sim"),
    ("targets.parquet --sim --rate 5", nothing, "rate is 5 s; it must be from 0.05 to 1 s"),
    ("targets.parquet --sim --rate quick", nothing, "quick"),
    ("targets.parquet --sim --blend 1", nothing, "put [play] and below it blend = ... into a file"),
    ("targets.parquet --sim --moonwalk", nothing, "--moonwalk"),
    ("targets.parquet --sim --policy nowhere.onnx", nothing, "there is no policy nowhere.onnx"),
    ("targets.parquet --sim --policy text.onnx", text_file("text.onnx"), "text.onnx is not an ONNX model"),
    ("targets.parquet --sim --video film.avi", nothing, "ends with .mp4"),
    ("targets.parquet --sim -o full", full_folder, "full exists and is not empty"),
    ("targets.parquet --sim -o text.txt", text_file("text.txt"), "text.txt exists"),
    ("text.parquet --sim", text_file("text.parquet"), "text.parquet is not a record of mimic"),
    ("wrists.parquet --sim", wrists, "the source is 0.00 s, shorter than one step"),
    ("joints.parquet --sim", joints, "holds a JointSamples, which cannot be played"),
    ("text.npz --sim", text_file("text.npz"), "text.npz cannot be read as NPZ"),
    ("text.trc --sim", text_file("text.trc"), "text.trc, line 1: not a TRC file"),
    ("text.bvh --sim", text_file("text.bvh"), "text.bvh, line 1"),
    ("text.c3d --sim", text_file("text.c3d"), "text.c3d is not a C3D file"),
    ("text.pkl --sim", text_file("text.pkl"), "text.pkl cannot be read as a pickle of arrays"),
    ("text.pt --sim", text_file("text.pt"), "text.pt cannot be read as a pickle of arrays"),
    ("text.FBX --sim", text_file("text.FBX"), "export its motion as BVH"),
    ("text.mvnx --sim", text_file("text.mvnx"), "is not read; export its motion as BVH or C3D"),
    ("retarget text.BVH -o a.parquet --up north", text_file("text.BVH"), "north"),
    ("retarget commands.parquet -o a.parquet", commands, "commands.parquet holds commands"),
    ("folder --sim", folder, "folder is a folder; expected a file"),
    ("folder.parquet --sim", lambda here: (here / "folder.parquet").mkdir(), "folder.parquet"),
    ("text.mp4 --sim", text_file("text.mp4"), "text.mp4"),
    ("retarget nowhere.mp4 -o a.parquet", nothing, "there is no file nowhere.mp4"),
    ("retarget text.mp4 -o a.parquet", text_file("text.mp4"), "text.mp4"),
    ("retarget nowhere.mp4", nothing, "--out"),
    ("evaluate nowhere.onnx", nothing, "there is no policy nowhere.onnx"),
    ("evaluate text.onnx", text_file("text.onnx"), "not an ONNX model"),
    ("evaluate text.onnx --episodes 0", text_file("text.onnx"), "episodes is 0"),
    ("evaluate text.onnx --seconds 0.5", text_file("text.onnx"), "seconds is 0.5"),
    ("targets.parquet --sim --effects nowhere.toml", nothing, "nowhere.toml cannot be read"),
    ("targets.parquet --sim --effects text.toml", text_file("text.toml"), "text.toml is not"),
    ("text.mp4 --sim --effects elbow.toml", elbows, "effect 'stribeck' names joint 'FL_elbow'"),
    ("evaluate --effects nowhere.toml", nothing, "nowhere.toml cannot be read"),
    ("--sim", nothing, "say what to play: a file, --text with a sentence, or --camera 0"),
    ("targets.parquet --text wave --sim", nothing, "are different inputs; give one of them"),
    ("--text wave", nothing, "add --sim"),
    ("--camera 0 --text wave --sim", nothing, "are different inputs; give one of them"),
    ("--text wave --sim --hold 0.5", nothing, "--hold: for a real robot only"),
    ("--text wave --sim --tether --dry-run", nothing, "--dry-run and --tether: for a real robot only"),
    ("--text wave --robot can0 --effects e.toml", nothing, "--effects: for the simulated robot only"),
    ("--camera nowhere.mp4 --sim", nothing, "there is no camera and no file 'nowhere.mp4'"),
    ("--camera text.mp4 --sim", text_file("text.mp4"), "no picture can be read from text.mp4"),
    ("--camera 0 targets.parquet --robot can0", nothing, "are different inputs; give one of them"),
    ("--camera 0 --sim --video film.mp4", nothing, "leave it out with --camera"),
    ("--camera 0 --sim --also side.mp4", nothing, "--also gives the second of two videos; a camera"),
    ("targets.parquet --sim --also side.mp4", nothing, "targets.parquet is no video"),
    ("--text moonwalk --sim", nothing, "has no word 'moonwalk'; its verbs are step"),
    ("--text wave --sim --config a.toml", text_file("a.toml", '[text]\nplanner = "llm"'), "llm_model"),
    ("--text wave --sim --config a.toml", text_file("a.toml", '[text]\nplanner = "poet"'), "planner is 'poet'"),
    ("text.yaml --sim", text_file("text.yaml"), "expected a list of frames"),
    ("fast.yaml --sim", fast_motion, "fast.yaml asks for what this robot cannot do: frame 1: velocity forward is 2"),
    ("view nowhere", nothing, "nowhere"),
    ("view folder", folder, "there is no scene.rrd in folder"),
    ("targets.parquet --sim --video folder.mp4", folders_of_files, "folder.mp4 is a folder; name a file in it"),
    ("retarget targets.parquet -o folder.parquet", folders_of_files, "folder.parquet is a folder"),
    ("log simulate -o folder.csv", folders_of_files, "folder.csv is a folder"),
    ("evaluate -o folder", folder, "folder is a folder"),
    ("evaluate --seed -1", nothing, "seed is -1"),
    ("emulate --seed -1", nothing, "seed is -1"),
    ("demo --seed -1", nothing, "seed is -1"),
    (f"wave{300 * 'e'}", nothing, "a sentence follows --text"),
    (f"wave{300 * 'e'}.mp4 --sim", nothing, "there is no file wave"),
    ("dance", nothing, "there is no command and no file 'dance'; commands are demo, retarget"),
]

BAD_TRAINING = [
    ("train new --set worlds=0", "worlds is 0"),
    ("train new --set colour=red", "there is no setting 'colour'"),
    ("train new --set rewards.mood=1", "there is no setting 'rewards.mood'"),
    ("train new --set worlds=many", "expected a whole number"),
    ("train new --set device=tpu", "device is 'tpu'; expected auto, cpu, cuda"),
    ("train new --set learning_rate=nan", "learning-rate is nan"),
    ("train new --set hidden=[]", "hidden is []; expected the width of each layer"),
    ("train new --set effects=nowhere.toml", "nowhere.toml cannot be read"),
    ("train new --resume nowhere.pt", "there is no checkpoint nowhere.pt"),
]


def refused(line: str, shown: str, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = contents(here)
    status = main(line.split())
    out, err = capsys.readouterr()
    assert status == 2
    assert err.startswith("mimic: ")
    assert shown in err
    assert err.count("\n") == 1, err
    assert "Traceback" not in out + err
    assert contents(here) == before


@pytest.mark.parametrize(("line", "prepare", "shown"), BAD, ids=[line for line, _, _ in BAD])
@pytest.mark.usefixtures("targets")
def test_bad_input_is_one_line_and_nothing_is_written(line, prepare, shown, here, capsys):
    prepare(here)
    refused(line, shown, here, capsys)


@pytest.mark.train
@pytest.mark.parametrize(("line", "shown"), BAD_TRAINING, ids=[line for line, _ in BAD_TRAINING])
def test_bad_training_settings_are_reported_in_one_line_and_nothing_is_written(line, shown, here, capsys):
    for library in ("torch", "mujoco_warp", "rsl_rl"):
        pytest.importorskip(library, reason="training needs the extra 'train'")
    refused(line, shown, here, capsys)


def test_targets_that_cannot_be_played_are_refused(here, contract, capsys):
    write_targets(here / "none.parquet", contract, 0)
    refused("none.parquet --sim", "there are no commands to play", here, capsys)
    write_targets(here / "slow.parquet", contract, 10, dt=0.1)
    refused("slow.parquet --sim", "come every 0.1 s; the policy needs one every 0.02 s", here, capsys)


def test_training_without_its_libraries_names_the_extra(here):
    code = (
        "import sys\nfrom mimic.cli import main\nsys.modules['torch'] = None\n"
        "sys.stderr = sys.stdout\nstatus = main(['train', 'new'])\nprint(status)"
    )
    *said, status = in_a_process(code)
    assert "which is not installed: pip install 'mujoco-warp==" in " ".join(said)
    assert status == "2"
    assert not (here / "new").exists()


@pytest.mark.parametrize("line", ["film.mp4 --sim --video film.mp4", "retarget film.mp4 -o film.mp4"])
def test_the_source_is_never_overwritten(line, here, capsys):
    (here / "film.mp4").write_bytes(b"a film that exists once")
    assert main(line.split()) == 2
    assert "would be overwritten" in capsys.readouterr().err
    assert (here / "film.mp4").read_bytes() == b"a film that exists once"


def test_brackets_in_a_name_are_printed_as_they_are(here, capsys):
    refused("[red]nowhere[/red].mp4 --sim", "there is no file [red]nowhere[/red].mp4", here, capsys)


# ---------------------------------------------------------------------- exit statuses


@pytest.mark.slow
def test_targets_that_someone_else_made_can_be_played(here, targets, capsys):
    assert main([str(targets), "--sim", "--no-view", "-o", "out", *SHORT]) == 0
    assert "0.5 s in all" in capsys.readouterr().out


def test_motion_from_elsewhere_becomes_a_run_like_a_video(here):
    rows = np.arange(60)
    sway = 0.2 * np.sin(0.2 * rows)[:, None]
    points = {name: np.zeros((60, 3)) + place for name, place in STANDING.items()}
    points["left_wrist"] = points["left_wrist"] + sway * [1.0, 0.0, 1.0]
    np.savez(here / "someone.npz", points=np.stack(list(points.values()), axis=1), names=list(points), fps=50)
    assert main(["someone.npz", "--sim", "--no-view", *SHORT]) == 0
    run = here / "runs" / "someone"
    assert {path.name for path in run.iterdir()} >= {"pose.parquet", "targets.parquet", "log.parquet", "scene.rrd"}
    report = json.loads((run / "metrics.json").read_text())["retarget"]
    assert report["pose"]["frames_with_person"] == 60
    assert "unseen" not in report["pose"]
    again = here / "again"
    assert main([str(run / "pose.parquet"), "--sim", "--no-view", *SHORT, "-o", str(again)]) == 0
    one, other = (store.load(folder / "targets.parquet", TargetTrack) for folder in (run, again))
    assert np.array_equal(one.p_BE, other.p_BE)


@pytest.mark.slow
def test_a_sentence_becomes_a_run_whose_key_frames_can_be_played_again(here, capsys):
    assert main(["--text", "step forward, then stop and wave the left hand", "--sim", "--no-view", *SHORT]) == 0
    shown = capsys.readouterr().out
    assert "grammar: 6 key frames" in shown
    assert shown.splitlines()[-1].split() == ["next", "mimic", "view", "runs/step-forward-then-stop-and-wave"]
    run = here / "runs" / "step-forward-then-stop-and-wave"
    assert {path.name for path in run.iterdir()} >= {"motion.yaml", "commands.parquet", "targets.parquet", "scene.rrd"}
    log = store.load(run / "log.parquet", RunLog)
    assert 0.2 < log.v_des[:, 0].max() <= 0.3  # as fast as the policy must be asked for 0.25 m/s
    assert json.loads((run / "metrics.json").read_text())["standing_share"] > 0.9
    assert main([str(run / "motion.yaml"), "--sim", "--no-view", *SHORT, "-o", "again"]) == 0
    again = store.load(here / "again" / "log.parquet", RunLog)
    asked, asked_again = (one.p_BE_des[one.phase <= PHASES.index("track")] for one in (log, again))
    np.testing.assert_allclose(asked_again, asked, atol=1e-3)  # then each walks on until it has arrived
    assert main([str(run / "commands.parquet"), "--sim", "--no-view", *SHORT, "-o", "once more"]) == 0
    assert not (here / "once more" / "targets.parquet").exists()
    once_more = store.load(here / "once more" / "log.parquet", RunLog)
    assert np.array_equal(once_more.q, log.q)
    assert np.array_equal(once_more.v_des, log.v_des)


@pytest.mark.parametrize("name", ["step_and_wave", "ballet"])
def test_the_example_motions_are_retargeted_without_clamping(name, here):
    motion = Path(__file__).parents[2] / "examples" / "motions" / f"{name}.yaml"
    assert main(["retarget", str(motion), "-o", "targets.parquet"]) == 0
    assert store.load(here / "targets.parquet", TargetTrack).report["clamped_share"] == 0.0


def test_ctrl_c_ends_with_three(here, targets, capsys, monkeypatch):
    def interrupted(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("mimic.flows.play.play_source", interrupted)
    assert main([str(targets), "--sim"]) == 3
    assert capsys.readouterr().err == "mimic: interrupted\n"


def test_a_bug_is_not_hidden(here, targets, monkeypatch):
    def wrong(*arguments: object, **options: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("mimic.flows.play.play_source", wrong)
    with pytest.raises(ZeroDivisionError):
        main([str(targets), "--sim"])


def test_a_run_that_falls_is_stopped_for_safety_and_kept(here, targets, constant_onnx, capsys):
    policy = constant_onnx(here / "useless.onnx")
    status = main([str(targets), "--sim", "--no-view", "-o", "out", "--policy", str(policy)])
    assert status == 3
    assert "stopped: the robot" in capsys.readouterr().out
    metrics = json.loads((here / "out" / "metrics.json").read_text())
    assert metrics["falls"] == 1
    assert (here / "out" / "log.parquet").is_file()


def test_an_evaluation_is_written_with_the_hash_of_its_policy(here, constant_onnx, capsys, monkeypatch):
    for few in ("TOE_EPISODES", "COMMAND_EPISODES"):
        monkeypatch.setattr(f"mimic.evaluation.policy.{few}", 1)
    policy = constant_onnx(here / "useless.onnx")
    assert main(["evaluate", str(policy), "--episodes", "1", "--seconds", "2", "--workers", "1"]) == 0
    shown = json.loads((here / "evaluation-useless.json").read_text())
    assert shown["summary"]["stood_up_and_kept"] == 0.0
    assert shown["provenance"]["inputs"]["policy"] == store.sha256_of(policy)
    assert shown["provenance"]["settings"]["episodes"] == 1
    assert "useless.onnx" in capsys.readouterr().out


def test_ctrl_c_while_the_program_is_still_loading_is_one_line(monkeypatch, capsys):
    class Interrupting:
        @staticmethod
        def find_spec(name: str, path: object = None, target: object = None) -> None:
            if name == "mimic.cli.app":
                raise KeyboardInterrupt

    monkeypatch.delitem(sys.modules, "mimic.cli.app", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Interrupting, *sys.meta_path])
    assert main(["demo"]) == 3
    assert capsys.readouterr().err == "mimic: interrupted\n"
