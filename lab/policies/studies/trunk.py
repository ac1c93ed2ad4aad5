"""Crouching and leaning: shares of robots that stand, and how far height and pitch are from what is asked."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from lab.policies.standing import standing_track
from lab.policies.studies.settings import TrunkSettings
from mimic.evaluation.episode import TIMING, Job, play_all, play_episode
from mimic.evaluation.policy import stands_at_end
from mimic.geometry import heading_from_quat, rotation_from_quat
from mimic.jobs.local import Progress
from mimic.policy.runtime import Policy
from mimic.records import FloatArray
from mimic.robot.trunk import TrunkPoses

BEGIN = 2.0
"""The trunk begins to move [s after the first goal]."""

WAY = 1.0
"""Time in which it gets there [s]."""

SQUAT = 3.0
"""Time of a squat down and up [s]."""

LAG = 2
"""Control steps from a command to its effect."""


def forward_lean(quat_WB: FloatArray) -> FloatArray:
    """Return the angle of base x from the vertical, in the plane of the heading (...,) [rad]; positive to the belly."""
    x = rotation_from_quat(quat_WB)[..., 0]
    heading = heading_from_quat(quat_WB)
    return np.arctan2(x[..., 0] * np.cos(heading) + x[..., 1] * np.sin(heading), x[..., 2])


@dataclass(frozen=True, kw_only=True)
class _Job(Job):
    height: float
    """Lowest [m]."""
    pitch: float
    """Farthest [rad]."""
    repeats: bool
    """Whether the trunk goes down and up again and again, or stays."""


def _share(t: FloatArray, *, repeats: bool) -> FloatArray:
    """Return how far (T,), 0 to 1, the trunk should be."""
    if repeats:
        return 0.5 - 0.5 * np.cos(2 * np.pi * np.maximum(t - BEGIN, 0.0) / SQUAT)
    return 0.5 - 0.5 * np.cos(np.pi * np.clip((t - BEGIN) / WAY, 0.0, 1.0))


def _play(job: _Job, policy: Policy) -> dict[str, Any]:
    description = policy.description
    still = standing_track(policy, job.seconds)
    trunk = _share(still.t, repeats=job.repeats)[:, None] * np.array([job.height, job.pitch])
    result = play_episode(job.plant(description), policy, replace(still, trunk=trunk), TIMING)
    figures: dict[str, Any] = {"kind": job.kind, "seed": job.seed, "stands": stands_at_end(result, description)}
    if not figures["stands"]:
        return figures
    log = result.log
    asked = np.roll(log.trunk_des, LAG, axis=0)
    poses = TrunkPoses(description).of(asked[:, 0], asked[:, 1])
    before = (log.t > TIMING.stand_up + TIMING.blend + 0.5) & (np.abs(asked).max(axis=1) == 0.0)
    after = log.t > TIMING.stand_up + TIMING.blend + BEGIN + WAY
    lower = log.p_WB[:, 2] - log.p_WB[before & ~after, 2].mean() - poses.base[:, 1]
    lean = forward_lean(log.quat_WB)
    leant = lean - lean[before & ~after].mean() - asked[:, 1]
    return figures | {
        "height_cm": float(100 * np.abs(lower[after]).mean()),
        "pitch_deg": float(np.degrees(np.abs(leant[after]).mean())),
        "toe_cm": float(100 * np.linalg.norm(log.p_BE - log.p_BE_des, axis=-1)[after].mean()),
    }


def evaluate_trunk(policy_path: Path, settings: TrunkSettings, *, progress: Progress | None = None) -> dict[str, Any]:
    """Evaluate crouching and leaning, with and without pushes; the same seeds give the same figures."""
    s = settings
    jobs = []
    for push, (height, pitch, repeats) in product(s.pushes, s.cases):
        kind = f"{100 * height:g} cm, {pitch:g} deg{', down and up' if repeats else ''}"
        kind += f", pushed by {push:g} m/s" if push else ""
        ranges = replace(s.randomisation, push=(push, push), push_interval=s.push_interval)
        common: dict[str, Any] = {"height": height, "pitch": float(np.radians(pitch)), "repeats": repeats}
        jobs += [
            _Job(kind=kind, seed=s.seed + i, seconds=s.seconds, ranges=ranges, robot=s.robot, **common)
            for i in range(s.episodes)
        ]
    rows = play_all(_play, jobs, policy_path, settings, progress)
    return {"policy": policy_path.name, "summary": summarise(rows), "episodes": rows}


def summarise(rows: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Return, by what was asked, the share that stood, and mean errors over those that did."""
    found = {}
    for kind in dict.fromkeys(r["kind"] for r in rows):
        mine = [r for r in rows if r["kind"] == kind]
        stood = [r for r in mine if r["stands"]]
        errors = {name: float(np.mean([r[name] for r in stood])) if stood else float("nan") for name in ERRORS}
        found[kind] = {"stood": len(stood) / len(mine)} | errors
    return found


ERRORS = ("height_cm", "pitch_deg", "toe_cm")
"""Mean absolute errors of an episode."""
