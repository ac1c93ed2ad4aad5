"""An emulated stock robot in its own time, with a proxy and a second program on its network."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from lab.faults.trouble import Trouble, halt
from mimic.config.emulator import EmulateSettings
from mimic.emulator.board import EmulatedBoard
from mimic.emulator.board_bus import EmulatedBoardBus
from mimic.emulator.faults import EmulatedFault
from mimic.emulator.sender_link import EmulatedSenderLink
from mimic.hardware.robot.plant import Robot
from mimic.hardware.stock.driver import OBEYS_ANOTHER, UNREACHED, StockDriver
from mimic.hardware.stock.messages import MOTOR_CTRL
from mimic.hardware.stock.wiring import load_board
from mimic.robot.description import RobotDescription

COMMANDS = ""
"""The way of commands to the board; the way of the others is the name of their channel."""


class StockScene:
    """An emulated stock robot and what is between it and its driver."""

    def __init__(
        self, description: RobotDescription, rng: np.random.Generator, seed: int, fault: EmulatedFault | None
    ) -> None:
        """Switch the robot on."""
        wiring, settings = load_board(), EmulateSettings(placement=0.02, seed=seed)
        self.board = EmulatedBoard(description, wiring, settings, faults=[] if fault is None else [fault])
        self.bus = EmulatedBoardBus(self.board)
        self.link = EmulatedSenderLink(StockDriver(self.bus, wiring, description), description)
        self.bus.listen(0.5)
        self.trouble = Trouble(rng, self.now)
        self.plant: Any = Robot(self.link, description)
        self._receive, self._heard = partial(self.board.take, MOTOR_CTRL.channel), self.bus.heard
        self.board.take = lambda _, data, t: self._pass(COMMANDS, data, t)  # type: ignore[method-assign]
        self.bus.heard = self._pass
        self.bus.hook = self._cycle

    def now(self) -> float:
        return self.board.now

    def _give(self, channel: str, data: bytes, t: float) -> None:
        if channel == COMMANDS:
            self._receive(data, t)
        else:
            self._heard(channel, data, t)

    def _pass(self, channel: str, data: bytes, t: float) -> None:
        """Let a message through, to the board or to the sender; readings can be damaged, commands come again."""
        commands = channel in (COMMANDS, MOTOR_CTRL.channel)
        if self.trouble.doing("repeats") and channel != COMMANDS:
            self._give(channel, data, t)
            return
        damage = None if commands else self.trouble.damaged
        forge = None if commands else partial(self.trouble.damaged, first=8)
        for one in self.trouble.through(channel, data, damage, forge):
            self._give(channel, one, t)

    def _cycle(self, t: float) -> None:
        """Let held messages go, and the second program speak."""
        for channel, data in self.trouble.due():
            self._give(channel, data, t)
        kind, rng = self.trouble.kind, self.trouble.rng
        halt(self.link, self.trouble)
        if not self.trouble.doing():
            return
        if kind == "master_once" or (kind == "master_commands" and rng.random() < 0.5):
            ones = np.ones(12)
            q = rng.uniform(-0.5, 0.5, 12)
            self.bus.foreign(
                MOTOR_CTRL.encode(q_des=q, qd_des=0.0 * ones, kp_des=20.0 * ones, kd_des=ones, tau_des=0.0 * ones)
            )
            self.trouble.end = t if kind == "master_once" else self.trouble.end

    def stands_still(self, seconds: float) -> None:
        self.wait(seconds)

    def is_alone(self) -> None:
        self.link.sender.closed()
        self.wait(12.0)

    def wait(self, seconds: float) -> None:
        self.link.wait(self.link.now() + seconds)

    def on(self) -> list[str]:
        return self.driven()

    def driven(self) -> list[str]:
        return list(self.board.driven())

    def reachable(self) -> bool:
        """Return whether no other program still commands the robot, whose firmware obeys whoever sends."""
        return not self.trouble.doing("master_commands")

    def told(self) -> bool:
        return self.plant.ending.startswith((OBEYS_ANOTHER, UNREACHED))
