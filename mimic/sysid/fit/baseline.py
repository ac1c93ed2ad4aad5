"""The least-squares problem of a log and a model, and the fit of the baseline parameters.

Also the paper's way, for comparison: random samples, the one with the least error wins. Source: Li et al. 2024, section
IV: 8192 samples, friction 0-0.3 N m, damping 0-0.1 N m s/rad; c2_systemid_config.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from mimic.config.sysid import CalibrateSettings
from mimic.dynamics.machine import MachineModel
from mimic.errors import MissingExtra
from mimic.io.joint_log import JointLog
from mimic.records import BoolArray, FloatArray
from mimic.sysid.least_squares import Fit, fit
from mimic.sysid.logs import Pool, enabled, make_blocks, pool, valid_samples
from mimic.sysid.noise import coarse_steps, noise_floor
from mimic.sysid.replay import Replay, physics_step
from mimic.sysid.residuals import Key, Point, Problem

SAME_AS_VISCOUS: tuple[Key, ...] = (("gains", "kd"),)
"""Numbers that brake as viscous friction does; measured torque tells them from it, another Kd, or drives that are off.
"""

LEAST_NOISE = 1e-9
"""Noise floor where no reading shows any [rad or m]."""

MOST_STEPS = 10
"""Most steps of the baseline fit; measured on hidden machines, five of them left a joint at 1.7 noise floors that ends
at 1.
"""

BEGINNING, LEAST_BEGINNING, MOST_BEGINNING = 1 / 3, 15.0, 0.5
"""Share of a log that the first steps are fitted to, the least of it [s], and its greatest share, from which on that
saves nothing.
"""


RANGES = {
    ("coulomb", "level"): (0.0, 0.3),
    ("viscous", "coefficient"): (0.0, 0.1),
    ("link_mass", "factor"): (0.8, 1.2),
    ("delay", "time"): (0.0, 0.03),
}
"""Uniform ranges of the samples."""


def problem_of(logs: JointLog | Pool, machine: MachineModel, settings: CalibrateSettings) -> Problem:
    """Return the problem of logs and a model, as they say (`mimic.dynamics.machine.as_logged`).

    Raises:
        CalibrationError: If the log cannot be replayed.
        MissingExtra: If the device's libraries are not installed.
    """
    together = logs if isinstance(logs, Pool) else pool([logs], machine, step_of([logs], settings))
    log = together.log
    replay = _replay(together, machine, settings)
    noise = _of_moving(log.q[valid_samples(log)], _noise(log, replay, log.q, valid_samples(log)))
    steps = np.zeros_like(noise)
    if not settings.effects or "encoder_step" in settings.effects:
        steps, noise = coarse_steps(log.q[valid_samples(log)], noise)
    torque = None
    if log.tau is not None and replay.torque:
        torque = _of_moving(log.tau, _noise(log, replay, log.tau))
    rows = [part.slice for part in together.parts]
    blocks = make_blocks(log.t, replay.counts & valid_samples(log), logs=rows, enabled=enabled(log))
    problem = Problem(replay, noise, torque, blocks)
    problem.encoder_steps, problem.sending = steps, together.sending
    kd = np.stack([part.kd for part in together.parts])
    if torque is None and "viscous" in settings.baseline and np.all(kd == kd[0]) and enabled(log).all():
        problem.pinned = frozenset(SAME_AS_VISCOUS)
    return problem


def _of_moving(readings: FloatArray, noise: FloatArray) -> FloatArray:
    """Return noise floors (J,); a constant channel (T, J) gets the largest floor of the others."""
    moves = (np.ptp(readings, axis=0) > 0) & (noise > 0)
    return np.where(moves, noise, noise[moves].max() if moves.any() else LEAST_NOISE)


def step_of(logs: Sequence[JointLog], settings: CalibrateSettings) -> float:
    """Return the physics step for logs [s]."""
    return settings.timestep or physics_step(max(log.rate for log in logs))


def _noise(log: JointLog, replay: Replay, x: FloatArray, known: BoolArray | None = None) -> FloatArray:
    """Return the noise floors of signals (T, J), over all logs (J,)."""
    known = np.ones(len(x), dtype=bool) if known is None else known
    floors = [noise_floor(x[rows], log.part(rows).rate, known[rows]) for rows in (p.slice for p in replay.parts)]
    return np.sqrt(np.mean(np.square(floors), axis=0))


def _replay(together: Pool, machine: MachineModel, settings: CalibrateSettings) -> Replay:
    log = together.log
    own: dict[str, Any] = {
        "timestep": together.step,
        "threads": settings.threads,
        "torque": settings.torque,
        "sending": together.sending[0],
        "parts": together.parts,
    }
    if settings.device == "cpu":
        return Replay(machine, log, **own)
    try:
        from mimic.sysid.gpu_replay import WorldReplay
    except ModuleNotFoundError as missing:
        raise MissingExtra(str(missing.name), "train") from None
    return WorldReplay(machine, log, device=settings.device, **own)


def fit_sending_times(
    problem: Problem, fitted: Fit, names: Sequence[str], joints: Mapping[str, BoolArray]
) -> tuple[Problem, Fit]:
    """Return problem and fit with the sending times of targets that explain most, of all that the log allows.

    From rows alone it is open whether a steady clock sends targets beside rows that jitter, or whoever writes the rows
    sends them too. The motion tells: the probability of the logs where their drives follow the targets, the residual of
    each log of a size of its own.
    """
    for times in problem.sending[1:]:
        shift = float(np.mean(times.at - problem.replay.sending.at))
        values = dict(fitted.point.values)
        if ("delay", "time") in values:
            values["delay", "time"] = values["delay", "time"] - shift
        other = problem.sent_at(times)
        found = fit(other, Point(values), names, joints, most=3)
        if _left(other, found) < _left(problem, fitted):
            problem, fitted = other, found
    return problem, fitted


def _left(problem: Problem, fitted: Fit) -> float:
    counts = np.isin(problem.blocks.index, problem.blocks.train) & enabled(problem.replay.log).all(axis=1)
    squares = np.mean(problem.in_floors(fitted.residual).astype(np.float64) ** 2, axis=1)
    parts = [squares[part.slice][counts[part.slice]] for part in problem.replay.parts]
    return float(sum(len(own) * np.log(np.mean(own)) for own in parts if len(own)))


def fit_baseline(problem: Problem, start: Point, names: Sequence[str], joints: Mapping[str, BoolArray]) -> Fit:
    """Return the fit of the baseline parameters.

    The first steps, which only have to lead near, are taken with the beginning of a long log, at a third of the price.

    Args:
        problem: Log and model.
        start: Where to begin.
        names: The baseline effects.
        joints: Which joints have an effect.
    """
    log = problem.replay.log
    share = max(BEGINNING, LEAST_BEGINNING / max(log.duration, 1e-9))
    if problem.replay.shorter_is_faster and len(problem.replay.parts) == 1 and share <= MOST_BEGINNING:
        part = problem.of_beginning(int(share * len(log.t)))
        if np.ptp(part.blocks.index) > 0:
            start = fit(part, start, names, joints, most=MOST_STEPS).point
            problem.replay.replays += part.replay.replays
    return fit(problem, start, names, joints, most=MOST_STEPS)


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
