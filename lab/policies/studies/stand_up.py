"""Evaluation of standing up from lying, and of standing still without commands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lab.policies.standing import standing_track
from lab.policies.studies.settings import StandUpSettings
from mimic.config.play import NOMINAL, Randomisation
from mimic.evaluation.episode import TIMING, Job, play_all, play_episode
from mimic.evaluation.policy import STOOD_WITHIN, stands_at_end
from mimic.geometry import heading_from_quat, wrap_angle
from mimic.jobs.local import Progress
from mimic.metrics import stand_up_time
from mimic.policy.runtime import Policy
from mimic.robot.description import RobotDescription, load_description

SETTLED = 2.0
"""Standing still is evaluated from this time on [s]."""

STANDING_RANGES = replace(NOMINAL, start_q=Randomisation().start_q, heading=Randomisation().heading)
"""The robot as described, at the paper's random starts."""


def _figures(job: Job, policy: Policy) -> dict[str, Any]:
    """Play a run whose only commands are neutral toes."""
    description = policy.description
    plant = job.plant(description, samples=True)
    result = play_episode(plant, policy, standing_track(policy, job.seconds), TIMING)
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
    """Evaluate lying starts, and the drift of robots that should stand still; the same seeds give the same figures."""
    s = settings
    jobs = [
        Job(kind=kind, seed=s.seed + i, seconds=seconds, ranges=ranges, robot=s.robot)
        for kind, count, seconds, ranges in (
            ("still", s.still_episodes, SETTLED + s.still_seconds, STANDING_RANGES),
            ("rise", s.episodes, s.seconds, s.randomisation),
        )
        for i in range(count)
    ]
    rows, description = play_all(_figures, jobs, policy_path, settings, progress), load_description(s.robot.robot_model)
    return {"policy": policy_path.name, "summary": summarise(rows, description), "episodes": rows}


def summarise(rows: list[dict[str, Any]], description: RobotDescription) -> dict[str, Any]:
    """Return the main figures of all episodes."""
    rise = [r for r in rows if r["kind"] == "rise"]
    still = [r for r in rows if r["kind"] == "still"]
    names = ("stand_up_s", "stands_at_end", "joint_speed_max_rad_s", "torque_max_nm")
    time, kept, speed, torque = (np.array([r[name] for r in rise]) for name in names)

    def over(reduce: Callable[[list[float]], Any], name: str) -> float:
        return float(reduce([r[name] for r in still])) if still else float("nan")

    return {
        "starts": len(rise),
        "upright_in_time": float((time <= STOOD_WITHIN).mean()),
        "upright_in_time_and_kept": float(((time <= STOOD_WITHIN) & kept).mean()),
        "stand_up_median_s": float(np.median(time)),
        "stand_up_p95_s": float(np.quantile(time, 0.95, method="nearest")),
        "joint_speed_max_rad_s": float(speed.max()),
        "joint_speed_limit_rad_s": float(description.speed_max.max()),
        "torque_max_nm": float(torque.max()),
        "torque_limit_nm": float(description.torque_max.max()),
        "still_episodes": len(still),
        "still_drift_mean_m": over(np.mean, "drift_m"),
        "still_drift_max_m": over(np.max, "drift_m"),
        "still_farthest_m": over(np.max, "farthest_m"),
        "still_turned_max_rad": over(np.max, "turned_rad"),
    }
