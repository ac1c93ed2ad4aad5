"""``mimic train``: a low-level policy."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from mimic.cli import options as o
from mimic.cli.exit_status import DONE
from mimic.config.training import ENDLESS, LearnSettings, MdpSettings


def train(
    out: Path,
    /,
    *,
    recipe: str | None = None,
    resume: Path | None = None,
    task: Literal["stand-track", "sit-down"] = "stand-track",
    worlds: int = MdpSettings().worlds,
    set: Annotated[tuple[str, ...], Parameter(name="--set")] = (),
    robot: o.Effects = None,
    learn: o.Learn = None,
) -> int:
    """Train the low-level policy: minutes on a GPU; on a CPU with few worlds to try it out.

    Parameters
    ----------
    out
        Folder for checkpoints, TensorBoard files and policy.onnx.
    recipe
        Settings of a shipped policy by its name, stand_track, or a TOML file; it goes before --worlds and the like.
    resume
        Checkpoint (.pt) to go on from, or a policy (.onnx), whose critic is then learned anew.
    task
        What is learned: to stand up, walk and bring the front toes to goals, or to sit down.
    worlds
        Robots simulated at once.
    set
        NAME=VALUE for any other setting, such as rewards.slip=-0.4 or randomisation.push=[0,0.5].
    """
    from mimic.cli.console import ConsoleReporter, console, note
    from mimic.flows.evaluate import train as train_policy

    learn = learn or LearnSettings()
    around = {"effects": robot.effects, "timestep": robot.timestep} if robot and robot.effects else {}
    mdp = replace(MdpSettings(), worlds=worlds, task=task.replace("-", "_"), **around)
    figure, unit = ("track/toe_error_cm", "cm toes") if task == "stand-track" else ("sit_down/lying", "lying")

    def report(update: int, row: dict[str, float]) -> None:
        if update % 10 == 0 or update == learn.updates - 1:
            console.print(
                f"update {update:5d}  {row['steps'] / 1e6:7.1f} M steps  {row['elapsed_s']:6.0f} s  "
                f"reward {row['reward']:7.1f}  episode {row['episode']:5.0f}  {row.get(figure, math.nan):5.2f} {unit}"
            )

    length = f"{learn.minutes:g} minutes" if learn.updates == ENDLESS else f"at most {learn.updates} updates"
    note(f"{worlds} worlds, {length}; TensorBoard: tensorboard --logdir {out}")
    path = train_policy(
        out, mdp, learn, resume=resume, recipe=recipe, overrides=list(set), report=report, reporter=ConsoleReporter()
    )
    note(f"wrote {path}; evaluate it with: mimic evaluate {path}")
    return DONE
