"""What the loop needs of a robot; simulation and hardware are plants alike."""

from __future__ import annotations

from typing import Protocol

from mimic.robot.description import RobotDescription
from mimic.types import JointCommand, RobotState, Tick


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
        """Send a command, let one control step pass, and return what came of it."""
        ...

    def close(self) -> None:
        """Leave the robot damped. Safe to call twice."""
        ...
