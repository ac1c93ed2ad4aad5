"""A session with the robot: starts the watchdog, opens the buses, runs the pre-flight, and only then gives a plant."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mimic.config.hardware import CheckSettings, DriveSettings, WiringSettings
from mimic.config.ranges import check_range
from mimic.errors import ConfigError, PlantError
from mimic.hardware.bus_lock import bus_lock
from mimic.hardware.can.link import Link
from mimic.hardware.dry_run import DryRobot
from mimic.hardware.homing import Homing, read_homing, with_homing
from mimic.hardware.motor_bus import MotorBus
from mimic.hardware.plant import CanRobot
from mimic.hardware.preflight import Check, before_moving, preflight, refuse
from mimic.hardware.step_budget import step_budget
from mimic.hardware.stock.plant import StockRobot
from mimic.hardware.stock.session import board_session
from mimic.hardware.stock.wiring import BOARDS
from mimic.hardware.watchdog import WatchdogProcess, allows_second_socket, open_buses
from mimic.hardware.wiring import Wiring, load_wiring
from mimic.records import FloatArray
from mimic.robot.description import RobotDescription

Report = Callable[[list[Check]], None]
"""Receives the results of the pre-flight."""


def homing_file(wiring: Wiring) -> Path:
    """Return the file with the zeros of a robot: one for each wiring file."""
    base = os.environ.get("XDG_STATE_HOME")
    folder = (Path(base) if base else Path.home() / ".local" / "state") / "mimic"
    return folder / f"zeros-{wiring.path.parent.name}-{wiring.path.stem}.json"


@dataclass(frozen=True, kw_only=True, eq=False)
class BusSession:
    """The open buses of a robot."""

    link: Link
    wiring: Wiring
    """With the zeros of this power-up, if they are known."""
    homing: Homing | None

    def motor_bus(self) -> MotorBus:
        """Return its motors and IMU."""
        return MotorBus(self.link, self.wiring)


def wiring_of(bus_url: str, settings: WiringSettings) -> Wiring:
    """Return the wiring of the robot on these buses, several separated by commas."""
    path = None if settings.wiring is None else Path(settings.wiring)
    return load_wiring(path, buses=len(bus_url.split(",")))


@contextmanager
def open_session(bus_url: str, settings: WiringSettings, *, zeros: bool) -> Iterator[BusSession]:
    """Open buses, and close them at the end; meanwhile no other program of mimic may use them.

    Args:
        bus_url: The buses; see `mimic.hardware.can.python_can`.
        settings: Wiring.
        zeros: Whether to read the zeros of this power-up; without them angles are as the wiring has them.

    Raises:
        ConfigError, AssetError, BusError: If that is not possible.
    """
    with bus_lock(bus_url), open_unlocked(bus_url, settings, zeros=zeros) as robot:
        yield robot


@contextmanager
def open_unlocked(bus_url: str, settings: WiringSettings, *, zeros: bool) -> Iterator[BusSession]:
    """Open buses that another program of mimic may be using; for who holds their lock, who only listens, or who damps.

    Args as of `open_session`.

    Raises:
        ConfigError, AssetError, BusError: If that is not possible.
    """
    wiring = wiring_of(bus_url, settings)
    homing = read_homing(homing_file(wiring)) if zeros else None
    link = open_buses(bus_url, wiring)
    try:
        yield BusSession(link=link, wiring=wiring if homing is None else with_homing(wiring, homing), homing=homing)
    finally:
        link.close()


def check_watchdog(checks: list[Check], bus_url: str, settings: CheckSettings) -> Check:
    """Check that something damps the robot when this process cannot.

    Args:
        checks: Of the pre-flight, the motors' own timeout among them.
        bus_url: The buses.
        settings: Whether a watchdog is wanted.
    """
    own = any(check.name == "own timeout" and check.verdict == "ok" for check in checks)
    if settings.watchdog and allows_second_socket(bus_url):
        return Check(
            name="watchdog", verdict="ok", text="a second process watches this one and damps the robot if it ends"
        )
    if own:
        return Check(name="watchdog", verdict="note", text="none; the motors stop by themselves if this process ends")
    if settings.watchdog:
        text = (
            f"a second process cannot open {bus_url}, and the motors have no timeout of their own: if this process is "
            "killed or the adapter is unplugged, they continue with their last command. "
            "Add --no-watchdog to accept that"
        )
        return Check(name="watchdog", verdict="stop", text=text)
    return Check(
        name="watchdog", verdict="note", text="none (--no-watchdog): nothing damps the robot if this process is killed"
    )


@contextmanager
def robot_session(
    bus_url: str,
    settings: DriveSettings,
    description: RobotDescription,
    *,
    rate_hz: float | FloatArray,
    report: Report,
    go: Callable[[], None],
    suspended: bool = False,
    dry_run: bool = False,
    inference: float | None = None,
) -> Iterator[CanRobot | StockRobot]:
    """Give a robot that passed its pre-flight. At the end it is damped and off, and its watchdog has ended.

    Args:
        bus_url: Its buses, or the name of a stock robot.
        settings: Wiring, zeros, watchdog and torque limit.
        description: The robot.
        rate_hz: Commands a second to each motor, or to these motors in each part of a motion (parts, 12).
        report: Receives the results of the pre-flight, also if they forbid moving.
        go: Returns when the user wants the robot to move; may raise.
        suspended: The robot hangs in the air instead of lying on the floor.
        dry_run: The motors stay off.
        inference: Time that the policy takes on this computer [s]; None where no policy drives the robot.

    Raises:
        ConfigError: If the torque limit is not one of this robot.
        PlantError: If a check forbids moving; or whatever was raised meanwhile, with how the robot was left.
        BusError: If a bus fails before anything was switched on.
    """
    if settings.torque_limit is not None:
        check_range("torque-limit", settings.torque_limit, 1.0, description.torque_max, "N m")
    if bus_url in BOARDS:
        if dry_run:
            raise ConfigError("--dry-run is for motors on CAN; to listen to a stock robot: mimic robot watch, or check")
        with board_session(settings, description, report=report, go=go, suspended=suspended) as board:
            yield board
        return
    wiring, dt = wiring_of(bus_url, settings), description.dt
    parts = round(float(np.max(rate_hz)) * dt)
    budget = None if inference is None else step_budget(wiring, dt, parts, inference)
    wanted = settings.watchdog and allows_second_socket(bus_url) and not dry_run
    with bus_lock(bus_url) as lock, ExitStack() as stack:
        watchdog = WatchdogProcess(bus_url, wiring.path, keep=lock) if wanted else None
        if watchdog is not None:
            stack.callback(watchdog.close)
        with open_unlocked(bus_url, settings, zeros=not settings.zeroed) as robot:

            def checked() -> list[Check]:
                motor_bus = robot.motor_bus()
                motor_bus.drain()  # what came while a person was asked
                return preflight(
                    motor_bus,
                    description,
                    rate_hz=rate_hz,
                    homing=robot.homing,
                    trust_zeros=settings.zeroed,
                    suspended=suspended,
                    budget=budget,
                )

            with before_moving():
                checks = checked()
                if not dry_run:
                    checks.append(check_watchdog(checks, bus_url, settings))
                report(checks)
                refuse(checks)
                go()
                refuse(checked())  # power may have blinked meanwhile, or the robot was moved
            kind = DryRobot if dry_run else CanRobot
            plant = kind(robot.link, robot.wiring, description, torque_limit=settings.torque, watchdog=watchdog)
            try:
                yield plant
            except PlantError as reason:  # such as a motor that does not switch on while others are on already
                plant.close()
                raise PlantError(f"{reason}; {plant.ending}") from reason
            finally:
                plant.close()
