"""``mimic export``: a run for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from mimic.cli import options as o
from mimic.cli.terminal.exit_status import DONE


def export(
    run: Path,
    /,
    *,
    out: o.RequiredOut,
    form: Annotated[Literal["lerobot", "csv", "npz", "mjlab", "gmr", "mcap"], Parameter(name="--format")] = "lerobot",
    video: bool = True,
) -> int:
    """Write a run, or all runs of a batch, in the format of another program.

    Parameters
    ----------
    run
        Folder of a run, or of a batch; each run of a batch becomes an episode.
    out
        Folder of the dataset, or file (.csv; .npz for npz and mjlab; .pkl for gmr; .mcap).
    form
        lerobot: a LeRobotDataset v3 with state, action and video; csv, npz: every column of the log;
        mjlab, gmr: joints and base as a motion file of these programs; mcap: joints, links and targets as messages of
        ROS 2.
    video
        Add a film of the robot, one frame for each row (lerobot).
    """
    from mimic.cli.terminal.console import ConsoleReporter, table
    from mimic.flows.export import export as write

    count = write(run, out, form, video=video, reporter=ConsoleReporter())
    table("Export", {"runs": str(count), "written": str(out)})
    return DONE
