"""The robot on its bus, against emulated motors in a time of their own: what is sent, what is read, how it ends."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from lab.in_process.can_link import EmulatedLink
from lab.in_process.sender_link import robot_on_can
from mimic.config.emulator import EmulateSettings
from mimic.emulator.faults import parse_fault
from mimic.emulator.robot import EmulatedRobot
from mimic.errors import BusError, PlantError, SenderError
from mimic.hardware.can.wiring import load_wiring
from mimic.hardware.motors.cybergear.codec import CAN_TIMEOUT, LIMIT_TORQUE
from mimic.hardware.motors.interface import MotorMode
from mimic.hardware.robot.plant import Robot
from mimic.records import JOINTS, JointCommand


@pytest.fixture(params=[1, pytest.param(2, marks=pytest.mark.slow)])
def made(request, description):
    """Return a function that makes an emulated robot and the plant on it, on one bus or two."""

    def make(*faults: str, torque_limit=None, **settings):
        wiring = load_wiring(buses=request.param)
        options = EmulateSettings(**{"zeroed": True, "placement": 0.02, **settings})
        robot = EmulatedRobot(description, wiring, options, faults=[parse_fault(f) for f in faults])
        link = EmulatedLink(robot)
        link.sleep(0.1)
        return robot, robot_on_can(link, wiring, description, torque_limit=torque_limit)

    return make


def hold(description, q=None) -> JointCommand:
    zeros = np.zeros(12)
    q = description.poses["lie"] if q is None else q
    return JointCommand(q_des=q, dq_des=zeros, kp=description.kp, kd=description.kd, tau_ff=zeros)


def steps(plant, description, count: int = 10) -> None:
    for _ in range(count):
        plant.step(hold(description))


def modes(robot) -> set[MotorMode]:
    return {motor.mode for motor in robot.motors}


def test_it_starts_switched_on_without_gains_where_it_lies(made, description):
    robot, plant = made()
    state = plant.start()
    assert modes(robot) == {MotorMode.RUNNING}
    assert {motor.drive.kp for motor in robot.motors} == {0.0}
    assert np.abs(state.q - robot.body.data.qpos[7:]).max() < 2e-3
    assert np.abs(state.quat_WB - robot.body.data.qpos[3:7]).max() < 1e-3
    assert np.isnan(state.p_WB).all()


def test_its_torque_limit_is_in_the_motors(made):
    robot, plant = made(torque_limit=7.5)
    plant.start()
    assert {motor.values[LIMIT_TORQUE] for motor in robot.motors} == {7.5}


@pytest.mark.parametrize("honoured", [True, False])
def test_the_motors_own_timeout_is_set_where_they_take_it(honoured, made):
    robot, plant = made(can_timeout=honoured)
    plant.start()
    assert all((motor.values[CAN_TIMEOUT] > 0) is honoured for motor in robot.motors)


def test_every_step_lasts_a_control_step_and_brings_every_joint(made, description):
    _, plant = made()
    times = [plant.start().t]
    for _ in range(20):
        tick = plant.step(hold(description))
        times.append(tick.state.t)
        assert np.isfinite(tick.state.q).all()
        assert not tick.health.missed.any()
        assert tick.health.age.max() < description.dt
        assert tick.health.running.all()
        assert tick.health.late < 1e-6
    assert np.allclose(np.diff(times), description.dt, atol=1e-6)


def test_a_tick_records_the_command_as_the_frames_rounded_it(made, description):
    robot, plant = made()
    plant.start()
    asked = hold(description, description.poses["lie"] + np.linspace(-0.1, 0.1, 12))
    sent = plant.step(asked).sent
    assert not np.array_equal(sent.q_des, asked.q_des)
    assert np.abs(sent.q_des - asked.q_des).max() <= 4e-4
    assert np.abs(sent.kp - asked.kp).max() <= 8e-3
    for joint, motor in enumerate(robot.motors):
        sign, offset = plant.link.driver.motor_bus.wiring.sign[joint], plant.link.driver.motor_bus.wiring.offset[joint]
        assert motor.drive.q * sign + offset == pytest.approx(sent.q_des[joint], abs=1e-9)
        assert motor.drive.kp == pytest.approx(sent.kp[joint], abs=1e-9)
        assert motor.drive.kd == pytest.approx(sent.kd[joint], abs=1e-9)


def test_what_it_reads_is_what_the_joints_do(made, description):
    robot, plant = made(suspended=True)
    plant.start()
    target = description.poses["four"]
    for _ in range(60):
        state = plant.step(hold(description, target)).state
    truth = robot.body.data.qpos[-12:]
    assert np.abs(state.q - truth).max() < 0.01
    assert np.abs(state.q - target).max() < 0.2
    assert np.abs(state.tau).max() > 0.3


@pytest.mark.parametrize("joint", ["FL_abad", "RR_knee"])
def test_a_motor_that_does_not_answer_is_nan_and_its_age_grows(joint, made, description):
    robot, plant = made()
    plant.start()
    index = JOINTS.index(joint)
    robot.inject(parse_fault(f"motor_mute:{joint}@{robot.now}"))
    ages = []
    for number in range(1, 6):
        tick = plant.step(hold(description))
        assert np.isnan([tick.state.q[index], tick.state.dq[index], tick.state.tau[index]]).all()
        assert np.isfinite(np.delete(tick.state.q, index)).all()
        assert tick.health.missed[index] == number
        ages.append(tick.health.age[index])
    assert np.allclose(np.diff(ages), description.dt, atol=1e-6)


def test_an_answer_that_comes_back_counts_again(made, description):
    robot, plant = made()
    plant.start()
    robot.inject(parse_fault(f"motor_mute:FL_hip@{robot.now}-{robot.now + 0.05}"))
    missed = [int(plant.step(hold(description)).health.missed[1]) for _ in range(8)]
    assert max(missed) in (2, 3)
    assert missed[-1] == 0


def test_an_answer_that_is_late_by_a_step_is_not_taken_for_a_new_one(made, description):
    robot, plant = made()
    plant.start()
    robot.inject(parse_fault(f"stalled@{robot.now + 0.005}-{robot.now + 0.0399}"))
    seen = [plant.step(hold(description)) for _ in range(4)]
    assert seen[-1].health.missed.max() == 0
    stale = [tick for tick in seen if tick.health.missed.any()]
    assert stale
    for tick in stale:
        assert np.isnan(tick.state.q[tick.health.missed > 0]).all()


def test_faults_temperature_and_mode_are_reported(made, description):
    robot, plant = made()
    plant.start()
    robot.inject(parse_fault(f"motor_fault:RL_hip=16@{robot.now}"))
    robot.inject(parse_fault(f"motor_hot:FR_knee=66@{robot.now}"))
    for _ in range(3):
        health = plant.step(hold(description)).health
    assert health.faults[JOINTS.index("RL_hip")] & 16
    assert not health.running[JOINTS.index("RL_hip")]
    assert health.temperature[JOINTS.index("FR_knee")] == pytest.approx(66.0, abs=0.2)
    assert health.faults[JOINTS.index("FR_knee")] == 0


def test_an_imu_that_falls_silent_ages_and_is_nan(made, description):
    robot, plant = made("imu_silent@1.0")
    plant.start()
    while robot.now < 1.2:
        tick = plant.step(hold(description))
    assert tick.health.imu_age > 0.15
    assert np.isnan(tick.state.quat_WB).all()


def test_closing_damps_until_it_rests_and_switches_off(made, description):
    robot, plant = made()
    plant.start()
    for _ in range(25):
        plant.step(hold(description, description.poses["four"]))  # pushes itself up a little
    begin = robot.now
    plant.close()
    assert robot.now - begin < description.safety.damp_seconds - 1.0
    assert modes(robot) == {MotorMode.OFF}
    assert plant.ending == "the robot was damped and all motors are off"
    assert np.abs(robot.body.data.qvel[6:]).max() < 0.3
    before = robot.now
    plant.close()
    assert robot.now == before


@pytest.mark.slow
def test_it_brakes_with_all_that_the_motors_have(made, description):
    robot, plant = made()
    plant.start()
    for _ in range(25):
        plant.step(hold(description, description.poses["four"]))
    seen: list[tuple[float, float]] = []
    link = plant.link.driver.motor_bus.link
    receive = link.receive

    def look(timeout: float):
        seen.extend((motor.drive.kp, motor.drive.kd) for motor in robot.motors if motor.mode is MotorMode.RUNNING)
        return receive(timeout)

    link.receive = look
    plant.close()
    damped = [pair for pair in seen if pair[0] == 0.0]
    assert damped
    assert max(kd for _, kd in damped) == pytest.approx(5.0, abs=1e-3)


def test_a_plant_that_was_never_started_sends_nothing(made):
    robot, plant = made()
    before = robot.buses[0].frames
    plant.close()
    assert robot.buses[0].frames == before
    assert modes(robot) == {MotorMode.OFF}


@pytest.mark.parametrize("fault", ["motor_dead:FL_knee@0", "motor_deaf:RR_hip@0", "motor_mute:FL_abad@0"])
def test_a_motor_that_is_silent_at_the_start_is_named_and_nothing_is_switched_on(fault, made):
    robot, plant = made(fault)
    with pytest.raises(PlantError, match=fault.split(":")[1].split("@")[0]):
        plant.start()
    plant.close()
    assert modes(robot) == {MotorMode.OFF}


@pytest.mark.slow
def test_a_motor_with_a_fault_does_not_switch_on_and_the_others_are_switched_off_again(made):
    robot, plant = made("motor_fault:FL_knee=8@0")
    with pytest.raises(PlantError, match="FL_knee did not switch on"):
        plant.start()
    plant.close()
    assert modes(robot) == {MotorMode.OFF}


@pytest.mark.slow
def test_a_motor_that_dies_is_named_at_the_end_and_the_others_are_off(made, description):
    robot, plant = made()
    plant.start()
    robot.inject(parse_fault(f"motor_mute:FL_hip@{robot.now}"))
    plant.step(hold(description))
    plant.close()
    assert "FL_hip did not confirm" in plant.ending
    assert modes(robot) == {MotorMode.OFF}


def until_silent(plant, description, count: int = 10) -> list:
    """Drive until every motor has been silent for so many steps, and return the steps."""
    seen = []
    while not seen or int(seen[-1].health.missed.min()) < count:
        seen.append(plant.step(hold(description)))
    return seen


@pytest.mark.slow
def test_an_adapter_that_is_pulled_is_a_robot_whose_motors_are_silent_and_closing_says_what_is_left(made, description):
    robot, plant = made()
    plant.start()
    robot.inject(parse_fault(f"unplugged@{robot.now}"))
    seen = until_silent(plant, description)
    assert seen[-1].health.bus_errors > 0
    plant.close()
    assert "could not be stopped" in plant.ending
    assert "cut the power" in plant.ending


@pytest.mark.slow
def test_an_adapter_that_comes_back_is_used_to_stop(made, description):
    robot, plant = made()
    plant.start()
    robot.inject(parse_fault(f"unplugged@{robot.now}-{robot.now + 2.0}"))
    until_silent(plant, description)
    plant.close()
    assert modes(robot) == {MotorMode.OFF}


@pytest.mark.slow
def test_one_bus_that_fails_does_not_keep_the_other_from_being_stopped(description):
    wiring = load_wiring(buses=2)
    robot = EmulatedRobot(description, wiring, EmulateSettings(zeroed=True))
    link = EmulatedLink(robot)
    link.sleep(0.1)
    plant = robot_on_can(link, wiring, description)
    plant.start()
    robot.inject(parse_fault(f"unplugged:bus1@{robot.now}"))
    steps(plant, description)
    plant.close()
    off = {wiring.bus[j]: motor.mode for j, motor in enumerate(robot.motors)}
    assert off[0] is MotorMode.OFF
    assert plant.ending.startswith("FR_abad, FR_hip, FR_knee, RR_abad")
    assert "could not be stopped" in plant.ending


# ---------------------------------------------------------------------- buses that fail


@pytest.mark.parametrize("seconds", [pytest.param(0.03, marks=pytest.mark.slow), 0.08])
def test_a_bus_that_fails_for_a_moment_ends_nothing(seconds, made, description):
    robot, plant = made()
    plant.start()
    robot.inject(parse_fault(f"unplugged@{robot.now}-{robot.now + seconds}"))
    seen = [plant.step(hold(description)) for _ in range(10)]
    assert max(int(tick.health.missed.max()) for tick in seen) >= 1
    assert not seen[-1].health.missed.any()
    assert seen[-1].health.bus_errors > 0
    times = np.diff([tick.state.t for tick in seen])
    assert np.allclose(times, description.dt, atol=1e-6)
    plant.close()


@pytest.mark.slow
def test_a_bus_that_takes_no_frames_but_still_hears_is_opened_again_to_damp(description):
    robot = EmulatedRobot(description, load_wiring(), EmulateSettings(zeroed=True, placement=0.02))
    link, opened = EmulatedLink(robot), []

    def reopen(bus: int) -> None:
        opened.append(robot.now)
        if len(opened) == 3:
            del link.send

    link.reopen = reopen
    link.sleep(0.1)
    plant = robot_on_can(link, load_wiring(), description)
    plant.start()
    steps(plant, description)

    def refuse(bus: int, frame: object) -> None:
        raise BusError("it takes no frames")

    link.send = refuse
    begin = robot.now
    until_silent(plant, description, 5)
    plant.close()
    assert opened[0] - begin < 0.7
    assert len(opened) == 3
    assert modes(robot) == {MotorMode.OFF}
    assert plant.ending == "the robot was damped and all motors are off"


@pytest.mark.slow
def test_a_bus_that_says_nothing_but_still_takes_frames_is_damped_blindly(made, description):
    robot, plant = made()
    plant.start()
    for _ in range(25):
        plant.step(hold(description, description.poses["four"]))
    link = plant.link.driver.motor_bus.link

    def closed(timeout: float) -> None:
        raise BusError("it has closed the connection")

    link.receive = closed
    until_silent(plant, description, 5)
    plant.link.sender.finish()
    plant.link.wait(robot.now + 0.05)
    assert {motor.drive.kp for motor in robot.motors} == {0.0}
    assert max(motor.drive.kd for motor in robot.motors) == pytest.approx(5.0, abs=1e-3)
    plant.close()
    assert "did not confirm" in plant.ending


@pytest.mark.slow
def test_motors_on_a_bus_that_works_get_their_commands_while_another_fails(description):
    wiring = load_wiring(buses=2)
    robot = EmulatedRobot(description, wiring, EmulateSettings(zeroed=True, placement=0.02))
    plant = robot_on_can(EmulatedLink(robot), wiring, description)
    plant.link.driver.motor_bus.link.sleep(0.1)
    plant.start()
    robot.inject(parse_fault(f"unplugged:bus0@{robot.now}-{robot.now + 0.05}"))
    done = plant.step(hold(description))
    for joint, motor in enumerate(robot.motors):
        assert wiring.bus[joint] == 0 or motor.drive.kp == pytest.approx(description.kp[joint], abs=0.01)
    assert np.isnan(done.sent.q_des).all()
    plant.close()


def test_the_load_of_the_bus_is_what_it_was(made, description):
    robot, plant = made()
    plant.start()
    begin, bits = robot.now, [bus.bits for bus in robot.buses]
    for _ in range(100):
        plant.step(hold(description))
    real = [(bus.bits - b) / bus.bitrate / (robot.now - begin) for bus, b in zip(robot.buses, bits, strict=True)]
    assert plant.load() == pytest.approx(real, rel=0.03)


def test_a_start_without_a_reading_asks_for_nothing(description):
    orders = []
    link = Mock(problem="", left=False)
    link.now.return_value = 0.0
    link.wait.return_value = []
    link.order.side_effect = orders.append
    Robot(link, description).start()
    (command,) = (order.command for order in orders)
    assert np.isfinite(command.q_des).all()
    assert not np.any([command.kp, command.kd, command.tau_ff])


def test_an_interpolated_command_goes_out_in_four_parts_on_a_line(made, description):
    robot, plant = made()
    plant.start()
    lie = description.poses["lie"]
    plant.step(hold(description))
    targets = []
    drive = robot.body.drive
    robot.body.drive = lambda joint, command, t: (joint == 1 and targets.append(command.q), drive(joint, command, t))
    tick = plant.step(replace(hold(description, lie + 0.1), ramp=description.dt))
    plant.step(hold(description, lie + 0.1))
    np.testing.assert_allclose(np.diff(targets[:4]), 0.025, atol=1e-3)
    assert targets[3] - targets[0] == pytest.approx(0.075, abs=1e-3)
    assert (tick.sent.ramp, len(targets)) == (description.dt, 5)
    np.testing.assert_allclose(tick.sent.q_des, lie + 0.1, atol=1e-3)


@pytest.mark.slow
def test_voltage_and_the_time_of_answers_are_measured_while_it_runs(made, description):
    _, plant = made("under_voltage=19@1.0", "frames_late=0.02@2.0")
    plant.start()
    seen = [plant.step(hold(description)).health for _ in range(180)]
    assert seen[20].voltage == pytest.approx(24.0)
    assert 0.0005 < seen[20].round_trip < 0.008
    assert seen[-1].voltage == pytest.approx(19.0)
    assert seen[-1].round_trip == pytest.approx(0.04, abs=0.01)
    plant.close()


# ---------------------------------------------------------------------- a sender that hangs or is gone


@pytest.mark.slow
def test_a_sender_that_pauses_for_a_moment_is_seen_and_nothing_ages_meanwhile(made, description):
    _, plant = made()
    plant.start()
    steps(plant, description)
    plant.link.halted = True
    seen = [plant.step(hold(description)).health for _ in range(6)]
    plant.link.halted = False
    seen += [plant.step(hold(description)).health for _ in range(3)]
    ages = [health.sender_age for health in seen]
    assert 0.1 < max(ages) < 0.13
    assert ages[-1] < 0.005
    assert max(int(health.missed.max()) for health in seen) == 0
    assert max(health.imu_age for health in seen) < 0.03
    plant.close()


def test_a_sender_that_hangs_ends_the_run_within_a_fifth_of_a_second(made, description):
    robot, plant = made()
    plant.start()
    steps(plant, description)
    plant.link.halted = True
    begin = robot.now
    with pytest.raises(SenderError, match="hangs: it said nothing"):
        steps(plant, description, 20)
    assert robot.now - begin <= 0.22 + 1e-6
    plant.link.halted = False
    plant.close()
    assert modes(robot) == {MotorMode.OFF}


@pytest.mark.slow
def test_a_loop_that_hangs_loses_the_robot_to_the_sender(made, description):
    robot, plant = made()
    plant.start()
    for _ in range(25):
        plant.step(hold(description, description.poses["four"]))
    plant.link.wait(robot.now + 0.14)
    assert {motor.drive.kp for motor in robot.motors} == {0.0}
    with pytest.raises(SenderError, match=r"damped the robot: no order for 0\.10 s"):
        plant.step(hold(description))
    plant.close()
    assert modes(robot) == {MotorMode.OFF}


# ---------------------------------------------------------------------- a decision to damp is one message


class TornLink(EmulatedLink):
    """A link that stays broken once its adapter was pulled, until it is opened again with the adapter back."""

    torn = False

    def _look(self) -> None:
        self.torn = self.torn or self._robot.unplugged(0)
        if self.torn:
            raise BusError("the adapter is gone")

    def send(self, bus: int, frame) -> None:
        self._look()
        super().send(bus, frame)

    def receive(self, timeout: float):
        if self.torn or self._robot.unplugged(0):
            self.sleep(min(timeout, 0.002))
        self._look()
        return super().receive(timeout)

    def reopen(self, bus: int) -> None:
        self.torn = self._robot.unplugged(0)


@pytest.fixture
def standing_up(description):
    """Return an emulated robot and a plant that pushes it up."""
    robot = EmulatedRobot(description, load_wiring(), EmulateSettings(zeroed=True, placement=0.02))
    link = TornLink(robot)
    link.sleep(0.1)
    plant = robot_on_can(link, load_wiring(), description)
    plant.start()
    for _ in range(10):
        plant.step(hold(description, description.poses["four"]))
    assert robot.driven()
    return robot, plant


def damps(plant, description, seconds: float) -> float:
    """Have the robot damped for a time, and return when its last motor was driven [s]."""
    robot, last = plant.link.driver.motor_bus.link._robot, -np.inf
    end = robot.now + seconds
    while plant.damp() and robot.now < end:
        plant.step(hold(description))  # whatever is asked for
        last = robot.now if robot.driven() else last
    return last


@pytest.mark.slow
@pytest.mark.parametrize("out", [1.0, 5.0])
def test_an_adapter_that_was_out_damps_with_the_first_frames_that_get_through(out, standing_up, description):
    robot, plant = standing_up
    back = robot.now + out
    robot.inject(parse_fault(f"unplugged@{robot.now}-{back}"))
    until_silent(plant, description, 5)
    assert damps(plant, description, out + 0.3) - back < 0.15
    plant.close()
    assert plant.ending == "the robot was damped and all motors are off"


def test_a_bus_that_comes_back_is_opened_again_while_the_other_one_works(description):
    wiring, asked = load_wiring(buses=2), []
    robot = EmulatedRobot(description, wiring, EmulateSettings(zeroed=True, placement=0.02))
    link = EmulatedLink(robot)
    link.reopen = asked.append
    link.sleep(0.1)
    plant = robot_on_can(link, wiring, description)
    plant.start()
    robot.inject(parse_fault(f"unplugged:bus1@{robot.now}"))
    steps(plant, description, 6)
    damps(plant, description, 0.5)
    assert set(asked) == {1}


def test_damping_says_whether_a_sender_is_there(made, description):
    _, plant = made()
    assert not plant.damp()  # never started
    plant.start()
    assert plant.damp()
    assert plant.damp()
    plant.close()
    assert not plant.damp()


def test_what_damps_is_not_driven_by_any_later_command(standing_up, description):
    robot, plant = standing_up
    begin = robot.now
    assert damps(plant, description, 1.0) - begin < 0.03
    assert {motor.drive.kp for motor in robot.motors} == {0.0}
    plant.close()
    assert plant.ending == "the robot was damped and all motors are off"


def test_a_bus_that_changes_commands_while_it_damps_switches_the_motors_off(standing_up, description):
    robot, plant = standing_up
    link, draws = plant.link.driver.motor_bus.link, np.random.default_rng(3)
    send = link.send

    def change(bus: int, frame) -> None:
        data = bytearray(frame.data)
        if draws.random() < 0.3:
            data[draws.integers(8)] = draws.integers(256)
        send(bus, replace(frame, data=bytes(data)))

    link.send = change
    begin = robot.now
    assert damps(plant, description, 2.0) - begin < 0.35
    assert modes(robot) == {MotorMode.OFF}
    plant.close()
    assert plant.ending == "the robot was damped and all motors are off"


def test_a_motor_that_drives_itself_is_switched_off_while_the_others_damp(standing_up, description):
    robot, plant = standing_up
    robot.inject(parse_fault(f"motor_runaway:RL_hip=8@{robot.now}"))
    damps(plant, description, 0.4)
    off = [name for name, motor in zip(JOINTS, robot.motors, strict=True) if motor.mode is MotorMode.OFF]
    assert off == ["RL_hip"]
    plant.close()


def test_damping_alone_switches_no_motor_off(standing_up, description):
    robot, plant = standing_up
    damps(plant, description, 0.5)
    assert modes(robot) == {MotorMode.RUNNING}
    plant.close()


def test_a_robot_that_is_damped_goes_on_saying_how_it_moves(standing_up, description):
    _, plant = standing_up
    seen = []
    while plant.damp() and len(seen) < 40:
        seen.append(plant.step(hold(description)))
    assert all(np.isfinite(tick.state.dq).all() for tick in seen)
    assert {float(tick.sent.kp.max()) for tick in seen[1:]} == {0.0}


def disobeys(plant, description, *, damped: bool = False) -> str:
    """Drive, or damp, until the sender is ended; return why, once the robot is left damped."""
    robot = plant.link.driver.motor_bus.link._robot
    begin, way = robot.now, description.poses["four"] - description.poses["lie"]
    with pytest.raises(SenderError) as raised:  # noqa: PT012
        for step in range(50):
            if damped:
                plant.damp()
            plant.step(hold(description, description.poses["four"] - 0.02 * step * way))
    assert robot.now - begin < 0.15
    ended = robot.now
    plant.link.finish()
    assert not robot.driven()
    assert plant.link.driver.report["kp_sent"].max() == 0.0
    assert robot.now - ended < 10.0
    return str(raised.value)


@pytest.mark.slow
def test_a_sender_that_keeps_its_old_target_is_ended(standing_up, description):
    _, plant = standing_up
    sender, kept = plant.link.sender, plant.link.sender._order
    sender.order = lambda order: type(sender).order(sender, replace(order, command=kept.command))
    assert "other targets" in disobeys(plant, description)


@pytest.mark.slow
def test_a_sender_that_reports_and_sends_nothing_is_ended(standing_up, description):
    _, plant = standing_up
    driver = plant.link.driver
    driver.drive = lambda command: None
    assert "has sent nothing" in disobeys(plant, description)


@pytest.mark.slow
def test_a_sender_that_goes_on_driving_when_it_should_damp_is_ended(standing_up, description):
    _, plant = standing_up
    sender = plant.link.sender
    sender.finish, sender.damp = lambda: None, lambda reason: None
    order = sender._order
    send, sender._send = sender._send, lambda now: (sender.order(replace(order, begin=now)), send(now))
    assert "another stiffness" in disobeys(plant, description, damped=True)


@pytest.mark.parametrize(
    "place", ["drive", pytest.param("listen", marks=pytest.mark.slow), pytest.param("report", marks=pytest.mark.slow)]
)
def test_an_exception_that_nobody_expects_damps_and_says_where_it_was(place, standing_up, description, monkeypatch):
    robot, plant = standing_up
    kind, broken = type(plant.link.driver), iter([True])
    whole = getattr(kind, place)

    def fails(*args):
        if next(broken, False):
            raise KeyError("what")
        return whole.fget(*args) if place == "report" else whole(*args)

    monkeypatch.setattr(kind, place, property(fails) if place == "report" else fails)
    begin = robot.now
    with pytest.raises(SenderError, match=r"damped the robot: it failed: KeyError: 'what' \(test_plant\.py:\d+\)"):
        steps(plant, description)
    assert robot.now - begin < 0.05
    assert not robot.driven()
    plant.close()
    assert plant.ending == "the robot was damped and all motors are off"
    assert plant.link.sender.failure


@pytest.mark.slow
def test_a_sender_that_breaks_while_it_ends_leaves_the_robot_damped_and_says_what_it_does_not_know(
    standing_up, description, monkeypatch
):
    robot, plant = standing_up

    def fails(*_, **__):
        raise KeyError("what")

    monkeypatch.setattr(type(plant.link.driver), "end", fails)
    plant.close()
    assert not robot.driven()
    assert "how the robot was left is not known (KeyError" in plant.ending
    assert "cut the power" in plant.ending
