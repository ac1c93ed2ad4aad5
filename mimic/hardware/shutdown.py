"""Shutdown: damp the robot until it rests, then switch its motors off, over whatever buses still work."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from mimic.control.damping import damping_command
from mimic.control.safety_limits import limits_for
from mimic.errors import BusError
from mimic.hardware.motor import MotorMode
from mimic.hardware.motor_bus import ALL, MotorBus
from mimic.records import JOINTS
from mimic.robot.description import RobotDescription

STOP_TRIES = 10
"""How often a stop is sent to a motor before it counts as unreachable."""


def damp(
    motor_bus: MotorBus, description: RobotDescription, beat: Callable[[], None], *, patience: float = np.inf
) -> None:
    """Damp every motor as much as it can until all that answer rest, for at most the robot's ``damp_seconds``.

    If one bus fails, the others are still served, and the failed one is tried again until the end.

    Args:
        motor_bus: With the motors.
        description: The robot.
        beat: Called every control step.
        patience: Give up when no bus has taken a frame for so long [s].

    Raises:
        BusError: If no frame could be sent in all that time, or for longer than the patience.
    """
    link, dt, limits = motor_bus.link, description.dt, limits_for(description)
    q, _, _ = motor_bus.readings(-np.inf)
    q = np.clip(np.where(np.isnan(q), description.poses["lie"], q), description.q_min, description.q_max)
    damping = damping_command(q, description.kd_max)
    began = rested = taken = link.now()
    sent = False
    while link.now() - began < limits.damp_seconds and link.now() - rested < limits.rest_seconds:
        beat()
        since = link.now()
        for joint in ALL:
            with suppress(BusError):
                motor_bus.command(damping, [joint])
                sent, taken = True, since
        if since - taken > patience:
            raise BusError("no bus takes frames any more")
        with suppress(BusError):
            motor_bus.listen(since + dt)
        link.sleep(max(since + dt - link.now(), 0.0))
        _, dq, _ = motor_bus.readings(since)
        if np.isnan(dq).all() or np.nanmax(np.abs(dq)) >= limits.rest_speed:
            rested = link.now()
    if not sent:
        raise BusError("no bus takes frames any more")


def switch_off(motor_bus: MotorBus, description: RobotDescription, beat: Callable[[], None]) -> list[int]:
    """Switch every motor off and return the joints whose motors did not confirm it."""
    link = motor_bus.link
    left, since = list(ALL), link.now()
    for _ in range(STOP_TRIES):
        beat()
        for joint in left:
            with suppress(BusError):
                motor_bus.send(joint, motor_bus.motors.stop(motor_bus.id(joint)))
        until = link.now() + description.dt
        with suppress(BusError):
            motor_bus.listen(until)
        link.sleep(max(until - link.now(), 0.0))
        left = [joint for joint in left if not _is_off(motor_bus, joint, since)]
        if not left:
            break
    return left


def _is_off(motor_bus: MotorBus, joint: int, since: float) -> bool:
    newest = motor_bus.feedback[joint]
    return newest is not None and motor_bus.came[joint] > since and newest.mode == MotorMode.OFF


def shutdown_report(left: list[int]) -> str:
    """Return how the robot was left, as a sentence without a full stop.

    Args:
        left: Joints whose motors did not confirm that they are off.
    """
    if not left:
        return "the robot was damped and all motors are off"
    names = "all motors" if len(left) == len(ALL) else ", ".join(JOINTS[j] for j in left)
    return f"damping was sent, but {names} did not confirm that they are off: cut the power"
