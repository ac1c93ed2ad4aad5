"""A dry run: everything but the commands. The motors stay off; they are asked for readings by orders to stop."""

from __future__ import annotations

import numpy as np

from mimic.errors import PlantError
from mimic.hardware.motor_bus import ALL
from mimic.hardware.plant import CanRobot, idle_command
from mimic.records import JointCommand, RobotState


class DryRobot(CanRobot):
    """A robot whose commands are computed, checked and logged, and not sent."""

    def start(self) -> RobotState:
        """Return the state of the robot, whose motors stay off.

        Raises:
            PlantError: If a motor does not answer.
            BusError: If a bus fails.
        """
        self._need(self.motor_bus.stop())
        self.ending = "dry run: nothing was switched on"
        self._missed[:] = 0
        self._began = self._ended = self._due = self._link.now()
        self._bits = self.motor_bus.bits.copy()
        q, _, _ = self.motor_bus.readings(-np.inf)
        return self.step(idle_command(q)).state

    def _send(self, command: JointCommand, asked: float) -> JointCommand:
        """Check a command, and send orders to stop in its place."""
        numbers = np.concatenate([command.q_des, command.dq_des, command.kp, command.kd, command.tau_ff])
        if not np.isfinite(numbers).all():
            raise PlantError("the command holds numbers that are not finite")
        motor_bus = self.motor_bus
        for joint in ALL:
            motor_bus.send(joint, motor_bus.motors.stop(motor_bus.id(joint)))
        return command
