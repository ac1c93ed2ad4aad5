"""Pre-flight on an emulated robot: a healthy one passes, and each thing that is wrong is named."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lab.in_process.can_link import EmulatedLink
from mimic.commissioning.homing import home
from mimic.config.emulator import EmulateSettings
from mimic.emulator.faults import parse_fault
from mimic.emulator.robot import EmulatedRobot
from mimic.hardware.can.load import expected_load
from mimic.hardware.can.preflight import preflight
from mimic.hardware.can.wiring import load_wiring
from mimic.hardware.can.zeros import with_homing
from mimic.hardware.motors import registers
from mimic.hardware.motors.bus import MotorBus
from mimic.hardware.motors.interface import Register
from mimic.hardware.robot.checks import Check, CheckOptions, feet_normal

WIRING = load_wiring()


def look(description, *faults: str, wiring=WIRING, zeroed=True, trust=True, rate=50.0, q=None, **settings):
    settings = {"zeroed": zeroed, "placement": 0.03, **settings}
    robot = EmulatedRobot(description, WIRING, EmulateSettings(**settings), faults=[parse_fault(f) for f in faults])
    if q is not None:
        robot.body.data.qpos[7:] = q
    motor_bus = MotorBus(EmulatedLink(robot), wiring)
    motor_bus.link.sleep(0.2)
    found = preflight(motor_bus, description, CheckOptions(rate_hz=rate), trust_zeros=trust)
    assert all(motor.mode.name == "OFF" for motor in robot.motors)
    return {finding.name: finding for finding in found}


def stops(found: dict[str, Check]) -> list[str]:
    return [name for name, finding in found.items() if finding.verdict == "stop"]


def test_a_healthy_robot_passes_and_everything_is_reported(description):
    found = look(description)
    assert stops(found) == []
    assert set(found) == {
        "bus load",
        "motors",
        "temperature",
        "voltage",
        "position range",
        "zeros",
        "pose",
        "IMU",
        "IMU and legs",
        "own timeout",
        "other programs",
    }
    assert all(finding.text for finding in found.values())
    assert found["own timeout"].verdict == "note"


@pytest.mark.parametrize(
    ("fault", "name", "told"),
    [
        ("motor_dead:FL_knee@0", "motors", "FL_knee"),
        ("motor_mute:RR_abad@0", "motors", "RR_abad"),
        ("motor_fault:FR_hip=8@0", "motors", "FR_hip"),
        ("motor_hot:RL_knee=65@0", "temperature", "RL_knee"),
        ("under_voltage=14@0", "motors", "UNDER_VOLTAGE"),
        ("imu_silent@0", "IMU", "IMU"),
        ("imu_frozen@0.1", "IMU", "repeated"),
        ("imu_invalid@0", "IMU", "invalid"),
        ("imu_tilted=0.5@0", "IMU and legs", "tilted"),
        ("imu_tilted=0.24@0", "IMU and legs", "differ"),
    ],
)
def test_what_is_wrong_is_named(fault, name, told, description):
    found = look(description, fault)
    assert name in stops(found)
    assert told in found[name].text


def test_zeros_that_are_not_known_stop_it(description):
    found = look(description, zeroed=False, trust=False)
    assert "zeros" in stops(found)
    assert "mimic robot zero" in found["zeros"].text


def test_zeros_that_were_set_pass(description):
    robot = EmulatedRobot(description, WIRING, EmulateSettings(placement=0.02))
    motor_bus = MotorBus(EmulatedLink(robot), WIRING)
    motor_bus.link.sleep(0.2)
    homing, _ = home(motor_bus, description, None)
    motor_bus = MotorBus(EmulatedLink(robot), with_homing(WIRING, homing))
    motor_bus.link.sleep(3.0)  # nobody keeps its legs folded any more: it sinks
    found = preflight(motor_bus, description, CheckOptions(rate_hz=50.0), homing=homing)
    assert {f.name: f.verdict for f in found}["zeros"] == "ok"
    assert not [f for f in found if f.verdict == "stop"]


@pytest.mark.parametrize(("spread", "verdict"), [(1.4, "ok"), (1.6, "note")])
def test_motors_that_differ_in_their_supply_are_a_hint_at_the_wires(spread, verdict, description, monkeypatch):
    whole = registers.read

    def read(motor_bus: MotorBus, register: Register) -> np.ndarray:
        drop = spread * (np.arange(12) == 5) if register == Register.SUPPLY_VOLTAGE else 0.0
        return whole(motor_bus, register) - drop

    monkeypatch.setattr(registers, "read", read)
    found = look(description)["voltage"]
    assert found.verdict == verdict
    assert ("check the wires" in found.text) == (verdict == "note")


def test_a_robot_that_does_not_lie_is_stopped_with_the_joint_that_is_furthest_off(description):
    q = description.poses["lie"].copy()
    q[7] -= 0.7
    found = look(description, q=q)
    assert "pose" in stops(found)
    assert "RL_hip" in found["pose"].text


@pytest.mark.parametrize(("true", "verdict"), [(4 * np.pi, "ok"), (12.5, "stop")])
def test_another_position_range_than_the_wirings_is_found_far_from_zero(true, verdict, description):
    far = dataclasses.replace(WIRING, offset=WIRING.offset - 9.0 * WIRING.sign * np.ones(12))
    robot = EmulatedRobot(description, far, EmulateSettings(zeroed=True, position_range=true))
    motor_bus = MotorBus(EmulatedLink(robot), far)
    motor_bus.link.sleep(0.2)
    found = {f.name: f for f in preflight(motor_bus, description, CheckOptions(rate_hz=50.0), trust_zeros=True)}
    assert found["position range"].verdict == verdict, found["position range"].text


def test_near_zero_no_position_range_can_be_told(description):
    assert look(description)["position range"].verdict == "note"


def test_more_than_the_bus_carries_is_refused(description):
    assert "bus load" in stops(look(description, rate=260.0))
    assert "bus load" not in stops(look(description, rate=200.0))


def test_motors_that_take_their_timeout_are_reported(description):
    assert look(description, can_timeout=True)["own timeout"].verdict == "ok"


@pytest.mark.parametrize(("rate", "buses", "expected"), [(50.0, 1, 0.19), (200.0, 1, 0.69), (200.0, 2, 0.35)])
def test_the_load_is_that_of_the_arithmetic(rate, buses, expected):
    assert expected_load(load_wiring(buses=buses), rate).max() == pytest.approx(expected, abs=0.03)


@pytest.mark.parametrize("rate", [50.0, 100.0])
def test_the_load_of_an_emulated_bus_is_within_a_twentieth_of_the_arithmetic(rate, description):
    from mimic.records import JointCommand

    robot = EmulatedRobot(description, WIRING, EmulateSettings(zeroed=True, suspended=True))
    motor_bus = MotorBus(EmulatedLink(robot), WIRING)
    motor_bus.link.sleep(1.0)
    motor_bus.drain()
    rng, begin, before = np.random.default_rng(0), robot.now, robot.buses[0].bits
    seen = motor_bus.bits.copy()
    gains = np.full(12, 30.0), np.full(12, 3.0)
    for _ in range(int(2 * rate)):
        q = description.poses["lie"] + rng.uniform(-0.3, 0.3, 12)
        motor_bus.command(JointCommand(q_des=q, dq_des=np.zeros(12), kp=gains[0], kd=gains[1], tau_ff=np.zeros(12)))
        motor_bus.listen(motor_bus.link.now() + 1.0 / rate)
    seconds = robot.now - begin
    load = (robot.buses[0].bits - before) / WIRING.bitrate / seconds
    assert load == pytest.approx(expected_load(WIRING, rate)[0], rel=0.05)
    assert (motor_bus.bits - seen)[0] / WIRING.bitrate / seconds == pytest.approx(load, rel=0.01)


def test_four_feet_on_the_ground_point_up(description):
    assert np.allclose(feet_normal(description.poses["lie"], description), [0.0, 0.0, 1.0], atol=1e-6)
