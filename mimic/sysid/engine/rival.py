"""What an unknown slow torque in each joint explains of innovations: what a name must beat.

The torque is constant for half a second, and forgets itself slowly; its size in each joint is the likeliest.
It is linear in the innovations, so that one pass for each joint of a chain tells all of its pieces. Source: Kennedy and
O'Hagan 2001, whose discrepancy it is.
"""

from __future__ import annotations

import numpy as np

from mimic.records import FloatArray
from mimic.sysid.engine.laws import MOMENT
from mimic.sysid.engine.likelihood import misfit, scales, weights
from mimic.sysid.engine.model import COARSE, LEVELS, Model

MEMORY = 3.0
"""Time in which the torque forgets itself [s]; what stays longer deserves a name."""

PIECE = 0.5
"""Time in which it is constant [s]: longer than a servo takes to answer it."""

ROUNDS = 6
"""Rounds in which sizes of the torque and scales of what is left follow from each other."""


def density(model: Model) -> float:
    """Return the log density of the readings with the likeliest of such torques beside a fitted model."""
    data = model.data
    changes = np.diff(data.block, prepend=-1) + np.diff((data.record.since / PIECE).astype(int), prepend=-1)
    begins = np.flatnonzero(changes != 0)
    piece = np.cumsum(changes != 0) - 1
    t = data.record.t[begins]
    log = data.record.log[begins]
    covariance = np.exp(-np.abs(t[:, None] - t) / MEMORY) * (log[:, None] == log)
    alike = np.linalg.cholesky(covariance + 1e-9 * np.eye(len(t)))
    torques = _torques(model)
    done = [np.zeros_like(one) for one in torques]
    left = np.nan_to_num(model.e)
    scale = model.scale
    best = -np.inf
    for _ in range(ROUNDS):
        w = weights(left, scale, data)
        unlikely = model.implausible(model.values())
        for j, moved in enumerate(torques):
            own = slice(int(data.tree.first[j]), int(data.tree.end[j]))
            left[:, own] -= done[j]
            pull = np.add.reduceat((w[:, own] * moved * left[:, own]).sum(axis=1), begins)
            square = np.add.reduceat((w[:, own] * moved**2).sum(axis=1), begins)
            torque, more = _likeliest(pull, square, alike, LEVELS * model.setting.gains.torque[j])
            done[j] = torque[piece, None] * moved
            left[:, own] += done[j]
            unlikely += more
        scale = scales(left, data)
        best = max(best, -float(misfit(left, scale, data).sum()) - unlikely)
    return best


def _likeliest(pull: FloatArray, square: FloatArray, alike: FloatArray, sizes: FloatArray) -> tuple[FloatArray, float]:
    """Return the torques (B,) of the likeliest size, and how unlikely they are [nats].

    Args:
        pull: Slopes of the cost (B,) where they are none.
        square: Its curvatures (B,).
        alike: Root of their covariance, at the size 1 (B, B).
        sizes: To choose from.
    """
    stiff, turned = np.linalg.eigh(alike.T @ (square[:, None] * alike))
    along = turned.T @ (alike.T @ pull)
    stiff = 1.0 + sizes[:, None] ** 2 * np.maximum(stiff, 0.0)
    unit = -sizes[:, None] * along / stiff
    volume = 0.5 * np.log(stiff).sum(axis=1)
    k = int(np.argmax(-0.5 * (unit * sizes[:, None] * along).sum(axis=1) - volume))
    return sizes[k] * (alike @ (turned @ unit[k])), 0.5 * float(unit[k] @ unit[k]) + float(volume[k])


def _torques(model: Model) -> list[FloatArray]:
    """Return derivatives of the innovations of a chain to a torque in each joint (T, J of the chain)."""
    data = model.data
    place = np.asarray(data.machine.place)
    shift = 0.1 * model.setting.scale["torque"]
    tables = []
    for k in range(place.max() + 1):
        table = model.table.copy()
        table[MOMENT] += np.where(place == k, shift, 0.0)
        tables.append(table)
    *moved, still = model.setting.passes.run([*tables, model.table], model.gains, COARSE[1])
    found = []
    for j in range(data.joints):
        own = slice(int(data.tree.first[j]), int(data.tree.end[j]))
        found.append(np.nan_to_num((moved[place[j]][:, own] - still[:, own]) / shift[j]))
    return found
