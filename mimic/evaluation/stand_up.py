"""Evaluation of standing up from lying, and of standing still without commands."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mimic.config.evaluation import StandUpSettings
from mimic.config.play import NOMINAL, EffectsSettings, Randomisation
from mimic.control.loop import RunResult
from mimic.evaluation.episode import play_episode
from mimic.evaluation.policy import STOOD_WITHIN, TIMING, standing_track, stands_at_end
from mimic.geometry import heading_from_quat, wrap_angle
from mimic.jobs.local import Progress, run_all
from mimic.metrics import stand_up_time
from mimic.policy.runtime import cached_policy
from mimic.robot.description import load_description
from mimic.simulation.plant import SimulatedPlant, plant_options

SETTLED = 2.0
"""Standing still is evaluated from this time on [s]."""

STANDING_RANGES = replace(NOMINAL, start_q=Randomisation().start_q, heading=Randomisation().heading)
"""The robot as described, at the paper's random starts."""


@dataclass(frozen=True, kw_only=True)
class _Job:
    kind: str
    seed: int
    seconds: float
    ranges: Randomisation
    robot: EffectsSettings


def _stand(job: _Job, policy_path: str) -> RunResult:
    """Play a run whose only commands are neutral toes."""
    description, policy = load_description(), cached_policy(policy_path)
    track = standing_track(policy, job.seconds)
    plant = SimulatedPlant(description, ranges=job.ranges, seed=job.seed, **plant_options(job.robot))
    return play_episode(plant, policy, track, TIMING)


def _figures(job: _Job, policy_path: str) -> dict[str, Any]:
    description = load_description()
    result = _stand(job, policy_path)
    log, samples = result.log, result.samples
    figures: dict[str, Any] = {"kind": job.kind, "seed": job.seed, "stands_at_end": stands_at_end(result, description)}
    if job.kind == "rise":
        assert samples is not None
        figures["stand_up_s"] = stand_up_time(log, description)
        figures["joint_speed_max_rad_s"] = float(np.abs(samples.dq).max())
        figures["torque_max_nm"] = float(np.abs(samples.tau).max())
        return figures
    rows = log.t >= SETTLED
    if not figures["stands_at_end"]:
        return figures | dict.fromkeys(("drift_m", "farthest_m", "turned_rad"), float("inf"))
    p_WB, heading = log.p_WB[rows, :2], heading_from_quat(log.quat_WB[rows])
    moved = np.linalg.norm(p_WB - p_WB[0], axis=1)
    turned = np.abs(wrap_angle(heading - heading[0]))
    return figures | {"drift_m": float(moved[-1]), "farthest_m": float(moved.max()), "turned_rad": float(turned.max())}


def evaluate_stand_up(
    policy_path: Path, settings: StandUpSettings, *, progress: Progress | None = None
) -> dict[str, Any]:
    """Evaluate lying starts, and the drift of robots that should stand still; the same seeds give the same figures.

    Raises:
        AssetError, ContractError: If the policy cannot be run on this robot.
    """
    cached_policy(str(policy_path))
    plant_options(settings.robot)
    rise = {"kind": "rise", "seconds": settings.seconds, "ranges": settings.randomisation, "robot": settings.robot}
    still = {
        "kind": "still",
        "seconds": SETTLED + settings.still_seconds,
        "ranges": STANDING_RANGES,
        "robot": settings.robot,
    }
    jobs = [_Job(seed=settings.seed + i, **still) for i in range(settings.still_episodes)]
    jobs += [_Job(seed=settings.seed + i, **rise) for i in range(settings.episodes)]
    play = partial(_figures, policy_path=str(policy_path))
    rows = run_all(play, jobs, workers=settings.workers, progress=progress)
    return {"policy": policy_path.name, "summary": summarise(rows), "episodes": rows}


def summarise(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the main figures of all episodes."""
    description = load_description()
    rise = [r for r in rows if r["kind"] == "rise"]
    still = [r for r in rows if r["kind"] == "still"]
    time = np.array([r["stand_up_s"] for r in rise])
    kept = np.array([r["stands_at_end"] for r in rise])
    speed = np.array([r["joint_speed_max_rad_s"] for r in rise])
    torque = np.array([r["torque_max_nm"] for r in rise])
    return {
        "starts": len(rise),
        "upright_in_time": float((time <= STOOD_WITHIN).mean()),
        "upright_in_time_and_kept": float(((time <= STOOD_WITHIN) & kept).mean()),
        "stand_up_median_s": float(np.median(time)),
        "stand_up_p95_s": float(np.quantile(time, 0.95, method="nearest")),
        "joint_speed_max_rad_s": float(speed.max()),
        "joint_speed_limit_rad_s": description.speed_max,
        "torque_max_nm": float(torque.max()),
        "torque_limit_nm": description.torque_max,
        "still_episodes": len(still),
        "still_drift_mean_m": float(np.mean([r["drift_m"] for r in still])) if still else float("nan"),
        "still_drift_max_m": float(np.max([r["drift_m"] for r in still])) if still else float("nan"),
        "still_farthest_m": float(np.max([r["farthest_m"] for r in still])) if still else float("nan"),
        "still_turned_max_rad": float(np.max([r["turned_rad"] for r in still])) if still else float("nan"),
    }
