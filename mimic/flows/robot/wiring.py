"""The guided check of a wiring: a person moves each joint by hand and tilts the trunk, and a file is written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from mimic.commissioning.scan import scan
from mimic.commissioning.wire_check import WireCheck
from mimic.config.hardware import WiringSettings
from mimic.errors import ConfigError, PlantError
from mimic.flows.play import load_robot
from mimic.frozen import frozen_arrays
from mimic.hardware.can.other_programs import look_first
from mimic.hardware.can.wiring import Wiring, load_wiring
from mimic.hardware.robot.board_wiring import BOARDS
from mimic.hardware.session import open_session, wiring_of
from mimic.io import store
from mimic.records import JOINTS


@frozen_arrays
class Wired:
    """A wiring that was found by hand."""

    file: Path
    wiring: Wiring
    differences: list[str]
    """Where it differs from the wiring that was given, as sentences."""


def wire_robot(
    bus_url: str,
    out: Path,
    bus: WiringSettings | None = None,
    *,
    say: Callable[[str], None] = lambda text: None,
) -> Wired:
    """Find motor and sign of each joint and the mounting of the IMU, and write the wiring file; motors stay off.

    Args:
        bus_url: Buses of the robot, which hangs or is held so that its legs can be moved.
        out: Wiring file to write.
        bus: How it is reached; maker, ids of hosts, offsets and what the IMU sends are those of its wiring.
        say: Tells the person what to do.

    Raises:
        ConfigError: If the file exists, or the robot is a stock one.
        PlantError: If a motion contradicts another one, or another program commands the motors.
        AssetError, BusError: If the buses cannot be opened, or the file cannot be written.
    """

    if bus_url in BOARDS:
        raise ConfigError(f"{bus_url} is a stock robot, whose wiring is known; to look at it: mimic robot watch")
    if out.exists():
        raise ConfigError(f"{out} exists; name another file with --out, or remove it")
    store.check_writable(out.parent)
    bus = bus or WiringSettings()
    given = wiring_of(bus_url, bus)
    with open_session(bus_url, bus, zeros=False) as robot:
        look_first(robot.motor_bus())
        check = WireCheck(robot.link, given, scan(robot.link, given), load_robot())
        places, signs = check.joints(say)
        quat_BI = check.imu(say)
    found = replace(
        given,
        bus=check.raw.bus[places],
        motor=check.raw.motor[places],
        sign=signs,
        imu=replace(given.imu, bus=check.raw.imu.bus, quat_BI=quat_BI),
    )
    out.write_text(wiring_text(found), encoding="utf-8")
    read = load_wiring(out, buses=given.buses)
    if not all(np.array_equal(getattr(read, name), getattr(found, name)) for name in ("bus", "motor", "sign")):
        raise PlantError(f"{out} does not read back as it was found; this is a bug, please report it")
    return Wired(file=out, wiring=read, differences=_differences(found, given))


def _differences(found: Wiring, given: Wiring) -> list[str]:
    told = []
    for joint, name in enumerate(JOINTS):
        ours, theirs = ((w.bus[joint], w.motor[joint], w.sign[joint]) for w in (found, given))
        if ours != theirs:
            bus, motor, sign = theirs
            told.append(
                f"{name} is motor {ours[1]} on bus {ours[0]}, sign {ours[2]:+.0f}; "
                f"{given.path.name} has motor {motor} on bus {bus}, sign {sign:+.0f}"
            )
    if abs(abs(float(found.imu.quat_BI @ given.imu.quat_BI)) - 1.0) > 1e-3:
        told.append(
            f"the IMU sits at quat_BI {np.round(found.imu.quat_BI, 3).tolist()}, not as {given.path.name} has it"
        )
    if found.imu.bus != given.imu.bus:
        told.append(f"the IMU is on bus {found.imu.bus}; {given.path.name} has bus {given.imu.bus}")
    return told


def wiring_text(wiring: Wiring) -> str:
    """Return a wiring as the text of a wiring file."""
    buses = ", ".join(str(int(bus)) for bus in wiring.bus)
    rows = [
        f"{name} = {{ motor = {int(wiring.motor[j])}, sign = {int(wiring.sign[j])}, offset = {wiring.offset[j]:.4f} }}"
        for j, name in enumerate(JOINTS)
    ]
    rate = ", ".join(f"{name} = {value:g}" for name, value in wiring.imu.rate.items())
    quat = ", ".join(f"{value:.6f}" for value in wiring.imu.quat_BI)
    return "\n".join(
        [
            "# Wiring of a robot, found by mimic robot wire: each joint was moved by hand, the trunk was tilted.",
            "# Offsets and the rates of the IMU are those of the wiring that was given.",
            "",
            f'motor = "{wiring.maker}"',
            f"bitrate = {wiring.bitrate}",
            f"host = {wiring.host}",
            f"position_range = {wiring.position_range!r}",
            "",
            "[layout]",
            f"{wiring.buses} = [{buses}]",
            "",
            "[joints]",
            *rows,
            "",
            "[imu]",
            f'kind = "{wiring.imu.kind}"',
            f"bus = {wiring.imu.bus}",
            f"quat_BI = [{quat}]",
            f"rate = {{ {rate} }}",
            "",
        ]
    )
