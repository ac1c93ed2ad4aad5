"""Effects ranked by how much of the torque they explain in blocks that were left out, in seconds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from mimic.dynamics.machine import MachineModel
from mimic.errors import CalibrationError
from mimic.io.joint_log import JointLog
from mimic.records import BoolArray, FloatArray, IntArray
from mimic.sysid.log.timing import SendingTimes, at_rows
from mimic.sysid.result import RULES
from mimic.sysid.torque.columns import Column, Columns, Motion, motion_of

DELAYS = (0.0, 0.005, 0.01, 0.015, 0.02, 0.03, 0.04)
"""Delays of the targets that are tried before anything else [s]; the baseline moves between them."""

GAUGE = ("gains", "kt_gain")
"""They multiply the torque itself, so that a regression of torques hardly sees them."""

REFINED = 4
"""Steps towards the best delay from there."""

BLOCK, LEAST_BLOCKS = 1.5, 12
"""Length of a block [s], some correlation times of the residual of a PD joint, and the fewest: with less, z has no
distribution to speak of.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Score:
    """One effect, or a set of them."""

    names: tuple[str, ...]
    at: tuple[tuple[float, ...], ...]
    """Thresholds of each."""
    gain: float
    """Log of the error before over the error with it, mean of the left-out blocks."""
    z: float
    """Gain over its standard error."""
    coefficients: tuple[FloatArray, ...]
    """Of each effect, over all blocks (K,)."""
    blocks: FloatArray
    """Log of the error in each left-out block, of each joint (B, J)."""

    @property
    def total(self) -> float:
        """Mean log error over blocks and joints."""
        return float(np.nanmean(self.blocks))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Rows:
    """What is compared: rows (R,) of one joint each, of all logs."""

    y: FloatArray
    joint: IntArray
    block: IntArray
    keep: tuple[BoolArray, ...]
    """Rows of each log that count (T, J)."""


class Torques:
    """The torques of some logs of one machine, and what each effect would add to them."""

    def __init__(
        self,
        logs: Sequence[tuple[JointLog, MachineModel]],
        rows: Sequence[BoolArray] | None = None,
        sending: Sequence[SendingTimes] | None = None,
    ) -> None:
        """Take the logs.

        Args:
            logs: What one machine did, with the model for each (payloads may differ); gains are those of the log.
            rows: Rows of each log that may be looked at (T,); all by default.
            sending: When the targets of each were sent; with the rows that first show them by default.

        Raises:
            CalibrationError: If there is nothing to compare: no torque, too little motion.
        """
        seen = rows or [np.ones(len(log.t), dtype=bool) for log, _ in logs]
        given = [
            (log.of(m.joints), m, use, sent)
            for (log, m), use, sent in zip(logs, seen, sending or [at_rows(log) for log, _ in logs], strict=True)
        ]
        self.delay, self.motions = _with_delay(given)
        columns = Columns(self.motions)
        self._base = columns.baseline()
        self.regression = Regression(self.motions, self._base)
        """On what every model has."""
        self.candidates = columns.candidates(self.regression.left_of_baseline())

    def singles(self, effects: Sequence[str] = (), given: Sequence[str] = ()) -> list[Score]:
        """Return how single effects do, best first, each with its best thresholds.

        Args:
            effects: Names to choose from; empty for all.
            given: Effects that are there anyhow, with the thresholds that suit them best: all others come on top.
        """
        base, regression, candidates = list(self._base), self.regression, self.candidates
        for name in given:
            own = [c for c in candidates if c.name == name]
            if own:
                base.append(min(own, key=lambda c: regression.score((c,)).total))
                candidates = [c for c in candidates if c.name != name]
                regression = Regression(self.motions, base)
        before, found = regression.score(()).blocks, dict[str, Score]()
        for c in candidates:
            if not effects or c.name in effects:
                s = regression.score((c,), before)
                if c.name not in found or s.gain > found[c.name].gain:
                    found[c.name] = s
        return sorted(found.values(), key=lambda s: -s.gain)


_Given = tuple[JointLog, MachineModel, BoolArray, SendingTimes]
"""A log, its model, the rows that may be looked at, and when its targets were sent."""


def _with_delay(logs: Sequence[_Given]) -> tuple[float, list[Motion]]:
    """Return the delay of the targets with which the baseline leaves least, and the motions with it."""
    by_target = any(log.tau is None and log.q_des is not None for log, *_ in logs)
    found = {d: _plain(logs, d) for d in (DELAYS if by_target else (0.0,))}
    delay = min(found, key=lambda d: found[d][0])
    for _ in range(REFINED if by_target else 0):
        nearer = float(np.clip(delay + found[delay][1], 0.0, 2 * DELAYS[-1]))
        if nearer not in found:
            found[nearer] = _plain(logs, nearer)
        if found[nearer][0] >= found[delay][0]:
            break
        delay = nearer
    return delay, found[delay][2]


def _plain(logs: Sequence[_Given], delay: float) -> tuple[float, float, list[Motion]]:
    """Return the log error of each joint's own inertia and friction, summed, by how much later is better, the motions.

    The error is that of a torque in units of the declared one, since all torques scale with inertia and friction.
    """
    motions = [motion_of(log, m, delay, use, sent) for log, m, use, sent in logs]
    rows = _rows(motions)
    left, later, weight = 0.0, 0.0, 0.0
    for j in range(motions[0].q.shape[1]):
        x, tau = [], []
        for m, keep in zip(motions, rows.keep, strict=True):
            own = [np.tanh(m.dq / m.slow), m.dq, m.ddq, m.need, np.ones_like(m.q), -m.later]
            x.append(m.filtered(np.stack([c[:, j] for c in own], -1))[keep[:, j]])
            tau.append(m.filtered(m.tau[:, j])[keep[:, j]])
        a, b = np.concatenate(x), np.concatenate(tau)
        if len(b) < 10:
            continue
        found = np.linalg.lstsq(a, b, rcond=None)[0]
        error = np.mean((b - a[:, :-1] @ found[:-1]) ** 2) + 1e-30
        left += float(np.log(error))
        there = np.mean(a[:, -1] ** 2) / error
        later, weight = later + there * 1e-3 * float(found[-1]), weight + there
    return left, float(later / max(weight, 1e-12)), motions


def _rows(motions: Sequence[Motion]) -> _Rows:
    y, joint, block, keep, blocks = [], [], [], [], 0
    seconds = min(BLOCK, sum(float(m.t[-1]) for m in motions) / (2 * LEAST_BLOCKS))
    for m in motions:
        edge = 2.0 / m.cut_off
        t = m.t[:: m.every]
        use = m.moving[:: m.every] & ((t > edge) & (t < t[-1] - edge))[:, None]
        at, which = np.nonzero(use)
        y.append(m.filtered(m.tau - m.need)[use])
        joint.append(which)
        block.append(blocks + np.floor(t[at] / seconds).astype(int))
        blocks += int(t[-1] / seconds) + 1
        keep.append(use)
    return _Rows(y=np.concatenate(y), joint=np.concatenate(joint), block=np.concatenate(block), keep=tuple(keep))


class Regression:
    """Sets of columns over the rows of all logs; chains that do not influence each other are solved apart."""

    def __init__(self, motions: Sequence[Motion], baseline: Sequence[Column]) -> None:
        self.rows = _rows(motions)
        self._joints = motions[0].q.shape[1]
        counted = np.unique(self.rows.block)
        if len(counted) < LEAST_BLOCKS or not np.any(self.rows.y):
            raise CalibrationError(
                f"the logs have {len(counted)} blocks of motion of {BLOCK:g} s or less; torques can be"
                f" compared from {LEAST_BLOCKS} on: log more motion"
            )
        self._block = np.searchsorted(counted, self.rows.block)
        self._blocks = len(counted)
        chain = np.asarray(motions[0].machine.chain)
        self._of_chain = [np.flatnonzero(chain[self.rows.joint] == c) for c in np.unique(chain)]
        self._mates = [np.flatnonzero(chain == c) for c in np.unique(chain)]
        self._kept: dict[tuple[int, int], tuple[FloatArray, FloatArray]] = {}
        self._base = list(baseline)
        self.spread = np.ones(self._joints)
        count = np.maximum(np.bincount(self.rows.joint, minlength=self._joints), 1)
        for _ in range(2):  # the second time with the rows weighed by what is left
            self._left = self._fit(())[1]
            squares = np.bincount(self.rows.joint, self._left**2, self._joints)
            self.spread = np.sqrt(squares / count) + 1e-12
            self._kept.clear()
        tau = np.concatenate([m.filtered(m.tau)[k] for m, k in zip(motions, self.rows.keep, strict=True)])
        self.torque = np.sqrt(np.bincount(self.rows.joint, tau**2, self._joints) / count)

    def left_of_baseline(self) -> list[FloatArray]:
        """Return the torque that the baseline leaves (T, J) in each log; zero at rest."""
        out, begin = [], 0
        for keep in self.rows.keep:
            part = np.zeros(keep.shape)
            part[keep] = self._left[begin : begin + int(keep.sum())]
            begin += int(keep.sum())
            out.append(part)
        return out

    def _matrix(self, column: Column, chain: int) -> tuple[FloatArray, FloatArray]:
        """Return the rows of a chain (R, K), whitened and scaled, and the prior precision of each coefficient."""
        key = (id(column), chain)
        if key not in self._kept:
            at, mine = self._of_chain[chain], self._mine(column, chain)
            x = np.concatenate([p[k] for p, k in zip(column.parts, self.rows.keep, strict=True)])[at][:, mine]
            x = x / self.spread[self.rows.joint[at], None]
            prior = np.full(x.shape[1], 1.0 / column.spread**2)
            self._kept[key] = (x, prior)
        return self._kept[key]

    def _fit(self, columns: Sequence[Column]) -> tuple[list[FloatArray], FloatArray, FloatArray]:
        """Return coefficients over all blocks for each chain, the left-out residual of each row, and its log square.

        The third is (B, J): log of the mean square of each left-out block and joint, NaN where it has no rows.
        """
        left, solved = np.zeros(len(self.rows.y)), []
        for chain, at in enumerate(self._of_chain):
            if not len(at):
                solved.append(np.zeros(0))
                continue
            parts = [self._matrix(c, chain) for c in (*self._base, *columns)]
            x = np.concatenate([p[0] for p in parts], 1)
            y = self.rows.y[at] / self.spread[self.rows.joint[at]]
            scale = np.sqrt(np.mean(x**2, axis=0)) + 1e-12
            prior = np.concatenate([p[1] for p in parts]) / scale**2 + 1e-7 * len(y)
            block = self._block[at]
            left[at], out, whole = _without_each(x / scale, y, block, self._blocks, prior)
            left[at] *= self.spread[self.rows.joint[at]]
            left[at] /= self._scaled(chain, columns, out / scale)[block, self.rows.joint[at]]
            solved.append(whole / scale)
        return solved, left, self._logs(left)

    def _logs(self, left: FloatArray) -> FloatArray:
        """Return the log of the mean square of each block and joint (B, J) of rows (R,), NaN where it has no rows."""
        cell = self._block * self._joints + self.rows.joint
        size = self._blocks * self._joints
        count = np.bincount(cell, minlength=size)
        squares = np.bincount(cell, (left / self.spread[self.rows.joint]) ** 2, size)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(count >= 4, 0.5 * np.log(squares / count), np.nan).reshape(self._blocks, self._joints)

    def _scaled(self, chain: int, columns: Sequence[Column], found: FloatArray) -> FloatArray:
        """Return by how much each left-out block multiplies the torque of each joint (B, J)."""
        factor = np.ones((self._blocks, self._joints))
        at = sum(int(self._mine(c, chain).sum()) for c in self._base)
        for c in columns:
            joints = c.joint[self._mine(c, chain)]
            if c.scales is not None:
                changed = c.scales[self._mine(c, chain)] * found[:, at : at + len(joints)]
                factor[:, joints] *= np.maximum(1.0 + changed, 0.05)
            at += len(joints)
        return factor

    def score(self, columns: Sequence[Column], before: FloatArray | None = None) -> Score:
        """Return how a set does; ``before`` is the log error (B, J) that it is compared with."""
        solved, _, logs = self._fit(columns)
        gain, z = (0.0, 0.0) if before is None else evidence(before - logs)
        coefficients, skip = [], [sum(int(self._mine(c, k).sum()) for c in self._base) for k in range(len(solved))]
        for c in columns:
            row = np.full(len(c.joint), np.nan)
            for k, found in enumerate(solved):
                mine = self._mine(c, k)
                if len(found):
                    row[mine] = found[skip[k] : skip[k] + int(mine.sum())]
                skip[k] += int(mine.sum())
            coefficients.append(row)
        return Score(
            names=tuple(c.name for c in columns),
            at=tuple(c.at for c in columns),
            gain=gain,
            z=z,
            coefficients=tuple(coefficients),
            blocks=logs,
        )

    def _mine(self, column: Column, chain: int) -> BoolArray:
        return np.isin(column.joint, self._mates[chain]) | (column.joint < 0)


def _without_each(
    x: FloatArray, y: FloatArray, block: IntArray, blocks: int, prior: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what a regression of y (R,) on x (R, K) leaves of each block without it, and its coefficients.

    Returns:
        Residuals (R,), coefficients without each block (B, K), coefficients of all (K,).
    """
    order = np.argsort(block, kind="stable")
    starts = np.searchsorted(block[order], np.arange(blocks + 1))
    xs, ys = x[order], y[order]
    gram = np.stack([xs[a:b].T @ xs[a:b] for a, b in pairwise(starts)])
    moment = np.stack([xs[a:b].T @ ys[a:b] for a, b in pairwise(starts)])
    whole, total = gram.sum(0) + np.diag(prior), moment.sum(0)
    out = np.linalg.solve(whole - gram, (total - moment)[..., None])[..., 0]
    return y - np.einsum("rk,rk->r", x, out[block]), out, np.linalg.solve(whole, total)


def evidence(difference: FloatArray) -> tuple[float, float]:
    """Return mean gain and z of log errors (B, J): of all joints together, or of the one that shows it best."""
    best = (-np.inf, -np.inf)
    columns = [np.nanmean(np.where(np.isfinite(difference).any(1, keepdims=True), difference, 0.0), axis=1)]
    if difference.shape[1] > 1:
        columns += list(difference.T)
    for i, d in enumerate(columns):
        d = d[np.isfinite(d)]
        if len(d) < 6:
            continue
        mean, deviation = float(d.mean()), float(d.std(ddof=1)) + 1e-12
        z = mean / deviation * np.sqrt(len(d))
        share = 1.0 if i == 0 else 1.0 / difference.shape[1]
        if z > best[1]:
            best = (mean * share, z)
    return best if np.isfinite(best[1]) else (0.0, 0.0)


def asked_for(
    torques: Sequence[Torques], effects: Sequence[str], given: Sequence[str] = (), least: float = 0.0
) -> tuple[str, ...]:
    """Return the effects that torques ask for, best by gain and by z in turn, and those that they cannot judge.

    Args:
        torques: Of the same logs, as they were measured and as the drives were asked for; without, none can be judged.
        effects: To choose from.
        given: Effects that are in the model by now.
        least: Standard errors by which they must be asked for; above 0 none that torques cannot judge.
    """
    found: dict[str, list[Score]] = {}
    for one in torques:
        for s in one.singles(effects, given):
            found.setdefault(s.names[0], []).append(s)
    by_gain = sorted(found, key=lambda n: -max(s.gain for s in found[n]))
    by_z = sorted(found, key=lambda n: -max(s.z for s in found[n]))
    chosen = list(dict.fromkeys(n for both in zip(by_gain, by_z, strict=True) for n in both))
    chosen = [n for n in chosen if n in by_gain[: RULES.shortlist] or n in by_z[: RULES.shortlist]]
    names = (*chosen, *(n for n in effects if n not in found or (n in GAUGE and n not in chosen)))
    if torques and least > 0.0:
        names = tuple(n for n in chosen if max(s.z for s in found[n]) >= least)
    return names


def torques_of(
    logs: Sequence[tuple[JointLog, MachineModel]],
    rows: Sequence[BoolArray] | None = None,
    sending: Sequence[SendingTimes] | None = None,
) -> tuple[Torques, ...]:
    """Return the torques of logs for `asked_for`; see `Torques`.

    Where torque was measured, once with that (the mechanics) and once with what the drives were asked for (all). None
    where there is too little motion to judge anything.
    """
    made = []
    if all(log.tau is not None and log.q_des is not None for log, _ in logs):
        made.append(logs)
    made.append([(replace(log, tau=None) if log.q_des is not None else log, m) for log, m in logs])
    try:
        return tuple(Torques(one, rows, sending) for one in made)
    except CalibrationError:
        return ()
