"""Looking at a robot on CAN: what is shown, that nothing moves, and that it asks no more beside somebody else."""

from __future__ import annotations

import re

import numpy as np
import pytest

from lab.in_process.can_link import EmulatedLink
from lab.in_process.sender_link import robot_on_can
from mimic.commissioning.watching import Watcher
from mimic.config.emulator import EmulateSettings
from mimic.config.hardware import BusSettings
from mimic.control.plant import damping_command
from mimic.emulator.faults import parse_fault
from mimic.emulator.robot import EmulatedRobot
from mimic.flows.watching import watch_robot
from mimic.hardware import session
from mimic.hardware.bus_lock import bus_lock
from mimic.hardware.can.wiring import load_wiring
from mimic.hardware.motors.cybergear.codec import Codec, HostMessage, Kind
from mimic.hardware.motors.interface import MotorCommand, MotorMode
from mimic.records import JOINTS

CODEC = Codec()


@pytest.fixture
def robot(description, monkeypatch, tmp_path) -> EmulatedRobot:
    """An emulated robot behind every word for a bus."""
    robot = EmulatedRobot(description, load_wiring(), EmulateSettings(zeroed=True, placement=0.02))
    monkeypatch.setattr(session, "open_buses", lambda bus_url, wiring, **quick: EmulatedLink(robot))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    robot.advance(0.2)
    return robot


def orders(robot: EmulatedRobot) -> list[type]:
    """Record the kinds of what hosts send from now on."""
    kinds: list[type] = []
    send = robot.send

    def record(host, bus, frame, **more):
        kinds.append(getattr(CODEC.decode(frame), "kind", None))
        send(host, bus, frame, **more)

    robot.send = record
    return kinds


def test_it_shows_joints_orientation_temperatures_and_the_load_of_the_bus(robot):
    seen = []
    settings = BusSettings(zeroed=True)
    watch_robot("can0", settings, seconds=1.0, every=0.5, show=seen.append)
    assert len(seen) == 2
    assert np.abs(seen[-1].report["q"] - robot.body.data.qpos[7:]).max() < 2e-3
    assert np.isfinite(seen[-1].report["temperature"]).all()
    assert np.abs(seen[-1].rpy).max() < 0.02
    assert seen[-1].rates["orientation"] == pytest.approx(100, abs=10)
    assert re.fullmatch(r"bus load \d+%; 0 motors on", seen[-1].notes[0])
    assert {motor.mode for motor in robot.motors} == {MotorMode.OFF}


def test_a_motor_that_is_silent_and_an_imu_that_is_silent_are_shown_as_such(robot):
    robot.inject(parse_fault(f"motor_mute:FL_hip@{robot.now}"))
    robot.inject(parse_fault(f"imu_silent@{robot.now}"))
    seen = []
    watch_robot("can0", BusSettings(zeroed=True), seconds=0.6, every=0.3, show=seen.append)
    assert np.isnan(seen[-1].report["q"][JOINTS.index("FL_hip")])
    assert np.isfinite(np.delete(seen[-1].report["q"], 1)).all()
    assert any("IMU has been silent" in note for note in seen[-1].notes)


def test_zeros_that_are_not_known_are_said(robot, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    seen = []
    watch_robot("can0", seconds=0.3, every=0.3, show=seen.append)
    assert any("zeros were not set" in note for note in seen[-1].notes)


@pytest.mark.slow
def test_beside_a_program_that_drives_it_asks_nothing_and_shows_what_that_one_is_told(robot, description):
    plant = robot_on_can(EmulatedLink(robot), load_wiring(), description)
    plant.start()
    link = EmulatedLink(robot)

    class Beside:
        def receive(self, timeout: float):
            end, received = link.now() + timeout, link.receive(0.0)
            while received is None and link.now() < end:
                plant.step(damping_command(description.poses["lie"], 0.0))
                received = link.receive(0.0)
            return received

        def __getattr__(self, name: str):
            return getattr(link, name)

    kinds = orders(robot)
    watcher = Watcher(Beside(), load_wiring(), description, asks=True)
    watcher.listen(watcher.now() + 0.2)
    assert "another program commands" in watcher.only_listens
    assert Kind.STOP not in kinds
    assert np.isfinite(watcher.report["q"]).all()
    assert watcher.report["running"].sum() == 12
    plant.close()


def test_it_asks_no_more_once_another_program_begins(robot, description):
    other = EmulatedLink(robot)
    watcher = Watcher(EmulatedLink(robot), load_wiring(), description, asks=True)
    watcher.listen(watcher.now() + 0.2)
    assert not watcher.only_listens
    other.send(
        0,
        CODEC.encode(HostMessage(Kind.OPERATION, 3, command=MotorCommand(q=0.0, dq=0.0, kp=1.0, kd=1.0, tau=0.0))),
    )
    watcher.listen(watcher.now() + 0.1)
    kinds = orders(robot)
    watcher.listen(watcher.now() + 0.3)
    assert kinds == []
    assert "a command for motor 3" in watcher.only_listens


def test_a_bus_that_another_program_has_is_watched_without_a_question(robot):
    kinds, seen = orders(robot), []
    with bus_lock("can0"):
        watch_robot("can0", BusSettings(zeroed=True), seconds=0.3, every=0.3, show=seen.append)
    assert kinds == []
    assert any("only listening: another program of this computer" in note for note in seen[-1].notes)


@pytest.mark.slow
def test_the_pose_is_written_to_a_scene(robot, tmp_path):
    path = tmp_path / "watch.rrd"
    watch_robot("can0", BusSettings(zeroed=True), seconds=0.4, every=0.2, scene=path)
    assert path.stat().st_size > 10_000
