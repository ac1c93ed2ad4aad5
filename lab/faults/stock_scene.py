"""Emulated robots with a motion board in their own time, with a proxy and a second program on their network."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from lab.faults.trouble import Trouble, halt
from lab.in_process.board_bus import EmulatedBoardBus, EmulatedGo2Bus
from lab.in_process.sender_link import EmulatedSenderLink
from mimic.config.emulator import EmulateSettings
from mimic.emulator.boards.board import EmulatedBoard
from mimic.emulator.boards.go2 import EmulatedGo2
from mimic.emulator.faults import EmulatedFault
from mimic.hardware.go2.driver import GONE_ON, OWN_MODE, RESTED, Go2Driver
from mimic.hardware.go2.driver import UNREACHED as GO2_UNREACHED
from mimic.hardware.go2.messages import LOWCMD, blank, encode
from mimic.hardware.go2.wiring import load_go2
from mimic.hardware.robot.plant import Robot
from mimic.hardware.stock.driver import OBEYS_ANOTHER, UNREACHED, StockDriver
from mimic.hardware.stock.messages import MOTOR_CTRL
from mimic.hardware.stock.wiring import load_board
from mimic.robot.description import RobotDescription

Way = tuple[bool, str]
"""Whether messages go to the board, and their channel or topic."""

CUTS = ("cuts", "flaps", "sends_nothing", "drops", "delays")
"""Faults of the network while which messages may not reach the board."""

OBEYS = (*CUTS, "master_commands")
"""These, and another program, which the board obeys as long as it speaks."""


class BoardScene:
    """An emulated robot with a motion board, and what is between it and its driver."""

    channel: str
    """Of commands."""
    robot: str
    wiring_of: Callable[[], Any]
    board_of: type[EmulatedBoard | EmulatedGo2]
    bus_of: type[EmulatedBoardBus | EmulatedGo2Bus]
    driver_of: type[StockDriver | Go2Driver]

    def __init__(
        self, description: RobotDescription, rng: np.random.Generator, seed: int, fault: EmulatedFault | None
    ) -> None:
        """Switch the robot on."""
        wiring: Any = self.wiring_of()
        settings = EmulateSettings(placement=0.02, seed=seed)
        self.board = self.board_of(description, wiring, settings, faults=[] if fault is None else [fault])
        self.bus: Any = self.bus_of(self.board)
        self.link = EmulatedSenderLink(self.driver_of(self.bus, wiring, description), description)
        self.bus.listen(0.5)
        self.trouble = Trouble(rng, self.now)
        self.plant: Any = Robot(self.link, description)
        self.last_driven = -np.inf
        self._receive, self._heard = self.board.take, self.bus.heard
        self.board.take = partial(self._pass, True)  # type: ignore[method-assign]
        self.bus.heard = partial(self._pass, False)
        self.bus.hook = self._cycle

    def _command(self, rng: np.random.Generator) -> bytes:
        """Return a command of another program."""
        raise NotImplementedError

    def now(self) -> float:
        return self.board.now

    def _give(self, way: Way, data: bytes, t: float) -> None:
        to_board, channel = way
        (self._receive if to_board else self._heard)(channel, data, t)

    def _pass(self, to_board: bool, channel: str, data: bytes, t: float) -> None:
        """Let a message through, to the board or to the sender; readings can be damaged, commands come again."""
        trouble, way = self.trouble, (to_board, channel)
        commands = to_board or channel == self.channel
        if trouble.doing("sends_nothing" if to_board else "hears_nothing"):
            return
        if trouble.doing("repeats") and not to_board:
            self._give(way, data, t)
            return
        if commands:
            passed = trouble.through(way, data)
        else:
            passed = trouble.through(way, data, trouble.damaged, partial(trouble.damaged, first=8), trouble.shorter)
        for one in passed:
            self._give(way, one, t)

    def _cycle(self, t: float) -> None:
        """Let held messages go, and the second program speak."""
        if self.board.driven():
            self.last_driven = t
        for way, data in self.trouble.due():
            self._give(way, data, t)
        kind, rng = self.trouble.kind, self.trouble.rng
        halt(self.link, self.trouble)
        if not self.trouble.doing():
            return
        if kind == "master_once" or (kind == "master_commands" and rng.random() < 0.5):
            self.bus.foreign(self._command(rng))
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

    def actable(self, t: float) -> float:
        """Return from when on, after a time [s], somebody can reach the board; infinite for never."""
        if self.trouble.kind in OBEYS and t >= self.trouble.begin:
            return max(t, self.trouble.end)
        cuts = ("bus_off", "frames_lost", "frames_late", "frames_corrupted")
        ends = [fault.until for fault in self.board.schedule.faults if fault.kind in cuts and fault.start <= t]
        return max([t, *ends])

    def reachable(self) -> bool:
        """Return whether no other program still commands the robot, which obeys whoever sends, and messages pass."""
        return self.actable(self.now()) <= self.now()

    def false_line(self) -> bool:
        """Return whether the last line is not true."""
        return False


class StockScene(BoardScene):
    """A stock CyberDog 2."""

    channel = MOTOR_CTRL.channel
    robot = "cyberdog2"
    wiring_of = staticmethod(load_board)
    board_of = EmulatedBoard
    bus_of = EmulatedBoardBus
    driver_of = StockDriver

    def _command(self, rng: np.random.Generator) -> bytes:
        ones = np.ones(12)
        q = rng.uniform(-0.5, 0.5, 12)
        return MOTOR_CTRL.encode(q_des=q, qd_des=0.0 * ones, kp_des=20.0 * ones, kd_des=ones, tau_des=0.0 * ones)

    def told(self) -> bool:
        return self.plant.ending.startswith((OBEYS_ANOTHER, UNREACHED))


class Go2Scene(BoardScene):
    """A Go2, which holds its last command when no more come."""

    channel = LOWCMD
    robot = "go2"
    wiring_of = staticmethod(load_go2)
    board_of = EmulatedGo2
    bus_of = EmulatedGo2Bus
    driver_of = Go2Driver

    def _command(self, rng: np.random.Generator) -> bytes:
        message = blank(LOWCMD)
        motors = message["motor_cmd"][:12]
        motors["mode"], motors["kp"], motors["kd"], motors["q"] = 1, 20.0, 1.0, rng.uniform(-0.5, 0.5, 12)
        return encode(LOWCMD, message)

    def false_line(self) -> bool:
        return self.board.mode != "" and self.plant.ending.startswith(RESTED)

    def told(self) -> bool:
        return self.plant.ending.startswith((GONE_ON, GO2_UNREACHED, OWN_MODE[:8]))
