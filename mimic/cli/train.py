"""``mimic train``: a low-level policy."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from mimic.cli.terminal.console import ConsoleReporter, console, matrix, note
from mimic.cli.terminal.exit_status import DONE
from mimic.config.play import DEFAULT_ROBOT

if TYPE_CHECKING:
    from mimic.config.training import MdpSettings


def train(
    out: Path | None = None,
    /,
    *,
    recipe: str = "stand_track",
    set: Annotated[tuple[str, ...], Parameter(name="--set")] = (),
    robot_model: str = DEFAULT_ROBOT,
    resume: Path | None = None,
    show_weights: bool = False,
) -> int:
    """Train the low-level policy: minutes on a GPU; on a CPU with few worlds to try it out.

    On several GPUs: torchrun --nproc-per-node 2 -m mimic train OUT; each then has its share of the worlds.

    Parameters
    ----------
    out
        Folder for checkpoints, TensorBoard files, settings.json and policy.onnx.
    recipe
        Settings: stand_track, sit_down, go2_stand_track, or a TOML file; missing settings are those of stand_track.
    set
        NAME=VALUE for single settings, such as minutes=9 worlds=4096 rewards.slip=-0.4 effects=effects.toml.
    robot_model
        cyberdog2, go2, or the folder of another robot with its robot.toml and MJCF.
    resume
        Checkpoint (.pt) to continue from, or a policy (.onnx), with a new critic; that of another robot begins easy.
    show_weights
        Print what a unit of each reward term counts over the training, and do not train.
    """
    from mimic.config.training import ENDLESS
    from mimic.errors import ConfigError
    from mimic.flows.reporter import SilentReporter
    from mimic.flows.train import train as train_policy
    from mimic.flows.train import training_settings

    mdp, learn = training_settings(recipe, set)
    if show_weights:
        _show_weights(mdp)
        return DONE
    if out is None:
        raise ConfigError("no folder for the training; expected OUT, as in: mimic train out/")
    first = os.environ.get("RANK", "0") == "0"  # of the processes that torchrun starts
    figure, unit = ("track/toe_error_cm", "cm toes") if mdp.task == "stand_track" else ("sit_down/lying", "lying")

    def report(update: int, row: dict[str, float]) -> None:
        if update % 10 == 0 or update == learn.updates - 1:
            console.print(
                f"update {update:5d}  {row['steps'] / 1e6:7.1f} M steps  {row['elapsed_s']:6.0f} s  "
                f"reward {row['reward']:7.1f}  episode {row['episode']:5.0f}  {row.get(figure, math.nan):5.2f} {unit}"
            )

    if first:
        length = f"{learn.minutes:g} minutes" if learn.updates == ENDLESS else f"at most {learn.updates} updates"
        note(f"{mdp.worlds} worlds, {length}; TensorBoard: tensorboard --logdir {out}")
    reporter = ConsoleReporter() if first else SilentReporter()
    path = train_policy(out, mdp, learn, robot=robot_model, resume=resume, report=report, reporter=reporter)
    if first:
        robot = "" if robot_model == DEFAULT_ROBOT else f" --robot-model {robot_model}"
        note(f"wrote {path}; evaluate it with: mimic evaluate {path}{robot}")
    return DONE


def _show_weights(mdp: MdpSettings) -> None:
    """Print the reward for a unit of each term, at each control step where one begins or ends to change."""
    from mimic.train.weights import weight_table

    by_step = weight_table(mdp)
    rows: dict[str, dict[str, str]] = {}
    for step, weights in by_step.items():
        for name, weight in weights.items():
            rows.setdefault(name, {})[f"{step}"] = f"{weight:z.3g}"
    matrix("reward for a unit of each term, after control steps of a world", rows)
