"""When each target arrived: targets that never did, and a delay of its own for each.

What a short delay of each does to the errors is measured once; those further apart than they are heard share a pass.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.ndimage import maximum_filter1d
from scipy.sparse.linalg import splu

from mimic.records import FloatArray, IntArray
from mimic.sysid.engine.likelihood import misfit, weights
from mimic.sysid.engine.model import COARSE, Model
from mimic.sysid.log.timing import SendingTimes

HEARD = 0.4
"""Time after which it does not matter any more when a target arrived [s]: as far apart they are tried together."""

LATER = 5e-4
"""Delay of a target for a derivative [s]."""

DEVIATIONS = 1e-3 * 2.0 ** np.arange(-2.0, 5.0, 0.5)
"""Deviations of the delays of single targets that are tried [s]."""

STEPS = 4
"""Steps of Gauss and Newton to the delays."""

DOUBTFUL = 0.25
"""Share of the price that a target must gain, were its delay as long as a period, to be left out in a pass."""


class Felt(NamedTuple):
    """What delays of single targets do."""

    columns: Any
    """To the errors, for a second (T * J, K), sparse."""
    gain: FloatArray
    """By how much readings would be likelier were each late by a period, to first order (K,) [nats]."""


def sent_at(model: Model, times: SendingTimes) -> Model:
    """Return a model whose targets were sent at these times, not yet fitted."""
    return model.over(model.data.sent_at(times))


def arrived(model: Model, names: Sequence[str], repeats: float, price: float) -> Iterator[Model]:
    """Yield models in which targets arrived otherwise: each number gains its price [nats], errors' repeats counted."""
    if names and model.data.log.q_des is not None and len(model.data.times.at) > 1:
        felt = _felt(model)
        for name in names:
            made = ARRIVALS[name](model, felt, repeats, price)
            if made is not model:
                yield made


def _without_lost(model: Model, felt: Felt, repeats: float, price: float) -> Model:
    """Return a model without the targets that never arrived: each must gain the price."""
    while True:
        lost = np.flatnonzero(_neglected(model, felt, repeats * price) > repeats * price)
        if not len(lost):
            return model
        model = sent_at(model, model.data.times.without(lost))
        felt = _felt(model)


def _late(model: Model, felt: Felt, repeats: float, price: float) -> Model:
    """Return a model in which each target was late by a time of its own, drawn about none with the deviation under
    which readings are likeliest, if that gains its price. Source: empirical Bayes, MacKay 1992.
    """
    start = model
    times = model.data.times
    if times.spread > 0.0:
        return model
    by = np.zeros(len(times.at))
    for step in range(STEPS):
        white = np.sqrt(weights(model.e, model.scale, model.data)).ravel()
        if step:
            felt = _felt(model)
        moved = sparse.diags_array(white) @ felt.columns
        pull = moved.T @ (white * np.nan_to_num(model.e).ravel())
        if not step and pull @ pull < repeats * moved.power(2).sum():
            return start  # delays pull no more than errors do that repeat themselves
        hessian = (moved.T @ moved).tocsc()
        descent = hessian @ by - pull
        if max(_evidence(hessian / repeats, descent / repeats, size)[0] for size in DEVIATIONS) < price:
            return start
        _, deviation = max((_evidence(hessian, descent, size)[0], size) for size in DEVIATIONS)
        less, more = (_evidence(share * hessian, 0.0 * descent, deviation)[0] for share in (0.99, 1.01))
        told = 100.0 * (less - more)  # how many delays readings determine
        by = _evidence(hessian, descent, deviation)[1]
        model = sent_at(model, times.late(by, deviation * np.sqrt(12.0), told)).fitted(1)
    return model


ARRIVALS = {"lost_commands": _without_lost, "delay_jitter": _late}
"""What is looked for in single targets."""


def _evidence(hessian: Any, descent: FloatArray, deviation: float) -> tuple[float, FloatArray]:
    """Return the log evidence of a deviation over none [nats], and the likeliest delays (K,)."""
    of_prior = sparse.eye_array(len(descent), format="csc") / deviation**2
    made = splu(hessian + of_prior, permc_spec="NATURAL")
    by = made.solve(descent)
    return float(0.5 * descent @ by - 0.5 * np.log(deviation**2 * np.abs(made.U.diagonal())).sum()), by


def _apart(at: FloatArray) -> Iterator[IntArray]:
    """Yield targets sent at times (K,) that may be tried together, but for the first."""
    apart = int(np.ceil(HEARD / float(np.median(np.diff(at)))))
    for first in range(1, min(apart + 1, len(at))):
        yield np.arange(first, len(at), apart)


def _heard(model: Model, tried: IntArray) -> IntArray:
    """Return which of the targets tried each reading hears (T,), from 1; 0 before the first."""
    return np.searchsorted(model.data.record.sent[tried], model.data.record.t, side="right")


def _errors(model: Model, times: SendingTimes) -> FloatArray:
    """Return the errors (T, J) with targets sent at these times, in coarse steps."""
    passes = model.setting.passes.of(model.data.sent_at(times))
    return passes.run([model.table], model.gains, COARSE)[0]


def _felt(model: Model) -> Felt:
    """Return what a delay of each target does."""
    data = model.data
    times = data.times
    size = len(times.at)
    still = _errors(model, times)
    period = float(np.median(np.diff(data.record.sent)))
    as_it_is = misfit(model.e, model.scale, data)
    parts = [(np.zeros(0), np.zeros(0, dtype=int), np.zeros(0, dtype=int))]
    gain = np.zeros(size)
    for tried in _apart(data.record.sent):
        by = np.zeros(size)
        by[tried] = LATER
        change = np.nan_to_num(_errors(model, times.late(by, 0.0, 0.0)) - still) / LATER
        heard = _heard(model, tried)
        change[heard == 0] = 0.0
        likelier = (as_it_is - misfit(model.e + period * change, model.scale, data)).sum(axis=1)
        gain[tried] = np.bincount(heard, likelier, len(tried) + 1)[1:]
        column = np.repeat(tried[np.maximum(heard - 1, 0)], data.joints)
        rows = np.flatnonzero(change)
        parts.append((change.ravel()[rows], rows, column[rows]))
    value, row, column = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Felt(sparse.csr_array((value, (row, column)), shape=(still.size, size)), gain)


def _neglected(model: Model, felt: Felt, price: float) -> FloatArray:
    """Return by how much readings are likelier had each target not arrived (K,) [nats]; 0 beside one of which they say
    more, and where a delay says that it is not worth a look.
    """
    data = model.data
    doubtful = felt.gain > DOUBTFUL * price
    said = np.zeros(len(doubtful))
    near = 1
    for together in _apart(data.record.sent):
        near = int(together[0])
        tried = together[doubtful[together]]
        if len(tried):
            other = sent_at(model, data.times.without(tried))
            by = (misfit(model.e, model.scale, data) - misfit(other.e, model.scale, data)).sum(axis=1)
            said[tried] = np.bincount(_heard(model, tried), by, len(tried) + 1)[1:]
    return np.where(said == maximum_filter1d(said, 2 * near + 1), said, 0.0)
