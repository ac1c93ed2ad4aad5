"""Serving the emulated robot to other processes."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from mimic.config.emulator import EmulateSettings, ServeOptions
from mimic.config.play import DEFAULT_ROBOT, EffectsSettings
from mimic.control.priority import EMULATOR, real_time
from mimic.control.signals import Signals
from mimic.dynamics.effect_set import EffectSet, read_effects
from mimic.dynamics.servo import read_standing
from mimic.emulator.boards.board import EmulatedBoard
from mimic.emulator.boards.board_base import TICK
from mimic.emulator.boards.board_server import BoardServer
from mimic.emulator.boards.go2 import EmulatedGo2
from mimic.emulator.faults import BOARD_ONLY, EmulatedFault, parse_fault
from mimic.emulator.robot import EmulatedRobot
from mimic.emulator.server import EmulatorServer
from mimic.errors import ConfigError
from mimic.flows.play import load_robot, warn_of_stand_effects
from mimic.flows.reporter import Reporter, reporting
from mimic.frozen import frozen
from mimic.hardware.can.wiring import load_wiring
from mimic.hardware.go2.dds_bus import DdsBus
from mimic.hardware.go2.dds_bus import check_network as check_go2_network
from mimic.hardware.go2.wiring import load_go2
from mimic.hardware.robot.board import Bus
from mimic.hardware.stock.lcm_bus import LcmBus, check_network
from mimic.hardware.stock.wiring import load_board

_LACKS = {
    "cyberdog2": ("listen", "slcan", "buses", "zeroed", "position_range", "can_timeout", "reply"),
    "go2": ("listen", "slcan", "buses", "zeroed", "position_range", "reply"),
}
"""Options and settings that a stock robot does not have."""


@frozen
class Served:
    """What was served."""

    seconds: float
    """Time of the emulation [s]."""
    figures: Mapping[str, str]
    """Rows of a table of what happened."""
    stood_still: float
    """For how long the emulation stood still because this computer was too slow [s]."""
    switched_on: tuple[str, ...]
    """Joints whose motors were on at the end; of a stock robot those that were driven."""
    driven: tuple[str, ...]
    """Those of them that had stiffness or torque."""


def _address(listen: str) -> tuple[str, int]:
    host, colon, port = listen.rpartition(":")
    if not colon or not host or not port.isdigit() or int(port) > 65535:
        raise ConfigError(f"--listen is {listen!r}; expected HOST:PORT, such as 127.0.0.1:29536")
    return host, int(port)


def _refuse_lacking(board: str, *given: ServeOptions | EmulateSettings) -> None:
    """Raise a ConfigError with the options that are given, but that a stock robot does not have."""
    lacks = []
    takes = []
    for settings in given:
        for f in fields(settings):
            name = f"--{f.name.replace('_', '-')}"
            if f.name not in _LACKS[board]:
                takes.append(name)
            elif getattr(settings, f.name) != f.default:
                lacks.append(name)
    if lacks:
        raise ConfigError(f"--board {board} has no {', '.join(lacks)}; it takes {', '.join(takes)}")


def serve_robot(
    options: ServeOptions | None = None,
    settings: EmulateSettings | None = None,
    effects: EffectsSettings | None = None,
    *,
    board: str | None = None,
    reporter: Reporter | None = None,
) -> Served:
    """Serve an emulated robot until Ctrl-C, SIGTERM or the given time: on emulated CAN buses, or a stock one.

    Args:
        options: Where, how long, and which faults.
        settings: How the robot behaves.
        effects: What a calibration found.
        board: Stock robot to serve, cyberdog2 or go2; None serves motors on CAN.
        reporter: Receives addresses, events and status lines.

    Raises:
        ConfigError: If an address, a fault or the effects cannot be used.
        AssetError: If a file cannot be read.
        BusError, MissingExtra: If its network cannot be opened.
    """
    options = options or ServeOptions()
    settings = settings or EmulateSettings()
    effects = effects or EffectsSettings()
    reporter = reporting(reporter)
    if board is None:
        emulated, faults, listen = _on_can(options, settings, effects, reporter)
    else:
        emulated, faults, listen = _board(board, options, settings, effects, reporter)
    with real_time(EMULATOR, inherited=True):  # also for the threads in which a network receives
        server = listen()
    for fault in faults:
        reporter.note(f"fault        {fault}")
    begin = reported = time.monotonic()

    def each() -> None:
        nonlocal reported
        while emulated.events:
            t, text = emulated.events.popleft()
            reporter.note(f"{t:9.3f} s  {text}")
        if options.every and time.monotonic() - reported >= options.every:
            reported = time.monotonic()
            reporter.note(server.line())

    def ended() -> bool:
        over = options.seconds is not None and time.monotonic() - begin >= options.seconds
        return over or signals.terminated or signals.interrupts > 0

    signals = Signals()
    try:
        with signals.caught(signal.SIGINT, signal.SIGTERM), real_time(EMULATOR):
            for address in server.addresses:
                reporter.note(f"ready        {address}")
            server.run(ended, each)
    finally:
        server.close()
    return Served(
        seconds=emulated.now,
        figures=server.figures(),
        stood_still=server.stood_still,
        switched_on=emulated.switched_on(),
        driven=emulated.driven(),
    )


_Made = tuple[Any, Sequence[EmulatedFault], Callable[[], Any]]
"""An emulated robot, its faults, and what opens its server."""


def _on_can(options: ServeOptions, settings: EmulateSettings, effects: EffectsSettings, reporter: Reporter) -> _Made:
    host, port = _address(options.listen)
    faults = [parse_fault(text) for text in options.fault]
    for fault in faults:
        if fault.kind in BOARD_ONLY:
            raise ConfigError(f"{fault.kind} is a fault of stock robots; add --board cyberdog2 or go2")
    robot = EmulatedRobot(
        load_robot(effects.robot_model),
        load_wiring(options.wiring, buses=options.buses),
        settings,
        effects=_effects(effects, settings, reporter),
        faults=faults,
        timestep=effects.timestep,
    )
    return robot, faults, lambda: EmulatorServer(robot, host=host, port=port, slcan=options.slcan)


def _network(board: str, options: ServeOptions) -> tuple[Any, Any, Callable[[], Bus]]:
    """Return class, wiring and network of a board."""
    if board == "go2":
        go2 = load_go2(options.wiring)
        check_go2_network(go2, "lo")
        return EmulatedGo2, go2, lambda: DdsBus(go2, "lo", robot=True)
    stock = load_board(options.wiring)
    check_network(stock, "lo")
    return EmulatedBoard, stock, lambda: LcmBus(stock, 0)


def _board(
    name: str, options: ServeOptions, settings: EmulateSettings, effects: EffectsSettings, reporter: Reporter
) -> _Made:
    _refuse_lacking(name, options, settings)
    made, wiring, open_bus = _network(name, options)
    faults = [parse_fault(text) for text in options.fault]
    board = made(
        load_robot(name if effects.robot_model == DEFAULT_ROBOT else effects.robot_model),
        wiring,
        settings,
        effects=_effects(effects, settings, reporter),
        faults=faults,
        timestep=TICK if effects.effects is None else effects.timestep,
    )
    address = f"{name} (on this computer: add --interface lo)"
    return board, faults, lambda: BoardServer(board, open_bus(), address)


def _effects(effects: EffectsSettings, settings: EmulateSettings, reporter: Reporter) -> EffectSet | None:
    """Return the effects that a robot in the air or on its feet has; None without a file."""
    if effects.effects is None:
        return None
    if settings.suspended:
        return read_effects(Path(effects.effects))
    warn_of_stand_effects(effects, reporter)
    return read_standing(Path(effects.effects))
