"""The stock robot's sender on an emulated board, in the board's own time: for rehearsals that repeat."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mimic.emulator.board import TICK, EmulatedBoard
from mimic.hardware.stock.messages import MOTOR_CTRL
from mimic.hardware.stock.readings import REPORT
from mimic.hardware.stock.sender import PERIOD, Order, Sender, State
from mimic.hardware.stock.wiring import BoardWiring
from mimic.robot.description import RobotDescription

LONGEST_ENDING = 20.0
"""A sender has ended by then [s]."""


class EmulatedBoardLink:
    """A `mimic.hardware.stock.plant.BoardLink` without a process: waiting advances the board."""

    def __init__(self, board: EmulatedBoard, wiring: BoardWiring, description: RobotDescription) -> None:
        """Connect a sender to a board.

        Args:
            board: Nothing else may advance it.
            wiring: As the sender reads the board.
            description: The robot.
        """
        self.board, self.sender = board, Sender(wiring, description)
        self.hook: Callable[[float], None] = lambda t: None
        """Called each cycle with the time, for whatever else happens on the network."""
        self.halted = False
        """The sender's process stands still or is gone: it sends and reports nothing."""
        self._reports: list[Any] = []

    def now(self) -> float:
        """Return the board's time [s]."""
        return self.board.now

    def order(self, order: Order) -> None:
        """Give an order."""
        if not self.halted:
            self.sender.order(order, self.now())

    def wait(self, until: float) -> list[Any]:
        """Let board and sender go on until a time [s], and return the sender's reports."""
        while self.board.now < until - 1e-9:
            self._cycle()
        reports, self._reports = self._reports, []
        return reports

    def _cycle(self) -> None:
        t = self.board.now
        data = None if self.halted else self.sender.message(t)
        if data is not None:
            self.board.receive(data, t)
            self.sender.heard(MOTOR_CTRL.channel, data, t)
        self.hook(t)
        self.board.advance(t + TICK)
        for message in self.board.published(self.board.now):
            if not self.halted:
                self.sender.heard(message.channel, message.data, message.t)
        if not self.halted:
            self._reports.append(np.frombuffer(self.sender.report(self.board.now), REPORT)[0])

    def foreign(self, data: bytes) -> None:
        """Let another program send a command."""
        self.board.receive(data, self.now())
        self.sender.heard(MOTOR_CTRL.channel, data, self.now())

    def alive(self) -> bool:
        """Return whether the sender still does what it is told."""
        return not self.halted and not self.sender.reason

    def finish(self) -> str:
        """Damp the robot until it rests, and return how it was left."""
        sender, end = self.sender, self.now() + LONGEST_ENDING
        sender.order(Order(state=State.DAMP), self.now())
        while sender.state != State.DONE and not self.halted and self.now() < end:
            self._cycle()
        return sender.ending


assert TICK == PERIOD
