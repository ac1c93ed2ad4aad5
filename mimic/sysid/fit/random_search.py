"""The paper's way, for comparison: random samples of the baseline parameters, the one with the least error wins.

Source: Li et al. 2024, section IV: 8192 samples, friction 0-0.3 N m, damping 0-0.1 N m s/rad; c2_systemid_config.py.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mimic.sysid.fit.least_squares import Fit
from mimic.sysid.fit.point import Point
from mimic.sysid.fit.residuals import Problem

RANGES = {
    ("coulomb", "level"): (0.0, 0.3),
    ("viscous", "coefficient"): (0.0, 0.1),
    ("link_mass", "factor"): (0.8, 1.2),
    ("delay", "time"): (0.0, 0.03),
}
"""Uniform ranges of the samples."""


def random_search(problem: Problem, start: Point, samples: int, seed: int, report: Callable[[str, int], None]) -> Fit:
    """Return the best of so many samples over the fitted blocks, each joint with numbers of its own."""
    rng = np.random.default_rng(seed)
    best, winner = problem.squares([start])[0], start
    for begin in range(0, samples, problem.replay.sets_per_batch):
        points = [_drawn(start, rng) for _ in range(min(problem.replay.sets_per_batch, samples - begin))]
        squares = problem.squares(points)
        i = int(np.argmin(squares))
        if squares[i] < best:
            best, winner = squares[i], points[i]
        report("random samples", problem.replay.replays)
    residual = problem.residuals([winner])[0]
    return Fit(point=winner, free_parameters=(), residual=residual, columns=(), sums=problem.sums(residual, [], []))


def _drawn(start: Point, rng: np.random.Generator) -> Point:
    values = dict(start.values)
    for key, row in start.values.items():
        if key in RANGES:
            values[key] = rng.uniform(*RANGES[key], row.shape)
    return Point(values)
