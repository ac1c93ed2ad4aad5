"""Values that explain the log: Levenberg and Marquardt's steps on batched replays, and how sure they are."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from mimic.records import BoolArray, FloatArray, IntArray
from mimic.sysid.fit.problem import FreeParameter, Key, Point, Problem
from mimic.sysid.log.pool import Sums
from mimic.sysid.result import RULES, Correlations

DAMPINGS = (0.0, 0.3, 10.0)
"""Values of Levenberg's parameter that are tried side by side."""

LARGEST, SMALLEST = float(np.finfo(np.float32).max), np.finfo(float).tiny
"""Stands for the sum of squares of a replay that blew up, and for what must not be zero."""

MOST_DOUBTFUL = 6
"""Most blocks of a fit for which that is replayed, those that grow most; the others keep what the linear model says."""

MOST_STEPS = 30
"""Most steps of a fit; five left a joint of a hidden machine at 1.7 noise floors that ends at 1, ten a limit at 4.

A fit has converged when the error would fall by less than ``RULES.gain`` in so many steps as the last one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """A point that was fitted, with what is known about it."""

    point: Point
    free_parameters: tuple[FreeParameter, ...]
    residual: FloatArray
    """Whitened residuals (T, C)."""
    columns: tuple[FloatArray, ...]
    """Derivatives of the predictions, whitened (T, C) each."""
    sums: Sums


def prior(free_parameters: Sequence[FreeParameter]) -> FloatArray:
    """Return the weight of each free parameter's prior (P,)."""
    return np.array([1.0 / k.spread**2 for k in free_parameters])


def solve(
    sums: Sums, blocks: IntArray, free_parameters: Sequence[FreeParameter], at: FloatArray, damping: float
) -> FloatArray:
    """Return a damped step toward the best weighed sum of squares over some blocks, and priors, inside the bounds.

    free parameters that would leave their bounds stop there, and the rest solve again.
    """
    hessian, gradient = sums.weighed_over(blocks)
    low, high = (np.array([k.bounds[i] for k in free_parameters]) for i in (0, 1))
    weight = prior(free_parameters) * sums.weight
    gradient = gradient - weight * (at - np.array([k.centre for k in free_parameters]))
    inside_bounds = np.ones(len(free_parameters), dtype=bool)
    step = np.zeros(len(free_parameters))
    scale = np.diag(hessian) * damping + weight
    for _ in range(4):
        if not inside_bounds.any():
            break
        index = np.flatnonzero(inside_bounds)
        h = hessian[np.ix_(index, index)] + np.diag(scale[index])
        g = gradient[index] - hessian[np.ix_(index, np.flatnonzero(~inside_bounds))] @ step[~inside_bounds]
        step[index] = scaled_solution(h, g, 1e-12)
        out = inside_bounds & ((at + step < low) | (at + step > high))
        if not out.any():
            break
        step[out] = np.clip(at[out] + step[out], low[out], high[out]) - at[out]
        inside_bounds &= ~out
    return np.clip(at + step, low, high) - at


def scaled_solution(hessian: FloatArray, gradient: FloatArray, rcond: float) -> FloatArray:
    """Return the solution of normal equations whose unknowns have units of their own, scaled to a diagonal of ones."""
    d = 1.0 / np.sqrt(np.maximum(np.diag(hessian), SMALLEST))
    return d * np.linalg.lstsq(hessian * d[:, None] * d[None], gradient * d, rcond=rcond)[0]


Asking: TypeAlias = Generator[Sequence[Point], FloatArray, "Fit"]
"""Yields points, is sent their whitened residuals (N, T, C) as coarse steps have them, returns the fit."""


def fit(
    problem: Problem, start: Point, names: Sequence[str], joints: Mapping[str, BoolArray], *, most: int, **how: Any
) -> Fit:
    """Fit the numbers of the named effects by themselves; see `fitting`."""
    return fit_all(problem, [fitting(problem, start, names, joints, most=most, **how)])[0]


def fit_all(problem: Problem, fits: Sequence[Asking]) -> list[Fit]:
    """Return what several fits end with, each sent the uncorrected residuals (N, T, C) of the points it asks for.

    They share their replays: what all ask for next runs as one batch.
    """
    asked: dict[int, Sequence[Point]] = {}
    done: dict[int, Fit] = {}

    def ask(i: int, answer: FloatArray | None) -> None:
        try:
            asked[i] = next(fits[i]) if answer is None else fits[i].send(answer)
        except StopIteration as end:
            done[i] = end.value
            asked.pop(i, None)

    for i in range(len(fits)):
        ask(i, None)
    while asked:
        order = sorted(asked)
        answers, at = problem.uncorrected([p for i in order for p in asked[i]]), 0
        for i in order:
            count = len(asked[i])
            ask(i, answers[at : at + count])
            at += count
    return [done[i] for i in range(len(fits))]


def fitting(
    problem: Problem,
    start: Point,
    names: Sequence[str],
    joints: Mapping[str, BoolArray],
    *,
    most: int,
    frozen: Fit | None = None,
    every: int = 2,
) -> Asking:
    """Ask for the replays of a fit of the named effects, step by step; see `fit_all`.

    Args:
        problem: Log and model.
        start: Where to begin; has the effects.
        names: Effects that are fitted.
        joints: Which joints have an effect.
        most: Most iterations.
        frozen: Begin with this fit's derivatives for the free parameters it has.
        every: After how many steps, and at the end, all derivatives are found anew; 0 for never. In between each step
            corrects them along its way (`_by_secant`).
    """
    free_parameters = problem.free_parameters(start, joints, names)
    point = start
    residual = problem.corrected((yield [point])[0])
    best = chain_costs(problem, point, residual, free_parameters)
    columns: dict[tuple[Key, int], FloatArray] = {}
    if frozen is not None:
        columns = {(k.key, k.joint): c for k, c in zip(frozen.free_parameters, frozen.columns, strict=True)}
    stacked: list[FloatArray] = []
    stale, harder = frozen is not None, 1.0
    for i in range(most):
        anew = bool(every and i and i % every == 0)
        if fresh := [k for k in free_parameters if anew or (k.key, k.joint) not in columns]:
            points, groups, sizes = problem.difference_points(point, fresh)
            made = problem.columns(residual, problem.corrected((yield points)), groups, fresh, sizes)
            columns |= {(k.key, k.joint): c for k, c in zip(fresh, made, strict=True)}
            stale = stale and not anew
        stacked = [columns[k.key, k.joint] for k in free_parameters]
        sums = problem.sums(residual, stacked, free_parameters)
        at, before = point.read(free_parameters), best
        tried = [solve(sums, problem.blocks.train, free_parameters, at, harder * damping) for damping in DAMPINGS]
        trials = [point.moved(free_parameters, step) for step in tried]
        steps, replayed = [np.zeros(len(free_parameters)), *tried], [residual, *problem.corrected((yield trials))]
        costs = [best]
        costs += [chain_costs(problem, p, r, free_parameters) for p, r in zip(trials, replayed[1:], strict=True)]
        mixed = best_of_chains(problem, free_parameters, steps, costs)
        if mixed is not None:  # no one step suits all chains
            trial = point.moved(free_parameters, mixed)
            steps.append(mixed)
            replayed.append(problem.corrected((yield [trial])[0]))
            costs.append(chain_costs(problem, trial, replayed[-1], free_parameters))
        winner = int(np.argmin([problem.weight @ cost for cost in costs]))
        if winner and i + 1 < most:
            stacked = _by_secant(problem, free_parameters, stacked, steps[winner], residual - replayed[winner])
            columns = {(k.key, k.joint): c for k, c in zip(free_parameters, stacked, strict=True)}
        point, residual, best = point.moved(free_parameters, steps[winner]), replayed[winner], costs[winner]
        stale = stale or winner > 0
        gain = 1 - best / before if winner else _promised(sums, problem, tried[-1]) / (problem.weight @ best)
        if (gain < 2 * RULES.gain / MOST_STEPS).all():
            break
        harder = max(harder / DAMPINGS[-1], 1.0) if winner else harder * DAMPINGS[-1]
    if every and free_parameters and stale:
        points, groups, sizes = problem.difference_points(point, free_parameters)
        stacked = problem.columns(residual, problem.corrected((yield points)), groups, free_parameters, sizes)
    sums = problem.sums(residual, stacked, free_parameters)
    return Fit(
        point=point, free_parameters=tuple(free_parameters), residual=residual, columns=tuple(stacked), sums=sums
    )


def _promised(sums: Sums, problem: Problem, step: FloatArray) -> float:
    """Return by how much a step (P,) lowers the sum of squares of a linear model."""
    hessian, gradient = sums.weighed_over(problem.blocks.train)
    return float((2 * gradient - hessian @ step) @ step)


def stepping(
    problem: Problem, start: Point, names: Sequence[str], joints: Mapping[str, BoolArray], known: Fit
) -> Asking:
    """Ask for the derivatives that a fit lacks at a start; return one linear step of all numbers, which none replays.

    Args:
        problem: Log and model.
        start: Where to begin; has the effects.
        names: Effects that are fitted.
        joints: Which joints have an effect.
        known: Its derivatives are used for the free parameters that it has.
    """
    free = problem.free_parameters(start, joints, names)
    columns = {(k.key, k.joint): c for k, c in zip(known.free_parameters, known.columns, strict=True)}
    fresh = [k for k in free if (k.key, k.joint) not in columns]
    points, groups, sizes = problem.difference_points(start, fresh)
    residual, *moved = problem.corrected((yield [start, *points]))
    made = problem.columns(residual, np.array(moved), groups, fresh, sizes) if moved else []
    columns |= {(k.key, k.joint): c for k, c in zip(fresh, made, strict=True)}
    stacked = tuple(columns[k.key, k.joint] for k in free)
    sums, at = problem.sums(residual, stacked, free), start.read(free)
    tried = [solve(sums, problem.blocks.train, free, at, damping) for damping in DAMPINGS]
    step = max(tried, key=lambda one: _promised(sums, problem, one))
    left = residual - sum(np.float32(size) * column for size, column in zip(step, stacked, strict=True))
    return Fit(
        point=start.moved(free, step),
        free_parameters=tuple(free),
        residual=left,
        columns=stacked,
        sums=problem.sums(left, stacked, free),
    )


def _by_secant(
    problem: Problem,
    free_parameters: Sequence[FreeParameter],
    columns: Sequence[FloatArray],
    step: FloatArray,
    change: FloatArray,
) -> list[FloatArray]:
    """Return derivatives (T, C) with which a step (P,) gives the change of the prediction (T, C) that it made.

    Source: Broyden 1965, for each chain, numbers in steps that matter.
    """
    size = np.array([k.step for k in free_parameters])
    of = np.array([-1 if k.joint < 0 else problem.machine.chain[k.joint] for k in free_parameters])
    corrected = [column.copy() for column in columns]
    for chain in np.unique(problem.channel_chain):
        mine = problem.channel_chain == chain
        index = np.flatnonzero(((of == chain) | (of < 0)) & (step != 0.0))
        length = float(np.sum((step[index] / size[index]) ** 2))
        missing = change[:, mine] - sum(np.float32(step[i]) * columns[i][:, mine] for i in index.tolist())
        if not len(index) or not np.isfinite(missing[problem.blocks.index >= 0]).all():
            continue
        for i in index.tolist():
            corrected[i][:, mine] += missing * np.float32(step[i] / size[i] ** 2 / length)
    return corrected


def chain_costs(
    problem: Problem, point: Point, residual: FloatArray, free_parameters: Sequence[FreeParameter]
) -> FloatArray:
    """Return the cost that a fit minimises, for each chain (K,): squares and priors."""
    cost = np.zeros(int(problem.machine.chain.max()) + 1)
    np.add.at(cost, problem.channel_chain, problem.block_squares(residual)[problem.blocks.train].sum(0))
    chains = [0 if k.joint < 0 else int(problem.machine.chain[k.joint]) for k in free_parameters]
    away = point.read(free_parameters) - np.array([k.centre for k in free_parameters])
    np.add.at(cost, np.array(chains, dtype=int), prior(free_parameters) * away**2)
    return np.minimum(cost, LARGEST)


def best_of_chains(
    problem: Problem, free_parameters: Sequence[FreeParameter], steps: Sequence[FloatArray], costs: Sequence[FloatArray]
) -> FloatArray | None:
    """Return the step (P,) that takes for each chain the one of steps (P,) with the least of costs (K,).

    Numbers of the whole machine go with the step that is best in all. None where one step is best for every chain.
    """
    choice, overall = np.argmin(costs, axis=0), int(np.argmin([problem.weight @ cost for cost in costs]))
    if (choice == choice[0]).all():
        return None
    of = [overall if k.joint < 0 else int(choice[problem.machine.chain[k.joint]]) for k in free_parameters]
    return np.stack(steps)[of, np.arange(len(free_parameters))]


Judged = tuple[FloatArray, FloatArray]
"""Squares of each channel of each fitted block under a fit without it (B_train, C), and how the fit moves (B_train, P).
"""


def left_out(fitted: Fit, problem: Problem) -> Judged:
    """Return the squares of each fitted block under a fit without that block, and how the fit moves.

    Infinitesimal jackknife: r_b(-b) = r_b + J_b (H - J_b'J_b)^-1 J_b'r_b, exact for linear models; H holds the priors.
    Where that changes a block much, the linear model is not believed, and the fit without the block is replayed. A
    block in which a drive is switched has none: a joint that is let go moves as in no other, so that it says nothing.
    """
    return left_out_all([fitted], problem)[0]


def left_out_all(fits: Sequence[Fit], problem: Problem, replays: bool = True) -> list[Judged]:
    """Return `left_out` of several fits, which share their replays; without replays, what a linear model says or less.

    A block is then not worse than what would ask for a replay.
    """
    found = [_by_linear_model(one, problem) for one in fits]
    if not replays:
        own = [np.minimum(problem.block_squares(f.residual)[problem.blocks.train], LARGEST) for f in fits]
        return [(np.minimum(s, RULES.doubtful * o), moves) for (s, moves), o in zip(found, own, strict=True)]
    asked = [_trials(one, problem, made) for one, made in zip(fits, found, strict=True)]
    batches: list[list[int]] = [[]]
    for i, (_, points) in enumerate(asked):
        if points:
            batches[-1].append(i)
            if sum(len(asked[k][1]) for k in batches[-1]) >= problem.replay.sets_per_batch:
                batches.append([])
    for batch in filter(None, batches):
        replayed, at = problem.residuals([p for k in batch for p in asked[k][1]]), 0
        for k in batch:
            doubt, points = asked[k]
            found[k] = _by_replays(fits[k], problem, found[k], doubt, points, replayed[at : at + len(points)])
            at += len(points)
    return found


def _by_linear_model(fitted: Fit, problem: Problem) -> Judged:
    train, s = problem.blocks.train, fitted.sums
    squares = problem.block_squares(fitted.residual)[train]
    if not fitted.free_parameters:
        return problem.judged(squares), np.zeros((len(train), 0))
    total = s.weighed_over(train)[0] + np.diag(prior(fitted.free_parameters) * s.weight)
    low_high = np.array([k.bounds for k in fitted.free_parameters]).reshape(-1, 2)
    at = fitted.point.read(fitted.free_parameters)
    inside_bounds = (at > low_high[:, 0]) & (at < low_high[:, 1])
    index = np.flatnonzero(inside_bounds)
    moves = np.zeros((len(train), len(at)))
    stacked = np.stack([fitted.columns[i] for i in index]) if len(index) else None
    for row, b in enumerate(train):
        if stacked is None:
            break
        rest = (total - s.weighed[0][b])[np.ix_(index, index)]
        change = scaled_solution(rest, s.weighed[1][b][index], 1e-10)
        moves[row, index] = -change
        inside = np.flatnonzero(problem.blocks.index == b)
        residual = fitted.residual[inside] + np.tensordot(change.astype(np.float32), stacked[:, inside], 1)
        squares[row] = np.nan_to_num(np.sum(residual.astype(np.float64) ** 2, axis=0), nan=np.inf)
    return np.minimum(problem.judged(squares), LARGEST), moves


def _trials(fitted: Fit, problem: Problem, made: Judged) -> tuple[BoolArray, list[Point]]:
    """Return the blocks and chains (B_train, K) that a linear model fails for, and the points to be replayed: the fit,
    and its move without each of these blocks.
    """
    own = problem.channel_chain[:, None] == np.arange(int(problem.machine.chain.max()) + 1)
    inside = np.minimum(problem.block_squares(fitted.residual)[problem.blocks.train], LARGEST)
    growth = (made[0] @ own) / np.maximum(inside @ own, SMALLEST)
    doubt = growth > RULES.doubtful
    doubt[np.argsort(-growth.max(1))[MOST_DOUBTFUL:]] = False
    rows = np.flatnonzero(doubt.any(1))
    moves = made[1][rows]
    return doubt, [fitted.point, *(fitted.point.moved(fitted.free_parameters, m) for m in moves)] if len(rows) else []


def _by_replays(
    fitted: Fit, problem: Problem, made: Judged, doubt: BoolArray, points: Sequence[Point], replayed: FloatArray
) -> Judged:
    """Return what was judged by a linear model, replayed (N, T, C) where that fails.

    There each chain moves if that suits the other blocks better.
    """
    train, own = problem.blocks.train, problem.channel_chain[:, None] == np.arange(doubt.shape[1])
    rows = np.flatnonzero(doubt.any(1))
    replayed = replayed + (fitted.residual - replayed[0])  # what a finer replay knows better
    blocks = np.stack([problem.block_squares(r)[train] for r in replayed])
    costs = np.stack(
        [chain_costs(problem, p, r, fitted.free_parameters) for p, r in zip(points, replayed, strict=True)]
    )
    chain_of = np.array(
        [k.joint if k.joint < 0 else int(problem.machine.chain[k.joint]) for k in fitted.free_parameters]
    )
    squares, moves = made[0].copy(), made[1].copy()
    for i, row in enumerate(rows):
        mine = [0, 1 + i]
        rest = costs[mine] - blocks[mine, row] @ own
        choice = np.argmin(np.nan_to_num(rest, nan=np.inf), axis=0)
        moved = np.where(doubt[row], choice, 1)
        moves[row] *= np.where(chain_of < 0, moved.min(), moved[chain_of])
        for chain in np.flatnonzero(doubt[row]):
            channels = own[:, chain]
            squares[row, channels] = np.minimum(blocks[mine[choice[chain]], row, channels], LARGEST)
    return squares, moves


def deviations(fitted: Fit, problem: Problem, moves: FloatArray) -> FloatArray:
    """Return jackknife standard deviations of the free parameters (P,), robust to coloured residuals.

    Args:
        fitted: The fit.
        problem: Log and model.
        moves: Changes of the free parameters without each block, from `left_out` (B_train, P).
    """
    count = len(moves)
    if count < 2 or not fitted.free_parameters:
        return np.full(len(fitted.free_parameters), np.inf)
    jackknife = np.sqrt((count - 1) / count * ((moves - moves.mean(0)) ** 2).sum(0))
    white = np.sqrt(np.maximum(np.diag(np.linalg.pinv(_information(fitted, problem))), 0.0))
    return np.maximum(jackknife, white)


def correlations(fitted: Fit, problem: Problem) -> Correlations | None:
    """Return how the errors of the free parameters hang together for a white residual; none if nothing is free."""
    if not fitted.free_parameters:
        return None
    hessian, scale = _information(fitted, problem), np.array([k.step for k in fitted.free_parameters])
    covariance = np.linalg.pinv(hessian * scale[:, None] * scale[None], hermitian=True)
    spread = np.sqrt(np.maximum(np.diag(covariance), SMALLEST))
    matrix = np.clip(covariance / spread[:, None] / spread[None], -1.0, 1.0)
    np.fill_diagonal(matrix, 1.0)
    names = tuple(k.called(problem.machine.joints) for k in fitted.free_parameters)
    return Correlations(names=names, matrix=matrix)


def _information(fitted: Fit, problem: Problem) -> FloatArray:
    """Return what data and prior say of the free parameters (P, P)."""
    return fitted.sums.over(problem.blocks.train)[0] + np.diag(prior(fitted.free_parameters))
