"""The motors of a robot on an emulated bus: what is kept of their answers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lab.in_process.can_link import EmulatedLink
from mimic.config.emulator import EmulateSettings
from mimic.emulator.robot import EmulatedRobot
from mimic.hardware.can.wiring import load_wiring
from mimic.hardware.motors.bus import MotorBus

WIRING = load_wiring()


@pytest.fixture
def robot(description) -> EmulatedRobot:
    return EmulatedRobot(description, WIRING, EmulateSettings(zeroed=True, placement=0.0))


@pytest.mark.parametrize(("overhear", "kept"), [(True, [3]), (False, [])])
def test_what_a_motor_answers_to_another_computer_is_kept_only_where_that_is_wanted(overhear, kept, robot):
    bus = MotorBus(EmulatedLink(robot), WIRING, overhear=overhear)
    other = MotorBus(EmulatedLink(robot), dataclasses.replace(WIRING, host=WIRING.host - 1))
    other.send(3, other.motors.stop(other.id(3)))
    bus.listen(bus.link.now() + 0.02)
    assert [joint for joint, answer in enumerate(bus.feedback) if answer is not None] == kept
    assert list(np.flatnonzero(np.isfinite(bus.came))) == kept
    assert bus.foreign > 0
