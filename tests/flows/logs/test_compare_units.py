"""Which effect differs between two units of one machine."""

from __future__ import annotations

import pytest

from mimic.cli import main
from tests.cli.test_calibrate import PENDULUM

UNIT = """[[effect]]
name = "coulomb"
joints = ["hinge"]
level = {friction}

[[effect]]
name = "spring"
joints = ["hinge"]
stiffness = {stiffness}
"""


@pytest.fixture
def unit(tmp_path, monkeypatch):
    """Return a function that writes the log of a unit."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.xml").write_text(PENDULUM)

    def write(name, friction, stiffness, seed):
        (tmp_path / "hidden.toml").write_text(UNIT.format(friction=friction, stiffness=stiffness))
        made = ["log", "simulate", "--model", "robot.xml", "--effects", "hidden.toml", "--seed", str(seed)]
        assert main([*made, "--seconds", "10", "--timestep", "0.001", "-o", f"{name}.parquet"]) == 0

    return write


def compared(capsys, *options):
    search = ("--effects", "spring", "--model", "robot.xml")
    status = main(["calibrate", "a.parquet", "--compare", "b.parquet", *search, *options])
    said = capsys.readouterr()
    return status, said.out + said.err


@pytest.mark.slow
def test_the_effect_that_differs_is_named_and_the_one_that_both_have_is_not(unit, capsys, tmp_path):
    unit("a", friction=0.2, stiffness=2.0, seed=1)
    unit("b", friction=0.3, stiffness=2.0, seed=2)
    status, said = compared(capsys)
    assert status == 0
    last = said.splitlines()[-1]
    assert last.startswith("The units differ in coulomb.level hinge")
    assert "spring.stiffness" in said
    assert "spring.stiffness" not in last
    assert not (tmp_path / "calibration").exists()


@pytest.mark.slow
def test_units_whose_logs_have_the_same_name_have_a_column_each(unit, capsys, tmp_path):
    for name, friction in (("one/log", 0.2), ("two/log", 0.3)):
        (tmp_path / name).parent.mkdir()
        unit(name, friction=friction, stiffness=2.0, seed=1)
    capsys.readouterr()
    assert (
        main(
            [
                "calibrate",
                "one/log.parquet",
                "--compare",
                "two/log.parquet",
                "--model",
                "robot.xml",
                "--effects",
                "spring",
            ]
        )
        == 0
    )
    said = capsys.readouterr().out
    assert "one/log.parquet" in said
    assert "two/log.parquet" in said


def test_a_log_is_not_compared_with_itself(unit, capsys):
    unit("b", friction=0.2, stiffness=2.0, seed=1)
    assert main(["calibrate", "b.parquet", "--compare", "b.parquet", "--model", "robot.xml"]) == 2
    assert "--compare b.parquet is the log itself; give that of another unit" in capsys.readouterr().err


def test_two_logs_beside_the_other_unit_are_refused(unit, capsys):
    unit("a", friction=0.2, stiffness=2.0, seed=1)
    status, said = compared(capsys, "a.parquet")
    assert status == 2
    assert "--compare compares two logs, and 2 are given beside it; give one" in said


@pytest.mark.parametrize("more", [("--out", "folder"), ("--held-out", "a.parquet")])
def test_what_a_comparison_does_not_do_is_refused(unit, capsys, more):
    unit("a", friction=0.2, stiffness=2.0, seed=1)
    status, said = compared(capsys, *more)
    assert status == 2
    assert "leave out --held-out and --out" in said
