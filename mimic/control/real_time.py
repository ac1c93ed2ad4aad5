"""A plant that follows the clock of the computer: for a simulated robot that answers to a camera."""

from __future__ import annotations

import time
from collections.abc import Callable

from mimic.robot.description import RobotDescription
from mimic.run.plant import Plant
from mimic.types import JointCommand, RobotState, Tick

BEHIND = 0.2
"""A plant that is later than this starts to count anew instead of hurrying [s]."""


class PacedPlant:
    """Steps a plant no faster than real time."""

    def __init__(
        self,
        plant: Plant,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._plant, self._clock, self._sleep = plant, clock, sleep
        self._due = 0.0
        self.late = 0
        """Steps that were late by more than a control step."""

    @property
    def description(self) -> RobotDescription:
        """The robot's numbers."""
        return self._plant.description

    def start(self) -> RobotState:
        """Bring the robot to its start, and begin to count."""
        state = self._plant.start()
        self._due = self._clock()
        return state

    def step(self, command: JointCommand) -> Tick:
        """Let one control step pass, and the time it takes in the world."""
        tick = self._plant.step(command)
        dt = self._plant.description.dt
        self._due += dt
        left = self._due - self._clock()
        if left > 0:
            self._sleep(left)
        else:
            self.late += left < -dt
            if left < -BEHIND:
                self._due = self._clock()
        return tick

    def close(self) -> None:
        """Leave the robot damped."""
        self._plant.close()
