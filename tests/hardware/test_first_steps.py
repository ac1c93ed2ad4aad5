"""First steps with less risk: a dry run switches nothing on, and a rope limits what the robot may do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lab.in_process.can_link import EmulatedLink
from lab.in_process.sender_link import EmulatedSenderLink, robot_on_can
from mimic.config.emulator import EmulateSettings
from mimic.config.hardware import TETHER_RAMP, TETHER_TORQUE, BusSettings
from mimic.config.play import RunSettings
from mimic.control.loop import run_policy
from mimic.control.plant import damping_command
from mimic.control.safety.supervisor import SafetyMode, Supervisor
from mimic.control.tick import Safety
from mimic.emulator.faults import parse_fault
from mimic.emulator.robot import EmulatedRobot
from mimic.errors import ConfigError, PlantError
from mimic.evaluation.policy import command_script
from mimic.hardware import session
from mimic.hardware.can import open_driver
from mimic.hardware.can.wiring import load_wiring
from mimic.hardware.motors.cybergear.codec import LIMIT_TORQUE
from mimic.hardware.motors.interface import MotorMode
from mimic.policy.runtime import load_policy

SHORT = RunSettings(stand_up=1.0, blend=0.2, hold_last=0.1, sit_down=1.5)


@pytest.fixture
def robot(description, monkeypatch, tmp_path) -> EmulatedRobot:
    """An emulated robot behind every word for a bus."""
    robot = EmulatedRobot(description, load_wiring(), EmulateSettings(zeroed=True, placement=0.02))
    monkeypatch.setattr(open_driver, "open_buses", lambda bus_url, wiring, **quick: EmulatedLink(robot))

    def process(settings, description, *, keep=()):
        return EmulatedSenderLink(open_driver.open_can_driver(settings), description)

    monkeypatch.setattr(session, "SenderProcess", process)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    robot.advance(0.2)
    return robot


def ready(description, settings: BusSettings):
    options = {"rate_hz": 50.0, "report": lambda _: None, "go": lambda: None, "dry_run": settings.dry_run}
    return session.robot_session("can0", settings, description, **options)


def rehearse(plant, description):
    safety = Safety(supervisor=Supervisor(description, moves=False), ramp=0.4, tested=False, checked=False)
    track = command_script(description, 0.3, np.random.default_rng(0))
    sitter = load_policy(None, description, task="sit_down")
    return run_policy(plant, load_policy(None, description), track, SHORT, sit_down=sitter, safety=safety)


def test_a_dry_run_goes_through_every_phase_and_switches_no_motor_on(robot, description):
    modes, parameters = set(), [dict(motor.values) for motor in robot.motors]
    settings = BusSettings(zeroed=True, yes=True, dry_run=True)
    with ready(description, settings) as plant:
        step = plant.step
        plant.step = lambda command: (modes.update(motor.mode for motor in robot.motors), step(command))[1]
        result = rehearse(plant, description)
    assert modes == {MotorMode.OFF}
    assert [dict(motor.values) for motor in robot.motors] == parameters
    assert [event.rule for event in result.events] == ["finished", "at_rest"]
    assert len(set(result.log.phase)) == 7
    assert np.isfinite(result.log.q).all()
    assert np.all(result.log.kp.max(axis=0) == description.start.kp)  # what would have been sent
    assert np.abs(result.log.q - result.log.q[0]).max() < 0.01
    assert plant.ending == "dry run: nothing was switched on"
    assert not result.health.missed[:-1].any()  # in the last step the sender has ended


@pytest.mark.parametrize(("fault", "rule"), [("motor_mute:FL_hip", "motor_silent"), ("imu_silent", "imu_silent")])
def test_a_dry_run_finds_what_is_broken(fault, rule, robot, description):
    settings = BusSettings(zeroed=True, yes=True, dry_run=True)
    with ready(description, settings) as plant:
        robot.inject(parse_fault(f"{fault}@{robot.now + 0.6}"))
        result = rehearse(plant, description)
    assert next(event.rule for event in result.events if event.mode > SafetyMode.RUN) == rule
    assert {motor.mode for motor in robot.motors} == {MotorMode.OFF}


def test_a_dry_run_refuses_a_command_that_is_no_number(robot, description):
    plant = robot_on_can(EmulatedLink(robot), load_wiring(), description, dry_run=True)
    plant.start()
    with pytest.raises(PlantError, match="not finite"):
        plant.step(replace(damping_command(description.poses["lie"], 0.0), tau_ff=np.full(12, np.nan)))


def test_a_stock_robot_has_no_dry_run(description):
    options = {"rate_hz": 50.0, "report": lambda _: None, "go": lambda: None, "dry_run": True}
    with (
        pytest.raises(ConfigError, match="--dry-run is for motors on CAN"),
        session.robot_session("cyberdog2", BusSettings(), description, **options),
    ):
        pass


@pytest.mark.slow
@pytest.mark.parametrize(("asked", "torque"), [(None, TETHER_TORQUE), (5.0, 5.0)])
def test_on_a_rope_the_motors_have_less_torque(asked, torque, robot, description):
    settings = BusSettings(zeroed=True, yes=True, tether=True, torque_limit=asked)
    with ready(description, settings) as plant:
        plant.start()
        assert {motor.values[LIMIT_TORQUE] for motor in robot.motors} == {torque}


def test_on_a_rope_the_start_takes_longer():
    assert BusSettings(tether=True).start_ramp == TETHER_RAMP
    assert BusSettings(tether=True, ramp=10.0).start_ramp == 10.0
    assert BusSettings(ramp=3.0).start_ramp == 3.0
    assert BusSettings().torque is None
