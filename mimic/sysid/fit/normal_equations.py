"""Normal equations of each block, and the scales of the log that parameters are measured in."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import signal

from mimic.records import FloatArray, IntArray
from mimic.sysid.fit.point import FreeParameter
from mimic.sysid.log.blocks import Blocks, Sums
from mimic.sysid.replay.cpu import Replay


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
