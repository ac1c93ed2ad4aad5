"""Held-out error against replays: least squares, and the paper's random search, on the same log and the same replay.

    python -m benchmarks.search_cost OUT.png [--samples 8192] [--seconds 10] [--results OUT.json]

The log is of a hidden hung CyberDog 2 with nothing but the baseline parameters wrong (benchmarks/hidden_effects).
Random search draws friction, damping, masses and delay as Li et al. 2024 do and keeps the sample with the least error
over the fitted blocks. Both are judged on blocks that neither used.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from benchmarks.hidden_effects.generator import FLOOR, measured, simulate
from benchmarks.hidden_effects.scenarios import Scenario, build
from mimic.dynamics.catalogue import BASELINE
from mimic.dynamics.machine import hung_robot, with_gains
from mimic.records import FloatArray
from mimic.robot.description import load_description
from mimic.sysid.fit.least_squares import fit
from mimic.sysid.fit.problem import Point, Problem
from mimic.sysid.fit.replay import Replay
from mimic.sysid.log.noise import noise_floor
from mimic.sysid.log.pool import make_blocks

BATCH = 128
"""Samples between two points of the curve."""

RANGES = {
    ("coulomb", "level"): (0.0, 0.3),
    ("viscous", "coefficient"): (0.0, 0.1),
    ("link_mass", "factor"): (0.8, 1.2),
    ("delay", "time"): (0.0, 0.03),
}
"""Uniform ranges of the samples. Source: Li et al. 2024, section IV; c2_systemid_config.py."""

Curve = list[tuple[int, float]]
"""Replays, held-out error [rad]."""


def problem_of(seconds: float) -> tuple[Problem, Point]:
    """Return the problem and the model as given."""
    built = build(Scenario(group="clean", seconds=seconds))
    log = measured(simulate(built.machine, built.motion, built.seed), built.seed)
    machine = with_gains(hung_robot(load_description()), log.metadata)
    replay = Replay(machine, log, timestep=0.0025, threads=1)
    problem = Problem(replay, noise_floor(log.q, log.rate), None, make_blocks(log.t, replay.counts))
    return problem, Point.of(BASELINE, machine)


def held_out(problem: Problem, residual: FloatArray) -> float:
    """Return the error over all joints on the blocks that were not fitted [rad]."""
    return float(np.sqrt(np.mean(problem.mean_squares(residual, True) * problem.noise**2)))


def least_squares(problem: Problem, start: Point, steps: int = 5) -> Curve:
    """Return the curve of so many steps."""
    begin = problem.replay.replays
    curve: Curve = [(1, held_out(problem, problem.residuals([start])[0]))]
    for _ in range(steps):
        fitted = fit(problem, start, BASELINE, {}, most=1)
        start = fitted.point
        curve.append((problem.replay.replays - begin, held_out(problem, fitted.residual)))
    return curve


def random_samples(problem: Problem, start: Point, samples: int) -> Curve:
    """Return the curve of the best sample so far."""
    rng, best, curve = np.random.default_rng(0), np.inf, []
    for i in range(samples // BATCH):
        points = [
            Point({k: rng.uniform(*RANGES[k], row.shape) for k, row in start.values.items()}) for _ in range(BATCH)
        ]
        squares = problem.squares(points)
        if squares.min() < best:
            best, residual = float(squares.min()), problem.residuals([points[int(squares.argmin())]])[0]
            error = held_out(problem, residual)
        curve.append((BATCH * (i + 1), error))
    return curve


def plot(curves: dict[str, Curve], path: Path) -> None:
    """Draw the curves and the noise floor."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(7.5, 4.2), constrained_layout=True)
    for (label, curve), colour, marker in zip(curves.items(), ("#1f5fa8", "#e07b1f"), ("o-", "-"), strict=True):
        x, y = np.array(curve).T
        axis.plot(x, 1e3 * y, marker, color=colour, label=label)
    axis.axhline(1e3 * FLOOR, color="#777", lw=1, ls="--", label="noise of the readings")
    axis.set(xscale="log", yscale="log", xlabel="replays of the log", ylabel="held-out error [mrad]")
    axis.set_title("Friction, damping, masses and delay of a hung CyberDog 2", loc="left")
    axis.legend(frameon=False)
    axis.grid(alpha=0.25, which="both")
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--samples", type=int, default=8192)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--results", type=Path)
    args = parser.parse_args()
    problem, start = problem_of(args.seconds)
    curves = {"least squares": least_squares(problem, start)}
    curves[f"best of {args.samples} random samples"] = random_samples(problem, start, args.samples)
    for label, curve in curves.items():
        print(label, *(f"{n}: {1e3 * e:.3f} mrad" for n, e in curve[:: max(1, len(curve) // 8)]), sep="\n  ")
        print(f"  {curve[-1][0]}: {1e3 * curve[-1][1]:.3f} mrad")
    if args.results:
        args.results.write_text(json.dumps(curves), encoding="utf-8")
    plot(curves, args.out)


if __name__ == "__main__":
    main()
