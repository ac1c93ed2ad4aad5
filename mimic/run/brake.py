"""The end of everything: damp the robot until it rests, then switch its motors off, whatever still works of its buses."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from mimic.errors import BusError
from mimic.robot.description import RobotDescription
from mimic.run.exchange import ALL, Exchange
from mimic.run.motor_messages import Mode, Stop
from mimic.run.safety_rules import LIMITS
from mimic.types import JOINTS, FloatArray, JointCommand

STOP_TRIES = 10
"""How often a motor is told to stop before it counts as not to be reached."""


def damping_command(q: FloatArray, kd: float) -> JointCommand:
    """Return the command that only brakes: no stiffness, velocity gain kd [N m s/rad]."""
    zeros = np.zeros_like(q)
    return JointCommand(q_des=q.copy(), dq_des=zeros, kp=zeros, kd=np.full_like(q, kd), tau_ff=zeros)


def damp(exchange: Exchange, description: RobotDescription, beat: Callable[[], None]) -> None:
    """Brake every motor as hard as it can until all that answer rest, for ``LIMITS.damp_seconds`` at most.

    A bus that fails does not keep the others from being told, and is tried again to the end.

    Args:
        exchange: With the motors.
        description: The robot.
        beat: Called every control step.

    Raises:
        BusError: If no frame could be sent in all that time.
    """
    link, dt = exchange.link, description.dt
    q, _, _ = exchange.readings(-np.inf)
    q = np.clip(np.where(np.isnan(q), description.poses["lie"], q), description.q_min, description.q_max)
    brake = damping_command(q, float(description.raw["motor"]["kd_most"]))
    began = rested = link.now()
    reached = False
    while link.now() - began < LIMITS.damp_seconds and link.now() - rested < LIMITS.rest_seconds:
        beat()
        since = link.now()
        for joint in ALL:
            with suppress(BusError):
                exchange.command(brake, [joint])
                reached = True
        with suppress(BusError):
            exchange.listen(since + dt)
        link.sleep(max(since + dt - link.now(), 0.0))
        _, dq, _ = exchange.readings(since)
        if np.isnan(dq).all() or np.nanmax(np.abs(dq)) >= LIMITS.rest_speed:
            rested = link.now()
    if not reached:
        raise BusError("no bus takes frames any more")


def switch_off(exchange: Exchange, description: RobotDescription, beat: Callable[[], None]) -> list[int]:
    """Switch every motor off and return the joints whose motors did not confirm it."""
    link, wiring = exchange.link, exchange.wiring
    left, since = list(ALL), link.now()
    for _ in range(STOP_TRIES):
        beat()
        for joint in left:
            with suppress(BusError):
                exchange.send(joint, Stop(motor=int(wiring.motor[joint]), host=wiring.host))
        until = link.now() + description.dt
        with suppress(BusError):
            exchange.listen(until)
        link.sleep(max(until - link.now(), 0.0))
        left = [joint for joint in left if not _is_off(exchange, joint, since)]
        if not left:
            break
    return left


def _is_off(exchange: Exchange, joint: int, since: float) -> bool:
    newest = exchange.feedback[joint]
    return newest is not None and exchange.came[joint] > since and newest.mode == Mode.RESET


def told_off(left: list[int]) -> str:
    """Return how the robot was left, as a sentence without its full stop, given the joints that did not confirm."""
    if not left:
        return "the robot was damped and all motors are off"
    names = "all motors" if len(left) == len(ALL) else ", ".join(JOINTS[j] for j in left)
    return f"damping was sent, but {names} did not confirm to be off: take the power away"
