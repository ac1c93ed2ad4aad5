"""The motors of a robot on an emulated bus: what is kept of their answers, and what must read back as written."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mimic.config.emulator import EmulateSettings
from mimic.emulator.link import EmulatedLink
from mimic.emulator.robot import EmulatedRobot
from mimic.errors import PlantError
from mimic.hardware.can.wiring import load_wiring
from mimic.hardware.motors.bus import MotorBus
from mimic.hardware.motors.interface import Register

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


@pytest.mark.parametrize("off", [0.01, -0.01, np.nan])
def test_a_motor_that_reads_back_another_value_than_was_written_is_refused(off, robot, monkeypatch):
    bus = MotorBus(EmulatedLink(robot), WIRING)
    bus.set(Register.TORQUE_LIMIT, 9.0)
    read = bus.read(Register.TORQUE_LIMIT)
    assert read == pytest.approx(np.full(12, 9.0))
    monkeypatch.setattr(bus, "write", lambda register, value: np.where(np.arange(12) == 4, value + off, value))
    with pytest.raises(PlantError, match=r"was set to 9, but FR_hip reads .*; expected all twelve motors to accept it"):
        bus.set(Register.TORQUE_LIMIT, 9.0)
