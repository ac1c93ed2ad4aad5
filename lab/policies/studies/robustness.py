"""How much disturbance a policy survives: one axis at a time, all together, and with other solvers.

An episode begins lying, with start pose, heading, goals and commands drawn as in the paper, and is survived when the
robot has not fallen and stands in its last second. Along an axis everything else is nominal, and each point sees the
same starts and commands.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lab.policies.disturbed import NO_DISTURBANCE, DisturbedJob, Solver
from lab.policies.standing import on_level_ground
from lab.policies.studies.disturbance_axes import AXES, START, World, all_at_once
from lab.policies.studies.settings import RobustnessSettings
from mimic.config.play import Randomisation
from mimic.config.training import TRAINING_RANDOMISATION
from mimic.errors import PlantError
from mimic.evaluation.episode import TIMING, play_all, play_episode
from mimic.evaluation.policy import asked_by, stands_at_end
from mimic.jobs.local import Progress
from mimic.policy.runtime import Policy
from mimic.records import SIDES

REQUIRED = 0.95
"""Share of survived episodes from which on a disturbance counts as tolerated."""

TOGETHER = (0.25, 0.5, 0.75, 1.0)
"""Shares of every target range, from nominal to its end, from which all axes are drawn at once."""

NO_REBOUND = dataclasses.replace(Randomisation(), restitution=(0.0, 0.0))
"""Steps of 5 ms do not resolve a bouncing ground."""

SOLVERS: dict[str, tuple[Solver, Randomisation]] = {
    "2.5 ms implicitfast elliptic": (Solver(), Randomisation()),
    "5 ms implicitfast elliptic": (Solver(timestep=0.005), Randomisation()),
    "5 ms implicitfast elliptic, no rebound": (Solver(timestep=0.005), NO_REBOUND),
    "1 ms implicitfast elliptic": (Solver(timestep=0.001), Randomisation()),
    "2.5 ms implicit elliptic": (Solver(integrator="implicit"), Randomisation()),
    "1 ms Euler elliptic": (Solver(timestep=0.001, integrator="Euler"), Randomisation()),
    "2.5 ms implicitfast elliptic, impratio 1": (Solver(impratio=1.0), Randomisation()),
    "2.5 ms implicitfast pyramidal, impratio 1": (Solver(cone="pyramidal", impratio=1.0), Randomisation()),
    "2.5 ms implicitfast pyramidal, impratio 10": (Solver(cone="pyramidal", impratio=10.0), Randomisation()),
    "1 ms implicitfast pyramidal, impratio 10": (
        Solver(timestep=0.001, cone="pyramidal", impratio=10.0),
        Randomisation(),
    ),
}
"""Integrators of the same physics, on the paper's random robots; the first is that of training. At friction 3 the feet
sink into the ground of pyramidal cones; with impratio 10 they do not, and what is left is about the policy."""


@dataclass(frozen=True, kw_only=True)
class _Job(DisturbedJob):
    key: tuple[str, str]
    solver: Solver | None = None


def _jobs(settings: RobustnessSettings) -> list[_Job]:
    jobs: list[_Job] = []

    def add(kind: str, name: str, world: Callable[[int], World], solver: Solver | None = None) -> None:
        for seed in range(settings.seed, settings.seed + settings.episodes):
            ranges, disturbance = world(seed)
            sided = dataclasses.replace(disturbance, toe=SIDES[seed % 2])
            made = {"seed": seed, "seconds": settings.seconds, "robot": settings.robot, "disturbance": sided}
            jobs.append(_Job(key=(kind, name), solver=solver, ranges=ranges, **made))

    def fixed(world: World) -> Callable[[int], World]:
        return lambda seed: world

    for name, axis in AXES.items():
        for value in axis.points:
            add(name, f"{value:g}", fixed(axis.apply((START, NO_DISTURBANCE), value)))
    for share in TOGETHER:
        add("together", f"{share:g}", partial(all_at_once, share))
    add("randomised", "the paper's Table II", fixed((Randomisation(), NO_DISTURBANCE)))
    add("randomised", "training's ranges", fixed((TRAINING_RANDOMISATION, NO_DISTURBANCE)))
    for name, (solver, ranges) in SOLVERS.items():
        add("solver", name, fixed((ranges, NO_DISTURBANCE)), solver)
    return jobs


def _survives(job: _Job, policy: Policy) -> bool:
    description = policy.description
    plant = job.plant(description, **({} if job.solver is None else {"solver": job.solver}))
    try:
        result = play_episode(plant, policy, asked_by(job, description), TIMING)
    except PlantError:  # the simulation exploded
        return False
    return stands_at_end(on_level_ground(result, plant.disturber.slope_quat), description)


def holds(shares: dict[float, float], nominal: float) -> tuple[float, float] | None:
    """Return the widest range of values around the nominal one at which at least REQUIRED survive, or None.

    Args:
        shares: Survived share at each value.
        nominal: Value without disturbance; the tried value next to it is where the range begins.
    """
    values = sorted(shares)
    begin = min(range(len(values)), key=lambda i: abs(values[i] - nominal))
    if shares[values[begin]] < REQUIRED:
        return None
    low = high = begin
    while low > 0 and shares[values[low - 1]] >= REQUIRED:
        low -= 1
    while high + 1 < len(values) and shares[values[high + 1]] >= REQUIRED:
        high += 1
    return values[low], values[high]


def evaluate_robustness(
    policy_path: Path, settings: RobustnessSettings, *, progress: Progress | None = None
) -> dict[str, Any]:
    """Return the survived share along each axis, with all axes at once, and with other solvers."""
    jobs = _jobs(settings)
    survived: dict[tuple[str, str], list[bool]] = {}
    for job, ok in zip(jobs, play_all(_survives, jobs, policy_path, settings, progress), strict=True):
        survived.setdefault(job.key, []).append(ok)
    share = {key: float(np.mean(values)) for key, values in survived.items()}
    axes = {}
    for name, axis in AXES.items():
        shares = {value: share[name, f"{value:g}"] for value in axis.points}
        axes[name] = {
            "unit": axis.unit,
            "nominal": axis.nominal,
            "asked": axis.asked,
            "trained": axis.trained,
            "holds": holds(shares, axis.nominal),
            "points": [{"value": value, "survived": ok} for value, ok in shares.items()],
        }
    return {
        "policy": policy_path.name,
        "episodes_per_point": settings.episodes,
        "axes": axes,
        "together": {f"{s:g}": share["together", f"{s:g}"] for s in TOGETHER},
        "randomised": {name: ok for (kind, name), ok in share.items() if kind == "randomised"},
        "solvers": {name: share["solver", name] for name in SOLVERS},
    }
