"""Where the fit of an effect begins, and what the model does at a fit.

A derivative at neutral is blind to effects with a threshold, so those start from a small grid away from neutral.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.servo import neutral
from mimic.records import BoolArray, FloatArray
from mimic.sysid.fit.least_squares import Fit, solve
from mimic.sysid.fit.problem import Point, Problem

DELAY = ("delay", "time")

FEWEST, MOST = 1.5, 40
"""Periods of cogging in the range of motion; a longer wave is a spring, or whatever else depends on position."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StartingPoint:
    """One place from which an effect may be fitted."""

    name: str
    point: Point
    joints: BoolArray
    """Joints that may have the effect (J,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PredictedMotion:
    """What the model does at a fit; arrays (T, J)."""

    t: FloatArray
    q: FloatArray
    dq: FloatArray
    tau: FloatArray


def starts_of(name: str, incumbent: Fit, problem: Problem, motion: PredictedMotion) -> list[Point]:
    """Return the points from which an effect is tried."""
    spec, machine = CATALOGUE[name], problem.machine
    if name == "torque_speed":
        torque, speed = spec.parameter("torque").starts, spec.parameter("speed").starts
        peak, fast = np.abs(motion.tau).max(0), np.abs(motion.dq).max(0)
        grid = [{"torque": a * peak, "speed": b * fast} for a, b in itertools.product(torque, speed)]
        return [_clipped(incumbent.point.with_effect(name, machine, g)) for g in grid]
    if name == "cogging":
        best = [best_order(motion.q[:, j], _left(incumbent, j)) for j in range(len(machine.joints))]
        return [incumbent.point.with_effect(name, machine, {"order": np.array(best)})]
    joints = range(len(machine.joints)) if spec.scope == "joint" else [-1]
    axes = [
        [(p.name, np.array([v * p.step * problem.scale(p.unit, j) for j in joints])) for v in p.starts]
        for p in spec.parameters
        if p.starts and not p.fixed
    ]
    points = [_clipped(incumbent.point.with_effect(name, machine, dict(v))) for v in itertools.product(*axes)]
    if name != "target_filter" or DELAY not in incumbent.point.values:
        return points
    late = [np.mean(p.values[name, "time"]) for p in points]  # a low-pass delays by its time what the delay does less
    return [_clipped(Point({**p.values, DELAY: p.values[DELAY] - by})) for p, by in zip(points, late, strict=True)]


def best_order(q: FloatArray, r: FloatArray) -> float:
    """Return the order whose sine and cosine over positions (T,) explain most of a residual (T,)."""
    bounds = CATALOGUE["cogging"].parameter("order")
    turns = 2 * np.pi / float(np.ptp(q)) if len(np.unique(q)) > 1 else np.inf
    low, high = max(FEWEST * turns, bounds.low), min(MOST * turns, bounds.high)
    orders = np.arange(low, high, turns / 12) if low < high else np.array([bounds.high])  # a twelfth of a peak's width
    waves = (np.stack([np.cos(k * q), np.sin(k * q), np.ones_like(q)], -1) for k in orders)
    return float(orders[np.argmin([np.sum((r - w @ np.linalg.lstsq(w, r, rcond=None)[0]) ** 2) for w in waves])])


def _clipped(point: Point) -> Point:
    values = {}
    for (name, parameter), row in point.values.items():
        p = CATALOGUE[name].parameter(parameter)
        values[name, parameter] = np.clip(row, p.low, p.high)
    return Point(values)


def _left(incumbent: Fit, joint: int) -> FloatArray:
    residual = incumbent.residual[:, joint].astype(np.float64)
    return np.where(np.isfinite(residual), residual, 0.0)


def starting_points(
    problem: Problem, incumbent: Fit, names: Sequence[str], motion: PredictedMotion
) -> list[StartingPoint]:
    """Return the best start of each of the named effects: a joint takes the one that suits it best, or none.

    Each start is replayed alone, with the numbers of the incumbent free to make up for it.
    """
    points = [(name, p) for name in names for p in starts_of(name, incumbent, problem, motion)]
    moving = [i for i, (name, p) in enumerate(points) if _acts(name, p, problem)]
    replayed = dict(zip(moving, problem.residuals([points[i][1] for i in moving]), strict=True)) if moving else {}
    left = {
        i: _refitted(problem, incumbent, residual)
        for i, residual in replayed.items()
        if np.isfinite(problem.block_squares(residual)).all()
    }
    own = _channel_squares(problem, incumbent.residual)
    found = []
    for name in names:
        rows = [i for i, (n, _) in enumerate(points) if n == name and (i in left or i not in replayed)]
        if not rows:
            continue
        point, joints = points[rows[0]][1], np.ones(problem.joints, dtype=bool)
        if rows[0] in replayed and CATALOGUE[name].scope == "machine":
            point = points[min(rows, key=lambda i: float(left[i].sum()))][1]
        elif rows[0] in replayed:
            starts = [points[i][1] for i in rows]
            point, joints = _mixed(name, starts, [left[i] for i in rows], own, problem, incumbent.point)
        found.append(StartingPoint(name=name, point=point, joints=joints))
    return found


def _refitted(problem: Problem, incumbent: Fit, residual: FloatArray) -> FloatArray:
    """Return the sum of squares of each channel (C,) after one linear step of the incumbent's numbers."""
    free, left = incumbent.free_parameters, residual.copy()
    sums = problem.sums(residual, incumbent.columns, free)
    step = solve(sums, problem.blocks.train, free, incumbent.point.read(free), 0.0)
    for size, column in zip(step, incumbent.columns, strict=True):
        left -= np.float32(size) * column
    return min((_channel_squares(problem, r) for r in (left, residual)), key=np.sum)


def _channel_squares(problem: Problem, residual: FloatArray) -> FloatArray:
    return problem.block_squares(residual)[problem.blocks.train].sum(0)


def _mixed(
    name: str, points: Sequence[Point], squares: Sequence[FloatArray], own: FloatArray, problem: Problem, none: Point
) -> tuple[Point, BoolArray]:
    """Return the point at which each joint has the start that suits it best, or none, and which joints have one."""
    joints = problem.joints
    by_joint = np.zeros((len(points) + 1, joints))
    for row, square in enumerate((own, *squares)):
        np.add.at(by_joint[row], problem.channel_joint, square)
    choice = np.argmin(by_joint, axis=0)
    mask = choice > 0
    if not CATALOGUE[name].structural:  # a derivative at neutral tells of the joints that no start suits
        mask = np.ones(joints, dtype=bool)
    elif not mask.any():  # the mildest start where it does the least harm
        harm = by_joint[1:] - by_joint[0]
        choice[:] = 0
        j = int(np.argmin(harm.min(0)))
        choice[j] = 1 + int(np.argmin(harm[:, j]))
        mask = choice > 0
    used = choice[choice > 0]
    values = dict((points[int(np.bincount(used).argmax()) - 1] if len(used) else none).values)
    for p in CATALOGUE[name].parameters:
        rows = np.stack([neutral(name, p.name, problem.machine), *(x.values[name, p.name] for x in points)])
        values[name, p.name] = rows[np.maximum(choice, 1) if p.shape and not p.fixed else choice, np.arange(joints)]
    return Point(values), mask


def _acts(name: str, point: Point, problem: Problem) -> bool:
    """Return whether any number of an effect that is not a shape differs from none."""
    return any(
        not np.array_equal(point.values[name, p.name], neutral(name, p.name, problem.machine))
        for p in CATALOGUE[name].parameters
        if not p.shape and not p.fixed
    )


def predicted(problem: Problem, fitted: Fit) -> PredictedMotion:
    """Return what the model does; velocities from the predicted positions, torques from the servo."""
    machine, log = problem.machine, problem.replay.log
    joints = len(machine.joints)
    left = problem.in_floors(fitted.residual)[:, :joints].astype(np.float64)
    residual = np.nan_to_num(left) * problem.noise[:joints]
    q = log.q - residual
    t = log.t - log.t[0]
    dq = np.gradient(q, t, axis=0)
    target = log.q_des if log.q_des is not None else q
    delay = fitted.point.values.get(DELAY, np.zeros(1))[0]
    delay -= float(np.mean(t[problem.replay.sent] - problem.replay.sending.at))
    late = np.stack([np.interp(t - delay, t, column) for column in target.T], -1)
    kp, kd = problem.replay.row_gains
    tau = kp * (late - q) - kd * dq
    if log.force is not None:
        tau = tau + log.force
    limit = np.asarray(machine.drives.torque)
    return PredictedMotion(t=t, q=q, dq=dq, tau=np.clip(tau, -limit, limit))
