"""How calmly a policy stands: planted feet, heat, torque, jitter of its commands, drift, and pushes from anywhere.

Torques are those of every physics step. One sample a control step would be off by some tens of percent, as the policy
answers at the same phase each time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from mimic.config.evaluation import CalmSettings
from mimic.evaluation.episode import play_episode
from mimic.evaluation.policy import TIMING, standing_track, stands_at_end
from mimic.jobs.local import Progress, run_all
from mimic.policy.runtime import cached_policy
from mimic.records import JOINTS, LEGS, BoolArray, FloatArray, JointSamples
from mimic.robot.description import RobotDescription, load_description
from mimic.robot.model import FLOOR
from mimic.simulation.plant import SimulatedPlant, plant_options

SETTLED = 2.0
"""Figures count from this time on [s]."""

PUSHED_AT = 4.0
"""Pushes come at this time, or a part of a gait period later [s]."""

HIGH = 20.0
"""Torque that changes faster than this is heard, not needed [Hz]."""

KNEES = [JOINTS.index(f"{leg}_knee") for leg in LEGS[2:]]
HIND = [i for i, joint in enumerate(JOINTS) if joint.startswith(LEGS[2:])]
"""The joints that carry a standing robot."""


@dataclass(frozen=True, kw_only=True)
class _Job:
    seed: int
    push: float
    settings: CalmSettings


class _Planted:
    """Notes at each physics step whether both hind feet touch the ground."""

    def __init__(self, model: mujoco.MjModel, description: RobotDescription) -> None:
        self._floor = model.geom(FLOOR).id
        self._feet = [
            [model.geom(name).id for name in description.names.shapes("toe", "shank", legs=(leg,))] for leg in LEGS[2:]
        ]
        self.rows: list[bool] = []

    def __call__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        pairs = data.contact.geom[: data.ncon]
        touching = set(pairs[(pairs == self._floor).any(axis=1)].ravel().tolist())
        self.rows.append(all(any(shape in touching for shape in foot) for foot in self._feet))


def winding_heat(tau: FloatArray, description: RobotDescription) -> FloatArray:
    """Return the heat of the windings [W] (...,) for torques (..., 12) [N m]: resistance times current squared.

    The torque constant is the voltage over the speed without load; at standstill the peak torque takes that voltage's
    share which leaves the torque-speed line of the description.
    """
    constant = description.voltage / description.speed_max
    resistance = (description.voltage - constant * description.speed_flat) * constant / description.torque_max
    return resistance * np.square(np.asarray(tau) / constant).sum(axis=-1)


def fast_share(values: FloatArray, rate_hz: float, above: float = HIGH) -> float:
    """Return the share of the variance of values (N, k) that lies above a frequency [Hz]."""
    power = np.square(np.abs(np.fft.rfft(values - values.mean(axis=0), axis=0))).sum(axis=1)
    fast = np.fft.rfftfreq(len(values), 1.0 / rate_hz) > above
    return float(power[fast].sum() / power.sum()) if power.sum() > 0 else 0.0


def still_figures(
    samples: JointSamples, planted: BoolArray, q_des: FloatArray, p_WB: FloatArray, description: RobotDescription
) -> dict[str, float]:
    """Return how a robot stood.

    Args:
        samples: Joints at each physics step.
        planted: Whether both hind feet touched the ground, at each physics step.
        q_des: Joint targets at each control step (T, 12) [rad].
        p_WB: Position of the base at each control step (T, 3) [m].
        description: The robot.
    """
    tau = samples.tau
    return {
        "planted": float(planted.mean()),
        "heat_w": float(winding_heat(tau, description).mean()),
        "knee_rms_nm": float(np.sqrt(np.square(tau[:, KNEES]).mean())),
        "at_limit": float((np.abs(tau) > 0.999 * description.torque_max).any(axis=1).mean()),
        "fast_torque": fast_share(tau, 1.0 / float(np.median(np.diff(samples.t)))),
        "action_rate_rad": float(np.sqrt(np.square(np.diff(q_des[:, HIND], axis=0)).mean())),
        "drift_m": float(np.linalg.norm(p_WB[-1, :2] - p_WB[0, :2])),
        "farthest_m": float(np.linalg.norm(p_WB[:, :2] - p_WB[0, :2], axis=1).max()),
    }


def _play(job: _Job, policy_path: str) -> dict[str, Any]:
    description, policy, s = load_description(), cached_policy(policy_path), job.settings
    ranges = replace(s.randomisation, push=(0.0, 0.0))
    seconds = s.seconds
    if job.push:
        ranges = replace(ranges, push=(job.push, job.push), push_interval=PUSHED_AT)
        seconds = 2 * PUSHED_AT - 0.5
    track = standing_track(policy, seconds)
    plant = SimulatedPlant(description, ranges=ranges, seed=job.seed, samples=not job.push, **plant_options(s.robot))
    planted = _Planted(plant.model, description)
    if not job.push:
        plant.watch(planted)
    result = play_episode(plant, policy, track, TIMING)
    figures: dict[str, Any] = {"seed": job.seed, "push": job.push, "stands": stands_at_end(result, description)}
    if job.push or not figures["stands"]:
        return figures
    assert result.samples is not None
    steps = result.samples.t >= SETTLED
    rows = result.log.t >= SETTLED
    names = ("t", "q", "dq", "tau", "q_des")
    samples = JointSamples(**{name: getattr(result.samples, name)[steps] for name in names})
    feet = np.array(planted.rows)[steps]
    return figures | still_figures(samples, feet, result.log.q_des[rows], result.log.p_WB[rows], description)


def evaluate_calm(policy_path: Path, settings: CalmSettings, *, progress: Progress | None = None) -> dict[str, Any]:
    """Evaluate standing without commands, and pushes while standing; the same seeds give the same figures.

    Raises:
        AssetError, ContractError: If the policy cannot be run on this robot.
    """
    cached_policy(str(policy_path))
    plant_options(settings.robot)
    jobs = [_Job(seed=settings.seed + i, push=0.0, settings=settings) for i in range(settings.episodes)]
    jobs += [
        _Job(seed=settings.seed + i, push=push, settings=settings)
        for push in settings.pushes
        for i in range(settings.pushed_episodes)
    ]
    play = partial(_play, policy_path=str(policy_path))
    rows = run_all(play, jobs, workers=settings.workers, progress=progress)
    return {"policy": policy_path.name, "summary": summarise(rows, settings), "episodes": rows}


def summarise(rows: list[dict[str, Any]], settings: CalmSettings) -> dict[str, Any]:
    """Return the means over the episodes that stood, the worst drift, and the share that survived each push."""
    still = [r for r in rows if not r["push"]]
    stood = [r for r in still if r["stands"]]
    names = ("planted", "heat_w", "knee_rms_nm", "at_limit", "fast_torque", "action_rate_rad", "drift_m")
    means = {name: float(np.mean([r[name] for r in stood])) if stood else float("nan") for name in names}
    return {
        "episodes": len(still),
        "stood": len(stood) / len(still),
        **means,
        "drift_max_m": max((r["drift_m"] for r in stood), default=float("nan")),
        "farthest_m": max((r["farthest_m"] for r in stood), default=float("nan")),
        "pushed": {
            f"{push:g}": float(np.mean([r["stands"] for r in rows if r["push"] == push])) for push in settings.pushes
        },
    }
