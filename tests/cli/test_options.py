"""Options as a person types them: several values, options from a file, mistakes, and an unusable environment."""

from __future__ import annotations

import errno
import re
from pathlib import Path

import pytest

from mimic.cli import main
from mimic.cli.app import COMMANDS, GROUPS, app


@pytest.fixture
def asked(monkeypatch, tmp_path) -> list[tuple[tuple, dict]]:
    """Calls of the flows instead of their work."""
    calls: list[tuple[tuple, dict]] = []

    def reached(*arguments: object, **options: object) -> None:
        calls.append((arguments, options))
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    for flow in (
        "play.play_source",
        "play.save_targets",
        "logs.calibrate.calibrate",
        "logs.machine_log.predict_log",
        "train.train",
    ):
        monkeypatch.setattr(f"mimic.flows.{flow}", reached)
    return calls


def test_bare_mimic_prints_the_help(capsys):
    assert main([]) == 0
    assert "Usage: mimic SOURCE --sim" in capsys.readouterr().out


COMMAND_LINES = [[], *([name] for name in COMMANDS), *([g, name] for g, (_, names) in GROUPS.items() for name in names)]
NO_CONSTANT = {"BUS_URL", "CAN_TIMEOUT", "OPENAI_API_KEY"}
"""An argument, a parameter of a motor's firmware, and a variable of the environment."""


@pytest.mark.parametrize("command", COMMAND_LINES, ids=" ".join)
def test_every_help_is_examples_and_plain_words(command, capsys):
    assert main([*command, "--help"]) == 0
    shown = capsys.readouterr().out
    assert "Examples:" in shown
    for marker in ("``", ":class:", "--empty-", ":mod:"):
        assert marker not in shown
    assert re.findall(r"\bNone\b|\bInstead\b|default: (?:\W*\]|\(|False|True)|\d\.\d{8}", shown) == []
    assert set(re.findall(r"\b[A-Z]+_[A-Z_]+\b", shown)) <= NO_CONSTANT


@pytest.mark.parametrize(("command", "most"), [([], 25), (["batch"], 14), (["train"], 12)])
def test_a_command_has_few_options_besides_help(command, most, capsys):
    assert main([*command, "--help"]) == 0
    shown = capsys.readouterr().out
    options = set(re.findall(r"^│ --(?!no-)([a-z-]+)", shown, re.MULTILINE)) - {"help", "version", "install-completion"}
    assert 3 < len(options | {"config"}) <= most


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        ("scan", {"wiring"}),
        ("wire", {"wiring", "out"}),
        ("damp", {"wiring", "interface"}),
        ("zero", {"wiring", "again", "yes"}),
        ("check", {"wiring", "interface", "zeroed", "suspended"}),
        ("watch", {"wiring", "interface", "zeroed", "seconds", "every", "view", "scene"}),
    ],
)
def test_a_robot_command_offers_only_what_it_uses(command, expected, capsys):
    assert main(["robot", command, "--help"]) == 0
    offered = set(re.findall(r"^│ --(?!no-)([a-z-]+)", capsys.readouterr().out, re.MULTILINE))
    assert offered == expected
    assert main(["robot", command, "can0", "--ramp", "3"]) == 2
    assert "--ramp" in capsys.readouterr().err


@pytest.mark.parametrize("command", [["--robot", "can0"], *([name] for name in COMMANDS)], ids=" ".join)
def test_no_option_of_a_command_means_two_things(command, capsys):
    assert main([]) == 0  # the command without a name is there from then on
    found = app if command[0].startswith("-") else app[command[0]]
    options = [name for one in found.assemble_argument_collection() if not one.children for name in one.names]
    assert len(options) == len(set(options))


def test_holding_a_button_is_asked_for_on_the_command_line(monkeypatch):
    asked = []
    monkeypatch.setattr("mimic.flows.robot.robot_run.play_on_robot", lambda *_, bus, **__: asked.append(bus) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        main(["--robot", "can0", "--hold", "/dev/input/js0"])
    assert asked[0].hold == "/dev/input/js0"


def test_a_mistyped_command_is_no_file(capsys):
    assert main(["evalute", "policy.onnx"]) == 2
    assert capsys.readouterr().err == "mimic: there is no command and no file 'evalute'; did you mean: mimic evaluate\n"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("view", "RUN is missing; for example: mimic view runs/video"),
        ("export runs/x --fromat csv", "--out is missing; for example: mimic export runs/video -o dataset"),
        (
            "robot check go2 --interface",
            "--interface needs a value; for example: mimic robot check cyberdog2 --interface",
        ),
        ("clip.mp4 --sim --rate ten", "--rate is ten; expected a number"),
        ("clip.mp4 --sim --slow-down fast", '--slow-down is fast; expected a number or "auto"'),
        ("export runs/x -o y --format csb", '--format is csb; expected "lerobot" or "csv" or "npz"'),
        ("--hlep", "Unknown option: --hlep. Did you mean --help?"),
        ("help", "there is no command and no file 'help'; did you mean: mimic --help"),
        ("clip.mp4 --versoin", "Unknown option: --versoin. Did you mean --version?"),
    ],
)
def test_a_slip_of_the_command_line_is_one_line_with_what_to_type(line, said, capsys):
    assert main(line.split()) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"mimic: {said}")
    assert err.count("\n") == 1


def test_a_sentence_without_its_option_is_answered_with_it(capsys):
    assert main(["wave the left hand", "--sim"]) == 2
    assert capsys.readouterr().err.endswith("to play a sentence: mimic --text 'wave the left hand' --sim\n")


def test_several_names_follow_one_option(asked):
    main(["retarget", "motion.npz", "-o", "t.parquet", "--names", "left_wrist=LWRA", "right_wrist=RWRA", "--mirror"])
    settings = asked[0][0][2]
    assert settings.stored.names == ("left_wrist=LWRA", "right_wrist=RWRA")
    assert settings.retarget.mirror


def test_several_effects_follow_one_option_of_calibrate(asked):
    main(["calibrate", "log.parquet", "--effects", "stribeck", "backlash"])
    assert asked[0][0][2].effects == ("stribeck", "backlash")


def test_several_files_follow_one_option_of_replay(asked):
    main(["log", "replay", "log.parquet", "--effects", "a.toml", "b.toml", "--whole"])
    assert asked[0][0][1] == (Path("a.toml"), Path("b.toml"))


def test_several_settings_follow_one_option_of_train(asked):
    main(["train", "out", "--recipe", "sit_down", "--set", "rewards.slip=-0.4", "noise_q=0.02"])
    _, mdp, learn = asked[0][0]
    assert (mdp.task, mdp.rewards.slip, mdp.noise_q, learn.minutes) == ("sit_down", -0.4, 0.02, 9.3)


def test_a_bad_mujoco_gl_is_one_line(monkeypatch, capsys):
    monkeypatch.setenv("MUJOCO_GL", "vulkan")
    assert main(["clip.mp4", "--sim"]) == 2
    assert "MUJOCO_GL is 'vulkan'; set it to egl" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OSError(errno.ENOSPC, "No space left on device", "runs/x/log.parquet"), "runs/x/log.parquet: No space left"),
        (PermissionError(errno.EACCES, "Permission denied", "runs"), "runs: Permission denied"),
        (EOFError(), "add --yes"),
    ],
)
def test_a_full_disk_missing_rights_and_no_input_are_one_line(error, said, monkeypatch, capsys):
    def fails(*arguments: object, **options: object) -> None:
        raise error

    monkeypatch.setattr("mimic.flows.play.play_source", fails)
    assert main(["clip.mp4", "--sim"]) == 2
    shown = capsys.readouterr().err
    assert said in shown
    assert shown.count("\n") == 1


def test_completion_can_be_installed(capsys):
    assert main(["--help"]) == 0
    assert "--install-completion" in capsys.readouterr().out
