"""A stock robot as a plant, on an emulated board in the board's own time: start, readings, faults, leaving."""

from __future__ import annotations

import numpy as np
import pytest

from mimic.config.emulator import EmulateSettings
from mimic.config.play import RunSettings
from mimic.control.loop import run_policy
from mimic.control.supervisor import SafetyMode, Supervisor
from mimic.control.tick import Safety
from mimic.emulator.board import EmulatedBoard
from mimic.emulator.board_link import EmulatedBoardLink
from mimic.emulator.faults import parse_fault
from mimic.errors import PlantError
from mimic.hardware.preflight import refuse
from mimic.hardware.stock.messages import MOTOR_CTRL
from mimic.hardware.stock.plant import StockRobot
from mimic.hardware.stock.preflight import board_preflight
from mimic.hardware.stock.wiring import load_board
from mimic.policy.runtime import load_policy
from mimic.records import CommandTrack, JointCommand


@pytest.fixture
def made(description):
    """Return a function that makes an emulated board, a link to it and the plant."""

    def make(*faults: str, **settings):
        wiring = load_board()
        options = EmulateSettings(**{"placement": 0.02, **settings})
        board = EmulatedBoard(description, wiring, options, faults=[parse_fault(text) for text in faults])
        link = EmulatedBoardLink(board, wiring, description)
        link.wait(0.5)
        return link, StockRobot(link, wiring, description, suspended=options.suspended)

    return make


def hold(q, **more) -> JointCommand:
    zeros = np.zeros(12)
    values = {"dq_des": zeros, "kp": np.full(12, 30.0), "kd": np.full(12, 3.0), "tau_ff": zeros}
    return JointCommand(q_des=q, **{**values, **more})


def findings(link, description, **more):
    return {check.name: check for check in board_preflight(link, description, "here", **more)}


# ---------------------------------------------------------------------- pre-flight


def test_preflight_sends_nothing_and_passes_a_robot_that_lies(made, description):
    link, _ = made()
    found = findings(link, description)
    assert [check.name for check in found.values() if check.verdict == "stop"] == []
    assert link.sender.readings.report["sent"] == 0
    assert link.board.err_flag == 0


def test_preflight_finds_another_program(made, description):
    link, _ = made()
    link.hook = lambda t: link.foreign(MOTOR_CTRL.encode())
    found = findings(link, description)
    assert found["other programs"].verdict == "stop"
    assert "another program commands this robot" in found["other programs"].text


@pytest.mark.slow
def test_preflight_finds_a_program_that_has_just_ended(made, description):
    link, _ = made()
    for _ in range(1500):
        link.board.receive(MOTOR_CTRL.encode(), link.now())
        link.wait(link.now() + 0.002)
    begin = link.now()
    link.hook = lambda t: t < begin + 1.3 and link.board.receive(MOTOR_CTRL.encode(), t)  # unseen here
    assert findings(link, description)["other programs"].verdict == "stop"


def test_preflight_refuses_a_silent_robot_in_one_line(made, description):
    link, _ = made("bus_off@0")
    found = board_preflight(link, description, "here")
    with pytest.raises(PlantError, match="no message came from the robot") as raised:
        refuse(found)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(("fault", "name"), [("imu_silent@0", "messages"), ("imu_tilted=0.5@0", "IMU and legs")])
def test_preflight_refuses_a_robot_without_a_sound_orientation(made, description, fault, name):
    link, _ = made(fault)
    assert findings(link, description)[name].verdict == "stop"


# ---------------------------------------------------------------------- start


def test_it_starts_through_error_2_and_reads_joints_orientation_temperature_and_flags(made, description):
    link, plant = made()
    state = plant.start()
    assert link.board.err_flag & 0x02 == 0
    assert 2.5 < link.now() - 0.5 < 2.8
    np.testing.assert_allclose(state.q, link.board.body.data.qpos[-12:], atol=5e-3)
    np.testing.assert_allclose(state.quat_WB, link.board.body.data.qpos[3:7], atol=1e-3)
    tick = plant.step(hold(state.q))
    assert tick.health.running.all()
    assert not tick.health.faults.any()
    assert np.all(tick.health.temperature > 20.0)
    assert tick.health.age.max() < 0.005
    assert tick.samples is not None
    assert len(tick.samples.t) == 10


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        ("mode_refused@0", "does not enter motor mode"),
        ("motor_fault:FL_knee=8@0", "motor FL_knee reports the error 0x8"),
        ("motor_hot:RR_hip=65@0", "motor RR_hip is at 65 degC"),
        ("imu_tilted=0.6@1.5", "the robot is tilted"),
        ("imu_silent@1.5", "no orientation comes"),
        ("bus_off@1.5", "error 0x02 of the robot does not clear"),
    ],
)
def test_it_refuses_to_start_and_says_why_in_one_line(made, fault, expected):
    _, plant = made(fault)
    with pytest.raises(PlantError, match=expected) as raised:
        plant.start()
    assert "\n" not in str(raised.value)


def test_a_sender_that_ends_before_the_robot_is_ready_is_named(made):
    link, plant = made()
    link.halted = True
    with pytest.raises(PlantError, match="the process that sends to the robot has ended"):
        plant.start()


@pytest.mark.slow
def test_it_refuses_to_start_beside_another_program(made):
    link, plant = made()
    link.hook = lambda t: t > 2.0 and link.foreign(MOTOR_CTRL.encode())
    with pytest.raises(PlantError, match="another program commands this robot"):
        plant.start()


def test_a_torque_limit_that_the_board_cannot_keep_is_refused(made, description):
    link, _ = made()
    with pytest.raises(PlantError, match="no torque limit"):
        StockRobot(link, load_board(), description, torque_limit=6.0)


# ---------------------------------------------------------------------- running


def test_readings_that_are_old_count_as_missing(made):
    link, plant = made("frames_lost=1@+4-4.1")
    state = plant.start()
    ages, missing = [], []
    while link.now() < 5.2:
        tick = plant.step(hold(np.nan_to_num(state.q)))
        ages.append(tick.health.age.max())
        missing.append((bool(np.isnan(tick.state.q).all()), int(tick.health.missed[0])))
    assert max(missing) in ((True, 4), (True, 5))
    assert missing[-1] == (False, 0)
    assert 0.08 < max(ages) < 0.12


@pytest.mark.slow
def test_no_message_for_a_quarter_of_a_second_ends_it_in_one_line(made):
    _, plant = made("bus_off@+3.5")
    state = plant.start()

    def go_on():
        for _ in range(200):
            plant.step(hold(state.q))

    with pytest.raises(PlantError, match=r"no message came from the robot for .* is the cable in place"):
        go_on()
    plant.close()
    assert "its firmware damps it by itself" in plant.ending


@pytest.mark.slow
def test_the_boards_error_and_the_gap_are_in_the_health(made):
    link, plant = made("frames_late=0.03@+3.4")
    state = plant.start()
    seen = [plant.step(hold(np.nan_to_num(state.q))).health for _ in range(60)]
    assert seen[0].err_flag == 0
    assert any(health.err_flag & 0x01 for health in seen) or link.board.late_ticks == 0
    assert max(health.command_gap for health in seen) < 0.1


def test_commands_of_others_are_counted(made):
    link, plant = made()
    state = plant.start()
    assert plant.step(hold(state.q)).health.foreign == 0
    link.foreign(MOTOR_CTRL.encode(kp_des=[1.0] * 12))
    assert plant.step(hold(state.q)).health.foreign == 1


@pytest.mark.slow
def test_a_command_that_is_not_finite_is_not_sent(made):
    link, plant = made()
    state = plant.start()
    sent = int(link.sender.readings.report["sent"])
    with pytest.raises(PlantError, match="not finite"):
        plant.step(hold(state.q, tau_ff=np.full(12, np.inf)))
    assert int(link.sender.readings.report["sent"]) == sent


@pytest.mark.slow
def test_closing_damps_and_ends_without_torque(made):
    link, plant = made()
    state = plant.start()
    for _ in range(30):
        plant.step(hold(state.q))
    plant.close()
    assert plant.ending == "the robot was damped until it rested, and its motors are without torque"
    assert not any(values.any() for values in link.board.applied[2:])
    plant.close()


# ---------------------------------------------------------------------- whole runs


def play(plant, description, ticks=50):
    policy, down = load_policy(None, description), load_policy(None, description, task="sit_down")
    toes = np.array(policy.contract.neutral_toes).reshape(1, 2, 3)
    track = CommandTrack(
        t=np.arange(ticks) * description.dt,
        v=np.zeros((ticks, 2)),
        heading=np.zeros(ticks),
        p_BE=np.repeat(toes, ticks, axis=0),
    )
    safety = Safety(supervisor=Supervisor(description))
    return run_policy(plant, policy, track, RunSettings(), sit_down=down, safety=safety)


def upright(log) -> np.ndarray:
    w, x, y, z = log.quat_WB.T
    return 2.0 * (x * z - w * y)


@pytest.mark.slow
def test_the_shipped_policy_stands_up_holds_and_sits_down(made, description):
    link, plant = made()
    done = play(plant, description)
    assert [event.rule for event in done.events if event.mode > SafetyMode.RUN] == ["finished", "at_rest"]
    assert upright(done.log)[done.log.phase == 3].min() > 0.95
    assert abs(upright(done.log)[-1]) < 0.1
    assert link.board.late_ticks == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "rule"),
    [
        ("motor_fault:RL_knee=8@+6", "motor_fault"),
        ("motor_hot:FR_hip=90@+6", "motor_hot"),
        ("imu_silent@+6", "imu_silent"),
        ("imu_frozen@+6", "imu_frozen"),
        ("imu_tilted=0.6@+6", "imu_contradicts_itself"),
        ("frames_lost=1@+6-6.3", "motor_silent"),
        ("bus_off@+6", "motor_silent"),
    ],
)
def test_a_standing_robot_is_brought_down_or_damped(made, description, fault, rule):
    link, plant = made(fault)
    done = play(plant, description)
    decisive = next(event for event in done.events if event.mode > SafetyMode.RUN)
    assert decisive.rule == rule
    kp = link.board.applied[2]
    assert not kp.any()
    assert plant.ending != "nothing was switched on"


@pytest.mark.slow
def test_another_program_makes_a_standing_robot_sit_down(made, description):
    link, plant = made()
    link.hook = lambda t: abs(t - 7.0) < 1e-6 and link.foreign(MOTOR_CTRL.encode())
    done = play(plant, description)
    decisive = next(event for event in done.events if event.mode > SafetyMode.RUN)
    assert (decisive.rule, decisive.mode) == ("foreign_commands", SafetyMode.SIT_DOWN)
    assert abs(upright(done.log)[-1]) < 0.1


@pytest.mark.slow
def test_losses_delays_and_overtaking_within_reason_do_not_end_a_run(made, description):
    _, plant = made("frames_lost=0.1@+5", "frames_late=0.004@+5", "frames_reordered=0.1@+5")
    done = play(plant, description)
    assert [event.rule for event in done.events if event.mode > SafetyMode.RUN] == ["finished", "at_rest"]
