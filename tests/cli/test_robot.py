"""What the commands for a real robot print at their end."""

from __future__ import annotations

import pytest

from mimic.cli import main
from mimic.hardware.robot.checks import Check


def last_line(capsys) -> str:
    return capsys.readouterr().out.strip().splitlines()[-1]


@pytest.mark.parametrize(
    ("verdict", "status", "expected"),
    [
        ("ok", 0, "done         nothing stands against moving it"),
        ("note", 0, "done         nothing stands against moving it"),
        ("stop", 2, "note: it must not move yet: pose"),
    ],
)
def test_a_check_ends_with_a_line_that_decides(verdict, status, expected, monkeypatch, capsys):
    found = [Check("network", "ok", "fine"), Check("pose", verdict, "it lies")]
    monkeypatch.setattr("mimic.flows.robot.commissioning.check_robot", lambda *_, **__: found)
    assert main(["robot", "check", "cyberdog2"]) == status
    assert last_line(capsys) == expected


def test_ctrl_c_is_the_ordinary_end_of_watching(monkeypatch, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("mimic.flows.watching.watch_robot", interrupted)
    assert main(["robot", "watch", "cyberdog2"]) == 0
    assert last_line(capsys) == "done         nothing was moved"


def test_a_question_that_nobody_can_answer_is_one_line(monkeypatch, capsys):
    def asks(bus_url, bus, *, again, operator):
        operator.confirm("Keep your hands off it from here on.")

    monkeypatch.setattr("mimic.flows.robot.commissioning.zero_robot", asks)
    monkeypatch.setattr("sys.stdin", None)
    assert main(["robot", "zero", "can0"]) == 2
    said = capsys.readouterr().err
    assert "a question could not be answered" in said
    assert "--yes" in said


@pytest.mark.parametrize(
    ("command", "board"),
    [(["--robot", "cyberdog"], "cyberdog2"), (["robot", "check", "Go2"], "go2"), (["robot", "damp", "GO2"], "go2")],
)
def test_a_name_that_is_nearly_a_robots_is_no_bus(command, board, capsys):
    assert main(command) == 2
    assert capsys.readouterr().err == f"mimic: there is no robot {command[-1]}; did you mean {board}?\n"


def test_an_argument_too_many_is_named(capsys):
    assert main(["emulate", "cyberdog2"]) == 2
    assert capsys.readouterr().err == "mimic: cyberdog2 is one argument too many; see --help\n"
