"""Getting at a robot: what is told when it ends before it began."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext

import pytest

from lab.in_process.can_link import EmulatedLink
from lab.in_process.sender_link import EmulatedSenderLink
from mimic.commissioning.homing import home
from mimic.config.emulator import EmulateSettings
from mimic.config.hardware import BusSettings
from mimic.emulator.faults import parse_fault
from mimic.emulator.robot import EmulatedRobot
from mimic.errors import BusError, PlantError
from mimic.hardware import session
from mimic.hardware.can import open_driver
from mimic.hardware.can.wiring import load_wiring
from mimic.hardware.motors.interface import MotorMode
from mimic.hardware.robot.plant import Robot


@pytest.fixture
def robot(description, monkeypatch, tmp_path) -> EmulatedRobot:
    """An emulated robot behind every word for a bus."""
    robot = EmulatedRobot(description, load_wiring(), EmulateSettings(zeroed=True))

    def opened(bus_url: str, wiring: object, **quick: bool) -> EmulatedLink:
        link = EmulatedLink(robot)
        link.sleep(0.2)
        return link

    def process(settings, description, *, keep=()):
        return EmulatedSenderLink(open_driver.open_can_driver(settings), description)

    for module in (session, open_driver):
        monkeypatch.setattr(module, "open_buses", opened)
    monkeypatch.setattr(session, "SenderProcess", process)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    return robot


def get_ready(description, then: Callable[[Robot], None]) -> None:
    """Do something with the robot once it is ready."""
    settings = BusSettings(zeroed=True, yes=True)
    options = {"rate_hz": 50.0, "report": lambda _: None, "go": lambda: None}
    with session.robot_session("can0", settings, description, **options) as plant:
        assert isinstance(plant, Robot)
        then(plant)


@pytest.mark.parametrize(("allowed", "lines"), [(True, 0), (False, 1)])
def test_a_computer_without_real_time_priority_is_said_at_the_start(allowed, lines, robot, description, monkeypatch):
    monkeypatch.setattr(session, "real_time", lambda priority: nullcontext(allowed))
    reports = []
    options = {"rate_hz": 50.0, "report": reports.append, "go": lambda: None}
    with session.robot_session("can0", BusSettings(zeroed=True, yes=True), description, **options):
        pass
    said = [check for check in reports[0] if check.name == "priority"]
    assert len(said) == lines
    assert all(check.verdict == "note" and "no real-time priority" in check.text for check in said)


@pytest.mark.parametrize("kind", [pytest.param(PlantError, marks=pytest.mark.slow), BusError])
def test_what_fails_while_motors_are_on_is_reported_with_how_they_were_left(kind, robot, description):
    def break_later(plant: Robot) -> None:
        plant.start()
        raise kind("it broke")

    with pytest.raises(PlantError, match="it broke; the robot was damped and all motors are off"):
        get_ready(description, break_later)
    assert {motor.mode for motor in robot.motors} == {MotorMode.OFF}


def test_a_motor_that_does_not_switch_on_is_reported_with_how_the_others_were_left(robot, description):
    def begin(plant: Robot) -> None:
        robot.inject(parse_fault("motor_mute:FL_knee@0"))
        plant.start()

    with pytest.raises(PlantError, match=r"no answer from FL_knee.*nothing was switched on"):
        get_ready(description, begin)
    assert {motor.mode for motor in robot.motors} == {MotorMode.OFF}


def test_what_fails_before_motors_are_on_says_so(robot, description):
    def break_at_once(plant: Robot) -> None:
        raise PlantError("it broke")

    with pytest.raises(PlantError, match="it broke; nothing was switched on"):
        get_ready(description, break_at_once)


@pytest.mark.parametrize(
    ("fault", "expected"),
    [("power_cycle:FL_knee", "zeros: .*FL_knee"), ("imu_invalid", "IMU: .*valid"), ("motor_fault:RR_hip", "RR_hip")],
)
def test_what_happens_while_the_person_is_asked_is_found_before_anything_moves(
    robot, description, monkeypatch, tmp_path, fault, expected
):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    settings = BusSettings(yes=True)
    with session.open_session("can0", settings, zeros=True) as opened:
        homing, _ = home(opened.motor_bus(), description, None)
        homing.save(open_driver.homing_file(opened.wiring))

    def go() -> None:
        robot.inject(parse_fault(f"{fault}@{robot.now + 0.01}"))
        robot.advance(robot.now + 1.0)

    reports = []
    options = {"rate_hz": 50.0, "report": reports.append, "go": go}
    with (
        pytest.raises(PlantError, match=rf"nothing was moved\. .*{expected}"),
        session.robot_session("can0", settings, description, **options) as plant,
    ):
        plant.start()
    assert not [check for check in reports[0] if check.verdict == "stop"]
    assert {motor.mode for motor in robot.motors} == {MotorMode.OFF}
