"""``mimic emulate``: an emulated robot for rehearsals."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from mimic.cli import options as o
from mimic.cli.terminal.console import ConsoleReporter, table
from mimic.cli.terminal.exit_status import DONE


def emulate(
    *,
    board: Literal["cyberdog2", "go2"] | None = None,
    listen: str = "127.0.0.1:29536",
    slcan: Annotated[bool, o.Flag] = False,
    buses: int = 1,
    wiring: Path | None = None,
    fault: tuple[str, ...] = (),
    seconds: float | None = None,
    every: float = 10.0,
    settings: o.Emulate = None,
    robot: o.Effects = None,
) -> int:
    """Serve an emulated robot on emulated CAN buses, or a stock one (--board), for rehearsals with --robot.

    Parameters
    ----------
    board
        Serve a stock CyberDog 2 (LCM) or a Unitree Go2 (DDS) on this computer; connect with --robot cyberdog2 or go2,
        and --interface lo.
    listen
        Address for socketcand; port 0 takes a free one. Keep it on this computer: whoever reaches it moves the robot.
    slcan
        Also offer each bus as a serial adapter (slcan) on a pseudo-terminal, like a USB adapter.
    buses
        Number of buses.
    wiring
        Wiring file; default: the shipped one.
    fault
        Faults to inject: KIND[:PLACE][=VALUE][@[+]FROM[-UNTIL]], such as motor_dead:FL_knee@12.5, in seconds of the
        emulation, or with + since the first motor was switched on. An unknown kind prints the list.
    seconds
        End after this time [s]; default: at Ctrl-C.
    every
        Interval of the status lines [s]; 0 for none.
    """
    from mimic.flows.robot.emulate import ServeOptions, serve_robot

    serve = ServeOptions(
        listen=listen,
        slcan=slcan,
        buses=buses,
        wiring=wiring,
        faults=fault,
        seconds=seconds,
        every=every,
        board=board,
    )
    served = serve_robot(serve, settings, robot, reporter=ConsoleReporter())
    table(
        "Emulated robot" if board is None else "Emulated stock robot",
        {
            "time": f"{served.seconds:.1f} s",
            **served.figures,
            "time stood still": f"{served.stood_still:.2f} s, because this computer was too slow",
            "motors at the end": _motors(served.switched_on, served.driven),
        },
    )
    return DONE


def _motors(switched_on: tuple[str, ...], driven: tuple[str, ...]) -> str:
    """Return how the motors were left, in words."""
    if driven:
        return f"driven: {', '.join(driven)}"
    return f"none driven; on: {', '.join(switched_on)}" if switched_on else "none driven"
