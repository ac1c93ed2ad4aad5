"""Single targets that came late or never: what each loss would do, and which targets the log says were late.

A replay in which one target in so many comes a period late shows what the loss of each of these does: a response that
is over before the next one begins. Replays with every offset give the responses of all targets, and the residual is a
sum of them, each times the lateness of its target. All joints take their targets from one message, so the lateness that
the other chains show predicts what is left of a chain: that is evidence from readings which nothing was fitted to.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from mimic.records import BoolArray, FloatArray, IntArray
from mimic.sysid.least_squares import Fit, prior
from mimic.sysid.replay import Targets
from mimic.sysid.residuals import Point, Problem, stack
from mimic.sysid.result import RULES

CERTAIN = 0.25
"""Standard deviation of a lateness, in periods, up to which it says something of its own."""

LEAST_CORRELATION_OF_DRIFT = 0.5
"""Correlation of the lateness of neighbouring targets from which on it is no jitter: something slow."""

LEAST_ACTING = 0.1
"""Share of a period for which a target must act to be seen."""

WIDEST = 5.0
"""Most periods by which targets are taken to be late."""

BLURS = (0.0, 0.05, 0.1, 0.2, 0.3, 0.5)
"""Standard deviations in periods that a linear model may be wrong by about the lateness of a target."""

STRAY = 0.05
"""Share of targets whose lateness may be anything: what several losses in a row do is not the sum of what each does."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Lateness:
    """Of each target, in its periods (K,): estimate of the log alone, and its standard deviation."""

    value: FloatArray
    deviation: FloatArray


def usual_delay(x: Lateness) -> float:
    """Return the lateness that most targets have: the delay that they share."""
    known = x.deviation < CERTAIN
    return float(np.median(x.value[known])) if known.any() else 0.0


def lost(x: Lateness, gaps: FloatArray) -> tuple[float, tuple[float, float], FloatArray]:
    """Return the share of lost targets, its interval, and the delay of each target (K,) [periods].

    One that is sent again until another follows (K,) may be lost each time.
    """
    known = x.deviation < CERTAIN
    usual = usual_delay(x)
    value, variance = x.value - usual, x.deviation**2
    share = 0.02
    gone = np.zeros(len(value))
    for _ in range(20):
        odds = np.log(share / (1 - share)) + (value**2 - (value - 1.0) ** 2) / (2 * variance)
        gone = 1.0 / (1.0 + np.exp(-np.clip(odds, -50, 50)))
        if not known.any():
            break
        share = float(np.clip(gone[known].mean(), 1e-4, 0.9))
    count = int(known.sum())
    lost = int((gone[known] > 0.5).sum())
    if count < 20 or lost < 3:
        return 0.0, (0.0, 0.0), np.zeros(len(value))
    share = lost / count
    z = 1.96
    centre = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z * np.sqrt(share * (1 - share) / count + z * z / (4 * count**2)) / (1 + z * z / count)
    times = np.clip(np.round(value), 1.0, gaps)
    return share, (centre - half, centre + half), np.where(gone > 0.5, times, 0.0) + usual


def jittered(x: Lateness, gaps: FloatArray) -> tuple[float, tuple[float, float], FloatArray]:
    """Return the width of uniform jitter, its interval, and the expected delay of each target (K,) [periods]."""
    known = x.deviation < CERTAIN
    count = int(known.sum())
    if count < 20:
        return 0.0, (0.0, 0.0), np.zeros(len(x.value))
    usual = float(np.mean(x.value[known]))
    value = x.value - usual
    weight = 1.0 / (x.deviation[known] ** 2 + 0.05**2) ** 2
    squared = value[known] ** 2 - x.deviation[known] ** 2
    variance = float(np.sum(weight * squared) / weight.sum())
    if variance <= 0.0:
        return 0.0, (0.0, 0.0), np.zeros(len(value))
    both = known[1:] & known[:-1]
    if both.any() and np.mean(value[1:][both] * value[:-1][both]) > LEAST_CORRELATION_OF_DRIFT * variance:
        return 0.0, (0.0, 0.0), np.zeros(len(value))
    error = np.sqrt(np.sum((weight * (squared - variance)) ** 2)) / weight.sum()
    low, width, high = (width_of(max(variance + s * 1.96 * error, 0.0)) for s in (-1.0, 0.0, 1.0))
    expected = value * variance / (variance + x.deviation**2) + usual
    return width, (low, high), expected


def until_next(lost: FloatArray, gaps: FloatArray) -> FloatArray:
    """Return after how many periods each target acts (K,); 0 where it is not lost.

    Args:
        lost: How often each is lost (K,).
        gaps: How often it is sent before the next one is (K,), which takes its place if it is lost each time.
    """
    wait = np.zeros(len(lost))
    for k in reversed(np.flatnonzero(lost > 0.5)):
        wait[k] = np.round(lost[k])
        if wait[k] >= gaps[k] and k + 1 < len(lost):
            wait[k] += wait[k + 1]
    return wait


def likelihood(x: Lateness, places: FloatArray, value: float, jitter: bool) -> float:
    """Return the logarithm of the probability of the lateness of targets, in periods, under a law.

    Args:
        x: What is known of each target.
        places: Latenesses that the law has: equally likely ones of jitter, or none and a whole period.
        value: Width of jitter, or share of the lost.
        jitter: Which of the two.
    """
    known = x.deviation < CERTAIN
    v, deviation = x.value[known], x.deviation[known]
    if jitter:
        places = np.quantile(places, (np.arange(64) + 0.5) / 64)
        weights, centre = np.full(64, 1 / 64), float(np.mean(v) - np.mean(places))
    else:
        weights, centre = np.array([1.0 - value, value]), float(np.median(v))
    away = v[:, None] - centre - places
    found = []
    for blur in BLURS:
        s = np.hypot(deviation, blur)[:, None]
        density = (weights * np.exp(-0.5 * (away / s) ** 2) / s).sum(1) / np.sqrt(2 * np.pi)
        found.append(float(np.sum(np.log((1.0 - STRAY) * density + STRAY / WIDEST))))
    return max(found)


def in_order(width: float) -> FloatArray:
    """Return latenesses, in periods, of targets that are late by a uniform time and wait for those before them.

    Of those that the next leaves some time to act: the others are not seen.
    """
    drawn = np.random.default_rng(0).uniform(0.0, width, 4000)
    sent = np.arange(4000.0)
    arrival = np.maximum.accumulate(sent + drawn)
    return (arrival - sent)[np.append(np.diff(arrival), np.inf) > LEAST_ACTING]


def spread_of_means(low: float, high: float) -> float:
    """Return half the difference of the mean delays of two widths of jitter."""
    return float(np.mean(in_order(high)) - np.mean(in_order(low))) / 2


def width_of(variance: float) -> float:
    """Return the width of a uniform lateness of which, in order, this variance is left."""
    if variance <= 1.0 / 12.0:
        return float(np.sqrt(12.0 * variance))
    low, high = 1.0, WIDEST
    for _ in range(20):
        middle = (low + high) / 2
        low, high = (middle, high) if in_order(middle).var() < variance else (low, middle)
    return (low + high) / 2


MODELS = {"lost_commands": ("share", lost), "delay_jitter": ("spread", jittered)}
"""Parameter of each effect, and what finds it from the lateness of the targets."""


FORGOTTEN = 0.5
"""Time after which a joint under a servo no longer knows that a target was late [s]."""

MOST_OFFSETS = 64
"""Targets that come faster than this many in that time are not told from each other."""

LEAST_ROWS = 3
"""Readings for each target below which its own time is not seen."""

DERIVATIVE_STEP = 0.25
"""Periods of lateness by which derivatives are taken."""

STEP_SHARES = (1.0, 0.6, 0.3, 0.1, 0.0)
"""Parts of a step that are replayed."""

FOLLOWING = 0.25
"""Time after a target in which it is seen whether a part of the step suits it [s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Timing:
    """A law of the lateness of single targets."""

    name: str
    """Effect of the catalogue."""
    value: float
    """Of its parameter."""
    interval: tuple[float, float]
    """95 % interval of the value."""
    late: FloatArray
    """How much later than the point's delay each target acts, as all chains show it (K,) [s]."""
    point: Point
    """With the effect, and the delay that goes with ``late``."""
    unsure: float
    """Half of the 95 % interval of the delay that follows from the interval of the value [s]."""
    agreement: float
    """Share of what single chains show of the lateness of single targets that the others show too; 1 where all is true.
    """
    squares: FloatArray
    """Sum of squares of each fitted block and channel that a linear model leaves with the lateness that the other
    chains show (B_train, C).
    """
    likelihood: float
    """Logarithm of the probability of the lateness of all targets under the law."""


def timings(problem: Problem, incumbent: Fit, names: Sequence[str] = ("lost_commands", "delay_jitter")) -> list[Timing]:
    """Return models of lost and jittering targets that a residual supports; empty if it shows none.

    Lateness that the replay already has is found again, from the derivatives there where it is no loss.
    """
    groups = _groups(problem)
    near = problem.replay.late is not None and "lost_commands" not in names
    responses = _responses(problem, incumbent, near) if len(groups) > 1 else None
    if responses is None:
        return []
    period, usual, gaps = _period(problem), _usual_late(problem), _gaps(problem)
    inside = problem.blocks.index[:, None] >= 0
    left = np.where(inside, np.nan_to_num(incumbent.residual), 0.0).astype(np.float64)
    had = problem.replay.late
    if had is not None:
        own = (had - usual) / period
        own = own if near else np.minimum(own, gaps)  # of losses in a row each is one
        left += _applied(problem, responses, own, np.ones(problem.channels, dtype=bool))
    normal = [_normal(problem, responses, left, channels) for channels in groups]
    weights = _weights(problem, responses, left, groups, normal)
    normal = [(bands * w, right * w) for (bands, right), w in zip(normal, weights, strict=True)]
    whole = _lateness(normal)
    seen = [_lateness([n for i, n in enumerate(normal) if i != g]) for g in range(len(groups))]
    agreement = _agreement(normal, seen)
    found = []
    for name in names:
        parameter, law = MODELS[name]
        value, interval, late = law(whole, gaps)
        if not value > 0.0:
            continue
        after = left.copy()
        for channels, lateness in zip(groups, seen, strict=True):
            after[:, channels] -= _applied(problem, responses, law(lateness, gaps)[2], channels)
        jitter = name == "delay_jitter"
        size = value * period if jitter else value
        shift = float(np.mean(in_order(value)) - np.mean(late)) if jitter else -float(np.median(late))
        point = incumbent.point.with_effect(name, problem.machine, {parameter: size})
        if ("delay", "time") in point.values:
            values = dict(point.values)
            values["delay", "time"] = values["delay", "time"] + usual - shift * period
            point = Point(values)
        residual = np.where(inside, after, np.nan).astype(np.float32)
        found.append(
            Timing(
                name=name,
                value=size,
                interval=(interval[0] * period, interval[1] * period) if jitter else interval,
                late=period * (np.clip(late + shift, 0.0, interval[1]) if jitter else until_next(late + shift, gaps)),
                point=point,
                unsure=period * spread_of_means(*interval) if jitter else 0.0,
                agreement=agreement,
                squares=problem.block_squares(residual)[problem.blocks.train],
                likelihood=likelihood(whole, in_order(value) if jitter else np.array([0.0, 1.0]), value, jitter),
            )
        )
    return found


def widening(problem: Problem, fitted: Fit, variance: float) -> FloatArray:
    """Return the factor by which unknown delays widen the uncertainty of each parameter (P,).

    Args:
        problem: Log and model; the replay has the targets late.
        fitted: The fit.
        variance: Of the lateness of single targets [s^2].
    """
    count = len(fitted.free_parameters)
    responses = _responses(problem, fitted, True)
    if responses is None or not count:
        return np.ones(count)
    everywhere = np.ones(problem.channels, dtype=bool)
    columns = np.where(problem.blocks.index[:, None] >= 0, np.nan_to_num(np.stack(fitted.columns)), 0.0)
    bands, _ = _normal(problem, responses, columns[0].astype(np.float64), everywhere)
    bands[-1] += _period(problem) ** 2 / max(variance, 1e-12)
    shared = np.zeros((count, bands.shape[1]))
    for rows, targets, of in _spans(problem, len(responses)):
        a = responses[of, rows].astype(np.float64).reshape(len(targets), -1)
        shared[:, targets] += columns[:, rows].reshape(count, -1) @ a.T
    flat = columns.reshape(count, -1).astype(np.float64)
    known = flat @ flat.T + np.diag(prior(fitted.free_parameters))
    unknown = known - shared @ linalg.solveh_banded(bands, shared.T)
    scale = 1.0 / np.sqrt(np.diag(known))
    ones = [np.diag(np.linalg.pinv(h * scale[:, None] * scale, 1e-10)) for h in (known, unknown)]
    return np.sqrt(np.maximum(ones[1] / np.maximum(ones[0], 1e-12), 1.0))


def _agreement(normal: Sequence[tuple[FloatArray, FloatArray]], others: Sequence[Lateness]) -> float:
    """Return the covariance of what each group shows with what the others show, over the variance of its own.

    How much of that variance is noise is not sure, since what a linear model leaves counts as noise: it is all the
    deviations say or less, and the answer is the one nearest to 1 that this allows.
    """
    products, own, all_of_it = [], 0.0, 0.0
    for one, rest in zip(normal, others, strict=True):
        mine = _lateness([one])
        both = (mine.deviation < CERTAIN) & (rest.deviation < CERTAIN)
        if both.sum() < 10:
            continue
        a, b = mine.value[both] - np.mean(mine.value[both]), rest.value[both] - np.mean(rest.value[both])
        products.append(a * b)
        own += float(np.sum(a * a - mine.deviation[both] ** 2))
        all_of_it += float(np.sum(a * a))
    product = np.concatenate(products) if products else np.zeros(1)
    shared = float(product.sum())
    if shared <= RULES.z * np.sqrt(np.sum(product**2)):
        return 0.0
    return float(np.clip(1.0, shared / all_of_it, shared / own if own > 0.0 else np.inf))


def _usual_late(problem: Problem) -> float:
    """Return the lateness that targets of the replay have in the middle [s]."""
    return 0.0 if problem.replay.late is None else float(np.median(problem.replay.late))


def _weights(
    problem: Problem,
    responses: FloatArray,
    left: FloatArray,
    groups: Sequence[BoolArray],
    normal: Sequence[tuple[FloatArray, FloatArray]],
) -> FloatArray:
    """Return the weight of each group: one over the mean square left, at most 1."""
    weights = np.ones(len(groups))
    rows = problem.blocks.index >= 0
    for _ in range(3):
        lateness = _lateness([(bands * w, right * w) for (bands, right), w in zip(normal, weights, strict=True)])
        rest = [left[:, g] - _applied(problem, responses, lateness.value, g) for g in groups]
        weights = np.array([1.0 / max(float(np.mean(r[rows] ** 2)), 1.0) for r in rest])
    return weights


def _period(problem: Problem) -> float:
    """Time between targets [s]."""
    return problem.replay.sending.period


def _gaps(problem: Problem) -> FloatArray:
    """Return after how many periods the next other target follows each (K,): until then it is sent again in each."""
    between = np.diff(problem.replay.sending.at) / _period(problem)
    return np.append(np.maximum(np.round(between), 1.0), 1.0)


def _groups(problem: Problem) -> list[BoolArray]:
    """Channels (C,) of each part that is judged by the others: chains, or joints where there is one chain."""
    of = problem.channel_chain if len(np.unique(problem.channel_chain)) > 1 else problem.channel_joint
    return [of == part for part in np.unique(of)]


def _responses(problem: Problem, incumbent: Fit, near: bool) -> FloatArray | None:
    """Return what a period of lateness of every n-th target changes (n, T, C), whitened; None where it cannot be seen.

    With ``near`` a quarter of a period more than it has, times four; else a whole one more than most targets have.
    """
    replay = problem.replay
    if len(replay.sent) < 10:
        return None
    rows = float(np.median(np.diff(replay.sent)))
    offsets = int(np.ceil(FORGOTTEN / _period(problem)))
    if rows < LEAST_ROWS or offsets > MOST_OFFSETS:
        return None
    own = replay.late if near and replay.late is not None else np.full(len(replay.sent), _usual_late(problem))
    share = DERIVATIVE_STEP if near else 1.0
    lates = [own]
    for offset in range(offsets):
        late = own.copy()
        late[offset::offsets] += share * _period(problem)
        lates.append(late)
    replayed = with_lateness(problem, incumbent.point, lates)
    return (replayed[0] - replayed[1:]) / np.float32(share)


def _spans(problem: Problem, offsets: int) -> Iterator[tuple[slice, IntArray, IntArray]]:
    """Yield the rows between two targets, the targets that still act in them, and their offsets."""
    sent = np.append(problem.replay.sent, len(problem.replay.log.t))
    for k in range(len(sent) - 1):
        targets = np.arange(max(k - offsets + 1, 1), k + 1)  # the first one has acted for long
        if len(targets):
            yield slice(int(sent[k]), int(sent[k + 1])), targets, targets % offsets


def _normal(
    problem: Problem, responses: FloatArray, left: FloatArray, channels: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Return the normal equations of the lateness of all targets: upper bands (n, K), and right side (K,)."""
    offsets, count = len(responses), len(problem.replay.sent)
    bands, right = np.zeros((offsets, count)), np.zeros(count)
    own = responses[:, :, channels].astype(np.float64)
    for rows, targets, of in _spans(problem, offsets):
        a = own[of, rows].reshape(len(targets), -1)
        square = a @ a.T
        for i, k in enumerate(targets):
            bands[offsets - 1 - (k - targets[: i + 1]), k] += square[: i + 1, i]
        right[targets] += a @ left[rows][:, channels].reshape(-1)
    return bands, right


def _lateness(normal: Sequence[tuple[FloatArray, FloatArray]]) -> Lateness:
    """Return what some of the channels say of each target."""
    bands, right = sum(n[0] for n in normal), sum(n[1] for n in normal)
    bands, right = np.asarray(bands), np.asarray(right)
    weight = 1.0  # a prior of one period, taken off again
    bands = bands.copy()
    bands[-1] += weight
    value = linalg.solveh_banded(bands, right)
    variance = np.minimum(_diagonal(bands), 0.999 / weight)
    data = 1.0 - weight * variance
    return Lateness(value=value / data, deviation=np.sqrt(variance / data))


def _diagonal(bands: FloatArray) -> FloatArray:
    """Return the diagonal of the inverse of a banded matrix."""
    factor = linalg.cholesky_banded(bands)
    count, width = bands.shape[1], bands.shape[0]
    found = np.empty(count)
    step = 512
    for begin in range(0, count, step):  # what is far from a column hardly matters
        near = slice(max(begin - 4 * width, 0), min(begin + step + 4 * width, count))
        size = near.stop - near.start
        right = np.zeros((size, min(step, count - begin)))
        right[np.arange(right.shape[1]) + begin - near.start, np.arange(right.shape[1])] = 1.0
        part = linalg.cho_solve_banded((_cut(factor, near), False), right)
        found[begin : begin + right.shape[1]] = part[
            np.arange(right.shape[1]) + begin - near.start, np.arange(right.shape[1])
        ]
    return found


def _cut(factor: FloatArray, near: slice) -> FloatArray:
    """Return the factor of the rows and columns of a range."""
    part = factor[:, near].copy()
    width = len(factor)
    for band in range(width - 1):
        part[band, : width - 1 - band] = 0.0
    return part


def _applied(problem: Problem, responses: FloatArray, late: FloatArray, channels: BoolArray) -> FloatArray:
    """Return what lateness (K,) in periods changes in some channels (T, c)."""
    out = np.zeros((responses.shape[1], int(channels.sum())))
    own = responses[:, :, channels].astype(np.float64)
    for rows, targets, of in _spans(problem, len(responses)):
        out[rows] = np.tensordot(late[targets], own[of, rows], 1)
    return out


def with_lateness(problem: Problem, point: Point, lates: Sequence[FloatArray]) -> FloatArray:
    """Return whitened residuals (N, T, C), 0 where masked, with each target delayed (K,) [s] in each replay."""
    replay, joints = problem.replay, problem.joints
    made = replay.run(
        stack([point] * len(lates), problem.machine), len(lates), Targets.stacked([replay.delayed(x) for x in lates])
    )
    parts = [made.residual]
    if made.torque_residual is not None and problem.channels > joints:
        parts.append(made.torque_residual)
    whitened = np.concatenate(parts, -1) / (problem.noise.astype(np.float32) * problem.log_scale)
    if problem.correction is not None:
        whitened += problem.correction
    whitened[:, problem.blocks.index < 0] = 0.0
    return np.nan_to_num(whitened)


def eased(problem: Problem, point: Point, had: FloatArray, late: FloatArray) -> FloatArray:
    """Return delays (K,) [s] between two sets, each target taking the share that suits the readings after it.

    Args:
        problem: Log and model.
        point: Its delay is that of both.
        had: Lateness before a step.
        late: After it.
    """
    lates = [had + share * (late - had) for share in STEP_SHARES]
    residual = with_lateness(problem, point, lates)
    squares = np.cumsum((residual.astype(np.float64) ** 2).sum(-1), axis=1)
    replay = problem.replay
    ends = np.searchsorted(replay.log.t, replay.log.t[replay.sent] + FOLLOWING) - 1
    choice = np.argmin(squares[:, ends] - squares[:, replay.sent], axis=0)
    mixed = np.stack(lates)[choice, np.arange(len(late))]
    mixed_squares = float((with_lateness(problem, point, [mixed]).astype(np.float64) ** 2).sum())
    best = int(np.argmin(squares[:, -1]))
    return mixed if mixed_squares < squares[best, -1] else lates[best]
