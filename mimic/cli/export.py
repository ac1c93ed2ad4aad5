"""``mimic export``: a run or a policy for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from mimic.cli import options as o
from mimic.cli.terminal.console import ConsoleReporter, table
from mimic.cli.terminal.exit_status import DONE
from mimic.config.play import DEFAULT_ROBOT

Format = Literal["lerobot", "csv", "npz", "mcap", "rl_sar", "unitree_rl_lab"]


def export(
    source: Path,
    /,
    *,
    out: o.RequiredOut,
    form: Annotated[Format, Parameter(name="--format")] = "lerobot",
    video: bool = True,
    robot_model: str = DEFAULT_ROBOT,
) -> int:
    """Write a run, all runs of a batch, or a policy in the format of another program.

    Parameters
    ----------
    source
        Folder of a run, or of a batch; each run of a batch becomes an episode. A policy for rl_sar or unitree_rl_lab.
    out
        Folder of the dataset or policy, or file (.csv, .npz, .mcap).
    form
        lerobot: a LeRobotDataset v3 with state, action and video; csv, npz: every column of the log; mcap: joints,
        links and targets as messages of ROS 2; rl_sar, unitree_rl_lab: a policy with the settings file of these
        programs.
    video
        Add a film of the robot, one frame for each row (lerobot).
    robot_model
        Robot of a policy.
    """
    from mimic.flows.export import export as write

    if form in ("rl_sar", "unitree_rl_lab"):
        from mimic.flows.deploy import export_policy

        unknown = export_policy(source, out, form, robot=robot_model)
        table("Export", {"written": str(out), f"terms that {form} lacks": ", ".join(unknown)})
        return DONE
    count = write(source, out, form, video=video, reporter=ConsoleReporter())
    table("Export", {"runs": str(count), "written": str(out)})
    return DONE
