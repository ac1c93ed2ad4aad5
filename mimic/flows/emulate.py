"""Serving the emulated robot to other processes."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mimic.config.emulator import EmulateSettings
from mimic.config.play import DEFAULT_ROBOT, EffectsSettings
from mimic.control.priority import EMULATOR, real_time
from mimic.errors import ConfigError
from mimic.flows.play import load_robot, warn_of_stand_effects
from mimic.flows.reporter import Reporter, SilentReporter

if TYPE_CHECKING:
    from mimic.emulator.server import EmulatorStatus

FRAME_INTERVAL = 1 / 30
"""Time between two pictures in the viewer [s]."""

CLOSE_TIMEOUT = 5.0
"""Longest wait for the viewer's window to close [s]."""

RANDOM_FAULT = (0.5, 8.0)
"""A random fault begins this long after the first motor was switched on [s]."""


@dataclass(frozen=True, kw_only=True)
class ServeOptions:
    """Where and how long the robot is served."""

    listen: str = "127.0.0.1:29536"
    """HOST:PORT for socketcand; port 0 takes a free one."""
    slcan: bool = False
    """Whether each bus is also served as a serial adapter (slcan) on a pseudo-terminal."""
    buses: int = 1
    """Number of buses."""
    wiring: Path | None = None
    """Wiring file; by default the shipped one."""
    faults: Sequence[str] = ()
    """Faults to inject, KIND[:PLACE][=VALUE][@[+]FROM[-UNTIL]]."""
    fault_seed: int | None = None
    """Also inject a random fault, drawn with this seed."""
    seconds: float | None = None
    """End after this [s]; None serves until Ctrl-C or SIGTERM."""
    every: float = 10.0
    """Interval of the status lines [s]; 0 for none."""
    view: bool = False
    """Open MuJoCo's viewer."""
    board: str | None = None
    """Stock robot to serve, cyberdog2 or go2; None serves motors on CAN."""


@dataclass(frozen=True, kw_only=True)
class Served:
    """What was served."""

    seconds: float
    """Time of the emulation [s]."""
    frames: int
    bits_per_frame: float
    load: tuple[float, ...]
    """Share of each bus's time that was used."""
    late: int
    """Frames delivered more than 2 ms late."""
    stood_still: float
    """For how long the emulation stood still because this computer was too slow [s]."""
    switched_on: tuple[str, ...]
    """Joints whose motors were on at the end."""
    driven: tuple[str, ...]
    """Those of them that had stiffness or torque."""


def _address(listen: str) -> tuple[str, int]:
    host, colon, port = listen.rpartition(":")
    if not colon or not host or not port.isdigit() or int(port) > 65535:
        raise ConfigError(f"--listen is {listen!r}; expected HOST:PORT, such as 127.0.0.1:29536")
    return host, int(port)


def serve_robot(
    options: ServeOptions | None = None,
    settings: EmulateSettings | None = None,
    effects: EffectsSettings | None = None,
    *,
    reporter: Reporter | None = None,
) -> Served:
    """Serve an emulated robot on emulated CAN buses until Ctrl-C, SIGTERM or the given time.

    Args:
        options: Where and how long.
        settings: How the robot behaves.
        effects: What a calibration found.
        reporter: Receives addresses, events and status lines.

    Raises:
        ConfigError: If an address, a fault or the effects cannot be used.
        AssetError: If a file cannot be read.
    """
    from mimic.emulator.faults import BOARD_ONLY, parse_fault, random_fault
    from mimic.emulator.robot import EmulatedRobot
    from mimic.emulator.server import EmulatorServer
    from mimic.hardware.can.wiring import load_wiring

    options, settings = options or ServeOptions(), settings or EmulateSettings()
    effects, reporter = effects or EffectsSettings(), reporter or SilentReporter()
    host, port = _address(options.listen)
    faults = [parse_fault(text) for text in options.faults]
    for fault in faults:
        if fault.kind in BOARD_ONLY:
            raise ConfigError(f"{fault.kind} is a fault of stock robots; add --board cyberdog2 or go2")
    if options.fault_seed is not None:
        faults.append(random_fault(options.fault_seed, start=RANDOM_FAULT, after_release=True))
    emulated = EmulatedRobot(
        load_robot(effects.robot_model),
        load_wiring(options.wiring, buses=options.buses),
        settings,
        effects=_effects(effects, settings, reporter),
        faults=faults,
        timestep=effects.timestep,
        visuals=options.view,
    )
    late, stood = 0, 0.0

    def line(status: EmulatorStatus) -> str:
        nonlocal late, stood
        late, stood = late + status.late, stood + status.stood_still
        return _line(status)

    def listen() -> tuple[EmulatorServer, Sequence[str]]:
        server = EmulatorServer(emulated, host=host, port=port, slcan=options.slcan)
        return server, server.addresses

    line(_serve(emulated, listen, line, options, faults, reporter))
    bits, frames = sum(bus.bits for bus in emulated.buses), sum(bus.frames for bus in emulated.buses)
    return Served(
        seconds=emulated.now,
        frames=frames,
        bits_per_frame=bits / max(frames, 1),
        load=tuple(emulated.load(i) for i in range(len(emulated.buses))),
        late=late,
        stood_still=stood,
        switched_on=emulated.switched_on(),
        driven=emulated.driven(),
    )


def _line(status: EmulatorStatus) -> str:
    buses = ", ".join(
        f"{load:.1%} at {rate:.0f} frames/s" for load, rate in zip(status.load, status.frames, strict=True)
    )
    late = f"; {status.late} frames late, {1e3 * status.latest:.1f} ms at most" if status.late else ""
    still = f"; stood still for {status.stood_still:.2f} s" if status.stood_still else ""
    clients = f"{status.clients} client{'s' if status.clients != 1 else ''}"
    return f"{status.t:9.1f} s  bus load {buses}; {clients}{late}{still}"


@dataclass(frozen=True, kw_only=True)
class ServedBoard:
    """What was served."""

    seconds: float
    """Time of the emulation [s]."""
    figures: Mapping[str, str]
    """Rows of a table of what happened."""
    stood_still: float
    """For how long the emulation stood still because this computer was too slow [s]."""
    driven: tuple[str, ...]
    """Joints that had stiffness or torque at the end."""


def serve_board(
    options: ServeOptions | None = None,
    settings: EmulateSettings | None = None,
    effects: EffectsSettings | None = None,
    *,
    reporter: Reporter | None = None,
) -> ServedBoard:
    """Serve an emulated stock robot on this computer until Ctrl-C, SIGTERM or the given time.

    Args:
        options: Which robot, for how long, and which faults.
        settings: How the robot lies or hangs.
        effects: What a calibration found.
        reporter: Receives events and status lines.

    Raises:
        ConfigError: If a fault or the effects cannot be used.
        AssetError: If a file cannot be read.
        BusError, MissingExtra: If its network cannot be opened.
    """
    from mimic.emulator.board_base import TICK
    from mimic.emulator.board_server import BoardServer, BoardStatus
    from mimic.emulator.faults import parse_fault, random_fault

    options, settings = options or ServeOptions(), settings or EmulateSettings()
    effects, reporter = effects or EffectsSettings(), reporter or SilentReporter()
    name = options.board or DEFAULT_ROBOT
    kind, kinds, wiring, open_bus = _board(name, options)
    faults = [parse_fault(text) for text in options.faults]
    if options.fault_seed is not None:
        faults.append(random_fault(options.fault_seed, start=RANDOM_FAULT, after_release=True, kinds=kinds))
    board = kind(
        load_robot(name if effects.robot_model == DEFAULT_ROBOT else effects.robot_model),
        wiring,
        settings,
        effects=_effects(effects, settings, reporter),
        faults=faults,
        timestep=TICK if effects.effects is None else effects.timestep,
        visuals=options.view,
    )

    def listen() -> tuple[BoardServer, Sequence[str]]:
        return BoardServer(board, open_bus()), (f"{name} (on this computer: add --interface lo)",)

    def line(status: BoardStatus) -> str:
        return f"{status.t:9.1f} s  {board.line()}"

    status = _serve(board, listen, line, options, faults, reporter)
    return ServedBoard(seconds=status.t, figures=board.figures(), stood_still=status.stood_still, driven=board.driven())


def _board(name: str, options: ServeOptions) -> tuple[Any, tuple[str, ...], Any, Callable[[], Any]]:
    """Return class, kinds of faults, wiring and network of a board."""
    if name == "go2":
        from mimic.emulator import go2
        from mimic.hardware.go2.dds_bus import DdsBus
        from mimic.hardware.go2.wiring import load_go2

        there = load_go2(options.wiring)
        return go2.EmulatedGo2, go2.FAULTS, there, lambda: DdsBus(there, "lo", robot=True)
    from mimic.emulator import board
    from mimic.hardware.stock.lcm_bus import LcmBus, check_network
    from mimic.hardware.stock.wiring import load_board

    wiring = load_board(options.wiring)
    check_network(wiring, "lo")
    return board.EmulatedBoard, board.FAULTS, wiring, lambda: LcmBus(wiring, 0)


def _effects(effects: EffectsSettings, settings: EmulateSettings, reporter: Reporter) -> Any:
    """Return the effects that a robot in the air or on its feet has; None without a file."""
    from mimic.dynamics.effect_set import read_effects
    from mimic.dynamics.servo import read_standing

    if effects.effects is None:
        return None
    if settings.suspended:
        return read_effects(Path(effects.effects))
    warn_of_stand_effects(effects, reporter)
    return read_standing(Path(effects.effects))


def _serve(
    emulated: Any,
    listen: Callable[[], tuple[Any, Sequence[str]]],
    line: Callable[[Any], str],
    options: ServeOptions,
    faults: Sequence[Any],
    reporter: Reporter,
) -> Any:
    """Serve a robot or board to the end; return the last statistics of its server.

    Args:
        emulated: What is served.
        listen: Opens the server; returns it with its addresses.
        line: Makes a status line of statistics.
        options: How long, and what is shown.
        faults: To be reported at the start.
        reporter: Receives addresses, events and status lines.
    """
    shown = _Viewer(emulated.body.model, emulated.body.data) if options.view else None
    server, addresses = listen()
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
            reporter.note(line(server.status()))
        if shown is not None:
            shown.show()

    try:
        with _until_signal() as signalled, real_time(EMULATOR):

            def ended() -> bool:
                over = options.seconds is not None and time.monotonic() - begin >= options.seconds
                return signalled() or over or (shown is not None and not shown.open())

            for address in addresses:
                reporter.note(f"ready        {address}")
            server.run(ended, each)
    finally:
        server.close()
        if shown is not None:
            shown.close()
    return server.status()


@contextmanager
def _until_signal() -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether Ctrl-C or SIGTERM has come."""
    came: list[int] = []
    before = {n: signal.signal(n, lambda n, _: came.append(n)) for n in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(came)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class _Viewer:
    """MuJoCo's viewer of the running emulation."""

    def __init__(self, model: Any, data: Any) -> None:
        from mimic.view.scene.viewer import display_available

        if not display_available():
            raise ConfigError("--view needs a display, and there is none here")
        import mujoco.viewer

        if not model.nlight:  # hung up there is no scene around the robot
            model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = 0.4, 0.7
        before = set(threading.enumerate())
        self._handle = mujoco.viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False)
        self._threads = [thread for thread in threading.enumerate() if thread not in before]
        self._next = 0.0

    def open(self) -> bool:
        return self._handle.is_running()

    def close(self) -> None:
        self._handle.close()
        for thread in self._threads:  # its window must be gone before the process ends, or that ends in a crash
            thread.join(CLOSE_TIMEOUT)

    def show(self) -> None:
        if time.monotonic() >= self._next:
            self._next = time.monotonic() + FRAME_INTERVAL
            self._handle.sync()
