"""Numbers of effects: where a model stands, which of them are fitted, and the normal equations of each block."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import signal

from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.machine import MachineModel
from mimic.dynamics.servo import neutral
from mimic.records import FloatArray, IntArray
from mimic.sysid.logs import Blocks, Sums
from mimic.sysid.replay import Replay

Key = tuple[str, str]
"""(effect, parameter)"""


@dataclass(frozen=True, kw_only=True, eq=False)
class FreeParameter:
    """One fitted number."""

    key: Key
    joint: int
    """Index of the joint; -1 for the whole machine."""
    step: float
    """A difference that matters."""
    centre: float
    """Value before anything is known."""
    spread: float
    """Standard deviation of what is plausible before anything is known."""

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and greatest value."""
        p = CATALOGUE[self.key[0]].parameter(self.key[1])
        return p.low, p.high

    def called(self, joints: Sequence[str]) -> str:
        """Return its name for a person: effect, parameter, and of which of the joints."""
        return ".".join(self.key) + ("" if self.joint < 0 else f" of {joints[self.joint]}")


@dataclass(frozen=True, eq=False)
class Point:
    """Values of all effects that are in the model: (effect, parameter) -> (J,) or (1,)."""

    values: Mapping[Key, FloatArray] = field(default_factory=dict)

    @classmethod
    def of(cls, names: Iterable[str], machine: MachineModel) -> Point:
        """Return the point with these effects, all neutral."""
        point = cls()
        for name in names:
            point = point.with_effect(name, machine)
        return point

    def with_effect(self, name: str, machine: MachineModel, start: Mapping[str, object] | None = None) -> Point:
        """Return the point with an effect added, neutral or at ``start`` (numbers or rows)."""
        values = dict(self.values)
        for p in CATALOGUE[name].parameters:
            row = neutral(name, p.name, machine)
            if p.fixed and p.starts:
                row = np.full_like(row, p.starts[0])
            if start and p.name in start:
                row = np.broadcast_to(np.asarray(start[p.name], dtype=np.float64), row.shape).copy()
            values[name, p.name] = row
        return Point(values)

    def without(self, name: str) -> Point:
        """Return the point without an effect."""
        return Point({k: v for k, v in self.values.items() if k[0] != name})

    def moved(self, free_parameters: Sequence[FreeParameter], by: FloatArray) -> Point:
        """Return the point with each free parameter changed, inside its bounds."""
        values = {k: v.copy() for k, v in self.values.items()}
        for free, delta in zip(free_parameters, by, strict=True):
            at = max(free.joint, 0)
            values[free.key][at] = np.clip(values[free.key][at] + delta, *free.bounds)
        return Point(values)

    def is_at(self, other: Point) -> bool:
        """Return whether another point has the same values."""
        if self.values.keys() != other.values.keys():
            return False
        return all(np.array_equal(row, other.values[key]) for key, row in self.values.items())

    def read(self, free_parameters: Sequence[FreeParameter]) -> FloatArray:
        """Return the values of the free parameters."""
        return np.array([self.values[k.key][max(k.joint, 0)] for k in free_parameters])


def stack(points: Sequence[Point], machine: MachineModel) -> dict[Key, FloatArray]:
    """Return points as the replay takes them; effects that a point lacks are neutral there."""
    keys = {key for point in points for key in point.values}
    return {
        key: np.stack([p.values[key] if key in p.values else neutral(*key, machine) for p in points])
        for key in sorted(keys)
    }


def scales(replay: Replay) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the root mean squares of position (about its mean), speed, acceleration and torque of each joint (J,)."""
    log, drives = replay.log, replay.machine.drives
    t = log.t - log.t[0]
    low_pass = signal.butter(2, min(20.0, 0.4 * log.rate), fs=log.rate, output="sos")
    pieces = [part.slice for part in replay.parts]
    q = np.concatenate([signal.sosfiltfilt(low_pass, log.q[rows], axis=0) for rows in pieces])
    dq = np.concatenate([np.gradient(q[rows], t[rows], axis=0) for rows in pieces])
    ddq = np.concatenate([np.gradient(dq[rows], t[rows], axis=0) for rows in pieces])
    tau = log.tau
    if tau is None:
        kp, kd = replay.row_gains
        tau = kp * ((q if log.q_des is None else log.q_des) - q) - kd * dq
        tau = tau + (0.0 if log.force is None else log.force)
    limit = np.asarray(drives.torque)
    rows = (q - q.mean(0), dq, ddq, np.clip(tau, -limit, limit))
    position, speed, acceleration, torque = (np.maximum(np.sqrt(np.mean(r**2, axis=0)), 1e-9) for r in rows)
    return position, speed, acceleration, torque


def normal_equations(
    residual: FloatArray,
    columns: Sequence[FloatArray],
    free_parameters: Sequence[FreeParameter],
    blocks: Blocks,
    channel_chain: IntArray,
    chain: IntArray,
    weights: FloatArray,
) -> Sums:
    """Return the normal equations of each block.

    Args:
        residual: Whitened (T, C).
        columns: Derivatives of the predictions, whitened (T, C), one for each free parameter.
        free_parameters: Those (P,).
        blocks: Blocks of the readings.
        channel_chain: Chain of each channel (C,).
        chain: Chain of each joint (J,).
        weights: Weight of each chain (K,).
    """
    count, total = len(free_parameters), len(blocks.held_out)
    hessian, gradient = np.zeros((total, count, count)), np.zeros((total, count))
    weighed = hessian.copy(), gradient.copy()
    square = np.zeros(total)
    chains = np.unique(channel_chain)
    of = np.array([-1 if k.joint < 0 else chain[k.joint] for k in free_parameters])
    members = {c: np.flatnonzero((of == c) | (of < 0)) for c in chains}
    rows_of = [np.flatnonzero(blocks.index == b) for b in range(total)]
    for c in chains:
        mine = np.flatnonzero(channel_chain == c)
        index = members[c]
        stacked = (
            np.stack([columns[int(i)][:, mine] for i in index.tolist()])
            if len(index)
            else np.zeros((0, len(residual), len(mine)))
        )
        own = residual[:, mine]
        for b, rows in enumerate(rows_of):
            if not len(rows):
                continue
            a = stacked[:, rows].reshape(len(index), len(rows) * len(mine)).astype(np.float64)
            r = own[rows].reshape(-1).astype(np.float64)
            good = np.isfinite(r)
            if not good.all() or not np.isfinite(a).all():
                a, r = np.nan_to_num(a), np.where(good, r, 0.0)
            outer, along = a @ a.T, a @ r
            hessian[b][np.ix_(index, index)] += outer
            gradient[b][index] += along
            weighed[0][b][np.ix_(index, index)] += weights[c] * outer
            weighed[1][b][index] += weights[c] * along
            square[b] += r @ r
    weight = np.where(of < 0, 1.0, weights[of]) if count else np.zeros(0)
    return Sums(hessian=hessian, gradient=gradient, square=square, weighed=weighed, weight=weight)
