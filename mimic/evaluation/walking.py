"""Speed reached by speed asked, with still and with moving arms; asked also beyond what a policy was trained for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mimic.config.play import EffectsSettings
from mimic.evaluation.disturbance_axes import START
from mimic.evaluation.episode import play_episode
from mimic.evaluation.policy import TIMING, command_script, forward_speed
from mimic.jobs.local import Progress, run_all
from mimic.policy.runtime import cached_policy
from mimic.records import CommandTrack, FloatArray
from mimic.robot.description import RobotDescription, load_description
from mimic.simulation.plant import SimulatedPlant, plant_options

SPEEDS = (-0.6, -0.45, -0.3, -0.15, 0.0, 0.15, 0.3, 0.45, 0.6)
"""Asked speeds [m/s], forward positive."""

ARMS = ("still", "moving")
"""Front toes at rest in the neutral place, or on the way to random goals."""

SECONDS = 12.0
"""Length of a walk, standing up included [s]."""

WALKS_FROM = 3.0
"""The speed is measured from here on [s]."""


@dataclass(frozen=True, kw_only=True)
class _Job:
    speed: float
    arms: str
    seed: int
    robot: EffectsSettings


def _asked(job: _Job, description: RobotDescription, neutral: FloatArray) -> CommandTrack:
    seconds = SECONDS - TIMING.stand_up - TIMING.blend
    rng = np.random.default_rng([job.seed, 5])
    track = command_script(description, seconds, rng, speed=job.speed, turn=0.0)
    if job.arms == "moving":
        return track
    return replace(track, p_BE=np.broadcast_to(neutral, track.p_BE.shape).copy())


def _play(job: _Job, policy_path: str) -> dict[str, Any]:
    described, policy = load_description(), cached_policy(policy_path)
    beyond = replace(described.commands, velocity=np.array([max(SPEEDS), 0.0]))
    description = replace(described, commands=beyond)  # or faster commands would be clamped to the trained ones
    neutral = np.array(policy.contract.neutral_toes).reshape(2, 3)
    plant = SimulatedPlant(description, ranges=START, seed=job.seed, samples=False, **plant_options(job.robot))
    result = play_episode(plant, policy, _asked(job, description, neutral), TIMING)
    return {
        "asked_m_s": job.speed,
        "arms": job.arms,
        "seed": job.seed,
        "reached_m_s": forward_speed(result.log, WALKS_FROM),
        "fell": result.fell_at is not None,
    }


def evaluate_walking(
    policy_path: Path, seeds: range, robot: EffectsSettings, *, workers: int = 0, progress: Progress | None = None
) -> list[dict[str, Any]]:
    """Return for each asked speed and each of ARMS the mean speed reached [m/s], its error and the share of falls.

    Args:
        policy_path: The policy.
        seeds: One walk each, of the robot as described at random starts.
        robot: Which robot is simulated.
        workers: Processes; 0 takes one for each core.
        progress: Called with the walks done and in all.
    """
    jobs = [_Job(speed=v, arms=arms, seed=seed, robot=robot) for v in SPEEDS for arms in ARMS for seed in seeds]
    if not jobs:
        return []
    rows = run_all(partial(_play, policy_path=str(policy_path)), jobs, workers=workers, progress=progress)
    found = []
    for speed in SPEEDS:
        for arms in ARMS:
            mine = [r for r in rows if r["asked_m_s"] == speed and r["arms"] == arms]
            reached = [r["reached_m_s"] for r in mine if np.isfinite(r["reached_m_s"])]
            found.append(
                {
                    "asked_m_s": speed,
                    "arms": arms,
                    "reached_m_s": float(np.mean(reached)) if reached else None,
                    "worst_error_m_s": float(np.max(np.abs(np.array(reached) - speed))) if reached else None,
                    "fell": float(np.mean([r["fell"] for r in mine])),
                }
            )
    return found
