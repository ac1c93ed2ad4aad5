"""``mimic emulate``: an emulated robot for rehearsals."""

from __future__ import annotations

from typing import Literal

from mimic.cli import options as o
from mimic.cli.terminal.console import ConsoleReporter, table
from mimic.cli.terminal.exit_status import DONE


def emulate(
    *,
    board: Literal["cyberdog2", "go2"] | None = None,
    serve: o.Serve = None,
    settings: o.Emulate = None,
    robot: o.Effects = None,
) -> int:
    """Serve an emulated robot on emulated CAN buses, or a stock one (--board), for rehearsals with --robot.

    Parameters
    ----------
    board
        Serve a stock CyberDog 2 (LCM) or a Unitree Go2 (DDS) on this computer; connect with --robot cyberdog2 or go2,
        and --interface lo.
    """
    from mimic.flows.robot.emulate import serve_robot

    served = serve_robot(serve, settings, robot, board=board, reporter=ConsoleReporter())
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
