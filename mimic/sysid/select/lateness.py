"""Targets that acted late or never: one linear solve for the lateness of each, judged by chains not used for it.

A replay in which one target in so many comes a period late shows what each of these does: a response that is over
before the next one begins. The residual is a sum of the responses of all, each times the lateness of its target. All
joints take their targets from one message, so that the lateness which the other chains show predicts what is left of a
chain: evidence from readings that nothing was fitted to.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import linalg, sparse
from scipy.ndimage import uniform_filter1d
from scipy.special import expit, logit
from scipy.stats import binomtest

from mimic.records import BoolArray, FloatArray
from mimic.sysid.fit.least_squares import Fit, fit
from mimic.sysid.fit.problem import Point, Problem
from mimic.sysid.fit.replay import SHOOT, Targets
from mimic.sysid.log.timing import LEAST_TARGETS
from mimic.sysid.result import RULES

CERTAIN = 0.25
"""Standard deviation of a lateness, in periods, up to which it says something of its own."""
MOST_OFFSETS = 40
"""Most targets within ``SHOOT``, after which a joint under a servo no longer knows that one was late: faster ones are
not told from each other, and each takes a replay."""


@dataclass(frozen=True, eq=False)
class Lateness:
    """A law of the lateness of single targets."""

    name: str
    """Effect of the catalogue: lost_commands or delay_jitter."""
    interval: tuple[float, float]
    """95 % interval of its parameter: share of the lost, or width of the jitter [s]."""
    late: FloatArray
    """How much later than the point's delay each target acts (K,) [s]."""
    point: Point
    """With the effect, and the delay that goes with ``late``."""
    squares: FloatArray
    """Squares of each fitted block that a linear model leaves with what the other chains show (B_train, C)."""


def _lost(value: FloatArray, deviation: FloatArray, gaps: FloatArray) -> tuple[float, tuple[float, float], FloatArray]:
    """Return the share of lost targets, and the lateness to be expected of each (K,): none or whole periods.

    The share and each target's probability of being lost are found in turn (expectation-maximisation). How far values
    scatter towards early, which no target can be, shows what the model's errors add. A target that is sent again until
    another follows (K,) may be lost each time.
    """
    known = deviation < CERTAIN
    usual = float(np.median(value[known])) if known.any() else 0.0
    late = value - usual
    early = float(np.mean(np.minimum(late / deviation, 0.0) ** 2))
    spread = deviation * np.sqrt(max(2 * early, 1.0))
    times = np.clip(np.round(late), 1.0, gaps)
    evidence = times * (late - times / 2) / spread**2
    gone = expit(evidence)
    for _ in range(30):
        gone = expit(evidence + logit(gone.mean()))
    share = float(gone.mean())
    count = max(int(known.sum()), 1)
    interval = binomtest(round(share * count), count).proportion_ci(method="wilson")
    return share, (interval.low, interval.high), gone * times + usual


def _jittered(
    value: FloatArray, deviation: FloatArray, gaps: FloatArray
) -> tuple[float, tuple[float, float], FloatArray]:
    """Return the width of uniform jitter, and the lateness to be expected of each target (K,)."""
    known = deviation < CERTAIN
    if known.sum() < LEAST_TARGETS:
        return 0.0, (0.0, 0.0), np.zeros(len(value))
    usual = float(np.mean(value[known]))
    value = np.where(known, value - usual, 0.0)
    drift = uniform_filter1d(value, LEAST_TARGETS)  # what changes slowly is no jitter
    squared = (value - drift)[known] ** 2 / (1 - 1 / LEAST_TARGETS) - deviation[known] ** 2
    weight = 1.0 / (deviation[known] ** 2 + 0.05**2) ** 2
    variance = max(float(np.sum(weight * squared) / weight.sum()), 0.0)
    error = 1.96 * np.sqrt(np.sum((weight * (squared - variance)) ** 2)) / weight.sum()
    low, width, high = (float(np.sqrt(12.0 * max(variance + s * error, 0.0))) for s in (-1.0, 0.0, 1.0))
    return width, (low, high), value * variance / (variance + deviation**2) + usual


def late_targets(problem: Problem, fitted: Fit, names: Sequence[str]) -> list[Lateness]:
    """Return laws of lost and jittering targets that a residual supports; empty where none can be seen."""
    of = problem.channel_chain if len(np.unique(problem.channel_chain)) > 1 else problem.channel_joint
    group, had = np.unique(of, return_inverse=True)[1], problem.replay.late
    near = had is not None and "delay_jitter" in names
    responses = _responses(problem, fitted, near) if group.any() else None
    if responses is None:
        return []
    period, inside = problem.replay.sending.period, problem.blocks.index >= 0
    gaps = np.append(np.maximum(np.round(np.diff(problem.replay.sending.at) / period), 1.0), 1.0)
    left = np.where(inside[:, None], np.nan_to_num(fitted.residual), 0.0).astype(np.float64)
    effects, groups = _design(problem, responses), np.arange(group.max() + 1)
    if had is not None:
        left += (effects @ (had / period if near else np.minimum(had / period, gaps))).reshape(left.shape)
    normal = []
    for g in groups:
        own: Any = effects[np.tile(group == g, len(left))]
        square = own.T @ own
        bands = [np.append(np.zeros(k), square.diagonal(k)) for k in range(len(responses))]
        normal.append((np.stack(bands[::-1]), own.T @ left[:, group == g].ravel()))
    weights = np.ones(len(groups))
    for _ in range(3):  # what lateness leaves of each says how much it counts
        rest = (left - (effects @ _solved(normal, weights)[0]).reshape(left.shape))[inside]
        weights = np.array([1.0 / max(float(np.mean(rest[:, group == g] ** 2)), 1.0) for g in groups])
    whole, found = _solved(normal, weights), []
    others = [_solved(normal, np.where(groups == g, 0.0, weights)) for g in groups]
    for name in names:
        jitter = name == "delay_jitter"
        law, scale, parameter = (_jittered, period, "spread") if jitter else (_lost, 1.0, "share")
        value, (low, high), late = law(*whole, gaps)
        if not low > 0.0:
            continue
        shown = [(effects @ law(*seen, gaps)[2]).reshape(left.shape) for seen in others]
        after = left - sum(np.where(group == g, one, 0.0) for g, one in enumerate(shown))
        after[~inside] = np.nan
        shift = value / 2 - float(np.mean(late)) if jitter else -float(np.median(late))
        late = np.clip(late + shift, 0.0, high) if jitter else _until_next(late + shift, gaps)
        point = fitted.point.with_effect(name, problem.machine, {parameter: value * scale})
        if ("delay", "time") in point.values:
            point = Point({**point.values, ("delay", "time"): point.values["delay", "time"] - shift * period})
        squares = problem.judged(problem.block_squares(after)[problem.blocks.train])
        found.append(Lateness(name, (low * scale, high * scale), period * late, point, squares))
    return found


def fit_lateness(
    problem: Problem, lateness: Lateness, names: Sequence[str], joints: Mapping[str, BoolArray], known: Fit
) -> tuple[Problem, Lateness, Fit]:
    """Fit the lateness of each target and all numbers in turn; return the problem with that lateness, too.

    Along the derivatives of a known fit, which lateness hardly changes. What the other chains show of each chain is
    read off there once more: without replays a lost target is mistaken for a jittering one.
    """
    best, least = None, np.inf
    while True:
        problem = problem.changed(replay=problem.replay.with_late(lateness.late))
        fitted = fit(problem, lateness.point, names, joints, most=2, frozen=known, every=0)
        left = float(problem.mean_squares(fitted.residual, False).sum())
        if best and left > (1 - RULES.gain) * least:
            return best
        again = late_targets(problem, fitted, [lateness.name])
        if not again:
            return problem, lateness, fitted
        best, least = (problem, replace(lateness, squares=again[0].squares), fitted), left
        lateness = again[0]


def _until_next(lost: FloatArray, gaps: FloatArray) -> FloatArray:
    """Return after how many periods each target acts (K,): one that is always lost gives way to the next."""
    wait = np.zeros(len(lost))
    for k in reversed(np.flatnonzero(np.round(lost) > 0)):
        wait[k] = np.round(lost[k])
        if wait[k] >= gaps[k] and k + 1 < len(lost):
            wait[k] += wait[k + 1]
    return wait


def _responses(problem: Problem, fitted: Fit, near: bool) -> FloatArray | None:
    """Return what a period of lateness (or a quarter more, times four) of every n-th target changes (n, T, C)."""
    replay, period, share = problem.replay, problem.replay.sending.period, 0.25 if near else 1.0
    offsets = int(np.ceil(SHOOT / period))
    if not 0 < offsets <= MOST_OFFSETS < len(replay.sent):
        return None
    own = replay.late if near and replay.late is not None else np.zeros(len(replay.sent))
    lates = [own, *(own + share * period * (np.arange(len(own)) % offsets == k) for k in range(offsets))]
    each = [replay.delayed(x) for x in lates]
    targets = Targets(held=np.stack([t.held for t in each]), begun=np.stack([t.begun for t in each]))
    made = np.nan_to_num(problem.uncorrected([fitted.point] * len(lates), targets))
    return (made[0] - made[1:]) / np.float32(share)


def _design(problem: Problem, responses: FloatArray) -> sparse.csr_array:
    """Return what a period of lateness of each target changes, reading by reading and channel by channel (T C, K)."""
    offsets, rows, channels = responses.shape
    target = np.searchsorted(problem.replay.sent, np.arange(rows), side="right")[:, None] - 1 - np.arange(offsets)
    row, back = np.nonzero(target > 0)  # the first one has acted for long
    target = target[row, back]
    at = row[:, None] * channels + np.arange(channels)
    where = (at.ravel(), np.repeat(target, channels))
    made = (responses[target % offsets, row].astype(np.float64).ravel(), where)
    return sparse.csr_array(made, shape=(rows * channels, len(problem.replay.sent)))


def _solved(normal: Sequence[tuple[FloatArray, FloatArray]], weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what normal equations (upper bands, right side) say of each target (K,), and its standard deviation.

    Solved with a prior of one period, which is taken off again.
    """
    bands, right = (np.tensordot(weights, np.stack(x), 1) for x in zip(*normal, strict=True))
    width, count = bands.shape
    bands[-1] += 1.0
    value, upper = linalg.solveh_banded(bands, right), np.asarray(linalg.cholesky_banded(bands))
    variance, near = np.empty(count), np.zeros((0, 0))
    for j in range(count - 1, -1, -1):  # the inverse near its diagonal (Takahashi et al. 1973)
        most = min(width - 1, count - 1 - j)
        row = np.array([upper[width - 1 - i, j + i] for i in range(1, most + 1)]) / upper[-1, j]
        beside = -near[:most, :most] @ row
        variance[j] = 1.0 / upper[-1, j] ** 2 - row @ beside
        near = np.block([[variance[j : j + 1, None], beside[None]], [beside[:, None], near[:most, :most]]])
    variance = np.minimum(variance, 1.0 - np.sqrt(np.finfo(np.float32).eps))  # responses are in single precision
    return value / (1.0 - variance), np.sqrt(variance / (1.0 - variance))
