"""Being led by either front toe in any direction: shares of robots that follow, and that stop when they are let go."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lab.policies.studies.settings import LeadSettings
from mimic.config.play import Randomisation
from mimic.evaluation.episode import OF_EPISODES, play_all
from mimic.evaluation.leading import lead_figures, lead_robot
from mimic.evaluation.policy import stands_at_end
from mimic.jobs.local import Progress
from mimic.policy.runtime import Policy
from mimic.records import SIDES
from mimic.simulation.hand import Hand
from mimic.simulation.plant import SimulatedPlant, plant_options


def _play(job: tuple[int, LeadSettings], policy: Policy) -> dict[str, Any]:
    seed, settings = job
    description = policy.description
    rng = np.random.default_rng([seed, 37])
    hand = replace(settings.hand, direction=float(rng.uniform(-180.0, 180.0)), toe=SIDES[int(rng.integers(2))])
    ranges: Randomisation = replace(settings.randomisation, push=(0.0, 0.0))
    plant = SimulatedPlant(description, ranges=ranges, seed=seed, **OF_EPISODES, **plant_options(settings.robot))
    pull = Hand(plant.model, hand)
    plant.watch(pull)
    result = lead_robot(plant, policy, settings.leading, seconds=hand.end + hand.after)
    if result.interrupted:
        raise KeyboardInterrupt
    return {"seed": seed, "stands": stands_at_end(result, description)} | lead_figures(result, pull, hand)


def evaluate_leading(policy_path: Path, settings: LeadSettings, *, progress: Progress | None = None) -> dict[str, Any]:
    """Evaluate being led by either front toe in any direction; the same seeds give the same figures."""
    jobs = [(settings.seed + i, settings) for i in range(settings.episodes)]
    rows = play_all(_play, jobs, policy_path, settings, progress)
    return {"policy": policy_path.name, "summary": summarise(rows), "episodes": rows}


def summarise(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return shares over all episodes, and means over those that stayed up."""
    up = [r for r in rows if r["stands"]]

    def mean(name: str) -> float:
        return float(np.mean([r[name] for r in up])) if up else float("nan")

    return {
        "episodes": len(rows),
        "stood": len(up) / len(rows),
        "followed": float(np.mean([r["stands"] and r["followed"] for r in rows])),
        "stopped": float(np.mean([r["stands"] and r["followed"] and r["stopped"] for r in rows])),
        "way_m": mean("way_m"),
        "pull_mean_n": mean("pull_mean_n"),
        "pull_max_n": max((r["pull_max_n"] for r in up), default=float("nan")),
        "speed_after_m_s": mean("speed_after_m_s"),
    }
