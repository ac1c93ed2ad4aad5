"""A session with a robot: the process that sends opens it, the pre-flight passes, and only then there is a plant."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

from mimic.config.hardware import DriveSettings, LookSettings, WiringSettings
from mimic.config.ranges import check_range
from mimic.control.priority import LOOP, real_time
from mimic.errors import ConfigError, PlantError
from mimic.frozen import frozen_arrays
from mimic.hardware.bus_lock import bus_lock
from mimic.hardware.can.frame import Link
from mimic.hardware.can.open_driver import open_buses
from mimic.hardware.can.wiring import Wiring, load_wiring
from mimic.hardware.can.zeros import Homing, homing_file, read_homing, with_homing
from mimic.hardware.motors.bus import MotorBus
from mimic.hardware.robot.board_wiring import BOARDS
from mimic.hardware.robot.checks import Check, CheckOptions, before_moving, refuse
from mimic.hardware.robot.driver import Driver, DriverSettings
from mimic.hardware.robot.opening import open_driver
from mimic.hardware.robot.plant import Robot
from mimic.hardware.robot.process import SenderProcess
from mimic.robot.description import RobotDescription

Report = Callable[[list[Check]], None]
"""Receives the results of the pre-flight."""


@frozen_arrays
class BusSession:
    """The open buses of a robot on CAN that nobody drives."""

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
def open_session(bus_url: str, settings: WiringSettings, *, zeros: bool, locked: bool = True) -> Iterator[BusSession]:
    """Open buses, and close them at the end; meanwhile no other program of mimic may use them.

    Args:
        bus_url: The buses; see `mimic.hardware.can.opening`.
        settings: Wiring.
        zeros: Whether to read the zeros of this power-up; without them angles are as the wiring has them.
        locked: Take the locks of the buses; not for who only listens.

    Raises:
        ConfigError, AssetError, BusError: If that is not possible.
    """
    with bus_lock(bus_url) if locked else nullcontext():
        wiring = wiring_of(bus_url, settings)
        homing = read_homing(homing_file(wiring)) if zeros else None
        link = open_buses(bus_url, wiring)
        try:
            yield BusSession(link=link, wiring=wiring if homing is None else with_homing(wiring, homing), homing=homing)
        finally:
            link.close()


def driver_settings(
    bus_url: str, settings: LookSettings, description: RobotDescription, *, dry_run: bool = False
) -> DriverSettings:
    """Return what it takes to open the driver of a robot."""
    return DriverSettings(
        bus_url=bus_url,
        robot=description.name,
        wiring=settings.wiring,
        interface=settings.interface,
        zeroed=settings.zeroed,
        torque_limit=settings.torque if isinstance(settings, DriveSettings) else None,
        dry_run=dry_run,
    )


@contextmanager
def open_robot(bus_url: str, settings: LookSettings, description: RobotDescription) -> Iterator[Driver]:
    """Open a robot that nobody drives, in this process, and let go of it at the end.

    Args:
        bus_url: Its buses, or the name of a motion board.
        settings: Wiring, network interface and zeros.
        description: The robot.

    Raises:
        ConfigError, AssetError, BusError, MissingExtra: If that is not possible.
    """
    with nullcontext() if bus_url in BOARDS else bus_lock(bus_url):
        driver = open_driver(driver_settings(bus_url, settings, description))
        try:
            yield driver
        finally:
            driver.close()


def _priority() -> list[Check]:
    """Return a note where this computer gives the program no real-time priority: other work may then hold it up."""
    with real_time(LOOP) as allowed:
        pass
    if allowed:
        return []
    busy = f"{os.getloadavg()[0]:.1f} programs wait for {os.cpu_count()} processors"
    text = (
        f"this user gets no real-time priority, so the robot is damped where other programs hold this one up ({busy}); "
        "to allow it, add to /etc/security/limits.conf, with your name, and log in again: NAME - rtprio 20"
    )
    return [Check("priority", "note", text)]


@contextmanager
def robot_session(
    bus_url: str,
    settings: DriveSettings,
    description: RobotDescription,
    *,
    rate_hz: float,
    report: Report,
    go: Callable[[], None],
    suspended: bool = False,
    dry_run: bool = False,
    inference: float | None = None,
) -> Iterator[Robot]:
    """Give a robot that passed its pre-flight. At the end it is damped and off.

    Args:
        bus_url: Its buses, or the name of a motion board.
        settings: Wiring, zeros and torque limit.
        description: The robot.
        rate_hz: Commands a second to each motor.
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
        check_range("torque-limit", settings.torque_limit, 1.0, float(description.torque_max.min()), "N m")
    board = bus_url in BOARDS
    if board and dry_run:
        raise ConfigError("--dry-run is for motors on CAN; to listen to a stock robot: mimic robot watch, or check")
    options = CheckOptions(rate_hz=rate_hz, suspended=suspended, inference=inference)
    with nullcontext(()) if board else bus_lock(bus_url) as locks:
        link = SenderProcess(driver_settings(bus_url, settings, description, dry_run=dry_run), description, keep=locks)
        try:
            with before_moving():
                checks = [*link.checks(options), *_priority()]
                report(checks)
                refuse(checks)
                go()
                refuse(link.checks(options))  # power may have blinked meanwhile, or the robot was moved
            plant = Robot(link, description, suspended=suspended)
            try:
                yield plant
            except PlantError as reason:  # such as a motor that does not switch on while others are on already
                plant.close()
                raise PlantError(f"{reason}; {plant.ending}") from reason
            finally:
                plant.close()
        finally:
            link.close()
