"""Settings from a file: what counts, what is refused, and the file that `mimic config` prints."""

from __future__ import annotations

import tomllib
from dataclasses import fields
from pathlib import Path

import pytest

from mimic.cli import main
from mimic.cli.settings_file import SECTIONS, read_settings


@pytest.fixture
def asked(monkeypatch, tmp_path) -> list[tuple[tuple, dict]]:
    """Calls of the flows instead of their work."""
    calls: list[tuple[tuple, dict]] = []

    def reached(*arguments: object, **options: object) -> None:
        calls.append((arguments, options))
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    for flow in ("play.play_source", "play.save_targets", "robot.robot_run.play_on_robot"):
        monkeypatch.setattr(f"mimic.flows.{flow}", reached)
    return calls


def test_settings_come_from_a_file_and_the_command_line_wins(asked):
    Path("mimic.toml").write_text("[retarget]\nrate = 0.2\nturns = true\n[mocap]\nnames = ['left_wrist=LWRA']\n")
    main(["clip.npz", "--sim", "--config", "mimic.toml"])
    main(["clip.npz", "--sim", "--config=mimic.toml", "--rate", "0.1"])
    main(["retarget", "clip.npz", "-o", "t.parquet", "--config", "mimic.toml"])
    first, second, third = asked[0][0][1], asked[1][0][1], asked[2][0][2]
    assert (first.retarget.rate, first.retarget.turns, first.stored.names) == (0.2, True, ("left_wrist=LWRA",))
    assert (second.retarget.rate, second.retarget.turns) == (0.1, True)
    assert (third.retarget.rate, third.retarget.turns) == (0.2, True)


def test_one_file_serves_the_simulated_and_the_real_robot(asked):
    Path("mimic.toml").write_text("[robot]\nramp = 4\n[effects]\neffects = 'e.toml'\n")
    main(["clip.npz", "--sim", "--config", "mimic.toml"])
    main(["clip.npz", "--robot", "can0", "--config", "mimic.toml"])
    assert asked[0][1]["effects"].effects == "e.toml"
    assert asked[1][1]["bus"].ramp == 4.0


def test_without_a_file_nothing_of_an_earlier_one_counts(asked):
    Path("mimic.toml").write_text("[retarget]\nrate = 0.2\n")
    main(["clip.npz", "--sim", "--config", "mimic.toml"])
    main(["clip.npz", "--sim"])
    assert asked[1][0][1].retarget.rate == 0.1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "there is no file mimic.toml"),
        ("rate = = 2", "is not a TOML file"),
        ("rate = 0.2", "unknown key rate outside a section; sections are retarget, play"),
        ("[retargeting]", "unknown section [retargeting]; sections are retarget, play"),
        ("retarget = 1", "retarget is 1; expected a section [retarget]"),
        ("[retarget]\nraet = 0.2", "there is no setting 'mimic.toml: [retarget] raet'"),
        ("[retarget]\nrate = 'fast'", "[retarget] rate is 'fast'; expected a number"),
        ("[retarget]\nrate = 5", "[retarget] rate is 5 s; it must be from 0.05 to 1 s"),
        ("[retarget]\nmirror = 1", "[retarget] mirror is 1; expected true or false"),
        ("[retarget]\nslow_down = 'much'", "slow_down is 'much'; expected a number or \"auto\""),
        ("[play]\nseed = true", "[play] seed is True; expected a whole number"),
        ("[camera]\ncamera_size = [640]", "camera_size is [640]; expected a list of 2, each a whole number"),
        ("[pose]\nalso = 3", "also is 3; expected a file name in quotes"),
    ],
)
def test_a_bad_file_is_one_line_with_file_key_and_what_is_expected(text, said, asked, capsys):
    if text is not None:
        Path("mimic.toml").write_text(text)
    assert main(["clip.mp4", "--sim", "--config", "mimic.toml"]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert "mimic.toml" in error
    assert error.count("\n") == 1
    assert not asked


def test_an_option_that_moved_into_the_file_says_where(asked, capsys):
    assert main(["clip.npz", "--sim", "--fps", "30"]) == 2
    assert main(["clip.mp4", "--sim", "--no-depth"]) == 2
    fps, depth = capsys.readouterr().err.splitlines()
    assert "--fps is a setting, not an option: put [mocap] and below it fps = ..." in fps
    assert "put [pose] and below it depth = ..." in depth


def test_config_prints_every_setting_as_a_file_that_changes_nothing(tmp_path, capsys):
    assert main(["config"]) == 0
    shown = capsys.readouterr().out
    file = tmp_path / "all.toml"
    file.write_text(shown)
    assert set(tomllib.loads(shown)) == set(SECTIONS)
    for section, given in read_settings(file).items():
        kind = SECTIONS[section]
        assert kind(**given) == kind()
        assert all(f"\n{f.name} = " in shown or f"\n# {f.name} = ..." in shown for f in fields(kind))


def test_config_explains_every_setting(capsys):
    assert main(["config"]) == 0
    lines = capsys.readouterr().out.splitlines()
    settings = [i for i, line in enumerate(lines) if " = " in line and not line.startswith("# Where")]
    unexplained = [lines[i] for i in settings if not lines[i - 1].startswith("# ") or " = ..." in lines[i - 1]]
    assert unexplained == []
