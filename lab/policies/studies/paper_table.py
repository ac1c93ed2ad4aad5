"""Evaluation of a policy as in the paper's Table III: random robots from the lying start, over evaluation seeds.

Each episode is played with each of SENSES. Beside the policy stands an ideal statue, which follows every command but
that to move: a policy is worth what it has beyond the statue.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lab.policies.studies.ground_contacts import GroundFacts, ground_facts, ground_parts
from lab.policies.studies.paper_columns import (
    COLUMNS,
    PAPER,
    TERMINATIONS,
    WEIGHTS,
    near_limits,
    terminations,
    terms,
    velocity_error,
)
from lab.policies.studies.senses import SENSES, SensingPolicy
from lab.policies.studies.settings import TableSettings
from lab.policies.studies.walking import evaluate_walking
from mimic.config.play import RunSettings
from mimic.evaluation.episode import OF_EPISODES, play_all, play_episode
from mimic.evaluation.paper_reward import STAND_STEPS
from mimic.evaluation.policy import command_script
from mimic.geometry import heading_from_quat, wrap_angle
from mimic.jobs.local import Progress
from mimic.policy.runtime import Policy
from mimic.records import JOINTS, LEGS, CommandTrack, FloatArray, RunLog
from mimic.robot.description import RobotDescription
from mimic.simulation.plant import SimulatedPlant, plant_options

TIMING = RunSettings(stand_up=1.0, blend=0.1, hold_last=0.0, hold_position=False)
"""As in the paper the first goal is approached from the neutral toes over 3 s, after 50 steps; the run loop commands no
velocity and no turn before, where the paper does."""

STATUE = "an ideal statue"
"""Name of the row of a robot that never moves."""

SEEDS_APART = 100_000
"""Between the episode seeds of two evaluation seeds."""


@dataclass(frozen=True, kw_only=True)
class Episode:
    """One episode in the paper's figures, with one set of terminations."""

    columns: dict[str, float]
    """Sum of each weighted term over the episode, divided by its full length."""
    reward: float
    """Sum over the steps of all weighted terms, not less than 0 in any, times the control step, as in the paper."""
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
        reward=float(np.maximum(np.sum(list(values.values()), axis=0), 0.0).sum() * description.dt),
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
    senses: str
    settings: TableSettings


def statue(track: CommandTrack, first: RunLog, steps: int, description: RobotDescription) -> tuple[RunLog, GroundFacts]:
    """Return the log of a robot that is asked the same, stands from the start without a motion, and has its toes where
    they should be; nothing of it slips.

    Args:
        track: What is asked after standing up.
        first: A log of the same episode, for what is asked until then.
        steps: Control steps of the episode.
        description: The robot.
    """
    ticks, d = steps + 1, description
    before = round((TIMING.stand_up + TIMING.blend) / d.dt)
    lean = -np.arctan2(d.upright_direction[2], d.upright_direction[0])
    turn = heading_from_quat(first.quat_WB[:1])
    quat = Rotation.from_euler("ZY", np.stack([turn, [lean]], -1)).as_quat(scalar_first=True)
    q = np.tile((d.q_min + d.q_max) / 2, (ticks, 1))
    zeros, no = np.zeros((ticks, len(JOINTS))), np.zeros(ticks, dtype=bool)

    def asked(until: FloatArray, then: FloatArray) -> FloatArray:
        return np.concatenate([np.repeat(until[None], before, axis=0), then])[:ticks]

    toes = asked(first.p_BE_des[0], track.p_BE)
    columns = {
        "t": d.dt * np.arange(ticks),
        "t_host": d.dt * np.arange(ticks),
        "phase": np.zeros(ticks, dtype=int),
        "q": q,
        "dq": zeros,
        "tau": zeros,
        "quat_WB": np.tile(quat, (ticks, 1)),
        "omega_B": np.zeros((ticks, 3)),
        "p_WB": np.tile([0.0, 0.0, d.pose_height["upright"]], (ticks, 1)),
        "v_WB": np.zeros((ticks, 3)),
        "p_BE": np.concatenate([toes[:1], toes[:-1]]),
        "v_des": asked(np.zeros(2), track.v),
        "heading_des": asked(turn[0], turn + track.heading),
        "p_BE_des": toes,
        "observation": zeros,
        "action": zeros,
        "q_des": q,
        "q_sent": q,
        "kp": zeros,
        "kd": zeros,
    }
    height = np.tile([d.pose_height["upright"]] * 2 + [d.toe_radius] * 2, (ticks, 1))
    touching = {part: no for part in ground_parts(d)} | {f"{leg}_foot": ~no for leg in LEGS[2:]}
    facts = GroundFacts(
        toe_height=height, toe_velocity=np.zeros((ticks, 4, 2)), toe_yaw_rate=np.zeros((ticks, 4)), touching=touching
    )
    return RunLog(**columns, metadata=first.metadata), facts


def _play(job: _Job, given: Policy) -> list[tuple[int, str, dict[str, Episode]]]:
    """Return the group, the row and the figures of an episode; the statue is asked what the first senses are."""
    description = given.description
    policy = SensingPolicy(given, SENSES[job.senses], job.seed)
    steps = round(job.settings.seconds / description.dt)
    rng = np.random.default_rng([job.seed, 5])
    neutral = np.array(policy.contract.neutral_toes).reshape(2, 3)
    seconds = (steps + 1) * description.dt - TIMING.stand_up - TIMING.blend
    track = command_script(description, seconds, rng, first=neutral)
    s = job.settings
    plant = SimulatedPlant(description, ranges=s.randomisation, seed=job.seed, **OF_EPISODES, **plant_options(s.robot))
    log = play_episode(plant, policy, track, TIMING).log
    played = [(job.senses, log, ground_facts(log, description))]
    if job.senses == s.senses[0]:
        played.append((STATUE, *statue(track, log, steps, description)))
    return [
        (
            job.group,
            row,
            {
                name: evaluate_episode(log, ground, description, steps=steps, kinds=kinds)
                for name, kinds in TERMINATIONS.items()
            },
        )
        for row, log, ground in played
    ]


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
    """Return the paper's Table III for a policy; the same seeds give the same figures.

    ``table`` and ``episodes`` hold, for each of the settings' senses and then the statue, each set of terminations.
    ``walking`` holds the speed reached by speed asked, as the velocity column does not show walking: a policy that
    ignores the command beats the paper's; ``turning`` the same for turns on the spot.
    """
    jobs = [
        _Job(group=group, seed=settings.seed + group * SEEDS_APART + i, senses=senses, settings=settings)
        for senses in settings.senses
        for group in range(settings.seeds)
        for i in range(settings.episodes)
    ]
    rows = [row for each in play_all(_play, jobs, policy_path, settings, progress) for row in each]
    table: dict[str, Any] = {}
    episodes: dict[str, Any] = {}
    for senses in (*settings.senses, STATUE):
        played = [(group, found) for group, name, found in rows if name == senses]
        table[senses], episodes[senses] = {}, {}
        for kinds in TERMINATIONS:
            groups = {at: [found[kinds] for group, found in played if group == at] for at in range(settings.seeds)}
            table[senses][kinds] = over_seeds(groups)
            episodes[senses][kinds] = [asdict(found[kinds]) | {"group": group} for group, found in played]
    paper = {name: {"mean": mean, "std": std} for name, (mean, std) in PAPER.items()}
    seeds = range(settings.seed, settings.seed + min(settings.walks, settings.episodes))
    walking = evaluate_walking(policy_path, seeds, settings, progress=progress)
    return {"policy": policy_path.name, "paper": paper, "table": table, **walking, "episodes": episodes}
