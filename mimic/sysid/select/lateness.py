"""Targets that acted late or never: one linear solve for the lateness of each, judged by chains not used for it.

A replay in which one target in so many comes a period late shows what the loss of each of these does: a response that
is over before the next one begins. Replays with every offset give the responses of all targets, and the residual is a
sum of them, each times the lateness of its target. All joints take their targets from one message, so the lateness that
the other chains show predicts what is left of a chain: that is evidence from readings which nothing was fitted to.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg
from scipy.ndimage import uniform_filter1d

from mimic.records import BoolArray, FloatArray, IntArray
from mimic.sysid.fit.least_squares import Fit, fit
from mimic.sysid.fit.problem import Point, Problem, stack
from mimic.sysid.fit.replay import Targets

CERTAIN = 0.25
"""Standard deviation of a lateness, in periods, up to which it says something of its own."""
FORGOTTEN = 0.5
"""Time after which a joint under a servo no longer knows that a target was late [s]."""
MOST_OFFSETS, LEAST_ROWS = 64, 3
"""Targets that come faster than so many in that time, or with fewer readings each, are not told from each other."""
SLOW = 25
"""Targets over which lateness is averaged: what changes more slowly is no jitter."""
ROUNDS = 4
"""Most rounds of finding which targets were late, and fitting all numbers."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Lateness:
    """A law of the lateness of single targets."""

    name: str
    """Effect of the catalogue: lost_commands or delay_jitter."""
    value: float
    """Of its parameter: share of the lost, or width of the jitter [s]."""
    interval: tuple[float, float]
    """95 % interval of the value."""
    late: FloatArray
    """How much later than the point's delay each target acts (K,) [s]."""
    point: Point
    """With the effect, and the delay that goes with ``late``."""
    squares: FloatArray
    """Sum of squares of each fitted block and channel that a linear model leaves with the lateness that the other
    chains show (B_train, C)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Estimate:
    """Of each target, in its periods (K,): estimate of the log alone, and its standard deviation."""

    value: FloatArray
    deviation: FloatArray

    @property
    def known(self) -> BoolArray:
        return self.deviation < CERTAIN


def _lost(x: _Estimate, gaps: FloatArray) -> tuple[float, tuple[float, float], FloatArray]:
    """Return the share of lost targets, its interval, and the lateness of each (K,) [periods]: none or whole ones.

    One that is sent again until another follows (K,) may be lost each time.
    """
    usual = float(np.median(x.value[x.known])) if x.known.any() else 0.0
    gone = (x.value - usual > 0.5) & x.known
    count, lost = int(x.known.sum()), int(gone.sum())
    if count < 20 or lost < 3:
        return 0.0, (0.0, 0.0), np.zeros(len(gone))
    share, z = lost / count, 1.96
    centre = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z * np.sqrt(share * (1 - share) / count + z * z / (4 * count**2)) / (1 + z * z / count)
    times = np.clip(np.round(x.value - usual), 1.0, gaps)
    return share, (max(centre - half, 0.0), centre + half), np.where(gone, times, 0.0) + usual


def _jittered(x: _Estimate, gaps: FloatArray) -> tuple[float, tuple[float, float], FloatArray]:
    """Return the width of uniform jitter, its interval, and the expected lateness of each target (K,) [periods]."""
    if x.known.sum() < 20:
        return 0.0, (0.0, 0.0), np.zeros(len(x.value))
    usual = float(np.mean(x.value[x.known]))
    value = np.where(x.known, x.value - usual, 0.0)
    quick = (value - uniform_filter1d(value, SLOW))[x.known]
    squared = quick**2 * SLOW / (SLOW - 1) - x.deviation[x.known] ** 2
    weight = 1.0 / (x.deviation[x.known] ** 2 + 0.05**2) ** 2
    variance = float(np.sum(weight * squared) / weight.sum())
    if variance <= 0.0:
        return 0.0, (0.0, 0.0), np.zeros(len(value))
    error = 1.96 * np.sqrt(np.sum((weight * (squared - variance)) ** 2)) / weight.sum()
    low, width, high = (float(np.sqrt(12.0 * max(variance + s * error, 0.0))) for s in (-1.0, 0.0, 1.0))
    return width, (low, high), value * variance / (variance + x.deviation**2) + usual


def late_targets(problem: Problem, fitted: Fit, names: Sequence[str]) -> list[Lateness]:
    """Return laws of lost and jittering targets that a residual supports; empty where none can be seen."""
    of = problem.channel_chain if len(np.unique(problem.channel_chain)) > 1 else problem.channel_joint
    groups = [of == part for part in np.unique(of)]
    near = problem.replay.late is not None and "delay_jitter" in names
    responses = _responses(problem, fitted, near) if len(groups) > 1 else None
    if responses is None:
        return []
    period, inside = problem.replay.sending.period, problem.blocks.index[:, None] >= 0
    gaps = np.append(np.maximum(np.round(np.diff(problem.replay.sending.at) / period), 1.0), 1.0)
    left = np.where(inside, np.nan_to_num(fitted.residual), 0.0).astype(np.float64)
    had = problem.replay.late
    if had is not None:
        left += _applied(problem, responses, had / period if near else np.minimum(had / period, gaps), slice(None))
    normal = [_normal(problem, responses, left, g) for g in groups]
    weights = [1.0] * len(groups)
    for _ in range(3):  # what lateness leaves of each says how much it counts
        value = _solved([(bands * w, right * w) for (bands, right), w in zip(normal, weights, strict=True)]).value
        rest = [(left[:, g] - _applied(problem, responses, value, g))[inside[:, 0]] for g in groups]
        weights = [1.0 / max(float(np.mean(r**2)), 1.0) for r in rest]
    normal = [(bands * w, right * w) for (bands, right), w in zip(normal, weights, strict=True)]
    whole, found = _solved(normal), []
    for name in names:
        parameter, law = ("spread", _jittered) if name == "delay_jitter" else ("share", _lost)
        value, interval, late = law(whole, gaps)
        if not interval[0] > 0.0:
            continue
        after = left.copy()
        for g, channels in enumerate(groups):
            seen = _solved([n for i, n in enumerate(normal) if i != g])
            after[:, channels] -= _applied(problem, responses, law(seen, gaps)[2], channels)
        jitter = name == "delay_jitter"
        shift = value / 2 - float(np.mean(late)) if jitter else -float(np.median(late))
        late = np.clip(late + shift, 0.0, interval[1]) if jitter else _until_next(late + shift, gaps)
        size, scale = (value * period, period) if jitter else (value, 1.0)
        point = fitted.point.with_effect(name, problem.machine, {parameter: size})
        if ("delay", "time") in point.values:
            point = Point({**point.values, ("delay", "time"): point.values["delay", "time"] - shift * period})
        squares = problem.block_squares(np.where(inside, after, np.nan).astype(np.float32))[problem.blocks.train]
        squares = problem.judged(squares)
        found.append(
            Lateness(
                name=name,
                value=size,
                interval=(interval[0] * scale, interval[1] * scale),
                late=period * late,
                point=point,
                squares=squares,
            )
        )
    return found


def fit_lateness(
    problem: Problem, lateness: Lateness, names: Sequence[str], joints: Mapping[str, BoolArray]
) -> tuple[Problem, Lateness, Fit]:
    """Fit the lateness of each target and all numbers in turn; return the problem with that lateness, too."""
    found: list[tuple[Problem, Lateness, Fit, float]] = []
    for _ in range(ROUNDS):
        problem = problem.changed(replay=problem.replay.with_late(lateness.late))
        fitted = fit(problem, lateness.point, names, joints, most=2)
        left = float(problem.mean_squares(fitted.residual, False).sum())
        if found and left > 0.99 * found[-1][3]:
            break
        found.append((problem, lateness, fitted, left))
        again = late_targets(problem, fitted, [lateness.name])
        if not again:
            break
        lateness = replace(again[0], squares=lateness.squares)
    problem, lateness, fitted, _ = found[-1]
    return problem, lateness, fitted


def _until_next(lost: FloatArray, gaps: FloatArray) -> FloatArray:
    """Return after how many periods each target acts (K,): one that is always lost gives way to the next."""
    wait = np.zeros(len(lost))
    for k in reversed(np.flatnonzero(lost > 0.5)):
        wait[k] = np.round(lost[k])
        if wait[k] >= gaps[k] and k + 1 < len(lost):
            wait[k] += wait[k + 1]
    return wait


def _responses(problem: Problem, fitted: Fit, near: bool) -> FloatArray | None:
    """Return what a period of lateness of every n-th target changes (n, T, C), whitened; None where it cannot be seen.

    With ``near`` a quarter of a period more than it has, times four; else a whole one.
    """
    replay, period = problem.replay, problem.replay.sending.period
    if len(replay.sent) < 10:
        return None
    offsets, share = int(np.ceil(FORGOTTEN / period)), 0.25 if near else 1.0
    if float(np.median(np.diff(replay.sent))) < LEAST_ROWS or offsets > MOST_OFFSETS:
        return None
    own = replay.late if near and replay.late is not None else np.zeros(len(replay.sent))
    lates = [own, *(own + share * period * (np.arange(len(own)) % offsets == k) for k in range(offsets))]
    points = stack([fitted.point] * len(lates), problem.machine)
    each = [replay.delayed(x) for x in lates]
    targets = Targets(held=np.stack([t.held for t in each]), begun=np.stack([t.begun for t in each]))
    made = replay.run(points, len(lates), targets)
    both = made.residual
    if problem.channels > problem.joints and made.torque_residual is not None:
        both = np.concatenate([both, made.torque_residual], -1)
    white = both / (problem.noise.astype(np.float32) * problem.log_scale)
    white[:, problem.blocks.index < 0] = 0.0
    white = np.nan_to_num(white)
    return (white[0] - white[1:]) / np.float32(share)


def _spans(problem: Problem, offsets: int) -> Iterator[tuple[slice, IntArray]]:
    """Yield the rows between two targets, and the targets that still act in them."""
    sent = np.append(problem.replay.sent, len(problem.replay.log.t))
    for k in range(1, len(sent) - 1):  # the first one has acted for long
        yield slice(int(sent[k]), int(sent[k + 1])), np.arange(max(k - offsets + 1, 1), k + 1)


def _normal(problem: Problem, responses: FloatArray, left: FloatArray, g: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return the normal equations of the lateness of all targets: upper bands (n, K), and right side (K,)."""
    n, count = len(responses), len(problem.replay.sent)
    bands, right, own = np.zeros((n, count)), np.zeros(count), responses[:, :, g].astype(np.float64)
    for rows, targets in _spans(problem, n):
        a = own[targets % n, rows].reshape(len(targets), -1)
        square = a @ a.T
        for i, k in enumerate(targets):
            bands[n - 1 - (k - targets[: i + 1]), k] += square[: i + 1, i]
        right[targets] += a @ left[rows][:, g].reshape(-1)
    return bands, right


def _applied(problem: Problem, responses: FloatArray, late: FloatArray, channels: BoolArray | slice) -> FloatArray:
    """Return what lateness (K,) in periods changes in some channels (T, c)."""
    own = responses[:, :, channels].astype(np.float64)
    out = np.zeros(own.shape[1:])
    for rows, targets in _spans(problem, len(responses)):
        out[rows] = np.tensordot(late[targets], own[targets % len(responses), rows], 1)
    return out


def _solved(normal: Sequence[tuple[FloatArray, FloatArray]]) -> _Estimate:
    """Return what some of the channels say of each target, with a prior of one period that is taken off again."""
    bands = np.sum([n[0] for n in normal], axis=0)
    right = np.sum([n[1] for n in normal], axis=0)
    bands[-1] += 1.0
    value, upper = linalg.solveh_banded(bands, right), np.asarray(linalg.cholesky_banded(bands))
    width, count = bands.shape
    variance, near = np.empty(count), np.zeros((0, 0))
    for j in range(count - 1, -1, -1):  # the inverse near its diagonal (Takahashi et al. 1973)
        most = min(width - 1, count - 1 - j)
        row = np.array([upper[width - 1 - i, j + i] for i in range(1, most + 1)]) / upper[-1, j]
        beside = -near[:most, :most] @ row
        variance[j] = 1.0 / upper[-1, j] ** 2 - row @ beside
        near = np.block([[variance[j : j + 1, None], beside[None]], [beside[:, None], near[:most, :most]]])
    variance = np.minimum(variance, 0.999)
    return _Estimate(value=value / (1.0 - variance), deviation=np.sqrt(variance / (1.0 - variance)))
