"""Independent episodes in parallel over the cores, in the order they were asked for."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar

from mimic.policy.runtime import Policy
from mimic.robot.description import load_description, with_timestep
from mimic.robot.machine import hung_robot
from mimic.robot.servo import parameters_of, read_standing
from mimic.settings import EffectsSettings, Solver

Job = TypeVar("Job")
Row = TypeVar("Row")

Progress = Callable[[int, int], None]
"""Called with the episodes done and in all."""

_loaded: dict[str, Policy] = {}


def loaded_policy(path: str) -> Policy:
    """Return the policy of a file, read once in each process.

    Raises:
        AssetError, ContractError: If it cannot be run on this robot.
    """
    if path not in _loaded:
        _loaded[path] = Policy(Path(path), load_description())
    return _loaded[path]


@cache
def simulated(robot: EffectsSettings) -> dict[str, Any]:
    """Return what a simulated plant is given so that it is this robot; effects are read once in each process.

    Raises:
        ConfigError: If the effects cannot be read or name a joint that the robot lacks, or the control step is no multiple of
            the physics step.
    """
    if robot.effects is None:
        return {}
    description = with_timestep(load_description(), robot.timestep)
    effects = read_standing(Path(robot.effects))
    parameters_of(effects, hung_robot(description))
    return {"effects": effects, "solver": Solver(timestep=robot.timestep)}


def play_all(
    play: Callable[[Job], Row], jobs: Sequence[Job], *, workers: int = 0, progress: Progress | None = None
) -> list[Row]:
    """Return what ``play`` makes of each job, in the order of the jobs.

    Args:
        play: A function that other processes can import.
        jobs: One for each episode.
        workers: Processes; 0 takes one for each core.
        progress: Called after each episode.
    """
    rows: list[Row] = []
    count = workers or len(os.sched_getaffinity(0))
    with ProcessPoolExecutor(max_workers=count, mp_context=get_context("spawn")) as pool:
        for row in pool.map(play, jobs, chunksize=2):
            rows.append(row)
            if progress is not None:
                progress(len(rows), len(jobs))
    return rows
