"""What must read back as it was written."""

from __future__ import annotations

import numpy as np
import pytest

from lab.in_process.can_link import EmulatedLink
from mimic.config.emulator import EmulateSettings
from mimic.emulator.robot import EmulatedRobot
from mimic.errors import PlantError
from mimic.hardware.can.wiring import load_wiring
from mimic.hardware.motors import registers
from mimic.hardware.motors.bus import MotorBus
from mimic.hardware.motors.interface import Register

WIRING = load_wiring()


@pytest.mark.parametrize("off", [0.01, -0.01, np.nan])
def test_a_motor_that_reads_back_another_value_than_was_written_is_refused(off, description, monkeypatch):
    robot = EmulatedRobot(description, WIRING, EmulateSettings(zeroed=True, placement=0.0))
    bus = MotorBus(EmulatedLink(robot), WIRING)
    registers.set_register(bus, Register.TORQUE_LIMIT, 9.0)
    read = registers.read(bus, Register.TORQUE_LIMIT)
    assert read == pytest.approx(np.full(12, 9.0))
    monkeypatch.setattr(
        registers, "write", lambda bus, register, value: np.where(np.arange(12) == 4, value + off, value)
    )
    with pytest.raises(PlantError, match=r"was set to 9, but FR_hip reads .*; expected all twelve motors to accept it"):
        registers.set_register(bus, Register.TORQUE_LIMIT, 9.0)
