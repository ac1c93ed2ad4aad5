"""Zeros on emulated motors, which forget them with the power and know their angle within a rotor turn only."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lab.in_process.can_link import EmulatedLink
from mimic.commissioning.homing import check_lying, home, joint_angles
from mimic.config.emulator import EmulateSettings
from mimic.dynamics.lying import sunk_pose
from mimic.emulator.faults import parse_fault
from mimic.emulator.robot import EmulatedRobot
from mimic.errors import AssetError, PlantError
from mimic.hardware.can.preflight import at_rest
from mimic.hardware.can.wiring import load_wiring
from mimic.hardware.can.zeros import LYING_TOLERANCE, read_homing, uneven, with_homing, zero_problems
from mimic.hardware.motors.bus import MotorBus
from mimic.hardware.motors.cybergear.codec import LIMIT_SPD
from mimic.hardware.robot.checks import refuse
from mimic.records import JOINTS

TURN = 2 * np.pi / 7.75


@pytest.fixture
def robot(description) -> EmulatedRobot:
    return EmulatedRobot(description, load_wiring(), EmulateSettings(placement=0.05, seed=4))


def exchange_of(robot: EmulatedRobot) -> MotorBus:
    motor_bus = MotorBus(EmulatedLink(robot), load_wiring())
    motor_bus.link.sleep(0.1)
    return motor_bus


def cycle_power(robot: EmulatedRobot) -> None:
    robot.body.held = True  # somebody keeps its legs where they are
    for joint in JOINTS:
        robot.inject(parse_fault(f"power_cycle:{joint}@{robot.now}"))
    robot.advance(robot.now + 0.2)


def truth(robot: EmulatedRobot) -> np.ndarray:
    return robot.body.data.qpos[7:].copy()


def test_a_robot_that_was_just_switched_on_is_not_zeroed(robot, description):
    motor_bus = exchange_of(robot)
    assert zero_problems(motor_bus, None)
    homing, _ = home(motor_bus, description, None)
    cycle_power(robot)
    problems = zero_problems(motor_bus, homing)
    assert len(problems) == 12
    assert "lost its zero" in problems[0]


def test_the_first_homing_takes_the_lying_pose_for_what_it_sees(robot, description):
    motor_bus = exchange_of(robot)
    homing, q = home(motor_bus, description, None)
    assert np.array_equal(q, description.poses["lie"])
    assert zero_problems(motor_bus, homing) == []
    known = with_homing(load_wiring(), homing)
    read = known.q_of(np.array([f.q for f in motor_bus.feedback]))
    assert np.abs(read - truth(robot)).max() < 0.055  # what the placement was off by


def test_a_later_homing_puts_joints_back_to_the_angles_of_the_first_one(robot, description):
    motor_bus = exchange_of(robot)
    homing, _ = home(motor_bus, description, None)
    before = truth(robot)
    error = description.poses["lie"] - before
    cycle_power(robot)
    moved = before + np.random.default_rng(0).uniform(-0.25, 0.25, 12)
    moved = np.clip(moved, description.q_min, description.q_max)
    robot.body.data.qpos[7:] = moved  # somebody laid it down differently
    again, q = home(motor_bus, description, homing)
    assert np.allclose(q, truth(robot) + error, atol=2e-3)
    assert zero_problems(motor_bus, again) == []
    assert again.mark != homing.mark
    assert zero_problems(motor_bus, homing)


def test_a_robot_that_sank_without_power_gets_its_zeros_where_it_lies(robot, description):
    motor_bus = exchange_of(robot)
    homing, _ = home(motor_bus, description, None)
    error = description.poses["lie"] - truth(robot)
    robot.advance(robot.now + 4.0)
    away = truth(robot) - description.poses["lie"]
    assert np.abs(away).max() > LYING_TOLERANCE
    cycle_power(robot)
    _, q = home(motor_bus, description, homing)
    assert np.allclose(q, truth(robot) + error, atol=2e-3)


@pytest.mark.parametrize("seed", range(20))
def test_a_robot_that_sank_is_told_from_one_whose_legs_are_folded(seed, description):
    rng, unknown = np.random.default_rng(seed), np.full(12, np.nan)
    for pose, most in ((description.poses["lie"], 0.3), (sunk_pose(description), 0.15)):
        q = np.clip(pose + rng.uniform(-most, most, 12), description.q_min, description.q_max)
        turns = rng.integers(-2, 3, 12)
        assert np.allclose(joint_angles(unknown, q + turns * TURN, description), q)
        check_lying(q, description)


def test_homing_twice_without_a_power_cycle_changes_nothing(robot, description):
    motor_bus = exchange_of(robot)
    first, q = home(motor_bus, description, None)
    second, again = home(motor_bus, description, first)
    assert np.allclose(again, q, atol=2e-3)
    assert np.allclose(second.phase, first.phase)


def test_a_motor_that_was_exchanged_is_reported_and_learnt_anew(robot, description):
    motor_bus = exchange_of(robot)
    homing, _ = home(motor_bus, description, None)
    other = dataclasses.replace(homing, uid=(homing.uid[0] + 1, *homing.uid[1:]))
    problems = zero_problems(motor_bus, other)
    assert len(problems) == 1
    assert "FL_abad has another motor" in problems[0]
    _, q = home(motor_bus, description, other)
    assert q[0] == description.poses["lie"][0]


def test_a_silent_motor_is_named(robot, description):
    robot.inject(parse_fault("motor_dead:RL_hip@0"))
    with pytest.raises(PlantError, match="no answer from RL_hip"):
        home(exchange_of(robot), description, None)


@pytest.mark.parametrize("joint", range(12))
@pytest.mark.parametrize("off", [0.45, -0.45, 0.8])
def test_a_joint_too_far_from_lying_is_refused_by_name(joint, off, description):
    q = description.poses["lie"].copy()
    q[joint] += off
    with pytest.raises(PlantError, match=JOINTS[joint]):
        check_lying(q, description)


def test_neighbours_that_differ_are_reported(description):
    q = description.poses["lie"].copy()
    assert uneven(q) == []
    q[1] += 0.3
    assert "FL_hip and FR_hip" in uneven(q)[0]
    q = description.poses["lie"].copy()
    q[[6, 9]] = 0.2, -0.2  # both outward
    assert uneven(q) == []


def test_what_is_known_comes_back_from_its_file(robot, description, tmp_path):
    homing, _ = home(exchange_of(robot), description, None)
    homing.save(tmp_path / "homing.json")
    read = read_homing(tmp_path / "homing.json")
    assert read.uid == homing.uid
    assert read.mark == homing.mark
    assert np.array_equal(read.offset, homing.offset)
    assert np.array_equal(read.phase, homing.phase, equal_nan=True)
    assert read_homing(tmp_path / "nowhere.json") is None


@pytest.mark.parametrize("text", ["", "[]", '{"uid": [1]}', "not json"])
def test_another_file_is_refused(text, tmp_path):
    (tmp_path / "homing.json").write_text(text)
    with pytest.raises(AssetError):
        read_homing(tmp_path / "homing.json")


@pytest.mark.parametrize("at_power_up", [0.0, 2.0, 30.0])
def test_whatever_the_motors_have_at_power_up_the_second_zero_is_that_of_the_first(at_power_up, description):
    first = EmulatedRobot(description, load_wiring(), EmulateSettings(placement=0.0, seed=4))
    motor_bus = exchange_of(first)
    for motor in first.motors:
        motor.values[LIMIT_SPD] = at_power_up
    homing, _ = home(motor_bus, description, None)
    cycle_power(first)
    for motor in first.motors:
        motor.values[LIMIT_SPD] = at_power_up
    moved = description.poses["lie"] + np.linspace(-0.25, 0.25, 12)
    first.body.data.qpos[7:] = moved
    assert len(zero_problems(motor_bus, homing)) == 12
    _, q = home(motor_bus, description, homing)
    assert np.abs(q - truth(first)).max() < 0.02


def test_a_zero_of_another_computer_is_not_built_upon(robot, description):
    motor_bus = exchange_of(robot)
    homing, _ = home(motor_bus, description, None)
    theirs, _ = home(motor_bus, description, homing)
    home(motor_bus, description, theirs)
    with pytest.raises(PlantError, match=r"FL_abad.*set by another computer.*power off and on"):
        home(motor_bus, description, homing)
    home(motor_bus, description, None)


@pytest.mark.parametrize(
    ("fault", "expected"),
    [("imu_tilted=0.4@0", "tilted by"), ("imu_silent@0", "silent|not sent"), ("imu_frozen@0.1", "repeated")],
)
def test_a_robot_that_does_not_lie_level_gets_no_first_zero(fault, expected, robot, description):
    robot.inject(parse_fault(fault))
    motor_bus = exchange_of(robot)
    motor_bus.link.sleep(0.2)
    with pytest.raises(PlantError, match=f"no zero was set.*({expected})"):
        refuse(at_rest(motor_bus, description), "no zero was set")


def test_a_robot_that_is_moved_gets_no_zero(robot, description):
    motor_bus = exchange_of(robot)
    assert at_rest(motor_bus, description)[0].verdict == "ok"
    listen = motor_bus.listen

    def moved(until, enough=None):
        if enough is None:
            robot.body.data.qpos[9] += 0.03
        return listen(until, enough)

    motor_bus.listen = moved
    with pytest.raises(PlantError, match="FL_knee moved by"):
        refuse(at_rest(motor_bus, description), "no zero was set")
