"""Probing an emulated robot that hangs: what is logged, that calibration takes it, and how it ends."""

from __future__ import annotations

import numpy as np
import pytest

from lab.in_process.board_bus import EmulatedBoardBus
from lab.in_process.can_link import EmulatedLink
from lab.in_process.sender_link import EmulatedSenderLink, robot_on_can
from mimic.commissioning.probe import probe, probe_motion, recorded_motion
from mimic.config.emulator import EmulateSettings
from mimic.config.hardware import ProbeSettings
from mimic.config.sysid import CalibrateSettings
from mimic.control.signals import Signals
from mimic.dynamics.excitation import hung_ranges
from mimic.dynamics.machine import hung_robot, with_gains
from mimic.emulator.boards.board import EmulatedBoard
from mimic.emulator.faults import parse_fault
from mimic.emulator.robot import EmulatedRobot
from mimic.errors import PlantError
from mimic.hardware.can.load import expected_load
from mimic.hardware.can.preflight import preflight
from mimic.hardware.can.wiring import load_wiring
from mimic.hardware.motors.interface import MotorMode
from mimic.hardware.robot.checks import CheckOptions
from mimic.hardware.robot.plant import Robot
from mimic.hardware.stock.driver import StockDriver
from mimic.hardware.stock.wiring import load_board
from mimic.io.joint_log import read_log, write_log
from mimic.records import JOINTS
from mimic.sysid.calibrate import calibrate
from mimic.sysid.log.checks import check_log

SHORT = ProbeSettings(seconds=14.0, rate_hz=100.0, approach=0.3)
"""The shortest that calibration takes."""

WIRING = load_wiring()

SLOW = ProbeSettings(seconds=14.0, rate_hz=50.0, approach=0.3)
"""The same with half of the frames."""

LESS = 200
"""Rows that are enough where calibration does not look."""


def made(description, *faults: str) -> tuple[EmulatedRobot, Robot]:
    options = EmulateSettings(zeroed=True, suspended=True)
    robot = EmulatedRobot(description, load_wiring(), options, faults=[parse_fault(f) for f in faults])
    link = EmulatedLink(robot)
    link.sleep(0.1)
    return robot, robot_on_can(link, load_wiring(), description)


def test_targets_stay_where_nothing_can_touch_and_every_joint_moves(description):
    motion = probe_motion(description, ProbeSettings(seconds=120.0, rate_hz=50.0))
    low, high, _ = hung_ranges(description)
    assert motion.shape == (6000, 12)
    assert np.all(motion >= low - 1e-12)
    assert np.all(motion <= high + 1e-12)
    assert np.all(np.ptp(motion, axis=0) > 0)


def test_a_recorded_run_is_played_inside_the_ranges_and_begins_anew(description):
    low, high, _ = hung_ranges(description)
    t = np.arange(100) * 0.02
    q = np.random.default_rng(0).uniform(-4, 4, (100, 12))
    motion = recorded_motion(t, q, description, SHORT)
    assert motion.shape == (1400, 12)
    assert np.all((motion >= low) & (motion <= high))
    assert np.allclose(motion[0], np.clip(q[0], low, high))
    assert np.allclose(motion[198], motion[0])  # 1.98 s later


@pytest.fixture(scope="module")
def probed(description):
    """A robot that answers late now and then, and the log of the shortest motion: the robot and the result."""
    robot, plant = made(description, "frames_late=0.004@+5-5.1")
    return robot, probe(plant, probe_motion(description, SLOW), SLOW, Signals(), wiring=WIRING)


@pytest.mark.slow
def test_the_log_is_one_that_calibration_takes(description, probed, tmp_path):
    robot, result = probed
    assert result.ended is None
    assert {motor.mode for motor in robot.motors} == {MotorMode.OFF}
    log = read_log(write_log(result.log, tmp_path / "probe.parquet"))
    machine = hung_robot(description)
    log = log.of(machine.joints)
    limits = np.stack([machine.low, machine.high], -1)
    facts = check_log(log, limits, unit=machine.unit)
    assert len(facts.log.t) == len(log.t) == round(SLOW.seconds * SLOW.rate_hz)
    assert log.rate == pytest.approx(SLOW.rate_hz, rel=1e-3)
    assert log.metadata["kp"] == SHORT.kp
    assert result.missing < 0.01
    assert np.nanmax(np.abs(log.q - log.q_des)) < 1.0
    for joint in JOINTS:
        came = np.isfinite(log.extra[f"t_receive.{joint}"])
        assert np.all((log.extra[f"t_receive.{joint}"] > log.extra[f"t_send.{joint}"])[came])
        assert np.all(log.extra[f"temperature.{joint}"][came] >= 24.0)
        assert np.nanmax(np.abs(log.extra[f"tau_now.{joint}"])) > 0.1
    assert log.tau is None
    assert log.extra["voltage"] == pytest.approx(24.0, abs=0.1)


@pytest.mark.slow
def test_calibration_of_a_probed_leg_that_lacks_nothing_names_nothing(description, probed):
    """The emulated motors act at any time within a step, tell rounded words, and answer late now and then."""
    leg = pytest.importorskip("lab.hidden_effects.suite").hung(JOINTS[6:9])
    log = probed[1].log.of(leg.joints)
    machine = with_gains(leg, log.metadata)
    facts = check_log(log, np.stack([machine.low, machine.high], -1))
    tried = CalibrateSettings(effects=("encoder_scale", "velocity_lag", "joint_delay"))
    result = calibrate(facts.log, machine, tried)
    assert result.names == ()
    assert np.sqrt(np.mean(result.final.held_out**2)) < 2e-4
    values = {e.name: e.values for e in result.effects}
    assert values["viscous"]["coefficient"] == pytest.approx(machine.model.dof_damping, rel=0.15)
    assert values["link_mass"]["factor"][1:] == pytest.approx([1.0, 1.0], abs=0.06)


@pytest.mark.slow
def test_the_bus_is_loaded_as_the_arithmetic_says(description):
    robot, plant = made(description)
    settings = ProbeSettings(seconds=40.0, rate_hz=200.0, approach=0.3)
    motion = probe_motion(description, settings)[: 2 * LESS]
    seen: list[tuple[float, int]] = []
    result = probe(
        plant,
        motion,
        settings,
        Signals(),
        wiring=WIRING,
        progress=lambda *_: seen.append((robot.now, robot.buses[0].bits)),
    )
    (begin, before), (end, after) = seen[0], seen[-1]
    expected = expected_load(WIRING, 200.0)
    assert (after - before) / WIRING.bitrate / (end - begin) == pytest.approx(expected[0], rel=0.05)
    assert result.load == pytest.approx(expected, rel=0.05)
    look = preflight(
        plant.link.driver.motor_bus, description, CheckOptions(rate_hz=200.0, suspended=True), trust_zeros=True
    )
    assert f"{expected[0]:.0%}" in look[0].text


@pytest.mark.slow
def test_readings_that_did_not_come_are_missing_and_not_repeated(description):
    _, plant = made(description, "frames_lost=0.05@1.4")
    result = probe(plant, probe_motion(description, SHORT)[:LESS], SHORT, Signals(), wiring=WIRING)
    assert 0.0 < result.missing < 0.2
    assert np.isnan(result.log.q).mean() == pytest.approx(result.missing)
    assert np.isnan(result.log.extra["t_receive.FL_hip"]).any()


def test_ctrl_c_damps_and_keeps_what_was_measured(description):
    robot, plant = made(description)
    signals = Signals()

    def press(done: int, total: int) -> None:
        signals.interrupts = 1 if done >= 100 else 0

    result = probe(plant, probe_motion(description, SHORT)[:LESS], SHORT, signals, wiring=WIRING, progress=press)
    assert result.ended is not None
    assert result.ended.rule == "asked_to_end"
    assert 100 <= len(result.log.t) <= 103
    assert {motor.mode for motor in robot.motors} == {MotorMode.OFF}


@pytest.mark.slow
@pytest.mark.parametrize(
    "fault",
    [
        "motor_dead:FL_knee@1.4",
        pytest.param("motor_fault:RR_hip=8@1.4", marks=pytest.mark.slow),
        pytest.param("motor_hot:FL_hip=75@1.4", marks=pytest.mark.slow),
    ],
)
def test_a_fault_damps_at_once_and_keeps_what_was_measured(fault, description):
    robot, plant = made(description, fault)
    result = probe(plant, probe_motion(description, SHORT)[:LESS], SHORT, Signals(), wiring=WIRING)
    assert result.ended is not None
    assert fault.split(":")[1][:6] in result.ended.text
    assert 10 < len(result.log.t) < LESS
    reached = [motor.mode for joint, motor in zip(JOINTS, robot.motors, strict=True) if joint not in fault]
    assert set(reached) == {MotorMode.OFF}


@pytest.mark.slow
def test_a_bus_that_fails_keeps_what_was_measured(description):
    _, plant = made(description, "unplugged@1.4-3")
    result = probe(plant, probe_motion(description, SHORT)[:LESS], SHORT, Signals(), wiring=WIRING)
    assert result.ended is not None
    assert result.ended.rule == "bus_errors"
    assert len(result.log.t) > 10


@pytest.mark.slow
def test_what_ends_before_anything_was_measured_is_an_error(description):
    _, plant = made(description, "motor_dead:FL_knee@0.3")
    with pytest.raises(PlantError, match="nothing was measured"):
        probe(plant, probe_motion(description, SHORT)[:LESS], SHORT, Signals(), wiring=WIRING)


BOARD = ProbeSettings(seconds=12.0, rate_hz=100.0, approach=0.3)


def on_board(description, *faults: str, suspended: bool = True) -> tuple[EmulatedBoard, Robot]:
    board = EmulatedBoard(
        description, load_board(), EmulateSettings(suspended=suspended), faults=[parse_fault(f) for f in faults]
    )
    bus = EmulatedBoardBus(board)
    bus.listen(0.5)
    link = EmulatedSenderLink(StockDriver(bus, load_board(), description), description)
    return board, Robot(link, description, suspended=suspended)


@pytest.mark.slow
def test_on_a_motion_board_every_row_has_every_joint(description):
    board, plant = on_board(description)
    result = probe(plant, probe_motion(description, BOARD)[:LESS], BOARD, Signals(), wiring=None)
    log = result.log
    assert (result.ended, result.missing, len(log.t), len(result.load)) == (None, 0.0, LESS, 0)
    np.testing.assert_allclose(np.diff(log.t), 0.01, atol=1e-6)
    delay = log.extra["t_receive.FL_hip"] - log.t
    assert 0.0 < np.nanmin(delay) <= np.nanmax(delay) <= 0.0101
    assert np.sqrt(np.mean((log.q - log.q_des) ** 2)) < 0.15
    assert not board.applied.kp.any()
    assert plant.ending.startswith("the robot was damped")


@pytest.mark.slow
def test_on_a_motion_board_a_motor_error_ends_it_damped_and_keeps_the_log(description):
    board, plant = on_board(description, "motor_fault:FR_hip=8@+4.5")
    result = probe(plant, probe_motion(description, BOARD)[:LESS], BOARD, Signals(), wiring=None)
    assert result.ended is not None
    assert "FR_hip" in result.ended.text
    assert 10 < len(result.log.t) < LESS
    assert not board.applied.kp.any()


@pytest.mark.slow
def test_a_quiet_imu_does_not_matter_to_a_robot_that_hangs(description):
    _, plant = made(description, "imu_silent@1.4")
    assert probe(plant, probe_motion(description, SHORT)[:LESS], SHORT, Signals(), wiring=WIRING).ended is None
