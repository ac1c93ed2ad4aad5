"""Evaluation of a policy that sits down, in plain MuJoCo, after a switch from a policy that stands or walks."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mimic.config.evaluation import SitDownEvaluateSettings
from mimic.control.loop import RunResult
from mimic.evaluation.contact_recorder import ContactRecorder
from mimic.evaluation.episode import TIMING, Job, play_all, play_episode
from mimic.evaluation.policy import command_script
from mimic.geometry import rotation_from_quat
from mimic.jobs.local import Progress
from mimic.policy.runtime import Policy, cached_policy, load_policy
from mimic.records import PHASES, FloatArray, RunLog
from mimic.robot.description import RobotDescription, load_description

GENTLE = 0.8
"""The base must be slower than this when trunk or belly first touches the ground [m/s]."""

EARLIEST = 1.6
"""Earliest policy switch after the start [s]: the robot has just stood up."""

LEVEL = 0.25
"""A lying robot is level within this [rad]."""

POSE = 0.4
"""… and each joint is within this of the lying pose [rad]."""

HEIGHTS = (0.07, 0.16)
"""… and its base this high [m]; 0.136 with rigid legs, about 0.11 with the motors' gains."""

RESTING = 0.12
"""… and its base moves less than this over the last half second [m]. The limit is this large because on bouncy ground
(restitution 0.2 to 0.4) the feet of a robot that lies on powered legs chatter and creep by up to 0.1 m, even with
constant commands; at a physics step of 1 ms instead of 5 ms they do not."""

LAST = 0.5
"""The end of the run over which lying is evaluated [s]."""

NEAR = 0.02
"""A robot is down once its base stays this near to its final height [m]."""


def final_pose(log: RunLog, description: RobotDescription) -> dict[str, float]:
    """Return the final pose: means over the last half second, and the largest error of a joint."""
    rows = slice(-round(LAST / description.dt), None)
    up = rotation_from_quat(log.quat_WB[rows])[:, 2, :]
    error = np.abs(log.q[rows].mean(axis=0) - description.poses["lie"])
    return {
        "tilt_rad": float(np.arccos(np.clip(up[:, 2].mean(), -1.0, 1.0))),
        "height_m": float(log.p_WB[rows, 2].mean()),
        "moved_m": float(np.linalg.norm(np.ptp(log.p_WB[rows], axis=0))),
        "pose_error_rad": float(error.mean()),
        "pose_error_max_rad": float(error.max()),
    }


def time_to_lie(t: FloatArray, height: FloatArray, begin: float, final: float) -> float:
    """Return the time from the policy switch until the base stays near its final height [s].

    Args:
        t: Times (n,) [s].
        height: Height of the base at each (n,) [m].
        begin: When it began to sit down [s].
        final: Final height of the base [m].
    """
    away = t[(t >= begin) & (np.abs(height - final) > NEAR)]
    return float(away[-1] - begin) if len(away) else 0.0


def lies(end: dict[str, float]) -> bool:
    """Return whether this final pose is that of a robot that lies on its legs, level and at rest."""
    return (
        end["tilt_rad"] < LEVEL
        and HEIGHTS[0] < end["height_m"] < HEIGHTS[1]
        and end["moved_m"] < RESTING
        and end["pose_error_max_rad"] < POSE
    )


def play_policy_switch(job: Job, tracker: Policy, sit_down: Policy) -> tuple[RunResult, ContactRecorder]:
    """Play one episode: a random robot stands up, tracks random commands for a random time, and sits down."""
    description = tracker.description
    rng = np.random.default_rng([job.seed, 7])
    seconds = rng.uniform(EARLIEST, job.seconds) - TIMING.stand_up - TIMING.blend
    track = command_script(description, max(seconds, 2 * description.dt), rng)
    recorder = ContactRecorder(description)
    plant = job.plant(description, observer=recorder)
    return play_episode(plant, tracker, track, TIMING, sit_down=sit_down), recorder


def _figures(job: Job, tracker: Policy, sit_down: str) -> dict[str, Any]:
    description = tracker.description
    result, recorder = play_policy_switch(job, tracker, cached_policy(sit_down, job.robot.robot_model))
    log = result.log
    begin = float(log.t[np.argmax(log.phase == PHASES.index("sit_down"))])
    touchdown = recorder.touchdown(begin)
    end = final_pose(log, description)
    gentle = not touchdown.head_touched and touchdown.impact_speed < GENTLE
    return {
        "seed": job.seed,
        "handed_over": result.fell_at is None,
        "at_s": begin,
        "gentle": gentle,
        "lies": lies(end),
        "success": gentle and lies(end),
        "lying_after_s": time_to_lie(log.t, log.p_WB[:, 2], begin, end["height_m"]),
        **asdict(touchdown),
        **end,
    }


def evaluate_sit_down(
    policy_path: Path, settings: SitDownEvaluateSettings, *, progress: Progress | None = None
) -> dict[str, Any]:
    """Evaluate a policy that sits down, episodes in parallel; the same seeds give the same figures on one machine.

    Raises:
        AssetError, ContractError: If a policy cannot be run on this robot, or does something else.
    """
    description = load_description(settings.robot.robot_model)
    tracker = load_policy(settings.tracker, description).path
    load_policy(policy_path, description, task="sit_down")
    s = settings
    jobs = [Job(seed=s.seed + i, seconds=s.seconds, ranges=s.randomisation, robot=s.robot) for i in range(s.episodes)]
    play = partial(_figures, sit_down=str(policy_path))
    rows = play_all(play, jobs, tracker, settings, progress)
    return {"policy": policy_path.name, "tracker": tracker.name, "summary": summarise(rows), "episodes": rows}


def summarise(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the main figures; robots that were about to fall before the policy switch are counted separately."""
    evaluated = [r for r in rows if r["handed_over"]]

    def column(name: str) -> np.ndarray:
        return np.array([r[name] for r in evaluated], dtype=np.float64)

    def spread(name: str) -> dict[str, float]:
        values = column(name) if evaluated else np.array([float("nan")])
        return {
            "median": float(np.median(values)),
            "p95": float(np.quantile(values, 0.95)),
            "max": float(values.max()),
            "mean": float(values.mean()),
        }

    names = (
        "impact_speed",
        "lying_after_s",
        "sinking_speed",
        "acceleration",
        "pose_error_rad",
        "height_m",
        "moved_m",
    )
    return {
        "hand_overs": len(evaluated),
        "falling_before": len(rows) - len(evaluated),
        **{name: spread(name)["mean"] for name in ("success", "gentle", "lies")},
        "head_contacts": int(column("head_touched").sum()),
        "trunk_contacts": int(column("trunk_touched").sum()),
        **{name: spread(name) for name in names},
    }
