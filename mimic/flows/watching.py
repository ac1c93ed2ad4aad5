"""Showing what a real robot says, in the terminal and in Rerun, while it is moved by hand."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mimic.commissioning.watching import Watcher, newest
from mimic.config.hardware import LookSettings
from mimic.errors import BusError
from mimic.flows.play import robot_on
from mimic.frozen import frozen_arrays
from mimic.geometry import rpy_from_quat
from mimic.hardware.bus_lock import bus_lock
from mimic.hardware.can.zeros import zero_problems
from mimic.hardware.robot.board_wiring import BOARDS
from mimic.hardware.robot.driver import SILENT
from mimic.hardware.robot.opening import open_driver
from mimic.hardware.session import driver_settings, open_session
from mimic.records import FloatArray

if TYPE_CHECKING:
    from mimic.robot.description import RobotDescription


@frozen_arrays
class Watched:
    """What a robot says at one moment."""

    t: float
    """Time since watching began [s]."""
    report: Any
    """Newest readings; a scalar of `mimic.hardware.robot.driver.REPORT`, NaN where nothing came."""
    rates: Mapping[str, float]
    """Messages a second of each kind."""
    notes: Sequence[str]
    """What else is to be said."""

    @property
    def rpy(self) -> FloatArray:
        """Roll, pitch and yaw of the base (3,) [rad]."""
        return rpy_from_quat(self.report["quat_WB"])


Show = Callable[[Watched], None]
"""Receives what the robot says."""


def watch_robot(
    bus_url: str,
    bus: LookSettings | None = None,
    *,
    seconds: float | None = None,
    every: float = 0.5,
    show: Show = lambda seen: None,
    scene: bool | Path = False,
) -> None:
    """Show what a robot says until Ctrl-C or for a time. It moves nothing.

    To a stock robot nothing is sent. Motors on CAN answer only when asked: they are asked while they are off, and no
    more as soon as another program is heard, whose answers are then shown.

    Args:
        bus_url: Buses of the robot, or the name of a stock one.
        bus: How it is reached.
        seconds: How long; None until Ctrl-C.
        every: Interval between two calls of ``show`` [s].
        show: Receives the newest readings.
        scene: Also show the robot's pose in Rerun, or write it to a scene file (.rrd).

    Raises:
        AssetError, BusError, ConfigError, MissingExtra, PlantError: If it cannot be reached.
    """

    description = robot_on(bus_url)
    with (
        _shown_in(scene, show, description) as show_all,
        _opened(bus_url, bus or LookSettings(), description) as driver,
    ):
        begin = driver.now()
        while seconds is None or driver.now() - begin < seconds:
            before = driver.counts()
            since = driver.now()
            driver.listen(since + every)
            now = driver.now()
            show_all(
                Watched(
                    t=now - begin,
                    report=newest(driver.report, now - max(SILENT, every)),
                    rates={name: (count - before[name]) / (now - since) for name, count in driver.counts().items()},
                    notes=driver.notes(),
                )
            )


@contextmanager
def _shown_in(scene: bool | Path, show: Show, description: RobotDescription) -> Iterator[Show]:
    """Yield a function that shows readings, also in Rerun where asked for."""
    if not scene:
        yield show
        return
    from mimic.view.scene.live import LiveView

    with LiveView(description, path=scene if isinstance(scene, Path) else None) as view:

        def both(seen: Watched) -> None:
            report = seen.report
            if np.isfinite(report["q"]).all() and np.isfinite(report["quat_WB"]).all():
                view.pose(seen.t, report["q"], report["quat_WB"])
            show(seen)

        yield both


@contextmanager
def _opened(bus_url: str, bus: LookSettings, description: RobotDescription) -> Iterator[Any]:
    """Open a robot to look at it, on CAN also beside another program."""

    if bus_url in BOARDS:
        with closing(open_driver(driver_settings(bus_url, bus, description))) as board:
            yield board
        return
    with ExitStack() as stack:
        try:
            stack.enter_context(bus_lock(bus_url))
            alone = True
        except BusError:
            alone = False
        robot = stack.enter_context(open_session(bus_url, bus, zeros=not bus.zeroed, locked=False))
        watcher = Watcher(robot.link, robot.wiring, description, asks=alone)
        if not (bus.zeroed or watcher.only_listens) and zero_problems(watcher.motor_bus, robot.homing):
            watcher.zeros = "the zeros were not set since power-up: angles are off by whole rotor turns or more"
        yield watcher
