"""Commissioning a real robot: scan its buses, set zeros, check it, and excite its joints for calibration."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mimic.commissioning.scan import BusScan, scan, wiring_problems
from mimic.config.hardware import DriveSettings, LookSettings, ProbeSettings, WiringSettings
from mimic.control.signals import Signals
from mimic.errors import ConfigError, PlantError
from mimic.flows.play import load_robot, robot_on
from mimic.flows.reporter import Reporter, reporting
from mimic.flows.robot.operator import Operator, undisturbed
from mimic.flows.run_folder import LOG
from mimic.frozen import frozen_arrays
from mimic.hardware.can.driver import CanDriver
from mimic.hardware.can.other_programs import look_first, others
from mimic.hardware.can.preflight import at_rest
from mimic.hardware.can.zeros import homing_file, uneven
from mimic.hardware.go2.driver import RESTED
from mimic.hardware.robot.board_wiring import BOARDS
from mimic.hardware.robot.checks import Check, CheckOptions, refuse
from mimic.hardware.robot.sender import Sender
from mimic.hardware.session import open_robot, open_session, robot_session, wiring_of
from mimic.io import store
from mimic.io.joint_log import is_joint_log, read_log, write_log
from mimic.records import JOINTS, FloatArray, RunLog

if TYPE_CHECKING:
    from mimic.commissioning.probe import ProbeResult
    from mimic.hardware.can.wiring import Wiring


def _only_on_can(bus_url: str, command: str, instead: str) -> None:

    if bus_url in BOARDS:
        raise ConfigError(f"mimic robot {command} is for motors on CAN; {bus_url} is a stock robot: {instead}")


def scan_robot(bus_url: str, bus: WiringSettings | None = None) -> tuple[list[BusScan], Wiring, list[str]]:
    """Find motors and IMU on the buses; nothing moves.

    Returns:
        What answered on each bus, the wiring, and what the wiring names but nobody answered to, as sentences.

    Raises:
        PlantError: If another program drives the motors.
        ConfigError, AssetError, BusError: If the buses cannot be opened.
    """
    _only_on_can(bus_url, "scan", "its motors have one fixed place each; to look at it: mimic robot check")

    with open_session(bus_url, bus or WiringSettings(), zeros=False) as robot:
        driven = others(robot.motor_bus())
        if driven:
            raise PlantError(f"nothing was asked. {driven}")
        seen = scan(robot.link, robot.wiring)
        return seen, robot.wiring, wiring_problems(seen, robot.wiring)


@frozen_arrays
class Zeroed:
    """Zeros that were set."""

    file: Path
    """Where they are kept until the power goes."""
    off: FloatArray
    """Joint angles minus the lying pose (12,) [rad]."""
    warnings: Sequence[str]
    first: bool
    """Whether no earlier zeros were known, so that the lying pose was taken for exact."""


def zero_robot(
    bus_url: str, bus: WiringSettings | None = None, *, again: bool = False, operator: Operator | None = None
) -> Zeroed:
    """Set the zeros of a robot that lies; its motors stay off.

    Args:
        bus_url: Buses of the robot.
        bus: How they are driven.
        again: Forget what was known of this robot.
        operator: Confirms that the robot lies.

    Raises:
        PlantError: If another program drives the motors, the robot moves or is tilted, or a joint is not near the
            lying pose.
        ConfigError, AssetError, BusError: If the buses cannot be opened.
    """
    _only_on_can(bus_url, "zero", "it keeps its zeros itself; to look at its joints: mimic robot check")
    from mimic.commissioning.homing import home

    description = load_robot()
    (operator or Operator()).confirm("Keep your hands off it from here on.")
    with open_session(bus_url, bus or WiringSettings(), zeros=True) as robot:
        known = None if again else robot.homing
        motor_bus = robot.motor_bus()
        look_first(motor_bus)
        refuse(at_rest(motor_bus, description), "no zero was set")
        homing, q = home(motor_bus, description, known)
    path = homing_file(robot.wiring)
    homing.save(path)
    return Zeroed(file=path, off=q - description.poses["lie"], warnings=uneven(q), first=known is None)


def damp_robot(bus_url: str, bus: LookSettings | None = None) -> tuple[bool, str]:
    """Damp all motors until the robot rests and switch them off, whoever commanded them before.

    Returns:
        Whether all motors are off, or a board's are damped, and how the robot was left, as a sentence without a full
        stop.

    Raises:
        PlantError: If the robot's own mode drives it.
        ConfigError, AssetError, BusError: If the buses cannot be opened, or take no frames.
    """

    description = robot_on(bus_url)
    if bus_url == "go2":  # what it does with the last command is not published
        with open_robot(bus_url, bus or LookSettings(), description) as board, undisturbed():
            mode = getattr(board, "ask_mode", str)()
            if mode:
                raise PlantError(f"no command was sent: its own mode {mode!r} drives the robot; use its remote control")
            ending = Sender(board, description).run()
            return ending == RESTED, ending
    _only_on_can(bus_url, "damp", "it damps itself half a second after the last command")
    with open_session(bus_url, bus or WiringSettings(), zeros=False, locked=False) as robot, undisturbed():
        driver = CanDriver(robot.link, robot.wiring, description)
        ending = Sender(driver, description).run()
        return driver.off, ending


def check_robot(bus_url: str, bus: LookSettings | None = None, *, suspended: bool = False) -> list[Check]:
    """Return what the pre-flight check finds; nothing moves, and to a stock robot nothing is sent.

    Raises:
        ConfigError, AssetError, BusError: If the buses cannot be opened.
    """

    description = robot_on(bus_url)
    with open_robot(bus_url, bus or LookSettings(), description) as driver:
        return driver.checks(CheckOptions(rate_hz=1.0 / description.dt, suspended=suspended))


def _targets_in(file: Path) -> tuple[FloatArray, FloatArray]:
    """Return times (T,) [s] and targets (T, 12) [rad] of a run's log, or of a joint log such as next_motion.parquet.

    Raises:
        AssetError, CalibrationError: If the file cannot be read.
        ConfigError: If it has no targets.
    """

    if not is_joint_log(file):
        run = store.load(file, RunLog)
        return run.t, run.q_des
    log = read_log(file).of(JOINTS)
    if log.q_des is None:
        raise ConfigError(f"{file} has no targets; --motion takes a run folder, its log, or a log with q_des.<joint>")
    return log.t, log.q_des


def probe_robot(
    bus_url: str,
    out: Path,
    *,
    motion: Path | None = None,
    settings: ProbeSettings | None = None,
    bus: DriveSettings | None = None,
    operator: Operator | None = None,
    reporter: Reporter | None = None,
) -> tuple[ProbeResult, Path, str]:
    """Move a robot that hangs with its feet free, and write the log that calibration reads.

    Args:
        bus_url: Buses of the robot.
        out: Parquet or CSV file to write.
        motion: Play the targets of this run folder, its log.parquet, or a calibration's next_motion.parquet instead.
        settings: The motion.
        bus: How the robot is driven.
        operator: Sees the pre-flight check and confirms that the robot may move.
        reporter: Receives notes.

    Returns:
        What was measured, the file written, and how the robot was left.

    Raises:
        PlantError, BusError, ConfigError, AssetError: If something stands against it.
    """
    from mimic.commissioning.probe import probe, probe_motion, recorded_motion

    if out.suffix.lower() not in (".parquet", ".csv"):
        raise ConfigError(f"--out is {out}; expected a file name that ends with .parquet or .csv")
    settings = settings or ProbeSettings()
    bus = bus or DriveSettings()
    operator = operator or Operator()
    reporter = reporting(reporter)
    store.check_file(out)
    description = robot_on(bus_url)
    signals = Signals()
    if motion is None:
        targets = probe_motion(description, settings)
    else:
        targets = recorded_motion(*_targets_in(motion / LOG if motion.is_dir() else motion), description, settings)
    seconds = len(targets) / settings.rate_hz
    with robot_session(
        bus_url,
        bus,
        description,
        rate_hz=settings.rate_hz,
        report=operator.show_findings,
        go=lambda: operator.confirm(f"It moves all joints for {seconds:.0f} s; feet free, nobody within reach."),
        suspended=True,
    ) as plant:
        reporter.note(f"It moves to the centre within {2 * settings.approach:g} s. Ctrl-C damps and keeps the log.")
        with signals.caught(), undisturbed():
            wiring = None if bus_url in BOARDS else wiring_of(bus_url, bus)
            result = probe(plant, targets, settings, signals, wiring=wiring)
    return result, write_log(result.log, out), plant.ending
