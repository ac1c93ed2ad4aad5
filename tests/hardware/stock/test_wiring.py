"""The board's wiring file: order, signs, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from mimic.errors import AssetError, ConfigError
from mimic.hardware.stock.wiring import load_board
from mimic.io.assets import shipped
from mimic.records import JOINTS


@pytest.fixture
def changed(tmp_path):
    """Return a function that writes a copy of the shipped file with some text replaced."""

    def write(before: str, after: str):
        text = shipped("assets", "cyberdog2", "board.toml").read_text()
        assert before in text
        path = tmp_path / "board.toml"
        path.write_text(text.replace(before, after))
        return path

    return write


def test_order_and_signs_are_those_that_were_measured_on_the_makers_firmware():
    wire = np.arange(1.0, 13.0)  # FR FL RR RL, each abad hip knee
    q = dict(zip(JOINTS, load_board().angles(wire), strict=True))
    assert (q["FR_abad"], q["FR_hip"], q["FR_knee"]) == (1.0, -2.0, -3.0)
    assert (q["FL_abad"], q["RR_knee"], q["RL_hip"]) == (4.0, -9.0, -11.0)


def test_angles_and_gains_survive_the_wire():
    board, q = load_board(), np.linspace(-1.0, 1.0, 12)
    np.testing.assert_allclose(board.angles(board.wire_angles(q)), q)
    np.testing.assert_allclose(board.wire_gains(q)[board.index], q)


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ('board = "cyberdog2"', 'board = "spot"', "board is 'spot'; expected cyberdog2"),
        ('"FR", "FL", "RR", "RL"', '"FR", "FL", "RR", "RR"', "legs is"),
        ("sign = [1, -1, -1]", "sign = [1, 0, -1]", "sign is .* expected 1 or -1"),
        ('quat = "wxyz"', 'quat = "wxy"', "quat is 'wxy'"),
        ("kp = 200.0", "kp = nan", "limits.kp is nan N m/rad; it must be from"),
        ("kd = 10.0", "kd = -1.0", "limits.kd is -1"),
        ("cut_margin = 0.01745", "cut_margin = 0.2", "cut_margin"),
        ("port = 7667", "port = 70000", "port is 70000"),
        ('address = "239.255.76.67"', 'address = "192.168.44.1"', "expected a multicast group"),
        ('"192.168.44.100/24"', '"robot"', "host is 'robot'"),
        ("[limits]", "[limit]", "no setting .limit."),
        ("[readings]", "[reading]", "no setting .reading."),
        ("torque = 24.0", "torque = 0.0", "readings.torque is 0 N m; it must be from"),
        ("[-40.0, 200.0]", "[200.0, -40.0]", "expected the lowest, then the highest"),
        ("[-40.0, 200.0]", "200.0", "temperature is 200.0; expected a list of 2, each a number"),
    ],
)
def test_a_file_that_cannot_be_right_is_refused_in_one_line(changed, before, after, expected):
    with pytest.raises(ConfigError, match=expected) as raised:
        load_board(changed(before, after))
    assert "\n" not in str(raised.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(AssetError, match=r"nothing\.toml"):
        load_board(tmp_path / "nothing.toml")
