"""A session with a stock robot: starts the process at its board, listens, and only then gives a plant."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from mimic.config.hardware import DriveSettings, LookSettings, WiringSettings
from mimic.errors import PlantError
from mimic.hardware.preflight import Check, before_moving, refuse
from mimic.hardware.stock.lcm_bus import check_network
from mimic.hardware.stock.plant import StockRobot
from mimic.hardware.stock.preflight import board_preflight
from mimic.hardware.stock.process import BoardProcess
from mimic.hardware.stock.wiring import BoardWiring, load_board
from mimic.robot.description import RobotDescription


def board_wiring(settings: WiringSettings, board: str = "cyberdog2") -> BoardWiring:
    """Return the wiring of a board: the file of the settings, or the shipped one."""
    return load_board(None if settings.wiring is None else Path(settings.wiring), board)


@contextmanager
def open_board(
    settings: LookSettings, description: RobotDescription
) -> Iterator[tuple[BoardProcess, BoardWiring, str]]:
    """Open the connection to a board, and end it afterwards; nothing is sent by itself.

    Yields:
        The process at the board, the wiring, and how messages leave this computer, in words.

    Raises:
        ConfigError, AssetError, BusError, MissingExtra, PlantError: If that is not possible.
    """
    wiring = board_wiring(settings)
    network, _ = check_network(wiring, settings.interface)
    link = BoardProcess(wiring, settings.interface, description)
    try:
        yield link, wiring, network
    finally:
        link.close()


@contextmanager
def board_session(
    settings: DriveSettings,
    description: RobotDescription,
    *,
    report: Callable[[list[Check]], None],
    go: Callable[[], None],
    suspended: bool = False,
) -> Iterator[StockRobot]:
    """Give a stock robot that passed its pre-flight. At the end it is damped, and its motors are without torque.

    Args:
        settings: Network interface and wiring.
        description: The robot.
        report: Receives the results of the pre-flight, also if they forbid moving.
        go: Returns when the user wants the robot to move; may raise.
        suspended: The robot hangs in the air instead of lying on the floor.

    Raises:
        PlantError: If a check forbids moving; or whatever was raised meanwhile, with how the robot was left.
        ConfigError, AssetError, BusError, MissingExtra: If the network cannot be used.
    """
    with open_board(settings, description) as (link, wiring, network):
        with before_moving():
            checks = board_preflight(link, description, network, suspended=suspended)
            report(checks)
            refuse(checks)
            go()
        plant = StockRobot(link, wiring, description, torque_limit=settings.torque_limit, suspended=suspended)
        try:
            yield plant
        except PlantError as reason:
            plant.close()
            raise PlantError(f"{reason}; {plant.ending}") from reason
        finally:
            plant.close()
