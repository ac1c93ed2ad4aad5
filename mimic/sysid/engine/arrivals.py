"""When each target arrived: targets that never did, and a delay of its own for each.

Each is moved alone; those further apart than they are heard share a pass.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy import sparse
from scipy.ndimage import maximum_filter1d
from scipy.sparse.linalg import splu

from mimic.records import FloatArray, IntArray
from mimic.sysid.engine.likelihood import misfit, weights
from mimic.sysid.engine.model import Model
from mimic.sysid.log.timing import SendingTimes

HEARD = 0.4
"""Time after which it does not matter any more when a target arrived [s]: as far apart they are tried together."""

LATER = 5e-4
"""Delay of a target for a derivative [s]."""

DEVIATIONS = 1e-3 * 2.0 ** np.arange(-2.0, 5.0, 0.5)
"""Deviations of the delays of single targets that are tried [s]."""

STEPS = 4
"""Steps of Gauss and Newton to the delays."""


def sent_at(model: Model, times: SendingTimes) -> Model:
    """Return a model whose targets were sent at these times, not yet fitted."""
    return model.over(model.data.sent_at(times))


def without_lost(model: Model, price: float) -> Model:
    """Return a model without the targets that never arrived: each must gain the price [nats]."""
    while True:
        lost = np.flatnonzero(_neglected(model) > price)
        if not len(lost):
            return model
        model = sent_at(model, model.data.times.without(lost))


def late(model: Model, price: float) -> Model:
    """Return a model in which each target was late by a time of its own, drawn about none with the deviation under
    which readings are likeliest, if that gains the price [nats]. Source: empirical Bayes, MacKay 1992.
    """
    start = model
    times = model.data.times
    if times.spread > 0.0 or len(times.at) < 2:
        return model
    by = np.zeros(len(times.at))
    for _ in range(STEPS):
        white = np.sqrt(weights(model.e, model.scale, model.data)).ravel()
        felt = sparse.diags_array(white) @ _felt(model)
        hessian = (felt.T @ felt).tocsc()
        descent = hessian @ by - felt.T @ (white * np.nan_to_num(model.e).ravel())
        found = [(*_likeliest(hessian, descent, size), size) for size in DEVIATIONS]
        gain, by, told, deviation = max(found, key=lambda one: one[0])
        if gain < price:
            return start
        model = sent_at(model, times.late(by, deviation * np.sqrt(12.0), told)).fitted(1)
    return model


ARRIVALS = {"lost_commands": without_lost, "delay_jitter": late}
"""What is looked for in single targets."""


def _likeliest(hessian: Any, descent: FloatArray, deviation: float) -> tuple[float, FloatArray, float]:
    """Return the log evidence of a deviation over none [nats], the likeliest delays (K,), and how many of them readings
    determine.
    """
    of_prior = sparse.eye_array(len(descent), format="csc") / deviation**2
    by = splu(hessian + of_prior, permc_spec="NATURAL").solve(descent)

    def volume(share: float) -> float:
        made = splu(share * hessian + of_prior, permc_spec="NATURAL")
        return float(np.log(deviation**2 * np.abs(made.U.diagonal())).sum())

    told = (volume(1.01) - volume(0.99)) / 0.02
    return float(0.5 * descent @ by - 0.5 * volume(1.0)), by, told


def _apart(at: FloatArray) -> Iterator[IntArray]:
    """Yield targets sent at times (K,) that may be tried together, but for the first."""
    apart = int(np.ceil(HEARD / float(np.median(np.diff(at))))) if len(at) > 1 else 1
    for first in range(1, min(apart + 1, len(at))):
        yield np.arange(first, len(at), apart)


def _heard(model: Model, tried: IntArray) -> IntArray:
    """Return which of the targets tried each reading hears (T,), from 1; 0 before the first."""
    return np.searchsorted(model.data.record.sent[tried], model.data.record.t, side="right")


def _felt(model: Model) -> Any:
    """Return what a delay of each target does to the errors, for a second (T * J, K), sparse."""
    times = model.data.times
    size = len(times.at)
    felt = sparse.csr_array((model.e.size, size))
    for tried in _apart(model.data.record.sent):
        by = np.zeros(size)
        by[tried] = LATER
        change = np.nan_to_num(sent_at(model, times.late(by, 0.0, 0.0)).e - model.e) / LATER
        heard = _heard(model, tried)
        change[heard == 0] = 0.0
        column = np.repeat(tried[np.maximum(heard - 1, 0)], model.data.joints)
        rows = np.flatnonzero(change)
        felt = felt + sparse.csr_array((change.ravel()[rows], (rows, column[rows])), shape=felt.shape)
    return felt


def _neglected(model: Model) -> FloatArray:
    """Return by how much readings are likelier had each target not arrived (K,) [nats]; 0 beside one of which they say
    more.
    """
    data = model.data
    said = np.zeros(len(data.record.sent))
    near = 1
    for tried in _apart(data.record.sent):
        other = sent_at(model, data.times.without(tried))
        by = (misfit(model.e, model.scale, data) - misfit(other.e, model.scale, data)).sum(axis=1)
        said[tried] = np.bincount(_heard(model, tried), by, len(tried) + 1)[1:]
        near = int(tried[0])
    return np.where(said == maximum_filter1d(said, 2 * near + 1), said, 0.0)
