"""Commands that need no robot: they end well, say so, and leave what they promise."""

from __future__ import annotations

import json
import shutil

import pytest

pytestmark = pytest.mark.acceptance


def test_the_boxing_clip_in_simulation(shell):
    out = shell.folder / "out"
    done = shell.mimic(shell.videos / "boxing.mp4", "--rate", "0.1", "--sim", "--out", out)
    shell.figures.append(f"boxing in simulation: {shell.check_run(done, out)}")
    assert done.row("run folder") == str(out)
    assert (out / "scene.rrd").stat().st_size > 100_000


def test_the_boxing_clip_on_a_simulated_go2(shell):
    done = shell.mimic(shell.videos / "boxing.npz", "--sim", "--robot-model", "go2", "--out", "out")
    figures = shell.check_run(done, shell.folder / "out", robot="go2")
    shell.figures.append(f"boxing on a simulated Go2: {figures}")


def test_a_sentence_in_simulation_on_a_model_with_the_effects_of_a_calibration(shell):
    hidden = shell.videos.parent / "hidden.toml"
    done = shell.mimic("--text", "step forward, then wave the left hand", "--sim", "--effects", hidden, "--out", "out")
    shell.figures.append(f"a sentence, knees with Stribeck friction: {shell.check_run(done, shell.folder / 'out')}")


def test_a_camera_followed_live(shell):
    def attempt(folder):
        done = shell.mimic("--camera", shell.videos / "waving.mp4", "--sim", "--out", folder)
        return done, f"{shell.check_run(done, folder)}, frame to target {done.row('frame to target')}"

    shell.in_real_time("a camera", attempt)


def test_the_demo(shell):
    done = shell.mimic("demo", "--out", "out")
    shell.figures.append(f"the demo: {shell.check_run(done, shell.folder / 'out')}")


def test_a_folder_of_clips(shell):
    clips = shell.folder / "clips"
    clips.mkdir()
    for clip in ("boxing.mp4", "waving.mp4"):
        shutil.copy(shell.videos / clip, clips)
    done = shell.mimic("batch", clips, "--out", "out")
    assert done.status == 0, done.said
    assert (shell.folder / "out" / "summary.html").is_file()
    rows = [json.loads(file.read_text())["row"] for file in (shell.folder / "out").glob("*/*/metrics.json")]
    assert [row["status"] for row in rows] == ["done", "done"]
    assert max(row["toe_error_cm"] for row in rows) < 3.0


def test_a_robot_that_never_stands_is_said_in_a_sentence(shell):
    joints = ", ".join(f'"{leg}_knee"' for leg in ("FL", "FR", "RL", "RR"))
    (shell.folder / "weak.toml").write_text(
        f'[[effect]]\nname = "torque_speed"\njoints = [{joints}]\ntorque = 0.5\nflat = 11.52\nspeed = 31.0\n',
        encoding="utf-8",
    )
    done = shell.mimic("--text", "wave", "--sim", "--effects", "weak.toml", "--out", "out")
    assert done.status == 3, done.said
    assert "the robot never stood up" in done.last
    assert (shell.folder / "out" / "log.parquet").is_file()


def test_a_short_log_is_explained(shell):
    folder = shell.folder
    (folder / "pendulum.xml").write_text(
        '<mujoco><compiler angle="radian"/><worldbody><body name="link">'
        '<joint name="hinge" axis="0 1 0" range="-1.2 1.2" damping="0.02"/>'
        '<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.8"/></body></worldbody>'
        '<actuator><position joint="hinge" kp="30" kv="1.5"/></actuator></mujoco>'
    )
    (folder / "hidden.toml").write_text('[[effect]]\nname = "spring"\njoints = ["hinge"]\nstiffness = 2.0\n')
    model = ("--model", "pendulum.xml")
    made = shell.mimic("log", "simulate", *model, "--effects", "hidden.toml", "--seconds", "16", "--out", "log.parquet")
    assert made.status == 0, made.said
    done = shell.mimic("calibrate", "log.parquet", *model, "--out", "found")
    assert done.status == 0, done.said
    found = json.loads((folder / "found" / "calibration.json").read_text())
    assert [one["name"] for one in found["found"]] == ["spring"]
    before, after = (found["errors"][which]["held_out"]["all"] for which in ("baseline", "final"))
    assert after < 0.5 * before
    shell.figures.append(f"a hidden spring: held-out error {1e3 * before:.2f} to {1e3 * after:.2f} mrad")
