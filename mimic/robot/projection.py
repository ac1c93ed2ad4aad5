"""The closest image of a smooth map under bounds and smooth inequalities: Newton steps on small quadratic programs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from mimic.records import FloatArray

SMALL_CURVATURE = 1e-4
"""Least curvature that a step trusts [m^2/rad^2]; a leg's own is 0.01 to 0.08."""
PENALTY = 10.0
"""Weight of a violated inequality [m] against half the squared distance [m^2], per metre of distance and one more."""

MOST_STEPS = 40
"""Of a search."""

LEAST_GAIN = 1e-12
"""A step that gains less than this ends the search [m^2]."""


@dataclass(frozen=True, slots=True)
class Local:
    """The map around one q."""

    p: FloatArray
    """Image (m,) [m]."""
    jacobian: FloatArray
    """Of the image (m, n) [m/rad]."""
    curvature: Callable[[FloatArray], FloatArray]
    """Weights (m,) -> sum of the weighted second derivatives of the image (n, n)."""
    gap: FloatArray
    """Inequalities gap >= 0 that are near or violated (k,) [m]."""
    gap_jacobian: FloatArray
    """(k, n) [m/rad]."""


def quadratic_program(h: FloatArray, g: FloatArray, rows: FloatArray, least: FloatArray) -> FloatArray | None:
    """Return the x (n,) that minimises x'hx/2 + g'x with rows @ x >= least, or None where there is none.

    Source: Lawson and Hanson, "Solving Least Squares Problems", 1974, chapter 23, problem LDP, after the change of
    variable z = L'x + L^-1 g with h = LL'.
    """
    inverse = np.linalg.inv(np.linalg.cholesky(h))
    shift = inverse @ g
    e = rows @ inverse.T
    f = least + e @ shift
    if np.all(f <= 0.0):
        return -inverse.T @ shift
    stacked = np.vstack([e.T, f])
    target = np.zeros(len(stacked))
    target[-1] = 1.0
    u: FloatArray = nnls(stacked, target)[0]
    r = stacked @ u - target
    if -r[-1] < 1e-10:
        return None
    return inverse.T @ (-r[:-1] / r[-1] - shift)


def project(
    look: Callable[[FloatArray], Local],
    wanted: FloatArray,
    q: FloatArray,
    low: FloatArray,
    high: FloatArray,
) -> tuple[FloatArray, Local]:
    """Return a q whose image is nearest to the wanted one among its neighbours that keep all bounds.

    Args:
        look: The map and its inequalities around a q.
        wanted: Wanted image (m,) [m].
        q: Where to start (n,) [rad].
        low, high: Bounds (n,) [rad].
    """
    q = np.clip(q, low, high)
    here = look(q)
    trust = 0.5
    eye = np.eye(len(q))
    penalty = PENALTY * (1.0 + float(np.linalg.norm(wanted - here.p)))
    for _ in range(MOST_STEPS):
        miss = wanted - here.p
        g = -here.jacobian.T @ miss
        h = here.jacobian.T @ here.jacobian - here.curvature(miss)
        values, axes = np.linalg.eigh(h)
        h = (axes * np.maximum(np.abs(values), SMALL_CURVATURE)) @ axes.T
        down = np.maximum(low - q, -trust)
        up = np.minimum(high - q, trust)
        rows = np.vstack([eye, -eye, here.gap_jacobian])
        most = np.where(here.gap_jacobian > 0.0, up, down)
        possible = np.sum(here.gap_jacobian * most, axis=1)
        x = quadratic_program(h, g, rows, np.concatenate([down, -up, np.minimum(-here.gap, 0.5 * possible)]))
        if x is None:
            x = np.clip(np.linalg.lstsq(here.gap_jacobian, -here.gap, rcond=None)[0], down, up)
        new = np.clip(q + x, low, high)
        there = look(new)
        gain = _merit(wanted, here, penalty) - _merit(wanted, there, penalty)
        if gain >= 0.0:
            q = new
            here = there
            trust = min(2.0 * trust, 0.5)
            if gain < LEAST_GAIN:
                break
        else:
            trust = 0.25 * max(float(np.max(np.abs(x))), 1e-12)
            if trust < 1e-8:
                break
    return q, here


def _merit(wanted: FloatArray, here: Local, penalty: float) -> float:
    miss = wanted - here.p
    return 0.5 * float(miss @ miss) + penalty * float(np.sum(np.maximum(-here.gap, 0.0)))
