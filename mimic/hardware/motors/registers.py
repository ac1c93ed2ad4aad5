"""Asks all motors, and again where no answer comes: to switch on and off, for their zeros, ids and registers."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from mimic.errors import PlantError
from mimic.hardware.can.frame import CanFrame
from mimic.hardware.motors.bus import ALL, MotorBus
from mimic.hardware.motors.interface import MotorMode, Register
from mimic.records import JOINTS, FloatArray, joint_names

ANSWER_TIMEOUT = 0.05
"""A motor answers within a millisecond on a quiet bus; adapters and a busy computer take the rest [s]."""

TRIES = 4
"""How often a motor is asked before it counts as silent."""

READ_BACK_TOLERANCE = 1e-3
"""A register that reads back further away than this was not accepted."""


def ask(motor_bus: MotorBus, question: Callable[[int], CanFrame], answered: Callable[[int], bool]) -> list[int]:
    """Send a frame to every motor, again where no answer comes, and return the joints that stayed silent.

    Args:
        motor_bus: The motors.
        question: Frame to a motor's id.
        answered: Whether the motor of a joint has answered.
    """
    silent = list(ALL)
    for _ in range(TRIES):
        for joint in silent:
            motor_bus.send(joint, question(motor_bus.id(joint)))
        waiting = tuple(silent)
        end = motor_bus.link.now() + ANSWER_TIMEOUT
        motor_bus.listen(end, lambda waiting=waiting: all(map(answered, waiting)))
        silent = [joint for joint in silent if not answered(joint)]
        if not silent:
            break
    return silent


def _ask_feedback(motor_bus: MotorBus, question: Callable[[int], CanFrame]) -> list[int]:
    """Send a frame that every motor answers with a feedback; return the joints that stayed silent."""
    motor_bus.drain()
    since = motor_bus.link.now()
    return ask(motor_bus, question, lambda joint: motor_bus.came[joint] > since)


def need_all_off(motor_bus: MotorBus) -> None:
    """Switch the motors off.

    Raises:
        PlantError: If one does not answer.
    """
    need(stop(motor_bus))


def set_up(motor_bus: MotorBus, torque_limit: float) -> None:
    """Set the registers of motors that are off; the torque limit is in N m.

    Raises:
        PlantError: If a motor does not accept it.
    """
    facts = motor_bus.motors.facts
    if Register.CONTROL_MODE in facts.registers:  # only a motor that is off may change it
        set_register(motor_bus, Register.CONTROL_MODE, facts.impedance_mode)
    set_register(motor_bus, Register.TORQUE_LIMIT, torque_limit)
    set_host_timeout(motor_bus)


def set_host_timeout(motor_bus: MotorBus) -> bool:
    """Ask the motors to stop by themselves when no host sends anything; return whether all of them read it back."""
    value = motor_bus.motors.facts.host_timeout
    return bool(np.all(np.abs(write(motor_bus, Register.HOST_TIMEOUT, value) - value) < 0.5))


def switch_on(motor_bus: MotorBus) -> None:
    """Switch the motors on, where they are and without gains.

    Raises:
        PlantError: If one does not answer, or stays off.
    """
    need(_ask_feedback(motor_bus, motor_bus.motors.enable))
    off = motor_bus.in_other_mode(MotorMode.RUNNING)
    if off:
        raise PlantError(f"{off} did not switch on; to see why, run: mimic robot check")


def need(silent: Sequence[int]) -> None:
    """Raise a PlantError with the joints whose motors did not answer, if there are any."""
    if len(silent):
        raise PlantError(f"no answer from {joint_names(silent)}; is the power on? Run: mimic robot scan")


def stop(motor_bus: MotorBus) -> list[int]:
    """Switch every motor off; return the joints whose motors did not answer."""
    return _ask_feedback(motor_bus, motor_bus.motors.stop)


def set_zero(motor_bus: MotorBus) -> None:
    """Make the present position of every motor zero."""
    _ask_feedback(motor_bus, motor_bus.motors.set_zero)


def read_uids(motor_bus: MotorBus) -> dict[int, int]:
    """Return the unique number of the motor of each joint that answers."""
    motor_bus.uids.clear()
    ask(motor_bus, motor_bus.motors.ask_identity, lambda joint: joint in motor_bus.uids)
    return dict(motor_bus.uids)


def read(motor_bus: MotorBus, register: Register) -> FloatArray:
    """Return a register of every motor (12,); NaN where none answered, or the motors do not have it."""
    values = motor_bus.values
    for joint in ALL:
        values.pop((joint, register), None)
    motors = motor_bus.motors
    if register in motors.facts.registers:
        ask(motor_bus, lambda motor: motors.read(motor, register), lambda joint: (joint, register) in values)
    return np.array([values.get((joint, register), np.nan) for joint in ALL])


def write(motor_bus: MotorBus, register: Register, value: float) -> FloatArray:
    """Write a register of every motor and return what each reads back (12,); NaN if there is no such register."""
    motors = motor_bus.motors
    if register in motors.facts.registers:
        _ask_feedback(motor_bus, lambda motor: motors.write(motor, register, value))
    return read(motor_bus, register)


def set_register(motor_bus: MotorBus, register: Register, value: float) -> None:
    """Write a register of every motor and check that it was accepted.

    Raises:
        PlantError: If a motor does not read back what was written.
    """
    got = write(motor_bus, register, value)
    wrong = np.flatnonzero(~(np.abs(got - value) <= READ_BACK_TOLERANCE))
    if len(wrong):
        name = motor_bus.motors.facts.registers.get(register, f"{register}, which these motors do not have,")
        readings = ", ".join(f"{JOINTS[j]} reads {got[j]:g}" for j in wrong)
        raise PlantError(f"{name} was set to {value:g}, but {readings}; expected all twelve motors to accept it")
