"""Showing what a real robot says, in the terminal and in Rerun, while it is moved by hand."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mimic.config.hardware import LookSettings
from mimic.errors import BusError
from mimic.flows.play import load_robot, robot_on
from mimic.geometry import rpy_from_quat
from mimic.records import FloatArray

if TYPE_CHECKING:
    from mimic.commissioning.watching import Watcher
    from mimic.hardware.session import BusSession


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Watched:
    """What a robot says at one moment."""

    t: float
    """Time since watching began [s]."""
    q: FloatArray
    """Joint angles (12,) [rad]; NaN where nothing came."""
    dq: FloatArray
    """Joint velocities (12,) [rad/s]."""
    tau: FloatArray
    """Torques (12,) [N m]; NaN where not known."""
    temperature: FloatArray
    """(12,) [degC]; NaN where not known."""
    errors: Sequence[int]
    """Error bits of each motor (12,)."""
    quat_WB: FloatArray
    """Orientation of the base, wxyz (4,)."""
    omega_B: FloatArray
    """Rate of turn, base axes (3,) [rad/s]."""
    rates: Mapping[str, float]
    """Messages a second of each kind."""
    notes: Sequence[str]
    """What else is to be said."""

    @property
    def rpy(self) -> FloatArray:
        """Roll, pitch and yaw of the base (3,) [rad]."""
        return rpy_from_quat(self.quat_WB)


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
    from mimic.hardware.robot.board_wiring import BOARDS

    bus = bus or LookSettings()
    with _shown_in(scene, show, robot_on(bus_url)) as show_all:
        if bus_url in BOARDS:
            _watch_board(bus_url, bus, seconds, every, show_all)
        else:
            _watch_can(bus_url, bus, seconds, every, show_all)


@contextmanager
def _shown_in(scene: bool | Path, show: Show, robot: str) -> Iterator[Show]:
    """Yield a function that shows readings, also in Rerun where asked for."""
    if not scene:
        yield show
        return
    from mimic.view.scene.live import LiveView

    description = load_robot(robot)
    with LiveView(description, path=scene if isinstance(scene, Path) else None) as view:

        def both(seen: Watched) -> None:
            if np.isfinite(seen.q).all() and np.isfinite(seen.quat_WB).all():
                view.pose(seen.t, seen.q, seen.quat_WB)
            show(seen)

        yield both


@contextmanager
def open_for_watching(bus_url: str, bus: LookSettings) -> Iterator[tuple[BusSession, bool]]:
    """Open buses to look at a robot, also beside another program.

    Yields:
        The buses, and whether this program may ask the motors: no other one of this computer uses them.
    """
    from mimic.hardware.bus_lock import bus_lock
    from mimic.hardware.session import open_session

    with ExitStack() as stack:
        try:
            stack.enter_context(bus_lock(bus_url))
            alone = True
        except BusError:
            alone = False
        yield stack.enter_context(open_session(bus_url, bus, zeros=not bus.zeroed, locked=False)), alone


def _watch_can(bus_url: str, bus: LookSettings, seconds: float | None, every: float, show: Show) -> None:
    """Show what motors and IMU on CAN say."""
    from mimic.commissioning.watching import Watcher
    from mimic.hardware.can.zeros import zero_problems
    from mimic.hardware.motors.bus import MotorBus

    with open_for_watching(bus_url, bus) as (robot, alone):
        motor_bus = MotorBus(robot.link, robot.wiring, overhear=True)
        watcher = Watcher(motor_bus, asks=alone)
        known = bus.zeroed or bool(watcher.only_listens) or not zero_problems(motor_bus, robot.homing)
        zeros = "" if known else "the zeros were not set since power-up: angles are off by whole rotor turns or more"
        begin = last = robot.link.now()
        before = motor_bus.imu.reading(begin).count
        while seconds is None or robot.link.now() - begin < seconds:
            seen = watcher.look(every)
            imu = seen.imu
            rates = {"orientation": (imu.count - before) / max(seen.t - last, 1e-3)}
            before = imu.count
            last = seen.t
            show(
                Watched(
                    t=seen.t - begin,
                    q=seen.q,
                    dq=seen.dq,
                    tau=seen.tau,
                    temperature=seen.temperature,
                    errors=[int(bits) for bits in seen.faults],
                    quat_WB=imu.quat_WB,
                    omega_B=imu.omega_B,
                    rates=rates,
                    notes=_can_notes(watcher, seen, zeros),
                )
            )


def _can_notes(watcher: Watcher, seen: Any, zeros: str) -> list[str]:
    """Return what there is to say beside the readings."""
    motor_bus = watcher.motor_bus
    notes = []
    names = motor_bus.link.names if len(seen.load) > 1 else ("",)
    load = ", ".join(f"{name} {share:.0%}".strip() for name, share in zip(names, seen.load, strict=True))
    notes.append(f"bus load {load}; {seen.running} motors on")
    if watcher.only_listens:
        notes.append(f"only listening: {watcher.only_listens}")
    if zeros:
        notes.append(zeros)
    if seen.imu.problem:
        notes.append(seen.imu.problem)
    if motor_bus.unknown:
        names = ", ".join(name for (_, name), _ in motor_bus.unknown.most_common(6))
        notes.append(f"unknown senders: {names}")
    if motor_bus.errors:
        notes.append(f"{motor_bus.errors} frames made no sense")
    return notes


def _board_notes(driver: Any, *, heard: bool) -> list[str]:
    last = driver.report
    notes = driver.notes() if heard else ["no message comes from the robot"]
    if last["errors"]:
        notes.append(f"{int(last['errors'])} messages made no sense")
    if last["foreign"]:
        notes.append(f"{int(last['foreign'])} commands of other programs")
    return notes


def _watch_board(bus_url: str, bus: LookSettings, seconds: float | None, every: float, show: Show) -> None:
    """Show what a stock robot says; nothing is sent."""
    from mimic.hardware.robot.opening import open_driver
    from mimic.hardware.session import driver_settings

    driver: Any = open_driver(driver_settings(bus_url, bus, load_robot(robot_on(bus_url))))
    begin = driver.now()

    def counts() -> dict[str, int]:
        report = driver.report
        numbers = driver.readings.joints, int(report["readings"]), int(report["imu_count"])
        return dict(zip(("joints", "motors", "orientation"), numbers, strict=True))

    try:
        while seconds is None or driver.now() - begin < seconds:
            before = counts()
            since = driver.now()
            driver.listen(since + every)
            now = driver.now()
            last = driver.report
            heard = now - float(last["heard"]) < max(0.5, every)
            names = ("q", "dq", "tau", "temperature", "quat_WB", "omega_B")
            show(
                Watched(
                    t=now - begin,
                    **{name: np.array(last[name]) if heard else np.full_like(last[name], np.nan) for name in names},
                    errors=[int(bits) for bits in last["faults"]],
                    rates={name: (count - before[name]) / (now - since) for name, count in counts().items()},
                    notes=_board_notes(driver, heard=heard),
                )
            )
    finally:
        driver.close()
