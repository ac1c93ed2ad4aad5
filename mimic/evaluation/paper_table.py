"""Evaluation of a policy as in the paper's Table III: random robots from the lying start, over evaluation seeds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mimic.config.evaluation import TableSettings
from mimic.config.play import RunSettings
from mimic.dynamics.ground_contacts import GroundFacts, ground_facts
from mimic.evaluation.episode import play_episode
from mimic.evaluation.paper_columns import (
    COLUMNS,
    PAPER,
    STAND_STEPS,
    TERMINATIONS,
    WEIGHTS,
    near_limits,
    terminations,
    terms,
    velocity_error,
)
from mimic.evaluation.policy import command_script
from mimic.geometry import heading_from_quat, wrap_angle
from mimic.jobs.local import Progress, run_all
from mimic.policy.runtime import cached_policy
from mimic.records import JOINTS, FloatArray, RunLog
from mimic.robot.description import RobotDescription, load_description
from mimic.simulation.plant import SimulatedPlant, plant_options

TIMING = RunSettings(stand_up=1.0, blend=0.1, hold=0.0)
"""As in the paper the first goal is approached from the neutral toes over 3 s, after 50 steps; the run loop commands no
velocity and no turn before, where the paper does."""

SEEDS_APART = 100_000
"""Between the episode seeds of two evaluation seeds."""


@dataclass(frozen=True, kw_only=True)
class Episode:
    """One episode in the paper's figures, with one set of terminations."""

    columns: dict[str, float]
    """Sum of each weighted term over the episode, divided by its full length."""
    reward: float
    """Sum of all weighted terms times the control step."""
    steps: int
    ended_by: str
    """Kind of termination, ``fall`` where the run ended before one, or ``time``."""
    toe_error_cm: float
    velocity_error: float
    """[m/s]"""
    heading_error: float
    """[rad]"""
    near_limit: tuple[float, ...]
    """Share of the steps that each joint is within 5 degrees of a limit (12,)."""


def _mean(values: FloatArray) -> float:
    return float(values.mean()) if values.size else float("nan")


def evaluate_episode(
    log: RunLog, ground: GroundFacts, description: RobotDescription, *, steps: int, kinds: tuple[str, ...]
) -> Episode:
    """Return the figures of one episode; unweighted errors are means after the 50th step.

    Args:
        log: From the lying start, steps + 1 ticks, or fewer where it fell.
        ground: Of the same log.
        description: The robot.
        steps: Control steps of a full episode.
        kinds: Kinds of termination that end it.
    """
    held = terminations(log, ground, description)
    first = {kind: int(np.argmax(held[kind])) + 1 for kind in kinds if held[kind].any()}
    count = min([*first.values(), steps, len(log.t) - 1])
    ended_by = next((kind for kind, at in first.items() if at == count), "time" if count == steps else "fall")
    values = {name: WEIGHTS[name] * value[:count] for name, value in terms(log, ground, description).items()}
    rows = slice(STAND_STEPS, count)
    toe = np.linalg.norm(log.p_BE[1:] - log.p_BE_des[:-1], axis=-1)
    turn = wrap_angle(log.heading_des[:-1] - heading_from_quat(log.quat_WB[1:]))
    return Episode(
        columns={name: float(value.sum() / steps) for name, value in values.items()},
        reward=float(sum(value.sum() for value in values.values()) * description.dt),
        steps=count,
        ended_by=ended_by,
        toe_error_cm=100 * _mean(toe[rows]),
        velocity_error=_mean(np.linalg.norm(velocity_error(log), axis=-1)[rows]),
        heading_error=_mean(np.abs(turn)[rows]),
        near_limit=tuple(near_limits(log.q[1 : count + 1], description).mean(0).tolist()),
    )


@dataclass(frozen=True, kw_only=True)
class _Job:
    group: int
    seed: int
    settings: TableSettings


def _play(job: _Job, policy_path: str) -> tuple[int, dict[str, Episode]]:
    description, policy = load_description(), cached_policy(policy_path)
    steps = round(job.settings.seconds / description.dt)
    rng = np.random.default_rng([job.seed, 5])
    neutral = np.array(policy.contract.neutral_toes).reshape(2, 3)
    seconds = (steps + 1) * description.dt - TIMING.stand_up - TIMING.blend
    track = command_script(description, seconds, rng, first=neutral)
    s = job.settings
    plant = SimulatedPlant(description, ranges=s.randomisation, seed=job.seed, samples=False, **plant_options(s.robot))
    log = play_episode(plant, policy, track, TIMING).log
    ground = ground_facts(log, description)
    return job.group, {
        name: evaluate_episode(log, ground, description, steps=steps, kinds=kinds)
        for name, kinds in TERMINATIONS.items()
    }


def over_seeds(groups: dict[int, list[Episode]]) -> dict[str, Any]:
    """Return mean and standard deviation over evaluation seeds of each figure, and the terminations.

    Args:
        groups: Episodes of each evaluation seed; figures that an episode lacks are left out of its seed's mean.
    """

    def over(value: Callable[[Episode], float]) -> dict[str, float]:
        means = []
        for episodes in groups.values():
            known = [v for v in map(value, episodes) if np.isfinite(v)]
            means.append(float(np.mean(known)) if known else float("nan"))
        return {"mean": float(np.mean(means)), "std": float(np.std(means))}

    def column(name: str) -> dict[str, float]:
        return over(lambda episode: episode.columns[name])

    everything = [episode for episodes in groups.values() for episode in episodes]
    kinds = sorted({episode.ended_by for episode in everything})
    near = np.mean([episode.near_limit for episode in everything], axis=0)
    return {
        "columns": {name: column(name) for name in COLUMNS}
        | {"episode_reward": over(lambda e: e.reward), "steps": over(lambda e: e.steps)},
        "unweighted": {
            "toe_error_cm": over(lambda e: e.toe_error_cm),
            "velocity_error_m_s": over(lambda e: e.velocity_error),
            "heading_error_rad": over(lambda e: e.heading_error),
        },
        "other_terms": {name: column(name) for name in WEIGHTS if name not in COLUMNS},
        "ended_by": {kind: sum(episode.ended_by == kind for episode in everything) for kind in kinds},
        "near_limit_share": dict(zip(JOINTS, near.tolist(), strict=True)),
    }


def evaluate_table(policy_path: Path, settings: TableSettings, *, progress: Progress | None = None) -> dict[str, Any]:
    """Return the paper's Table III for a policy, for each set of terminations; the same seeds give the same figures.

    Raises:
        AssetError, ContractError: If the policy cannot be run on this robot.
    """
    cached_policy(str(policy_path))
    plant_options(settings.robot)
    jobs = [
        _Job(group=group, seed=settings.seed + group * SEEDS_APART + i, settings=settings)
        for group in range(settings.seeds)
        for i in range(settings.episodes)
    ]
    rows = run_all(partial(_play, policy_path=str(policy_path)), jobs, workers=settings.workers, progress=progress)
    table, episodes = {}, {}
    for name in TERMINATIONS:
        groups = {group: [found[name] for at, found in rows if at == group] for group in range(settings.seeds)}
        table[name] = over_seeds(groups)
        episodes[name] = [asdict(episode) | {"group": at} for at, episode in ((at, f[name]) for at, f in rows)]
    paper = {name: {"mean": mean, "std": std} for name, (mean, std) in PAPER.items()}
    return {"policy": policy_path.name, "paper": paper, "table": table, "episodes": episodes}
