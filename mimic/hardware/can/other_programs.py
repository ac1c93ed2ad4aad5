"""Listening before speaking: is another program driving the motors, or do they follow one that has ended?"""

from __future__ import annotations

import numpy as np

from mimic.errors import PlantError
from mimic.hardware.motors import registers
from mimic.hardware.motors.bus import MotorBus
from mimic.hardware.motors.interface import Register
from mimic.records import joint_names

LISTEN = 0.15
"""How long to listen [s]: seven control steps of another program."""

HOLDING = 0.5
"""Current in a motor that makes torque [A]; it gives 0.3 N m."""


def others(motor_bus: MotorBus) -> str:
    """Listen, and return what another program does on the buses, as a sentence; empty if nothing was heard.

    Nothing is sent.
    """
    before = motor_bus.foreign
    motor_bus.listen(motor_bus.link.now() + LISTEN)
    if motor_bus.foreign == before:
        return ""
    return (
        f"another program commands the motors ({motor_bus.foreign - before} frames in {LISTEN:g} s, the last "
        f"{motor_bus.foreign_text}); end it first"
    )


def holding(motor_bus: MotorBus) -> str:
    """Ask the motors, and return which of them hold a torque though nobody commands them; empty if none does.

    Asks for ids and currents only, which changes nothing in a motor.
    """
    current = registers.read(motor_bus, Register.CURRENT)
    on = np.flatnonzero(np.abs(current) > HOLDING)
    if not len(on):
        return ""
    strongest = float(np.nanmax(np.abs(current)))
    return (
        f"{joint_names(on)} hold a torque (up to {strongest:.1f} A), though nobody commands them: they follow the last "
        "command of a program that has ended. Support the robot, then run: mimic robot damp"
    )


def look_first(motor_bus: MotorBus) -> None:
    """Refuse to speak on buses on which motors are driven.

    Raises:
        PlantError: If another program commands the motors, or they hold a torque.
    """
    problem = others(motor_bus) or holding(motor_bus)
    if problem:
        raise PlantError(f"nothing was changed. {problem}")
