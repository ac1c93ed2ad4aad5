"""Getting at a robot on its buses: guardian first, then buses, then pre-flight, and only then a plant."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from mimic.errors import PlantError
from mimic.robot.description import RobotDescription
from mimic.robot.wiring import Wiring, load_wiring
from mimic.run.can_robot import CanRobot
from mimic.run.exchange import Exchange
from mimic.run.guardian import Guardian, allows_second_socket, opened
from mimic.run.homing import Homing, read_homing, with_homing
from mimic.run.link import Link
from mimic.run.preflight import Finding, preflight
from mimic.settings import BusSettings
from mimic.types import FloatArray

Told = Callable[[list[Finding]], None]


def homing_file(wiring: Wiring) -> Path:
    """Return where the zeros of a robot are kept: one file for each file of wiring."""
    base = os.environ.get("XDG_STATE_HOME")
    folder = (Path(base) if base else Path.home() / ".local" / "state") / "mimic"
    return folder / f"zeros-{wiring.path.parent.name}-{wiring.path.stem}.json"


@dataclass(frozen=True, kw_only=True, eq=False)
class Reached:
    """A robot whose buses are open."""

    link: Link
    wiring: Wiring
    """With the zeros of this power-up, where they are known."""
    homing: Homing | None

    def exchange(self) -> Exchange:
        """Return somebody to talk with its motors."""
        return Exchange(self.link, self.wiring)


def wiring_of(words: str, settings: BusSettings) -> Wiring:
    """Return the wiring of the robot on these buses."""
    path = None if settings.wiring is None else Path(settings.wiring)
    return load_wiring(path, buses=len(words.split(",")))


@contextmanager
def reached(words: str, settings: BusSettings) -> Iterator[Reached]:
    """Open the buses that a person names, and close them again.

    Raises:
        ConfigError, AssetError, BusError: If that is not possible.
    """
    wiring = wiring_of(words, settings)
    homing = None if settings.homed else read_homing(homing_file(wiring))
    link = opened(words, wiring)
    try:
        yield Reached(link=link, wiring=wiring if homing is None else with_homing(wiring, homing), homing=homing)
    finally:
        link.close()


def guarded(findings: list[Finding], words: str, settings: BusSettings) -> Finding:
    """Return what pre-flight says of who damps the robot when this process cannot.

    Args:
        findings: Of the pre-flight, the motors' own timeout among them.
        words: The buses.
        settings: Whether a guardian is wanted.
    """
    own = any(finding.name == "own timeout" and finding.verdict == "ok" for finding in findings)
    if settings.guardian and allows_second_socket(words):
        return Finding(name="guardian", verdict="ok", text="a process of its own watches this one and damps if it ends")
    if own:
        return Finding(name="guardian", verdict="note", text="none; the motors stop by themselves without this process")
    if settings.guardian:
        text = (
            f"{words} cannot be opened by a second process, and the motors have no timeout of their own: if this process "
            "is killed or the adapter pulled, they go on with their last command. Add --no-guardian to accept that"
        )
        return Finding(name="guardian", verdict="stop", text=text)
    return Finding(name="guardian", verdict="note", text="none, as asked for: nobody damps if this process is killed")


def refuse(findings: list[Finding]) -> None:
    """Raise if anything stands against moving.

    Raises:
        PlantError: With all that does.
    """
    against = [f"{finding.name}: {finding.text}" for finding in findings if finding.verdict == "stop"]
    if against:
        raise PlantError("nothing was moved. " + "; ".join(against))


@contextmanager
def ready(
    words: str,
    settings: BusSettings,
    description: RobotDescription,
    *,
    rate_hz: float | FloatArray,
    told: Told,
    go: Callable[[], None],
    hung: bool = False,
) -> Iterator[CanRobot]:
    """Give a robot that passed its pre-flight; at the end it is damped and off, and its guardian gone.

    Args:
        words: Its buses.
        settings: How it is driven.
        description: The robot.
        rate_hz: Commands a second to each motor, or to these motors in each part of a motion (parts, 12).
        told: Is told what pre-flight found, also where that stands against moving.
        go: Returns when a person wants it to move; may raise.
        hung: It hangs instead of lying.

    Raises:
        PlantError: If something stands against moving, or what was raised meanwhile, with how the robot was left.
        BusError: If a bus fails before anything was switched on.
    """
    wiring = wiring_of(words, settings)
    guardian = Guardian(words, wiring.path) if settings.guardian and allows_second_socket(words) else None
    try:
        with reached(words, settings) as robot:
            findings = preflight(
                robot.exchange(),
                description,
                rate_hz=rate_hz,
                homing=robot.homing,
                trust_zeros=settings.homed,
                hung=hung,
            )
            findings.append(guarded(findings, words, settings))
            told(findings)
            refuse(findings)
            go()
            plant = CanRobot(
                robot.link, robot.wiring, description, torque_limit=settings.torque_limit, watcher=guardian
            )
            try:
                yield plant
            except PlantError as reason:  # such as a motor that does not switch on; others are on already
                plant.close()
                raise PlantError(f"{reason}; {plant.ending}") from reason
            finally:
                plant.close()
    finally:
        if guardian is not None:
            guardian.close()
