"""A plant in real time, for a simulated robot that follows a camera."""

from __future__ import annotations

import time
from collections.abc import Callable

from mimic.control.plant import Plant
from mimic.records import JointCommand, RobotState, Tick
from mimic.robot.description import RobotDescription

LONGEST_LAG = 0.2
"""A plant that lags behind the clock by more than this gives up the lost time instead of catching up [s]."""


class PacedPlant:
    """Steps a plant no faster than real time."""

    def __init__(
        self,
        plant: Plant,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._plant = plant
        self._clock = clock
        self._sleep = sleep
        self._due = 0.0
        self.overruns = 0
        """Steps that ended more than a control step too late."""

    @property
    def description(self) -> RobotDescription:
        """The robot's numbers."""
        return self._plant.description

    def start(self) -> RobotState:
        """Bring the robot to its start, and start the clock."""
        state = self._plant.start()
        self._due = self._clock()
        return state

    def step(self, command: JointCommand) -> Tick:
        """Let one control step pass, in real time."""
        tick = self._plant.step(command)
        dt = self._plant.description.dt
        self._due += dt
        left = self._due - self._clock()
        if left > 0:
            self._sleep(left)
        else:
            self.overruns += left < -dt
            if left < -LONGEST_LAG:
                self._due = self._clock()
        return tick

    def damp(self) -> bool:
        """Have the robot damped for good."""
        return self._plant.damp()

    def close(self) -> None:
        """Leave the robot damped."""
        self._plant.close()
