"""A stock robot as a plant, on an emulated board in the board's own time: start, readings, faults, leaving."""

from __future__ import annotations

import numpy as np
import pytest

from lab.in_process.board_bus import EmulatedBoardBus
from lab.in_process.sender_link import EmulatedSenderLink
from mimic.config.emulator import EmulateSettings
from mimic.config.play import RunSettings
from mimic.control.loop import run_policy
from mimic.control.safety.supervisor import SafetyMode, Supervisor
from mimic.control.tick import Safety
from mimic.emulator.boards.board import EmulatedBoard
from mimic.emulator.faults import parse_fault
from mimic.errors import PlantError, SenderError
from mimic.hardware.robot.checks import CheckOptions, refuse
from mimic.hardware.robot.plant import Robot
from mimic.hardware.stock.driver import StockDriver
from mimic.hardware.stock.messages import MOTOR_CTRL
from mimic.hardware.stock.wiring import load_board
from mimic.policy.runtime import load_policy
from mimic.records import CommandTrack, JointCommand


@pytest.fixture
def made(description):
    """Return a function that makes an emulated board on its bus, and the plant."""

    def make(*faults: str, **settings):
        wiring = load_board()
        options = EmulateSettings(**{"placement": 0.02, **settings})
        board = EmulatedBoard(description, wiring, options, faults=[parse_fault(text) for text in faults])
        bus = EmulatedBoardBus(board)
        bus.listen(0.5)
        link = EmulatedSenderLink(StockDriver(bus, wiring, description, network="here"), description)
        return bus, Robot(link, description, suspended=options.suspended)

    return make


def hold(q, **more) -> JointCommand:
    zeros = np.zeros(12)
    values = {"dq_des": zeros, "kp": np.full(12, 30.0), "kd": np.full(12, 3.0), "tau_ff": zeros}
    return JointCommand(q_des=q, **{**values, **more})


def found_by(plant):
    return {check.name: check for check in plant.link.checks(CheckOptions(rate_hz=50.0))}


# ---------------------------------------------------------------------- pre-flight


def test_preflight_sends_nothing_and_passes_a_robot_that_lies(made, description):
    bus, plant = made()
    found = found_by(plant)
    assert [check.name for check in found.values() if check.verdict == "stop"] == []
    assert plant.link.driver.report["sent"] == 0
    assert bus.board.err_flag == 0


def test_preflight_finds_another_program(made, description):
    bus, plant = made()
    bus.hook = lambda t: bus.foreign(MOTOR_CTRL.encode())
    found = found_by(plant)
    assert found["other programs"].verdict == "stop"
    assert "another program commands this robot" in found["other programs"].text


@pytest.mark.slow
def test_preflight_finds_a_program_that_has_just_ended(made, description):
    bus, plant = made()
    for _ in range(1500):
        bus.board.take(MOTOR_CTRL.channel, MOTOR_CTRL.encode(), bus.now())
        bus.listen(bus.now() + 0.002)
    begin = bus.now()
    bus.hook = lambda t: t < begin + 1.3 and bus.board.take(MOTOR_CTRL.channel, MOTOR_CTRL.encode(), t)  # unseen here
    assert found_by(plant)["other programs"].verdict == "stop"


def test_preflight_refuses_a_silent_robot_in_one_line(made, description):
    _bus, plant = made("bus_off@0")
    found = plant.link.checks(CheckOptions(rate_hz=50.0))
    with pytest.raises(PlantError, match="no message came from the robot") as raised:
        refuse(found)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(("fault", "name"), [("imu_silent@0", "messages"), ("imu_tilted=0.5@0", "IMU and legs")])
def test_preflight_refuses_a_robot_without_a_sound_orientation(made, description, fault, name):
    _bus, plant = made(fault)
    assert found_by(plant)[name].verdict == "stop"


# ---------------------------------------------------------------------- start


def test_it_starts_through_error_2_and_reads_joints_orientation_temperature_and_flags(made, description):
    bus, plant = made()
    state = plant.start()
    assert bus.board.err_flag & 0x02 == 0
    assert 2.5 < bus.now() - 0.5 < 2.8
    np.testing.assert_allclose(state.q, bus.board.body.data.qpos[-12:], atol=5e-3)
    np.testing.assert_allclose(state.quat_WB, bus.board.body.data.qpos[3:7], atol=1e-3)
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


@pytest.mark.slow
def test_it_refuses_to_start_beside_another_program(made):
    bus, plant = made()
    bus.hook = lambda t: t > 2.0 and bus.foreign(MOTOR_CTRL.encode())
    with pytest.raises(PlantError, match="another program commands this robot"):
        plant.start()


def test_a_torque_limit_that_the_board_cannot_keep_is_refused(made, description):
    bus, _ = made()
    with pytest.raises(PlantError, match="no torque limit"):
        StockDriver(bus, load_board(), description, torque_limit=6.0)


# ---------------------------------------------------------------------- running


def test_readings_that_are_old_count_as_missing(made):
    bus, plant = made("frames_lost=1@+4-4.1")
    state = plant.start()
    ages, missing = [], []
    while bus.now() < 5.2:
        tick = plant.step(hold(np.nan_to_num(state.q)))
        ages.append(tick.health.age.max())
        missing.append((bool(np.isnan(tick.state.q).all()), int(tick.health.missed[0])))
    assert max(missing) in ((True, 4), (True, 5), (True, 6))
    assert missing[-1] == (False, 0)
    assert 0.08 < max(ages) < 0.12


@pytest.mark.slow
def test_the_boards_error_and_the_gap_are_in_the_health(made):
    bus, plant = made("frames_late=0.03@+3.4")
    state = plant.start()
    seen = [plant.step(hold(np.nan_to_num(state.q))).health for _ in range(60)]
    assert seen[0].err_flag == 0
    assert any(health.err_flag & 0x01 for health in seen) or bus.board.late_ticks == 0
    assert max(health.command_gap for health in seen) < 0.1


def test_commands_of_others_are_counted(made):
    bus, plant = made()
    state = plant.start()
    assert plant.step(hold(state.q)).health.foreign == 0
    bus.foreign(MOTOR_CTRL.encode(kp_des=[1.0] * 12))
    assert plant.step(hold(state.q)).health.foreign == 1


@pytest.mark.slow
def test_a_command_that_is_not_finite_is_not_sent(made):
    bus, plant = made()
    state = plant.start()
    sent = int(plant.link.driver.report["sent"])
    with pytest.raises(SenderError, match="not finite"):
        plant.step(hold(state.q, tau_ff=np.full(12, np.inf)))
    assert int(plant.link.driver.report["sent"]) > sent
    assert not bus.board.applied.kp.any()


@pytest.mark.slow
def test_closing_damps_and_ends_without_torque(made):
    bus, plant = made()
    state = plant.start()
    for _ in range(30):
        plant.step(hold(state.q))
    plant.close()
    assert plant.ending == "the robot was damped until it rested, and its motors are without torque"
    assert not any(values.any() for values in bus.board.applied[2:])
    plant.close()


# ---------------------------------------------------------------------- whole runs


def play(plant, description, ticks=50, sink=None):
    policy, down = load_policy(None, description), load_policy(None, description, task="sit_down")
    toes = np.array(policy.contract.neutral_toes).reshape(1, 2, 3)
    track = CommandTrack(
        t=np.arange(ticks) * description.dt,
        v=np.zeros((ticks, 2)),
        heading=np.zeros(ticks),
        p_BE=np.repeat(toes, ticks, axis=0),
    )
    safety = Safety(supervisor=Supervisor(description), ramp=1.0, tested=False)
    settings = RunSettings(hold_last=0.5, sit_down=2.0)
    return run_policy(plant, policy, track, settings, sit_down=down, safety=safety, sink=sink)


def upright(log) -> np.ndarray:
    w, x, y, z = log.quat_WB.T
    return 2.0 * (x * z - w * y)


@pytest.mark.slow
def test_the_shipped_policy_stands_up_holds_and_sits_down(made, description):
    bus, plant = made()
    late: list[int] = []
    done = play(plant, description, sink=lambda _: late.append(bus.board.late_ticks))
    assert [event.rule for event in done.events if event.mode > SafetyMode.RUN] == ["finished", "at_rest"]
    assert upright(done.log)[done.log.phase == 3].min() > 0.95
    assert abs(upright(done.log)[-1]) < 0.1
    assert late[-2] == 0  # in the last step the sender has ended


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "rule"),
    [
        ("motor_fault:RL_knee=8@+5", "motor_failed"),
        ("motor_hot:FR_hip=90@+5", "too_hot"),
        ("imu_silent@+5", "imu_silent"),
        ("imu_frozen@+5", "imu_silent"),
        ("bus_off@+5", "motor_silent"),
    ],
)
def test_a_standing_robot_is_brought_down_or_damped(made, description, fault, rule):
    bus, plant = made(fault)
    done = play(plant, description)
    decisive = next(event for event in done.events if event.mode > SafetyMode.RUN)
    assert decisive.rule == rule
    kp = bus.board.applied[2]
    assert not kp.any()
    assert plant.ending != "nothing was switched on"


@pytest.mark.slow
def test_another_program_makes_a_standing_robot_sit_down(made, description):
    bus, plant = made()
    bus.hook = lambda t: abs(t - 6.0) < 1e-6 and bus.foreign(MOTOR_CTRL.encode())
    done = play(plant, description)
    decisive = next(event for event in done.events if event.mode > SafetyMode.RUN)
    assert (decisive.rule, decisive.mode) == ("other_program", SafetyMode.SIT_DOWN)
    assert abs(upright(done.log)[-1]) < 0.1


@pytest.mark.slow
def test_losses_delays_and_overtaking_within_reason_do_not_end_a_run(made, description):
    _, plant = made("frames_lost=0.1@+4", "frames_late=0.004@+4", "frames_reordered=0.1@+4")
    done = play(plant, description)
    assert [event.rule for event in done.events if event.mode > SafetyMode.RUN] == ["finished", "at_rest"]
