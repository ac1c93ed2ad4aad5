"""The guided check of a wiring: the test plays the person who moves the joints and tilts the trunk."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lab.in_process.can_link import EmulatedLink
from mimic.commissioning import wire_check
from mimic.commissioning.wire_check import mounting
from mimic.config.emulator import EmulateSettings
from mimic.config.hardware import BusSettings
from mimic.emulator.faults import parse_fault
from mimic.emulator.robot import EmulatedRobot
from mimic.errors import ConfigError, PlantError
from mimic.flows.robot.wiring import wire_robot
from mimic.hardware import session
from mimic.hardware.can.wiring import Wiring, load_wiring
from mimic.hardware.motors.interface import MotorMode
from mimic.records import JOINTS

SEED = np.random.default_rng(5)


def other_wiring() -> Wiring:
    """Return a wiring that differs from the shipped one in ids, signs and the IMU's mounting."""
    wiring = load_wiring()
    quat = Rotation.from_euler("ZX", [90, 180], degrees=True).as_quat(scalar_first=True)
    return dataclasses.replace(
        wiring,
        motor=SEED.permutation(np.arange(20, 32)),
        sign=SEED.choice([-1.0, 1.0], 12),
        imu=dataclasses.replace(wiring.imu, quat_BI=quat),
    )


class Person:
    """Does what it is told, or what a test says instead."""

    def __init__(self, robot: EmulatedRobot, instead: dict[str, Callable[[EmulatedRobot], None]] | None = None) -> None:
        self.robot, self.instead, self.heard = robot, instead or {}, []

    def __call__(self, text: str) -> None:
        self.heard.append(text)
        qpos = self.robot.body.data.qpos
        word = text.split(":")[0]
        for key, act in self.instead.items():
            if text.startswith(key):
                return act(self.robot)
        if word in JOINTS:
            qpos[7 + JOINTS.index(word)] += 0.35
        elif "lift the nose" in text:
            qpos[3:7] = Rotation.from_euler("Y", -0.5).as_quat(scalar_first=True)
        elif "roll it to its left" in text:
            qpos[3:7] = Rotation.from_euler("X", -0.5).as_quat(scalar_first=True)
        elif "level" in text:
            qpos[3:7] = 1.0, 0.0, 0.0, 0.0


@pytest.fixture
def found_by(description, monkeypatch, tmp_path):
    """Return a function that lets a person wire a robot that is wired in some way."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(wire_check, "PATIENCE", 5.0)

    def wire(wiring: Wiring, *faults: str, **instead):
        settings = EmulateSettings(zeroed=True, placement=0.02, imu_noise=0.0005)
        robot = EmulatedRobot(description, wiring, settings, faults=[parse_fault(text) for text in faults])
        monkeypatch.setattr(session, "open_buses", lambda bus_url, given: EmulatedLink(robot))
        robot.advance(0.2)
        person = Person(robot, instead.get("instead"))
        buses = ",".join(f"can{i}" for i in range(wiring.buses))
        try:
            return wire_robot(buses, tmp_path / "wiring.toml", BusSettings(zeroed=True), say=person), robot
        finally:
            assert {motor.mode for motor in robot.motors} == {MotorMode.OFF}

    return wire


def test_a_robot_that_is_wired_as_the_file_says_agrees_with_it(found_by):
    done, _ = found_by(load_wiring())
    assert done.differences == []


@pytest.mark.parametrize("buses", [1, 2])
def test_the_file_that_is_written_is_the_true_wiring(buses, found_by):
    shipped = load_wiring(buses=buses)
    true = other_wiring() if buses == 1 else dataclasses.replace(shipped, bus=1 - shipped.bus)
    done, _ = found_by(true)
    for name in ("bus", "motor", "sign"):
        assert np.array_equal(getattr(done.wiring, name), getattr(true, name)), name
    assert abs(done.wiring.imu.quat_BI @ true.imu.quat_BI) == pytest.approx(1.0, abs=1e-6)
    assert np.abs(done.wiring.offset - shipped.offset).max() < 1e-4
    assert done.wiring.imu.rate == shipped.imu.rate
    assert done.differences


def test_a_swapped_sign_is_named(found_by):
    wiring = load_wiring()
    sign = wiring.sign.copy()
    sign[JOINTS.index("RL_hip")] *= -1
    done, _ = found_by(dataclasses.replace(wiring, sign=sign))
    assert len(done.differences) == 1
    assert "RL_hip is motor 8 on bus 0" in done.differences[0]


def move(*joints: str) -> Callable[[EmulatedRobot], None]:
    def act(robot: EmulatedRobot) -> None:
        for joint in joints:
            robot.body.data.qpos[7 + JOINTS.index(joint)] += 0.35

    return act


def tilt(axis: str, angle: float) -> Callable[[EmulatedRobot], None]:
    def act(robot: EmulatedRobot) -> None:
        robot.body.data.qpos[3:7] = Rotation.from_euler(axis, angle).as_quat(scalar_first=True)

    return act


@pytest.mark.parametrize(
    ("instead", "expected"),
    [
        ({"FR_abad": move("FL_hip")}, "FR_abad: motor 2 on .* turned, which turned for FL_hip already"),
        ({"FR_abad": move("FR_abad", "FR_hip")}, "turned together; move this joint alone"),
        ({"RR_knee": lambda robot: None}, "nothing was seen for 5 s"),
        pytest.param({"IMU: lift the nose": tilt("X", 0.5)}, "the two tilts are .* deg apart", marks=pytest.mark.slow),
        ({"IMU: lift the nose": tilt("Y", 0.5)}, "mirror image"),
        pytest.param({"IMU: roll it to its left": tilt("X", 0.5)}, "mirror image", marks=pytest.mark.slow),
        pytest.param({"IMU: lift the nose": tilt("Z", 0.5)}, "nothing was seen", marks=pytest.mark.slow),
    ],
)
def test_what_contradicts_itself_is_refused_and_no_file_is_written(instead, expected, found_by, tmp_path):
    with pytest.raises(PlantError, match=expected):
        found_by(load_wiring(), instead=instead)
    assert not (tmp_path / "wiring.toml").exists()


@pytest.mark.parametrize(
    ("fault", "expected"), [("motor_dead:FL_knee@0", "11 motors answer"), ("imu_silent@0", "IMU is heard on 0 buses")]
)
def test_a_robot_that_is_not_whole_is_refused(fault, expected, found_by):
    with pytest.raises(PlantError, match=expected):
        found_by(load_wiring(), fault)


def test_a_file_that_exists_is_not_overwritten(found_by, tmp_path):
    (tmp_path / "wiring.toml").write_text("mine")
    with pytest.raises(ConfigError, match="exists"):
        found_by(load_wiring())


@pytest.mark.parametrize("turn", [Rotation.random(random_state=seed) for seed in range(8)])
def test_any_mounting_is_found_from_two_tilts_and_gravity(turn):
    axes = turn.inv().apply(np.eye(3))  # of the base, in those of the IMU
    quat = mounting(axes[2], -axes[1], -axes[0])
    error = (Rotation.from_quat(quat, scalar_first=True) * turn.inv()).magnitude()
    assert error < np.deg2rad(15.1)


def test_a_mounting_close_to_right_angles_is_taken_for_one():
    skew = Rotation.from_euler("XYZ", [4, -5, 3], degrees=True)
    axes = skew.apply(np.eye(3))
    assert np.allclose(mounting(axes[2], -axes[1], -axes[0]), [1, 0, 0, 0])
