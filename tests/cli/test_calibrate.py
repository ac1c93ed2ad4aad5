"""mimic calibrate, mimic log simulate and mimic log replay, on a pendulum that takes a second."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mimic.cli import main
from mimic.dynamics.effect_set import read_effects
from mimic.io.joint_log import read_log, write_log

PENDULUM = """<mujoco><compiler angle="radian"/><worldbody><body name="link">
<joint name="hinge" axis="0 1 0" range="-1.2 1.2" damping="0.02"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.8"/></body></worldbody>
<actuator><position joint="hinge" kp="30" kv="1.5"/></actuator></mujoco>"""

HIDDEN = """[[effect]]
name = "coulomb"
joints = ["hinge"]
level = 0.2

[[effect]]
name = "spring"
joints = ["hinge"]
stiffness = 2.0
"""

SPRING = ("--effects", "spring")
QUICK = ("--seconds", "10", "--timestep", "0.001")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.xml").write_text(PENDULUM)
    (tmp_path / "hidden.toml").write_text(HIDDEN)
    return tmp_path


def simulated(*options: str) -> int:
    return main(["log", "simulate", "--model", "robot.xml", "--effects", "hidden.toml", *QUICK, *options])


@pytest.mark.slow
def test_a_simulated_log_is_one_that_can_be_read(here: Path) -> None:
    assert simulated("-o", "log.csv", "--rate-hz", "100", "--kd", "2.5", "--lost-samples", "0.1") == 0
    log = read_log(here / "log.csv")
    assert log.joints == ("hinge",)
    assert log.metadata["kp"] == {"hinge": 30.0}
    assert log.metadata["kd"] == {"hinge": 2.5}
    assert 850 < len(log.t) < 950
    assert log.tau is not None


@pytest.mark.slow
def test_the_same_seed_gives_the_same_log_and_effects_change_it(here: Path) -> None:
    assert simulated("-o", "a.csv") == simulated("-o", "b.csv") == 0
    assert (here / "a.csv").read_bytes() == (here / "b.csv").read_bytes()
    assert main(["log", "simulate", "--model", "robot.xml", "-o", "none.csv", *QUICK]) == 0
    difference = read_log(here / "a.csv").q - read_log(here / "none.csv").q
    assert np.abs(difference).max() > 0.01


@pytest.mark.slow
def test_calibrating_finds_the_spring_and_writes_its_files(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert simulated("-o", "log.parquet") == 0
    assert main(["calibrate", "log.parquet", "--model", "robot.xml", "-o", "out", *SPRING]) == 0
    written = {"actuators.json", "calibration.json", "effects.toml", "model.xml", "report.html"}
    assert {p.name for p in (here / "out").iterdir()} == written
    data = json.loads((here / "out" / "calibration.json").read_text())
    assert [one["name"] for one in data["found"]] == ["spring"]
    assert data["errors"]["final"]["held_out"]["all"] < 0.5 * data["errors"]["baseline"]["held_out"]["all"]
    assert set(data["metadata"]["provenance"]["inputs"]) == {"log", "model"}
    found = {e.name: e for e in read_effects(here / "out" / "effects.toml")}
    assert found["spring"].values["stiffness"] == pytest.approx([2.0], rel=0.1)
    assert found["coulomb"].values["level"] == pytest.approx([0.2], abs=0.02)
    assert "spring or cable pull" in (here / "out" / "report.html").read_text()
    shown = capsys.readouterr().out
    assert "spring or cable pull" in shown
    assert "Held-out error [mrad]" in shown


@pytest.mark.slow
def test_logs_with_gains_of_their_own_are_explained_together(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for seed, gains in enumerate((("30", "1.5"), ("15", "0.8"), ("30", "1.5"), ("20", "1.0"))):
        options = ("--motion", "random", "--seed", str(seed), "--kp", gains[0], "--kd", gains[1])
        words = ("--model", "robot.xml", "--effects", "hidden.toml", *QUICK)
        assert main(["log", "simulate", *words, "-o", f"{seed}.csv", *options]) == 0
        (here / f"{seed}.json").write_text("{}")  # nothing is said beside the log
    notes = [word for i, kp, kd in ((0, 30, 1.5), (1, 15, 0.8), (2, 30, 1.5), (3, 20, 1.0)) for word in (
        "--note", f"{i}.csv:kp={kp}", "--note", f"{i}.csv:kd={kd}")]  # fmt: skip
    files = ["0.csv", "1.csv", "2.csv", "--held-out", "3.csv"]
    assert main(["calibrate", *files, "--model", "robot.xml", *notes, "-o", "out", *SPRING]) == 0
    data = json.loads((here / "out" / "calibration.json").read_text())
    assert [one["name"] for one in data["found"]] == ["spring"]
    assert [(log["name"], log["fitted"]) for log in data["logs"]] == [
        ("0.csv", True), ("1.csv", True), ("2.csv", True), ("3.csv", False)]  # fmt: skip
    for log in data["logs"]:
        assert log["final"][0] < 0.5 * log["baseline"][0]
    for log in data["logs"][:3]:
        assert log["left_out_final"][0] < 1.2 * log["final"][0]
    assert "Each log" in (here / "out" / "report.html").read_text()


@pytest.mark.slow
def test_a_second_log_shows_whether_effects_hold(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert simulated("-o", "second.csv", "--motion", "random", "--seed", "5") == 0
    (here / "wrong.toml").write_text(HIDDEN.replace("2.0", "3.0"))
    files = ("--effects", "hidden.toml", "wrong.toml")
    capsys.readouterr()
    assert main(["log", "replay", "second.csv", "--model", "robot.xml", *files, "-o", "errors.json"]) == 0
    shown = capsys.readouterr().out
    data = json.loads((here / "errors.json").read_text())
    given, right, wrong = (data["errors"][name]["all"] for name in ("as given", "hidden.toml", "wrong.toml"))
    assert right == pytest.approx(data["noise"][0], rel=0.1)
    assert right < 0.2 * wrong < 0.2 * given
    assert data["errors"]["hidden.toml"]["relative"][0] < 0.01
    for heading in ("Error [mrad]", "as given", "hidden.toml", "wrong.toml", "noise floor"):
        assert heading in shown
    assert set(data["provenance"]["inputs"]) == {"log", "model", "effects 0", "effects 1"}


@pytest.mark.slow
def test_a_wave_longer_than_the_motion_is_no_cogging(here: Path) -> None:
    assert simulated("-o", "log.parquet") == 0  # its spring is a wave of any long period
    options = ("--effects", "cogging")
    assert main(["calibrate", "log.parquet", "--model", "robot.xml", "-o", "out", *options]) == 0
    data = json.loads((here / "out" / "calibration.json").read_text())
    assert data["found"] == []
    assert data["tried"][0]["candidates"][0]["name"] == "cogging"


@pytest.mark.slow
def test_a_log_of_something_else_ends_with_2_and_no_effects(here: Path) -> None:
    assert simulated("-o", "log.parquet") == 0
    log = read_log(here / "log.parquet")
    assert log.q_des is not None
    rng = np.random.default_rng(0)
    write_log(replace(log, q_des=rng.permutation(log.q_des)), here / "wrong.parquet")
    (here / "out").mkdir()
    (here / "out" / "effects.toml").write_text("of an earlier log")
    assert main(["calibrate", "wrong.parquet", "--model", "robot.xml", "-o", "out"]) == 2
    assert sorted(p.name for p in (here / "out").iterdir()) == ["calibration.json", "report.html"]
    assert "does not match the model" in (here / "out" / "report.html").read_text()


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["calibrate", "missing.parquet"], "missing.parquet does not exist"),
        (["calibrate", "hidden.toml"], "cannot be read as Parquet"),
        (["calibrate", "log.csv", "--model", "missing.xml"], "there is no model missing.xml"),
        (["calibrate", "log.csv"], "the model has joint 'FL_abad'"),
        (["calibrate", "log.csv", "--model", "robot.xml"], "lasts 0.01 s"),
        (["calibrate"], "no log is given"),
        (["calibrate", "log.csv", "--held-out", "log.csv"], "log.csv is given twice"),
        (
            ["calibrate", "log.csv", "knee.csv", "--model", "robot.xml"],
            "log.csv has joints hinge, but knee.csv has knee",
        ),
        (["calibrate", "log.csv", "--held-out", "forces.csv"], "log.csv has targets (q_des), but forces.csv has none"),
        (["calibrate", "log.csv", "--note", "kp"], "--note kp: expected KEY=VALUE"),
        (["calibrate", "log.csv", "--note", "b.csv:kp=1"], "b.csv is none of the logs: log.csv"),
        (["calibrate", "log.csv", "--model", "robot.xml", "--note", "kp=-1"], "what is said of log.csv: kp is -1"),
        (["calibrate", "log.csv", "-o", "robot.xml"], "robot.xml is a file"),
        (["calibrate", "log.csv", "-o", "earlier"], "earlier holds an earlier calibration; name another folder with"),
        (["calibrate", "log.csv", "-o", "robot.xml/out"], "nothing can be written to robot.xml/out"),
        (["calibrate", "log.csv", "--effects", "spring", "--effects", "spring"], "names an effect twice"),
        (["calibrate", "log.csv", "--effects", "effects.toml"], "effect 'effects.toml' is not in the catalogue"),
        (["calibrate", "log.csv", "--baseline", "friction"], "effect 'friction' is not in the catalogue"),
        (["calibrate", "log.csv", "--threads", "-1"], "threads is -1"),
        (["log", "replay", "missing.csv"], "missing.csv does not exist"),
        (["log", "replay", "log.csv", "--model", "robot.xml"], "lasts 0.01 s"),
        (["log", "replay", "log.csv", "--effects", "a.toml", "--effects", "a.toml"], "names a file twice"),
        (["log", "replay", "log.csv", "--effects", "none.toml"], "none.toml cannot be read"),
        (["log", "replay", "log.csv", "-o", "robot.xml/a.json"], "nothing can be written to robot.xml"),
        (["log", "simulate", "-o", "robot.xml/a.csv"], "nothing can be written to robot.xml"),
        (["log", "simulate", "-o", "a.csv", "--torque-noise", "-1"], "torque-noise is -1"),
        (["log", "simulate", "-o", "a.csv", "--kp", "-1"], "kp is -1"),
        (["log", "simulate", "-o", "a.csv", "--seed", "-1"], "seed is -1"),
        (["log", "simulate", "-o", "a.csv", "--seconds", "nan"], "an excitation of nan s"),
        (["log", "simulate", "-o", "log.txt"], "neither .parquet nor .csv"),
        (["log", "simulate", "-o", "a.csv", "--effects", "robot.xml"], "robot.xml"),
        (["log", "simulate", "-o", "a.csv", "--noise", "2"], "noise is 2 rad"),
        (["log", "simulate", "-o", "a.csv", "--seconds", "3"], "an excitation of 3 s"),
    ],
)
def test_what_cannot_work_is_said_and_nothing_is_written(
    here: Path, capsys: pytest.CaptureFixture[str], words: list[str], reason: str
) -> None:
    rows = "0,0,0\n0.005,0,0.1\n0.01,0,0.2\n"
    (here / "log.csv").write_text(f"t,q.hinge,q_des.hinge\n{rows}")
    (here / "knee.csv").write_text(f"t,q.knee,q_des.knee\n{rows}")
    (here / "forces.csv").write_text(f"t,q.hinge,force.hinge\n{rows}")
    (here / "earlier").mkdir()
    (here / "earlier" / "calibration.json").write_text("{}")
    before = sorted(here.rglob("*"))
    assert main(words) == 2
    assert reason in capsys.readouterr().err
    assert sorted(here.rglob("*")) == before


def test_a_joint_without_a_range_cannot_be_moved(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "robot.xml").write_text(PENDULUM.replace('range="-1.2 1.2"', ""))
    assert simulated("-o", "log.csv") == 2
    assert "joint 'hinge' of robot.xml has no range" in capsys.readouterr().err


def test_a_model_without_gains_needs_them(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "robot.xml").write_text(PENDULUM.replace("<position joint", "<motor joint").replace('kp="30" kv="1.5"', ""))
    assert simulated("-o", "log.csv") == 2
    assert "give --kp and --kd" in capsys.readouterr().err
    assert simulated("-o", "log.csv", "--kp", "20", "--kd", "1") == 0
