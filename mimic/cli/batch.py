"""``mimic batch``: a folder of files, into one table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from mimic.cli import options as o
from mimic.cli.terminal.console import ConsoleReporter, table, warn
from mimic.cli.terminal.exit_status import DONE, PARTLY_FAILED, STOPPED, USER_ERROR

if TYPE_CHECKING:
    from mimic.flows.batch import Batch


def batch(
    folder: Path,
    /,
    *,
    out: o.RequiredOut,
    workers: int = 0,
    ray: str | None = None,
    retarget: Annotated[o.Retarget, o.only("retarget", "rate", "mirror", "slow_down")] = None,
    run: Annotated[o.Run, o.only("run", "policy", "seed", "early")] = None,
    robot: Annotated[o.Effects, o.only("robot", "robot_model", "effects")] = None,
    pose: Annotated[o.Pose, o.only("pose", "person")] = None,
    stored: Annotated[o.Stored, o.only("stored")] = None,
) -> int:
    """Play every video and motion file of a folder in simulation, into one table; go on where it was stopped.

    Parameters
    ----------
    folder
        Folder to search, with its subfolders.
    out
        Folder for summary.html, summary.parquet and a folder for each file.
    workers
        Processes; 0: one per core.
    ray
        Play on a Ray cluster at this address, such as auto or 10.0.0.5:6379; its nodes need the same paths.
    """
    from mimic.flows.batch import batch as play_folder

    settings = o.input_settings(pose=pose, stored=stored, retarget=retarget)
    done = play_folder(
        folder, out, settings, run=run, effects=robot, workers=workers, ray=ray, reporter=ConsoleReporter()
    )
    return _show(done)


def _show(done: Batch) -> int:
    failed = done.with_status("failed")
    fell = done.with_status("fell")
    for row in failed:
        warn(f"{row['file']}: {row['error']}")
    for row in fell:
        warn(f"{row['file']}: the robot was about to fall and was damped")
    played = [row for row in done.rows if row["status"] != "failed"]
    unplayed = done.files - len(done.rows)
    figures = {"files": f"{len(played)} played, {len(failed)} failed, {unplayed} not processed"}
    errors = [row["toe_error_cm"] for row in played if row["toe_error_cm"] is not None]
    clamped = [row["clamped_share"] for row in played if row["clamped_share"] is not None]
    if errors:
        figures["toe error"] = f"{sum(errors) / len(errors):.1f} cm, mean over the files"
    if clamped:
        figures["clamped"] = f"{sum(clamped) / len(clamped):.1%} of the targets"
    if played:
        figures["fell"] = f"{len(fell)}"
    table("Batch", figures | {"written": f"{done.page}, {done.summary}"})
    if done.interrupted:
        return STOPPED
    if failed:
        return PARTLY_FAILED if played else USER_ERROR
    return DONE
