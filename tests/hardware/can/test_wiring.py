from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mimic.errors import AssetError, ConfigError
from mimic.hardware.can.wiring import load_wiring
from mimic.io.assets import shipped
from mimic.records import JOINTS


@pytest.fixture
def edited(tmp_path) -> Callable[[str, str], Path]:
    """Return a function that writes the shipped file with one thing replaced."""
    text = shipped("assets", "cyberdog2", "bus.toml").read_text(encoding="utf-8")

    def write(old: str, new: str) -> Path:
        assert text.count(old) == 1
        path = tmp_path / "bus.toml"
        path.write_text(text.replace(old, new), encoding="utf-8")
        return path

    return write


def test_the_shipped_file_gives_each_joint_a_motor(description):
    wiring = load_wiring()
    assert sorted(wiring.motor.tolist()) == list(range(1, 13))
    assert set(wiring.bus.tolist()) == {0}
    for i in range(len(JOINTS)):
        assert wiring.joint_of(0, int(wiring.motor[i])) == i
    assert wiring.joint_of(0, 99) is None
    assert np.allclose(wiring.offset, description.poses["lie"], atol=1e-3), "the zero is set lying"


def test_readings_and_angles_turn_into_each_other(description):
    wiring = load_wiring()
    q = description.poses["upright"]
    assert np.allclose(wiring.q_of(wiring.p_of(q)), q)
    assert np.allclose(wiring.q_of(np.zeros(12)), wiring.offset)
    assert np.array_equal(wiring.q_of(np.ones(12)) - wiring.offset > 0, wiring.sign > 0)


def test_a_file_without_a_maker_has_cybergear_motors(edited):
    assert load_wiring(edited('motor = "cybergear"', "")).maker == "cybergear"


def test_two_buses_share_left_and_right():
    wiring = load_wiring(buses=2)
    assert [JOINTS[i][1] for i in np.flatnonzero(wiring.bus == 1)] == ["R"] * 6


def test_a_layout_may_name_every_joint(edited):
    wiring = load_wiring(edited("2 = [0, 1, 0, 1]", f"2 = {[0, 1] * 6}"), buses=2)
    assert wiring.bus.tolist() == [0, 1] * 6


def test_the_same_id_may_be_on_two_buses(edited):
    wiring = load_wiring(edited("FR_abad = { motor = 4", "FR_abad = { motor = 1"), buses=2)
    assert wiring.joint_of(0, 1) == JOINTS.index("FL_abad")
    assert wiring.joint_of(1, 1) == JOINTS.index("FR_abad")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("FR_abad = { motor = 4", "FR_abad = { motor = 1", "FL_abad and FR_abad both have motor 1 on bus 0"),
        ("FL_hip = { motor = 2, sign = -1, offset = 1.3963 }\n", "", "names FL_abad, FL_knee"),
        ("FL_hip =", "FL_elbow =", "FL_elbow"),
        ("FL_hip = { motor = 2", "FL_hip = { motor = 128", "motor of FL_hip is 128"),
        ("FL_hip = { motor = 2, sign = -1", "FL_hip = { motor = 2, sign = 2", "sign of FL_hip is 2"),
        (
            "FL_hip = { motor = 2, sign = -1, offset = 1.3963",
            "FL_hip = { motor = 2, sign = -1, offset = nan",
            "joints.FL_hip.offset is nan",
        ),
        ('motor = "cybergear"', 'motor = "acme"', "the motors are 'acme'; mimic knows cybergear"),
        ('motor = "cybergear"', "motor = 3", "motor is 3; expected text"),
        ("host = 0xFD", "host = 5", "host is 5"),
        ("position_range = 12.566370614359172", "position_range = 720.0", "position_range is 720"),
        ("bitrate = 1_000_000", 'bitrate = "fast"', "bitrate is .fast.; expected a whole number"),
        ("1 = [0, 0, 0, 0]", "1 = [0, 0, 0, 1]", "expected a bus from 0 to 0"),
        ("1 = [0, 0, 0, 0]", "1 = [0, 0, 0]", "for each of 4 legs"),
        ("1 = [0, 0, 0, 0]", "3 = [0, 1, 2, 0]", "no line for 1 bus"),
        ("[imu]\n", "[compass]\n", "no setting .compass."),
        ("quat_BI = [1.0, 0.0, 0.0, 0.0]", "quat_BI = [1.0, 1.0, 0.0, 0.0]", "length 1.414"),
        ("quat_BI = [1.0, 0.0, 0.0, 0.0]", "quat_BI = [1.0, 0.0, 0.0]", "quat_BI is .*expected a list of 4"),
        ("rate = { quaternion = 100,", "rate = {", "lacks quaternion"),
        ("rate = { quaternion = 100,", "rate = { pressure = 100,", "names 'pressure'"),
        ("rate = { quaternion = 100,", "rate = { quaternion = 1000,", "at most 400"),
        ("bitrate = 1_000_000", "bitrate = ", "not a TOML file"),
    ],
)
def test_a_file_that_cannot_be_is_refused_and_says_where(old, new, says, edited):
    path = edited(old, new)
    with pytest.raises(ConfigError, match=says) as error:
        load_wiring(path)
    assert str(path) in str(error.value)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(AssetError, match=r"nowhere\.toml"):
        load_wiring(tmp_path / "nowhere.toml")
