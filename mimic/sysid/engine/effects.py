"""What was found in the words of every other flow: an effects file, and what an unknown torque depends on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.effect_set import EffectSet, EffectValues
from mimic.records import FloatArray, IntArray
from mimic.sysid.engine.laws import ROW
from mimic.sysid.engine.model import Free, Key, Model, from_fit

BINS = 12
"""Equal shares of the readings over which a torque is averaged: few enough that each holds a whole motion."""

DEPENDS = 0.1
"""Share of a torque in blocks left out that a quantity must tell to be what it depends on."""

SURE = 1.96
"""Standard deviations of a 95 % interval."""


class Motion(NamedTuple):
    """What a pass that follows every reading says of a machine, (T, J) each."""

    position: FloatArray
    speed: FloatArray
    unknown: FloatArray
    """Unknown torque."""
    torque: FloatArray
    """Of the motors."""


def motion_of(model: Model) -> Motion:
    """Return the motion that a log tells."""
    read, unknown, torque = model.setting.passes.whole([model.table], model.gains, follow=True)[0]
    return Motion(position=read, speed=np.gradient(read, model.data.record.t, axis=0), unknown=unknown, torque=torque)


def effects_of(model: Model) -> EffectSet:
    """Return all numbers that were fitted, with their 95 % intervals, as an effects file has them."""
    spread = np.sqrt(np.maximum(np.diag(model.covariance()), 0.0))
    known = {(f.key, f.joint): (f, x, s) for f, x, s in zip(model.free, model.values(), spread, strict=True)}
    names = dict.fromkeys(f.key[0] for f in model.free)
    return EffectSet(tuple(_values(model, name, known) for name in names))


def _values(model: Model, name: str, known: dict[tuple[Key, int], tuple[Free, float, float]]) -> EffectValues:
    index = sorted({joint for (key, joint) in known if key[0] == name})
    values: dict[str, FloatArray] = {}
    intervals: dict[str, FloatArray] = {}
    for p in CATALOGUE[name].parameters:
        key = (name, p.name)
        values[p.name] = np.clip([model.table[ROW[key], j] for j in index], p.low, p.high)
        own = [known.get((key, j)) for j in index]
        if all(one is not None for one in own):
            ends = [[from_fit(p, x - SURE * s), from_fit(p, x + SURE * s)] for _, x, s in own]  # type: ignore[misc]
            intervals[p.name] = np.sort(np.array(ends), axis=-1)
    joints = () if index == [-1] else tuple(model.data.machine.joints[j] for j in index)
    return EffectValues(name=name, joints=joints, values=values, intervals=intervals, role="fitted")


def dependences(model: Model, motion: Motion) -> tuple[tuple[tuple[str, float], ...], ...]:
    """Return for each joint which quantities tell its unknown torque, and the share of it that each tells in blocks
    left out, the most telling first.
    """
    joints = model.data.machine.joints
    found = []
    for j in range(len(joints)):
        quantities = {
            "position": motion.position[:, j],
            "speed": motion.speed[:, j],
            "torque": motion.torque[:, j],
            "time": model.data.record.t,
        }
        quantities |= {f"position of {joints[k]}": motion.position[:, k] for k in range(len(joints)) if k != j}
        rows = model.data.counts[:, j]
        left = motion.unknown[rows, j]
        told = {name: _told(x[rows], left, model.data.block[rows]) for name, x in quantities.items()}
        ranked = sorted(((name, share) for name, share in told.items() if share > DEPENDS), key=lambda r: -r[1])
        found.append(tuple(ranked))
    return tuple(found)


def _told(x: FloatArray, y: FloatArray, block: IntArray) -> float:
    """Return the share of y in every second block that its mean over equal shares of x in the others tells."""
    edges = np.quantile(x, np.linspace(0.0, 1.0, BINS + 1)[1:-1])
    at = np.searchsorted(edges, x)
    fit = block % 2 == 0
    count = np.bincount(at[fit], minlength=BINS)
    mean = np.bincount(at[fit], y[fit], minlength=BINS) / np.maximum(count, 1)
    left = y[~fit] - mean[at[~fit]]
    return float(1.0 - np.sum(left**2) / max(float(np.sum((y[~fit] - y[fit].mean()) ** 2)), 1e-30))
