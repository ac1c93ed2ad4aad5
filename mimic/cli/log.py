"""``mimic log``: simulate, replay and salvage logs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from mimic.cli import options as o
from mimic.cli.terminal.console import ConsoleReporter, note, warn
from mimic.cli.terminal.exit_status import DONE


def simulate(
    *,
    out: o.RequiredOut,
    effects: Path | None = None,
    model: Path | None = None,
    motion: o.LogMotion = None,
    settings: o.SimulatedLog = None,
) -> int:
    """Write the log of a simulated machine with hidden effects, as a real one would be logged.

    Parameters
    ----------
    out
        Parquet or CSV file to write.
    effects
        effects.toml of the machine; default: no effects.
    model
        MJCF of the machine, base fixed; default: the suspended CyberDog 2.
    """
    from mimic.flows.logs.machine_log import simulate_log

    log = simulate_log(effects, model, motion, settings, out=out, reporter=ConsoleReporter())
    note(f"wrote {out}: {len(log.t)} readings of {len(log.joints)} joints; to explain it: mimic calibrate {out}")
    return DONE


def replay(
    log: Path,
    /,
    *,
    effects: tuple[Path, ...] = (),
    model: Path | None = None,
    whole: Annotated[bool, Parameter(negative="")] = False,
    out: o.Out = None,
) -> int:
    """Show how well models predict a log, such as one that was not calibrated from; nothing is fitted.

    Parameters
    ----------
    log
        Parquet or CSV file as for mimic calibrate.
    effects
        effects.toml files of calibrations, to compare them.
    model
        MJCF of the machine, base fixed; default: the suspended CyberDog 2.
    whole
        Replay the log in one piece; default: in blocks of 1.5 s, each from where the readings before say it is.
    out
        JSON file for the errors.
    """
    from mimic.cli.calibrate import show_errors
    from mimic.flows.logs.machine_log import predict_log
    from mimic.view.report.plots import unit_of_size

    found = predict_log(log, effects, model, whole=whole, out=out, reporter=ConsoleReporter())
    for text in found.warnings:
        warn(text)
    unit = unit_of_size(max(e["all"] for e in found.errors.values()), found.unit)
    columns = {name: e["rms"] for name, e in found.errors.items()}
    show_errors("Error", found.joints, {**columns, "noise floor": found.noise}, unit)
    if out is not None:
        note(f"wrote {out}")
    return DONE


def salvage(run: Path, /) -> int:
    """Recover the log of a run on the robot whose process was killed.

    Parameters
    ----------
    run
        Folder of the run.
    """
    from mimic.flows.robot.robot_run import salvage as recover

    path, ticks = recover(run)
    note(f"salvaged     {ticks} ticks into {path}")
    return DONE
