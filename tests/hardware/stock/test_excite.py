"""Probing a suspended stock robot on an emulated board."""

from __future__ import annotations

import numpy as np
import pytest

from mimic.config.emulator import EmulateSettings
from mimic.config.hardware import ProbeSettings
from mimic.control.signals import Signals
from mimic.emulator.board import EmulatedBoard
from mimic.emulator.board_link import EmulatedBoardLink
from mimic.emulator.faults import parse_fault
from mimic.hardware.excite_motion import probe_motion
from mimic.hardware.stock.excite import probe_board
from mimic.hardware.stock.plant import StockRobot
from mimic.hardware.stock.wiring import load_board

pytestmark = pytest.mark.slow

SETTINGS = ProbeSettings(seconds=12.0, rate_hz=100.0, approach=1.0)


def probed(description, *faults, signals=None):
    wiring = load_board()
    board = EmulatedBoard(
        description, wiring, EmulateSettings(suspended=True), faults=[parse_fault(text) for text in faults]
    )
    link = EmulatedBoardLink(board, wiring, description)
    link.wait(0.5)
    robot = StockRobot(link, wiring, description, suspended=True)
    motion = probe_motion(description, SETTINGS)
    return robot, board, probe_board(robot, motion, SETTINGS, signals or Signals())


def test_it_logs_every_target_with_readings_of_that_moment(description):
    robot, board, result = probed(description)
    log = result.log
    assert result.ended is None
    assert result.missing == 0.0
    assert len(log.t) == 1200
    np.testing.assert_allclose(np.diff(log.t), 0.01, atol=1e-6)
    age = log.t - log.extra["t_receive.FL_hip"]
    assert 0.0 <= age.min() <= age.max() < 0.004
    moved = np.ptp(log.q, axis=0)
    assert np.all(moved > 0.2)
    assert np.sqrt(np.mean((log.q - log.q_des) ** 2)) < 0.15
    assert np.nanmax(np.abs(log.extra["tau_now.FL_knee"])) > 0.5
    assert not board.applied.kp.any()
    assert robot.ending.startswith("the robot was damped")


def test_a_motor_error_ends_it_damped_and_keeps_the_log(description):
    robot, board, result = probed(description, "motor_fault:FR_hip=8@+8")
    assert result.ended is not None
    assert "FR_hip" in result.ended.text
    assert 200 < len(result.log.t) < 700
    assert not board.applied.kp.any()
    assert robot.ending.startswith("the robot was damped")


def test_ctrl_c_ends_it_damped(description):
    signals = Signals()
    signals.interrupts = 1
    wiring = load_board()
    board = EmulatedBoard(description, wiring, EmulateSettings(suspended=True))
    link = EmulatedBoardLink(board, wiring, description)
    link.wait(0.5)
    robot = StockRobot(link, wiring, description, suspended=True)
    with pytest.raises(Exception, match="Ctrl-C"):
        probe_board(robot, probe_motion(description, SETTINGS), SETTINGS, signals)
    assert not board.applied.kp.any()
