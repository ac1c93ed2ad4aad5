"""Evaluation of a policy in plain MuJoCo, from the lying start: standing up, standing, reaching, walking, turning."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from mimic.config.evaluation import EvaluateSettings
from mimic.config.play import NOMINAL
from mimic.control.loop import RunResult
from mimic.evaluation.episode import TIMING, Job, play_all, play_episode
from mimic.geometry import heading_from_quat, smoothstep, wrap_angle
from mimic.jobs.local import Progress
from mimic.metrics import run_metrics, standing
from mimic.policy.contract import FRONT
from mimic.policy.runtime import Policy
from mimic.records import CommandTrack, FloatArray, RunLog
from mimic.robot.description import RobotDescription
from mimic.robot.goals import MARGIN, draw_goals, leg_joints
from mimic.robot.leg_kinematics import front_toes

STOOD_WITHIN = 1.5
"""A stand-up counts when the robot stands within this [s]."""

GOAL_SECONDS = 3.0
"""Time between two toe goals; paper: 3 s."""

SPARE = float(np.deg2rad(2.0))
"""Further distance that goals keep from joint limits [rad]: arms that follow exactly, with noise on their readings,
would else end every episode of the paper's table, whose limit is that of the goals."""

COMMAND_SECONDS = 10.0
"""Time between two velocity and heading commands; paper: 10 s."""

TURNS = (np.pi / 2, -np.pi / 3)
"""Heading commands that must be reached [rad]."""

TOE_EPISODES = 10
"""Nominal episodes that only reach for goals."""

COMMAND_EPISODES = 4
"""Nominal episodes of each walking speed and each turn."""


def goal_path(goals: FloatArray, ticks: int, dt: float, description: RobotDescription) -> FloatArray:
    """Return toes (ticks, 2, 3) [m] that go from goal to goal (goals, 2, 3) [m], GOAL_SECONDS each.

    Joints go straight from goal to goal, and rest at each; a straight way of a toe may lead where no leg reaches.
    """
    joints, _ = leg_joints(goals, description)
    t = np.arange(ticks) * dt / GOAL_SECONDS
    index = np.minimum(t.astype(int), len(goals) - 2)
    share = smoothstep(np.minimum(t - index, 1.0))[:, None, None]
    q = joints[index] + share * (joints[index + 1] - joints[index])
    return front_toes(q.reshape(ticks, FRONT), description)


def _spacious(goals: FloatArray, description: RobotDescription) -> FloatArray:
    """Return those goals (N, 2, 3) [m] whose joints keep SPARE more than the margin of goals from their limits."""
    joints = leg_joints(goals, description)[0].reshape(-1, FRONT)
    q_min = description.q_min[:FRONT]
    q_max = description.q_max[:FRONT]
    return goals[np.minimum(joints - q_min, q_max - joints).min(axis=1) > MARGIN + SPARE]


def command_script(
    description: RobotDescription,
    seconds: float,
    rng: np.random.Generator,
    *,
    speed: float | None = None,
    turn: float | None = None,
    first: FloatArray | None = None,
) -> CommandTrack:
    """Return random reachable goals every 3 s; velocity and heading as in the paper where none is given.

    Args:
        seconds: Length of the track [s].
        speed: Forward speed throughout [m/s].
        turn: Heading throughout, relative to the start [rad].
        first: Toes (2, 3) where the path to the first goal begins [m]; by default at another goal.
    """
    dt = description.dt
    ticks = round(seconds / dt)
    count = int(seconds / GOAL_SECONDS) + 3
    goals = _spacious(draw_goals(description, 2 * count + 20, rng), description)[:count]
    if first is not None:
        goals = np.concatenate([first[None], goals])
    blocks = np.arange(ticks) * dt // COMMAND_SECONDS
    count = int(blocks[-1]) + 1
    speeds = rng.integers(-3, 4, count) * 0.1 if speed is None else np.full(count, speed)
    turns = np.cumsum(rng.uniform(-np.pi / 2, np.pi / 2, count)) if turn is None else np.full(count, turn)
    row = blocks.astype(int)
    v = np.stack([speeds[row], np.zeros(ticks)], axis=-1)
    return CommandTrack(t=np.arange(ticks) * dt, v=v, heading=turns[row], p_BE=goal_path(goals, ticks, dt, description))


def forward_speed(log: RunLog, begin: float) -> float:
    """Return the mean velocity along the heading after ``begin`` [s] in m/s; NaN for a run that was over before."""
    rows = log.t > begin
    if rows.sum() < 2:
        return float("nan")
    heading = heading_from_quat(log.quat_WB[rows])[:-1]
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return float(np.sum(np.diff(log.p_WB[rows, :2], axis=0) * ahead) / np.ptp(log.t[rows]))


def asked_by(job: Job, description: RobotDescription) -> CommandTrack:
    """Return the commands of an episode, drawn by its seed where it gives none."""
    rng = np.random.default_rng([job.seed, 5])
    seconds = job.seconds - TIMING.stand_up - TIMING.blend
    return command_script(description, seconds, rng, speed=job.speed, turn=job.turn)


def stands_at_end(result: RunResult, description: RobotDescription) -> bool:
    """Return whether a robot has not fallen and stands for most of its last second."""
    last = standing(result.log, description)[-round(1.0 / description.dt) :]
    return bool(
        result.fell_at is None
        and last.mean() > 0.5
        and result.log.p_WB[-1, 2] > round(0.7 * description.pose_height["upright"], 2)
    )


def _figures(job: Job, policy: Policy) -> dict[str, Any]:
    description = policy.description
    result = play_episode(job.plant(description), policy, asked_by(job, description), TIMING)
    log = result.log
    figures = run_metrics(log, description) | {"kind": job.kind, "seed": job.seed}
    figures["stands_at_end"] = stands_at_end(result, description)
    heading = heading_from_quat(log.quat_WB)
    if job.kind == "walk":
        figures["forward_m_s"] = float(np.nan_to_num(forward_speed(log, 2.0)))  # who fell has walked nowhere
        figures["commanded_m_s"] = job.speed
    if job.kind == "turn":
        within = (log.t > 10.0) & (log.t <= 11.5)  # the command is given at 1.5 s, 10 s are allowed
        error = np.abs(wrap_angle(heading - log.heading_des))
        figures["turn_error_rad"] = float(error[within].mean()) if within.any() else float("inf")
        figures["commanded_rad"] = job.turn
    return figures


def _jobs(s: EvaluateSettings) -> Iterator[Job]:
    def nominal(kind: str, i: int, seconds: float, speed: float = 0.0, turn: float = 0.0) -> Job:
        return Job(kind=kind, seed=s.seed + i, seconds=seconds, ranges=NOMINAL, speed=speed, turn=turn, robot=s.robot)

    for i in range(s.episodes):
        yield Job(kind="randomised", seed=s.seed + i, seconds=s.seconds, ranges=s.randomisation, robot=s.robot)
    for i in range(TOE_EPISODES):
        yield nominal("toes", i, s.seconds)
    for i in range(COMMAND_EPISODES):
        yield from (nominal("walk", i, 12.0, speed=speed) for speed in (-0.3, 0.3))
        yield from (nominal("turn", i, 12.0, turn=turn) for turn in TURNS)


def evaluate(policy_path: Path, settings: EvaluateSettings, *, progress: Progress | None = None) -> dict[str, Any]:
    """Evaluate a policy, episodes in parallel; the same seeds give the same figures on one machine."""
    rows = play_all(_figures, list(_jobs(settings)), policy_path, settings, progress)
    return {"policy": policy_path.name, "summary": summarise(rows), "episodes": rows}


def _mean_minutes(minutes: list[float]) -> float:
    """Return the minutes to the motor limit at the mean heating of all episodes; infinite where none heats."""
    heating = float(np.mean([1.0 / m for m in minutes]))
    return 1.0 / heating if heating > 0 else float("inf")


def _mean(values: list[float]) -> float:
    known = [v for v in values if np.isfinite(v)]  # an episode that fell before its first goal has no toe error
    return float(np.mean(known)) if known else float("nan")


def summarise(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the main figures of all episodes."""

    def of_kind(kind: str, **asked: float | None) -> list[dict[str, Any]]:
        return [r for r in rows if r["kind"] == kind and asked.items() <= r.items()]

    randomised = of_kind("randomised")
    stand_up = np.array([r["stand_up_s"] for r in randomised])
    stood = stand_up <= STOOD_WITHIN
    kept = np.array([r["stands_at_end"] for r in randomised])

    toes = of_kind("toes")
    walks = {}
    for speed in (-0.3, 0.3):
        walks[f"{speed:+.1f}"] = float(np.mean([r["forward_m_s"] for r in of_kind("walk", commanded_m_s=speed)]))
    turns = {}
    for turn in TURNS:
        name = f"{np.rad2deg(turn):+.0f}"
        turns[name] = float(np.mean([r["turn_error_rad"] for r in of_kind("turn", commanded_rad=turn)]))

    return {
        "episodes": len(randomised),
        "stood_up_and_kept": float((stood & kept).mean()),
        "stood_up": float(stood.mean()),
        "stand_up_median_s": float(np.median(stand_up)),
        "stand_up_p95_s": float(np.quantile(stand_up, 0.95, method="nearest")),
        "randomised_toe_error_cm": _mean([r["toe_error_cm"]["mean"] for r in randomised]),
        "nominal_toe_error_cm": _mean([r["toe_error_cm"]["mean"] for r in toes]),
        "nominal_drift_m": _mean([r["drift_m"] for r in toes]),
        "nominal_knee_torque_rms_nm": _mean([r["torque_nm"]["knee_rms"] for r in toes]),
        "nominal_minutes_to_limit": _mean_minutes([r["minutes_to_limit"] for r in toes]),
        "walk_m_s": walks,
        "turn_error_rad": turns,
        "nominal_falls": int(sum(r["falls"] for r in rows if r["kind"] != "randomised")),
    }
