"""Speed and acceleration limits of joint motions: without lag for a whole motion, causal for a live one."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from mimic.records import FloatArray

STEPS = 400
"""Most iterations of the splitting."""
TIGHTER = 0.98
"""The splitting works on limits smaller by this, so that what it leaves open still keeps the limits."""


def limit_track(q: FloatArray, dt: float, speed: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Return the motion nearest to q that keeps joint speeds and accelerations; it neither lags nor leads.

    Least squares over the whole motion, min |x - q|^2 with |x[i+1] - x[i]| <= speed dt and
    |x[i+1] - 2 x[i] + x[i-1]| <= acceleration dt^2, so that a motion played backwards is limited alike. A motion that
    keeps the limits is returned unchanged.

    Args:
        q: Joint motion (T, n) [rad].
        dt: Time between rows [s].
        speed: Most speed of each joint (n,) [rad/s].
        acceleration: Most acceleration of each joint (n,) [rad/s^2].

    Source: Boyd et al., "Distributed Optimization and Statistical Learning via the Alternating Direction Method of
    Multipliers", 2011, section 5 (quadratic programs); a banded Cholesky factor serves every iteration.
    """
    rows = len(q)
    if rows < 3 or _keeps(q, dt, speed, acceleration):
        return q.copy()
    bounds = (speed * dt * TIGHTER, acceleration * dt * dt * TIGHTER)
    band = np.zeros((3, rows))
    band[0] = 1.0
    for stencil in ((-1.0, 1.0), (1.0, -2.0, 1.0)):
        for i, a in enumerate(stencil):
            for j in range(i, len(stencil)):
                start = rows - len(stencil) + 1
                band[j - i, i : i + start] += a * stencil[j]
    factor = (cholesky_banded(band, lower=True), True)
    x = q.copy()
    z = [np.clip(np.diff(q, n + 1, axis=0), -bound, bound) for n, bound in enumerate(bounds)]
    u = [np.zeros_like(part) for part in z]
    for _ in range(STEPS):
        right = q.copy()
        for n in range(2):
            right += _spread(z[n] - u[n], n + 1, rows)
        x = np.asarray(cho_solve_banded(factor, right))
        for n, bound in enumerate(bounds):
            slope = np.diff(x, n + 1, axis=0) + u[n]
            z[n] = np.clip(slope, -bound, bound)
            u[n] = slope - z[n]
        if _keeps(x, dt, speed, acceleration):
            break
    return x


def limit_step(
    q: FloatArray, dq: FloatArray, q_wanted: FloatArray, dt: float, speed: FloatArray, acceleration: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return joints and speeds one step later, on the way to q_wanted within the limits; for a live source.

    The speed never exceeds what can still be braked before the wanted joints.

    Args:
        q: Joints (n,) [rad].
        dq: Their speeds (n,) [rad/s].
        q_wanted: Where to go (n,) [rad].
        dt: Step [s].
        speed: Most speed (n,) [rad/s].
        acceleration: Most acceleration (n,) [rad/s^2].
    """
    error = q_wanted - q
    change = acceleration * dt
    braking = 0.5 * (np.sqrt(change * change + 8.0 * acceleration * np.abs(error)) - change)
    wanted = np.sign(error) * np.minimum(np.minimum(braking, speed), np.abs(error) / dt)
    dq = np.clip(wanted, dq - change, dq + change)
    return q + dq * dt, dq


def _keeps(q: FloatArray, dt: float, speed: FloatArray, acceleration: FloatArray) -> bool:
    slow = np.all(np.abs(np.diff(q, axis=0)) <= speed * dt)
    return bool(slow and np.all(np.abs(np.diff(q, 2, axis=0)) <= acceleration * dt * dt))


def _spread(slope: FloatArray, order: int, rows: int) -> FloatArray:
    """Return the transpose of np.diff of that order over the first axis."""
    for size in range(rows - order, rows):
        wider = np.zeros((size + 1, *slope.shape[1:]))
        wider[1:] += slope
        wider[:-1] -= slope
        slope = wider
    return slope
