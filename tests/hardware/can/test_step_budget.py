"""What shares a control step on CAN: computing, the parts of a command, and the answers to them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lab.in_process.can_link import EmulatedLink
from lab.in_process.sender_link import robot_on_can
from mimic.config.emulator import EmulateSettings
from mimic.emulator.robot import EmulatedRobot
from mimic.hardware.can.frame import CanFrame
from mimic.hardware.can.preflight import preflight
from mimic.hardware.can.step_budget import PARTS, SPARE, step_budget
from mimic.hardware.can.wiring import load_wiring
from mimic.hardware.motors.bus import MotorBus
from mimic.hardware.robot.checks import CheckOptions
from mimic.hardware.robot.plant import Robot
from mimic.records import JointCommand

DT = 0.02


class TimedLink(EmulatedLink):
    """Notes when commands are sent."""

    def __init__(self, robot: EmulatedRobot) -> None:
        super().__init__(robot)
        self.sent: list[float] = []

    def send(self, bus: int, frame: CanFrame) -> None:
        super().send(bus, frame)
        if frame.extended and frame.id >> 24 == 1:
            self.sent.append(self.now())


@pytest.fixture
def started(description) -> tuple[TimedLink, Robot, JointCommand]:
    link = TimedLink(EmulatedRobot(description, load_wiring(), EmulateSettings(zeroed=True)))
    link.sleep(0.1)
    plant = robot_on_can(link, load_wiring(), description)
    plant.start()
    link.sent.clear()
    zeros = np.zeros(12)
    lie = {"q_des": description.poses["lie"], "kp": np.full(12, 30.0), "kd": np.full(12, 3.0)}
    return link, plant, JointCommand(dq_des=zeros, tau_ff=zeros, ramp=DT, **lie)


def test_twelve_motors_on_one_bus_fit_and_the_sum_is_right():
    budget = step_budget(load_wiring(), DT, PARTS, inference=0.0005)
    assert budget.fits
    assert budget.computing + budget.bus + budget.spare == pytest.approx(DT)
    assert budget.bus < budget.dt


@pytest.mark.parametrize("more", [{"bitrate": 500_000}, {}])
def test_a_slow_bus_and_a_slow_computer_do_not_fit(more):
    wiring = replace(load_wiring(), **more)
    assert not step_budget(wiring, DT, PARTS, inference=0.0 if more else 0.008).fits


def test_two_buses_leave_more_to_spare():
    one, two = (step_budget(load_wiring(buses=buses), DT, PARTS).spare for buses in (1, 2))
    assert two > one + 0.004


def test_a_robot_whose_steps_do_not_fit_is_not_moved(description):
    link = EmulatedLink(EmulatedRobot(description, load_wiring(), EmulateSettings(zeroed=True)))
    link.sleep(0.1)
    for inference, verdict in ((0.0005, "ok"), (0.01, "stop")):
        options = CheckOptions(rate_hz=PARTS / DT, inference=inference)
        motor_bus = MotorBus(link, load_wiring())
        found = {c.name: c for c in preflight(motor_bus, description, options, trust_zeros=True)}
        assert found["control step"].verdict == verdict
    assert "Use more buses or a faster computer" in found["control step"].text


def test_the_parts_of_a_command_are_a_quarter_of_a_step_apart_and_the_step_ends_in_time(started):
    link, plant, command = started
    for _ in range(5):
        begin = link.now()
        health = plant.step(command).health
        assert sorted({round(t - begin, 4) for t in link.sent}) == [0.0, 0.005, 0.01, 0.015]
        assert health.late == pytest.approx(0.0, abs=1e-9)
        assert health.missed.max() == 0
        link.sent.clear()


@pytest.mark.parametrize(("computing", "times"), [(0.004, [0.004, 0.005, 0.01, 0.015]), (0.012, [0.012, 0.015])])
def test_computing_delays_no_part_but_those_whose_time_it_takes(computing, times, started):
    link, plant, command = started
    plant.step(command)
    for _ in range(5):
        begin = link.now()
        link.sleep(computing)
        link.sent.clear()
        health = plant.step(command).health
        assert sorted({round(t - begin, 4) for t in link.sent}) == times
        assert health.late == pytest.approx(0.0, abs=1e-9)
        assert health.missed.max() == 0


def test_a_step_that_begins_too_late_sends_the_whole_command_at_once_and_hears_its_answers(started):
    link, plant, command = started
    plant.step(command)
    link.sleep(0.019)
    link.sent.clear()
    health = plant.step(command).health
    assert len(link.sent) == 12
    assert 0.0 < health.late < 0.005 + SPARE
    assert health.missed.max() == 0
