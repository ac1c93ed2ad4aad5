"""Speed and turning reached by what is asked, with still and with moving arms; asked also beyond what was trained."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from lab.policies.studies.disturbance_axes import START
from mimic.config.evaluation import EpisodeSettings
from mimic.evaluation.episode import TIMING, Job, play_all, play_episode
from mimic.evaluation.policy import asked_by, forward_speed
from mimic.geometry import heading_from_quat
from mimic.jobs.local import Progress
from mimic.policy.runtime import Policy
from mimic.records import LEGS, FloatArray, RunLog
from mimic.robot.description import RobotDescription

SPEEDS = (-0.6, -0.45, -0.3, -0.15, 0.0, 0.15, 0.3, 0.45, 0.6)
"""Asked speeds [m/s], forward positive."""

TURNS = (-1.0, -0.5, 0.5, 1.0)
"""Asked turning rates [rad/s], to the left positive."""

ARMS = ("still", "moving", "still, way kept")
"""Front toes at rest in the neutral place, or on the way to random goals; the last with leg odometry, as motions are
played."""

SECONDS = 12.0
"""Length of a walk, standing up included [s]."""

WALKS_FROM = 3.0
"""Speed and turning are measured from here on [s]."""

LEAST_LIFT = 0.001
"""A hind toe that is higher than this is off the ground [m]; the contact lets it sink in by less."""


@dataclass(frozen=True, kw_only=True)
class _Job(Job):
    turning: float
    """Turning rate [rad/s]."""
    arms: str


class _Lifts:
    """Notes how high the hind toes are at each physics step."""

    def __init__(self, model: mujoco.MjModel, description: RobotDescription) -> None:
        self._toes = [model.geom(name).id for name in description.names.shapes("toe", legs=LEGS[2:])]
        self._rows: list[tuple[float, FloatArray]] = []

    def __call__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._rows.append((data.time, data.geom_xpos[self._toes, 2] - model.geom_size[self._toes, 0]))

    def heights(self, begin: float) -> list[float]:
        """Return the greatest height of the toe in each swing after ``begin`` [s], in m."""
        rows = [heights for t, heights in self._rows if t > begin]
        return swing_heights(np.array(rows)) if rows else []


def swing_heights(clearance: FloatArray) -> list[float]:
    """Return the greatest height of each whole swing [m], for the heights of toes above the ground (steps, toes)."""
    found = []
    for heights in clearance.T:
        up = heights > LEAST_LIFT
        edges = np.flatnonzero(np.diff(up)) + 1
        edges = edges[int(up[0]) :]  # a swing that had begun before is not whole
        found += [float(heights[a:b].max()) for a, b in zip(edges[::2], edges[1::2], strict=False)]
    return found


def turning_rate(log: RunLog, begin: float) -> float:
    """Return the mean rate of the heading after ``begin`` [s] in rad/s; NaN for a run that was over before."""
    rows = log.t > begin
    if rows.sum() < 2:
        return float("nan")
    heading = np.unwrap(heading_from_quat(log.quat_WB[rows]))
    return float((heading[-1] - heading[0]) / np.ptp(log.t[rows]))


def _play(job: _Job, policy: Policy) -> dict[str, Any]:
    described = policy.description
    beyond = replace(described.commands, velocity_max=np.array([max(SPEEDS), 0.0]))
    description = replace(described, commands=beyond)  # or faster commands would be clamped to the trained ones
    track = asked_by(job, description)
    track = replace(track, heading=job.turning * track.t)
    if job.arms != "moving":
        neutral = np.array(policy.contract.neutral_toes).reshape(2, 3)
        track = replace(track, p_BE=np.broadcast_to(neutral, track.p_BE.shape).copy())
    plant = job.plant(description)
    lifts = _Lifts(plant.model, description)
    plant.watch(lifts)
    timing = replace(TIMING, hold_position=job.arms == "still, way kept")
    result = play_episode(plant, policy, track, timing)
    return {
        "speed": forward_speed(result.log, WALKS_FROM),
        "turn": turning_rate(result.log, WALKS_FROM),
        "lifts": lifts.heights(WALKS_FROM),
        "fell": result.fell_at is not None,
    }


def evaluate_walking(
    policy_path: Path, seeds: range, settings: EpisodeSettings, *, progress: Progress | None = None
) -> dict[str, list[dict[str, Any]]]:
    """Return how a policy walks and turns, each with each of ARMS; no rows without a seed.

    ``walking`` has a row for each of SPEEDS, ``turning`` one for each of TURNS, on the spot: the mean of what was
    reached, the largest error, the share of walks that ended in a fall, and the median height of a step [m].

    Args:
        policy_path: The policy.
        seeds: One walk each, of the robot as described at random starts.
        settings: Processes, and which robot is simulated.
        progress: Called with the walks done and in all.
    """
    asked = [(v, 0.0) for v in SPEEDS] + [(0.0, w) for w in TURNS]
    cells = [(v, w, arms) for v, w in asked for arms in ARMS]
    usual: dict[str, Any] = {"seconds": SECONDS, "ranges": START, "robot": settings.robot, "turn": 0.0}
    jobs = [_Job(speed=v, turning=w, arms=arms, seed=seed, **usual) for v, w, arms in cells for seed in seeds]
    if not jobs:
        return {"walking": [], "turning": []}
    rows = play_all(_play, jobs, policy_path, settings, progress)
    found: dict[str, list[dict[str, Any]]] = {"walking": [], "turning": []}
    for i, (speed, turn, arms) in enumerate(cells):
        mine = rows[i * len(seeds) : (i + 1) * len(seeds)]
        if turn:
            found["turning"].append(_row(mine, "turn", turn, "rad_s", arms))
        else:
            found["walking"].append(_row(mine, "speed", speed, "m_s", arms))
    return found


def _row(walks: list[dict[str, Any]], name: str, asked: float, unit: str, arms: str) -> dict[str, Any]:
    reached = np.array([w[name] for w in walks if np.isfinite(w[name])])
    lifts = [height for w in walks for height in w["lifts"]]
    return {
        f"asked_{unit}": asked,
        "arms": arms,
        f"reached_{unit}": float(reached.mean()) if len(reached) else None,
        f"worst_error_{unit}": float(np.abs(reached - asked).max()) if len(reached) else None,
        "fell": float(np.mean([w["fell"] for w in walks])),
        "step_height_m": float(np.median(lifts)) if lifts else None,
    }
