"""Opens the driver of a robot on CAN, with the zeros that this computer keeps."""

from __future__ import annotations

import time
from pathlib import Path

from mimic.errors import BusError
from mimic.hardware.can.driver import CanDriver
from mimic.hardware.can.frame import Link
from mimic.hardware.can.wiring import Wiring, load_wiring
from mimic.hardware.can.zeros import homing_file, read_homing, with_homing
from mimic.hardware.robot.driver import DriverSettings
from mimic.robot.description import load_description

OPEN_EVERY = 0.2
"""Time between two attempts to open the buses at first [s]."""

OPEN_TRIES = 3
"""How many attempts to open the buses are made at first: a busy server may miss the time for its greeting."""


def open_buses(bus_url: str, wiring: Wiring, *, quick: bool = False) -> Link:
    """Open the buses of a robot.

    Args:
        bus_url: See `mimic.hardware.can.opening`.
        wiring: For the bit rate.
        quick: One attempt, and no time for an adapter to start up.

    Raises:
        ConfigError, BusError: If that is not possible.
    """
    from mimic.hardware.can.opening import open_link

    for _ in range(0 if quick else OPEN_TRIES - 1):
        try:
            return open_link(bus_url, bitrate=wiring.bitrate)
        except BusError:
            time.sleep(OPEN_EVERY)
    return open_link(bus_url, bitrate=wiring.bitrate, quick=quick)


def open_can_driver(settings: DriverSettings, *, quick: bool = False) -> CanDriver:
    """Open the driver of a robot on CAN; see `mimic.hardware.robot.opening.open_driver`."""
    path = None if settings.wiring is None else Path(settings.wiring)
    wiring = load_wiring(path, buses=len(settings.bus_url.split(",")))
    homing = None if settings.zeroed else read_homing(homing_file(wiring))
    return CanDriver(
        open_buses(settings.bus_url, wiring, quick=quick),
        wiring if homing is None else with_homing(wiring, homing),
        load_description(settings.robot),
        torque_limit=settings.torque_limit,
        homing=homing,
        zeroed=settings.zeroed,
        dry_run=settings.dry_run,
    )
