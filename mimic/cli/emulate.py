"""``mimic emulate``: the emulated robot, served to other processes until it is told to stop."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mimic.cli.app import DONE
from mimic.cli.console import note, table
from mimic.errors import ConfigError
from mimic.settings import EffectsSettings, EmulateSettings

FRAMES_SHOWN = 1 / 30
"""Time between two pictures in the viewer [s]."""

CLOSED_WITHIN = 5.0
"""A viewer that does not close within this is left alone [s]."""

RANDOM_FAULT = (0.5, 8.0)
"""A fault that is drawn begins this long after the first motor was switched on [s]."""


@dataclass(frozen=True, kw_only=True)
class ServeOptions:
    """Where and how long the robot is served."""

    listen: str
    slcan: int | None
    buses: int
    wiring: Path | None
    faults: Sequence[str]
    fault_seed: int | None
    seconds: float | None
    every: float
    view: bool


def _address(listen: str) -> tuple[str, int]:
    host, colon, port = listen.rpartition(":")
    if not colon or not host or not port.isdigit() or int(port) > 65535:
        raise ConfigError(f"--listen is {listen!r}; expected HOST:PORT, such as 127.0.0.1:29536")
    return host, int(port)


def emulate(options: ServeOptions, settings: EmulateSettings, robot: EffectsSettings) -> int:
    """Serve the robot until Ctrl-C, SIGTERM or the given time."""
    from mimic.robot.description import load_description
    from mimic.robot.effect_set import read_effects
    from mimic.robot.servo import read_standing
    from mimic.robot.wiring import load_wiring
    from mimic.run.emulated_faults import parse_fault, random_fault
    from mimic.run.emulator import EmulatedRobot
    from mimic.run.emulator_server import EmulatorServer

    host, port = _address(options.listen)
    faults = [parse_fault(text) for text in options.faults]
    if options.fault_seed is not None:
        faults.append(random_fault(options.fault_seed, start=RANDOM_FAULT, after_release=True))
    effects = None
    if robot.effects is not None:
        if not settings.hung:
            from mimic.cli.judge import tell_of_stand

            tell_of_stand(robot)
        effects = (read_effects if settings.hung else read_standing)(Path(robot.effects))
    emulated = EmulatedRobot(
        load_description(),
        load_wiring(options.wiring, buses=options.buses),
        settings,
        effects=effects,
        faults=faults,
        timestep=robot.timestep,
        visuals=options.view,
    )
    shown = _Viewer(emulated.body.model, emulated.body.data) if options.view else None
    server = EmulatorServer(emulated, host=host, port=port, slcan=options.slcan)
    for fault in faults:
        note(f"fault        {fault}")
    begin = time.monotonic()
    told, late, stood = begin, 0, 0.0

    def each() -> None:
        nonlocal told, late, stood
        while emulated.told:
            t, text = emulated.told.popleft()
            note(f"{t:9.3f} s  {text}")
        if options.every and time.monotonic() - told >= options.every:
            told = time.monotonic()
            status = server.status()
            late, stood = late + status.late, stood + status.stood_still
            note(_line(status))
        if shown is not None:
            shown.show()

    try:
        with _until_signal() as signalled:

            def ended() -> bool:
                over = options.seconds is not None and time.monotonic() - begin >= options.seconds
                return signalled() or over or (shown is not None and not shown.open())

            for address in server.addresses:
                note(f"ready        {address}")
            server.run(ended, each)
    finally:
        server.close()
        if shown is not None:
            shown.close()
    status = server.status()
    bits, frames = sum(bus.bits for bus in emulated.buses), sum(bus.frames for bus in emulated.buses)
    rows = {
        "time": f"{emulated.now:.1f} s",
        "frames": f"{frames}, {bits / max(frames, 1):.1f} bits each on average",
        "bus load": ", ".join(f"{emulated.load(i):.1%}" for i in range(len(emulated.buses))),
        "handed out late": f"{late + status.late} frames by more than 2 ms",
        "time stood still": f"{stood + status.stood_still:.2f} s, because this machine was too slow",
    }
    table("Emulated robot", rows)
    return DONE


def _line(status: Any) -> str:
    buses = ", ".join(
        f"{load:.1%} at {rate:.0f} frames/s" for load, rate in zip(status.load, status.frames, strict=True)
    )
    late = f"; {status.late} frames late, {1e3 * status.latest:.1f} ms at most" if status.late else ""
    still = f"; stood still for {status.stood_still:.2f} s" if status.stood_still else ""
    clients = f"{status.clients} client{'s' if status.clients != 1 else ''}"
    return f"{status.t:9.1f} s  bus load {buses}; {clients}{late}{still}"


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
        from mimic.view.viewer import display_available

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
            thread.join(CLOSED_WITHIN)

    def show(self) -> None:
        if time.monotonic() >= self._next:
            self._next = time.monotonic() + FRAMES_SHOWN
            self._handle.sync()
