"""The least-squares problem of a log and a model, and the fit of the baseline parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mimic.config.sysid import CalibrateSettings
from mimic.dynamics.machine import MachineModel
from mimic.errors import MissingExtra
from mimic.io.joint_log import JointLog
from mimic.records import BoolArray, FloatArray
from mimic.sysid.fit.least_squares import Fit, chain_costs, fit
from mimic.sysid.fit.point import Key, Point
from mimic.sysid.fit.residuals import Problem
from mimic.sysid.log.blocks import make_blocks
from mimic.sysid.log.missing import valid_samples
from mimic.sysid.log.noise import noise_floor
from mimic.sysid.log.quantisation import coarse_steps
from mimic.sysid.replay.cpu import Replay
from mimic.sysid.replay.records import physics_step
from mimic.sysid.timing import sending_times

SAME_AS_VISCOUS: tuple[Key, ...] = (("gains", "kd"),)
"""Numbers that brake as viscous friction does; only measured torque tells them from it."""

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


def problem_of(log: JointLog, machine: MachineModel, settings: CalibrateSettings) -> Problem:
    """Return the problem of a log and a model, as the log says (`mimic.dynamics.machine.as_logged`).

    Raises:
        CalibrationError: If the log cannot be replayed.
        MissingExtra: If the device's libraries are not installed.
    """
    step = settings.timestep or physics_step(log.rate)
    replay = _replay(log, machine, settings, step)
    noise = _of_moving(log.q[valid_samples(log)], noise_floor(log.q, log.rate, valid_samples(log)))
    steps = np.zeros_like(noise)
    if not settings.effects or "encoder_step" in settings.effects:
        steps, noise = coarse_steps(log.q[valid_samples(log)], noise)
    torque = None
    if log.tau is not None and replay.torque:
        torque = _of_moving(log.tau, noise_floor(log.tau, log.rate))
    problem = Problem(replay, noise, torque, make_blocks(log.t, replay.counts & valid_samples(log)))
    problem.encoder_steps = steps
    if torque is None and "viscous" in settings.baseline:
        problem.pinned = frozenset(SAME_AS_VISCOUS)
    return problem


def _of_moving(readings: FloatArray, noise: FloatArray) -> FloatArray:
    """Return noise floors (J,); a constant channel (T, J) gets the largest floor of the others."""
    moves = (np.ptp(readings, axis=0) > 0) & (noise > 0)
    return np.where(moves, noise, noise[moves].max() if moves.any() else LEAST_NOISE)


def _replay(log: JointLog, machine: MachineModel, settings: CalibrateSettings, step: float) -> Replay:
    own: dict[str, Any] = {
        "timestep": step,
        "threads": settings.threads,
        "torque": settings.torque,
        "sending": sending_times(log)[0],
    }
    if settings.device == "cpu":
        return Replay(machine, log, **own)
    try:
        from mimic.sysid.replay.gpu import WorldReplay
    except ModuleNotFoundError as missing:
        raise MissingExtra(str(missing.name), "train") from None
    return WorldReplay(machine, log, device=settings.device, **own)


def fit_sending_times(problem: Problem, fitted: Fit, names: Sequence[str], joints: Mapping[str, BoolArray]) -> Fit:
    """Return the fit with the sending times of targets that explain most, of all that the log allows.

    From rows alone it is open whether a steady clock sends targets beside rows that jitter, or whoever writes the rows
    sends them too. The motion tells.
    """
    best = problem.replay.sending
    for times in sending_times(problem.replay.log)[1:]:
        before = problem.replay.sending
        shift = float(np.mean(times.at - before.at))
        values = dict(fitted.point.values)
        if ("delay", "time") in values:
            values["delay", "time"] = values["delay", "time"] - shift
        problem.send_at(times)
        other = fit(problem, Point(values), names, joints, most=3)
        if _left(problem, other) < _left(problem, fitted):
            best, fitted = times, other
        problem.send_at(best)
    return fitted


def _left(problem: Problem, fitted: Fit) -> float:
    return float(problem.weight @ chain_costs(problem, fitted.point, fitted.residual, fitted.free_parameters))


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
    if problem.replay.shorter_is_faster and share <= MOST_BEGINNING:
        part = problem.of_beginning(int(share * len(log.t)))
        if np.ptp(part.blocks.index) > 0:
            start = fit(part, start, names, joints, most=MOST_STEPS).point
            problem.replay.replays += part.replay.replays
    return fit(problem, start, names, joints, most=MOST_STEPS)
