"""The newest readings of a board: what is taken, and which messages count as damaged."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mimic.hardware.stock.driver import StockDriver
from mimic.hardware.stock.messages import LEG_CONTROL_DATA, MOTOR_CTRL_STATE, SPI_DATA, STATE_ESTIMATOR
from mimic.hardware.stock.wiring import load_board
from mimic.robot.description import load_description

LEG = np.array([0.1, -0.2, 0.3, -0.4])


def silent() -> StockDriver:
    """Return the driver of a board that has said nothing."""
    return StockDriver(SimpleNamespace(), load_board(), load_description("cyberdog2"))


def healthy() -> StockDriver:
    """Return readings after one message of each kind, at 1 s."""
    readings = silent()
    readings.heard("spi_data", SPI_DATA.encode(q_hip=LEG, qd_knee=LEG, tau_abad=LEG, tmp_hip=[300] * 4), 1.0)
    readings.heard("state_estimator", STATE_ESTIMATOR.encode(quat=[1, 0, 0, 0], timestamp=10**9), 1.0)
    readings.heard("motor_ctrl_state", MOTOR_CTRL_STATE.encode(ctrl_topic_interval=2.0), 1.0)
    assert readings.report["errors"] == 0
    return readings


def in_one(values, value) -> np.ndarray:
    """Return values with the last of them replaced."""
    return np.append(np.asarray(values, dtype=float)[:-1], value)


@pytest.mark.parametrize(
    "damage",
    [
        {"q_hip": in_one(LEG, 13.0)},
        {"qd_knee": in_one(LEG, -90.0)},
        {"tau_abad": in_one(LEG, 1e4)},
        {"tau_abad": in_one(LEG, np.nan)},
        {"tau_knee": in_one(LEG, np.float32(3e38))},
        {"tmp_hip": [300, 300, 300, 32767]},
        {"tmp_hip": [300, 300, 300, -2000]},
    ],
)
def test_a_message_with_a_number_that_no_motor_can_report_is_left_out(damage):
    readings = healthy()
    before = readings.report.copy()
    readings.heard("spi_data", SPI_DATA.encode(**{"q_hip": LEG, "tau_abad": LEG} | damage), 1.002)
    assert readings.report["errors"] == 1
    for name in ("q", "dq", "tau", "temperature", "came", "readings"):
        np.testing.assert_array_equal(readings.report[name], before[name])


def test_joints_from_before_motor_mode_are_held_to_the_same_ranges():
    readings = silent()
    readings.heard("leg_control_data", LEG_CONTROL_DATA.encode(q=in_one(np.zeros(12), 40.0)), 1.0)
    assert readings.report["errors"] == 1
    assert np.isnan(readings.report["q"]).all()


@pytest.mark.parametrize("damage", [{"omegaBody": [0, 0, 1e6]}, {"omegaBody": [0, np.inf, 0]}, {"quat": [3, 0, 0, 0]}])
def test_an_orientation_that_no_imu_can_report_is_left_out(damage):
    readings = healthy()
    message = {"quat": [1, 0, 0, 0], "timestamp": 1_002_000_000} | damage
    readings.heard("state_estimator", STATE_ESTIMATOR.encode(**message), 1.002)
    assert (readings.report["errors"], readings.report["imu_count"]) == (1, 1)


@pytest.mark.parametrize("interval", [np.nan, np.inf, -np.inf])
def test_an_interval_that_cannot_be_is_left_out(interval):
    readings = healthy()
    readings.heard("motor_ctrl_state", MOTOR_CTRL_STATE.encode(err_flag=2, ctrl_topic_interval=interval), 1.002)
    assert (readings.report["errors"], readings.report["err_flag"]) == (1, 0)


def test_what_motors_do_report_at_their_limits_is_taken():
    readings = healthy()
    extremes = {"q_knee": in_one(LEG, -2.8), "qd_hip": in_one(LEG, 38.19), "tau_hip": in_one(LEG, -12.5)}
    readings.heard("spi_data", SPI_DATA.encode(**extremes, tmp_knee=[1200] * 4), 1.002)
    assert (readings.report["errors"], readings.report["readings"]) == (0, 2)


@pytest.mark.parametrize("step", [-5.0, -0.2, 0.2, 5.0])
def test_a_robot_whose_clock_is_set_is_not_silent(step):
    readings = healthy()
    for tick in range(1, 50):
        t, stamp = 1.0 + 0.002 * tick, 10.0 + 0.002 * tick + step * (tick > 20)
        readings.heard("state_estimator", STATE_ESTIMATOR.encode(quat=[1, 0, 0, 0], timestamp=round(1e9 * stamp)), t)
        assert t - readings.report["imu_came"] < 0.01
    assert readings.report["imu_count"] == 50
