"""The interface between the control loop and a robot, in simulation or on its bus, and the command that only damps."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from mimic.records import FloatArray, JointCommand, RobotState, Tick
from mimic.robot.description import RobotDescription


class Plant(Protocol):
    """A robot that takes joint commands at a fixed rate."""

    @property
    def description(self) -> RobotDescription:
        """The robot's numbers."""
        ...

    def start(self) -> RobotState:
        """Bring the robot to its start, lying, and return its state."""
        ...

    def step(self, command: JointCommand) -> Tick:
        """Send a command, let one control step pass, and return the state, the health and the command that was sent."""
        ...

    def damp(self) -> bool:
        """Have the robot damped for good; return whether it still is, so that time may pass by steps.

        Whatever is sent afterwards, the robot is not driven again.
        """
        ...

    def close(self) -> None:
        """Leave the robot damped. Safe to call twice."""
        ...


def damping_command(q: FloatArray, kd: float) -> JointCommand:
    """Return the command that only damps: no stiffness, velocity gain kd [N m s/rad]."""
    zeros = np.zeros_like(q)
    return JointCommand(q_des=q.copy(), dq_des=zeros, kp=zeros, kd=np.full_like(q, kd), tau_ff=zeros)
