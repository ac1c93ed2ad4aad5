"""Switches the motors of a robot on, where they are and without gains."""

from __future__ import annotations

import numpy as np

from mimic.errors import PlantError
from mimic.hardware.motors import registers
from mimic.hardware.motors.bus import MotorBus
from mimic.hardware.motors.interface import MotorMode, Register
from mimic.records import JOINTS


def need_all_off(motor_bus: MotorBus) -> None:
    """Switch the motors off.

    Raises:
        PlantError: If one does not answer.
    """
    _need(registers.stop(motor_bus))


def set_up(motor_bus: MotorBus, torque_limit: float) -> None:
    """Set the registers of motors that are off; the torque limit is in N m.

    Raises:
        PlantError: If a motor does not accept it.
    """
    facts = motor_bus.motors.facts
    if Register.CONTROL_MODE in facts.registers:  # only a motor that is off may change it
        registers.set_register(motor_bus, Register.CONTROL_MODE, facts.impedance_mode)
    registers.set_register(motor_bus, Register.TORQUE_LIMIT, torque_limit)
    set_host_timeout(motor_bus)


def set_host_timeout(motor_bus: MotorBus) -> bool:
    """Ask the motors to stop by themselves when no host sends anything; return whether all of them read it back."""
    value = motor_bus.motors.facts.host_timeout
    return bool(np.all(np.abs(registers.write(motor_bus, Register.HOST_TIMEOUT, value) - value) < 0.5))


def switch_on(motor_bus: MotorBus) -> None:
    """Switch the motors on.

    Raises:
        PlantError: If one does not answer, or stays off.
    """
    _need(registers.enable(motor_bus))
    off = [JOINTS[j] for j, f in enumerate(motor_bus.feedback) if f is not None and f.mode != MotorMode.RUNNING]
    if off:
        raise PlantError(f"{', '.join(off)} did not switch on; to see why, run: mimic robot check")


def _need(silent: list[int]) -> None:
    if silent:
        names = ", ".join(JOINTS[j] for j in silent)
        raise PlantError(f"no answer from {names}; is the power on? Run: mimic robot scan")
