"""How closely the front toes follow, and what that costs the rest of the robot: one row a situation.

    python -m lab.policies.arms [--robot-model go2] [--arms network] [SITUATION ...]

Arms are moved by the policy's contract, or as --arms says. Every figure is of the phase "track".
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from lab.policies.disturbed import NO_DISTURBANCE, Disturbance, DisturbedPlant
from lab.policies.studies.senses import SENSES, SensingPolicy
from mimic.config.play import NOMINAL, Randomisation, RunSettings
from mimic.control.loop import RunResult, run_policy
from mimic.evaluation.episode import OF_EPISODES
from mimic.flows.motions.motion import InputSettings, load_motion
from mimic.geometry import heading_from_quat
from mimic.metrics import run_metrics
from mimic.policy.runtime import Policy, load_policy
from mimic.records import Command, CommandTrack, FloatArray
from mimic.retargeting.commands import command_track
from mimic.robot.description import RobotDescription, load_description
from mimic.robot.goals import draw_goals
from mimic.simulation.plant import SimulatedPlant

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "videos"
ROBOTS = Randomisation(push=(0.0, 0.0), ground_friction=(0.5, 2.0))
"""Table II of the paper, on slippery and on rough ground."""
PUSH = 0.8
"""Speed of a push [m/s]."""
WAYS, TIMES = 8, 3
"""Directions of the pushes, and how often each."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One run."""

    track: CommandTrack
    live: bool = False
    ranges: Randomisation = NOMINAL
    disturbance: Disturbance = NO_DISTURBANCE
    seed: int = 0
    senses: str = ""
    push: float | None = None
    """Direction of a push in the middle of the motion, from where the belly faces [rad]."""


@dataclass
class Stream:
    """A motion whose future the robot does not know."""

    track: CommandTrack
    wait: int
    """Control steps before the motion begins, while the robot blends."""
    row: int = field(default=0, init=False)

    def newest(self) -> Command | None:
        """Return the command of this control step."""
        row = max(self.row - self.wait, 0)
        self.row += 1
        if row >= len(self.track.t):
            return None
        t = self.track
        return Command(v=t.v[row], heading=float(t.heading[row]), p_BE=t.p_BE[row])


def play(case: Case, policy: Policy, description: RobotDescription, arms: str | None) -> RunResult:
    """Play a case in plain MuJoCo."""
    settings = RunSettings(arms=arms, hold_last=0.0)  # type: ignore[arg-type]
    plant = DisturbedPlant(description, ranges=case.ranges, seed=case.seed, disturbance=case.disturbance, **OF_EPISODES)
    if case.push is not None:
        begin = settings.stand_up + settings.blend + 0.5 * case.track.t[-1]
        plant.watch(_pusher(plant, case.push, begin))
    acts = SensingPolicy(policy, SENSES[case.senses], case.seed) if case.senses else policy
    track = Stream(case.track, round(settings.blend / description.dt)) if case.live else case.track
    return run_policy(plant, acts, track, settings)


def _pusher(plant: SimulatedPlant, angle: float, at: float):
    waiting = [True]

    def push(model, data) -> None:
        if waiting[0] and data.time >= at:
            waiting[0] = False
            way = float(heading_from_quat(data.qpos[3:7])) + angle
            plant.data.qvel[:2] += PUSH * np.array([np.cos(way), np.sin(way)])

    return push


def clip(name: str, description: RobotDescription) -> CommandTrack:
    """Return the commands of a shipped video."""
    targets = load_motion(EXAMPLES / f"{name}.mp4", InputSettings(), description=description).targets
    assert targets is not None
    return command_track(targets)


def goals_track(description: RobotDescription, seed: int = 0) -> CommandTrack:
    """Return thirty random goals, one a second, each reached in half a second."""
    dt = description.dt
    pairs = draw_goals(description, 30, np.random.default_rng(seed))
    rows: list[FloatArray] = []
    for before, after in pairwise(pairs):
        share = np.clip(2.0 * np.arange(0.0, 1.0, dt), 0.0, 1.0)[:, None, None]
        rows.append(before + share**2 * (3.0 - 2.0 * share) * (after - before))
    p_BE = np.concatenate(rows)
    zeros = np.zeros(len(p_BE))
    return CommandTrack(t=dt * np.arange(len(p_BE)), v=np.zeros((len(p_BE), 2)), heading=zeros, p_BE=p_BE)


def walking(track: CommandTrack, speed: float) -> CommandTrack:
    """Return the same arms at a speed [m/s]."""
    v = np.zeros_like(track.v)
    v[:, 0] = speed
    return replace(track, v=v)


def cases(description: RobotDescription) -> Iterator[tuple[str, list[Case]]]:
    """Return each situation and its runs."""
    boxing = clip("boxing", description)
    for name in ("boxing", "waving", "ballet"):
        yield name, [Case(track=clip(name, description))]
    yield "goals", [Case(track=goals_track(description))]
    for speed in (0.3, -0.3):
        yield f"walk{speed:+.1f}", [Case(track=walking(boxing, speed))]
    yield "robots", [Case(track=boxing, ranges=ROBOTS, seed=seed) for seed in range(20)]
    yield "noise", [Case(track=boxing, senses="the paper's noise", seed=seed) for seed in range(3)]
    for name in ("boxing", "ballet"):
        yield f"live_{name}", [Case(track=clip(name, description), live=True)]
    angles = 2.0 * np.pi * np.arange(WAYS) / WAYS
    pushes = [(angle, seed) for angle in angles for seed in range(TIMES)]
    yield "pushed", [Case(track=boxing, ranges=ROBOTS, seed=seed, push=angle) for angle, seed in pushes]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("situations", nargs="*")
    parser.add_argument("--robot-model", default="cyberdog2")
    parser.add_argument("--policy")
    parser.add_argument("--arms", choices=("network", "inverse_kinematics"))
    options = parser.parse_args()
    description = load_description(options.robot_model)
    policy = load_policy(options.policy, description)
    print("| situation | toe error mean, p95, worst run [cm] | lag [ms] | stood | knees [N m] | speed [m/s] |")
    print("|---|---|---|---|---|---|")
    for name, runs in cases(description):
        if options.situations and name not in options.situations:
            continue
        results = [play(case, policy, description, options.arms) for case in runs]
        found = [run_metrics(result.log, description) for result in results]
        errors = [m["toe_error_cm"]["mean"] for m in found if not m["falls"]]
        tails = [m["toe_error_cm"]["p95"] for m in found if not m["falls"]]
        knees = np.mean([m["torque_nm"]["knee_rms"] for m in found])
        lag = np.mean([m["lag_s"] for m in found])
        stood = sum(not m["falls"] for m in found)
        speed = results[0].log.v_WB[results[0].log.aimed] @ _ahead(results[0])
        print(
            f"| {name} | {np.mean(errors):.2f}, {np.mean(tails):.2f}, {np.max(errors):.2f} | {1e3 * lag:.0f} "
            f"| {stood} of {len(runs)} | {knees:.2f} | {speed.mean():.2f} |",
            flush=True,
        )


def _ahead(result: RunResult) -> FloatArray:
    heading = float(heading_from_quat(result.log.quat_WB[0]))
    return np.array([np.cos(heading), np.sin(heading), 0.0])


if __name__ == "__main__":
    main()
