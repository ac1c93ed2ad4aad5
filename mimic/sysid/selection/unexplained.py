"""The residual that no effect explains: does it depend on the state, on time alone, or on nothing?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import signal

from mimic.records import FloatArray, IntArray
from mimic.sysid.result import UnexplainedResidual
from mimic.sysid.search import PredictedMotion
from mimic.sysid.thresholds import RULES

STATE_R2 = 0.1
"""Share that the state predicts on blocks that were not used, from which on the rest depends on the state."""

PEAK = 40.0
"""Height of a spectral peak over the median, from which on the rest is periodic. Effects in the model leave 2 to 8."""

COHERENT = 0.4
"""Coherence with the torque at a peak, from which on the robot's own motion made it."""

STEADY_R2 = 0.1
"""Share that one sine wave predicts on blocks that were not used, from which on the rest is periodic."""

OF_THE_BASE = 0.5
"""Share of the squares of a torque that a motion of the base removes, from which on the rest is called that."""

BURST_SHARE, BURST_TIME = 0.5, 0.1
"""So much of the squares in so little of the time are single events."""

FEATURES = 160
"""Random Fourier features of the regression on the state."""


def unexplained_residuals(
    joints: Sequence[str],
    residual: FloatArray,
    motion: PredictedMotion,
    target: FloatArray,
    blocks: IntArray,
    neighbour: IntArray,
    base: FloatArray | None = None,
) -> tuple[UnexplainedResidual, ...]:
    """Classify the residual of each joint.

    Args:
        joints: Names.
        residual: In noise floors (T, J); NaN where a reading does not count.
        motion: What the model does.
        target: Targets (T, J).
        blocks: Block of each reading, -1 where it does not count (T,).
        neighbour: Index of the joint next to each (J,).
        base: Share of the torque that is left which a motion of the base removes (J,), where one explains it.
    """
    found = []
    for j, name in enumerate(joints):
        rest = _remainder(name, residual[:, j], _state(j, motion, target, int(neighbour[j])), blocks, motion.t)
        if base is not None and rest.verdict != "explained" and base[j] > OF_THE_BASE:
            rest = replace(rest, verdict="moving base", depends_on=("the base",))
        found.append(rest)
    return tuple(found)


def _state(j: int, motion: PredictedMotion, target: FloatArray, n: int) -> dict[str, FloatArray]:
    error = target[:, j] - motion.q[:, j]
    late = np.concatenate([error[:10], error[:-10]])
    v = motion.dq[:, j]
    return {
        "position": motion.q[:, [j]],
        "velocity": np.stack([v, np.tanh(v / 0.05)], -1),
        "torque": np.stack([motion.tau[:, j], error, late], -1),
    } | ({} if n == j else {"another joint": np.stack([motion.q[:, n], motion.dq[:, n]], -1)})


def _remainder(
    name: str, residual: FloatArray, state: dict[str, FloatArray], blocks: IntArray, t: FloatArray
) -> UnexplainedResidual:
    rows = (blocks >= 0) & np.isfinite(residual)
    r = residual[rows].astype(np.float64)
    ratio = float(np.sqrt(np.mean(r**2)))
    dt = float(np.median(np.diff(t)))
    peak_hz, peak_ratio = _peak(r, dt)
    slow = _low_pass(r, dt)
    inputs = {k: v[rows] for k, v in state.items()}
    r2 = predicted(slow, inputs, blocks[rows])
    depends: tuple[str, ...] = ()
    if ratio >= RULES.explained and r2 > STATE_R2:
        alone = {k: predicted(slow, {k: v}, blocks[rows]) for k, v in inputs.items()}
        lost = {k: r2 - predicted(slow, {n: v for n, v in inputs.items() if n != k}, blocks[rows]) for k in inputs}
        score = {k: max(alone[k], 0.0) + max(lost[k], 0.0) for k in inputs}
        top = max(score.values())
        depends = tuple(sorted((k for k in score if score[k] > 0.4 * top), key=lambda k: -score[k]))
    if ratio < RULES.explained:
        verdict = "explained"
    elif r2 > STATE_R2:
        verdict = "state-dependent"
    elif peak_ratio > PEAK and _coherence(r, inputs["torque"][:, 0], dt, peak_hz) >= COHERENT:
        verdict = "state-dependent"
        depends = ("torque",)
    elif peak_ratio > PEAK and _steady(slow, t[rows], blocks[rows], peak_hz) > STEADY_R2:
        verdict = "periodic"
        depends = ("time",)
    else:
        verdict = "events" if _bursts(r, dt) else "broadband"
    return UnexplainedResidual(
        joint=name,
        ratio=ratio,
        state_r2=r2,
        depends_on=depends,
        peak_hz=peak_hz,
        peak_ratio=peak_ratio,
        verdict=verdict,
    )


def _peak(r: FloatArray, dt: float) -> tuple[float, float]:
    size = min(len(r), int(10.0 / dt))
    frequency, power = signal.welch(r - r.mean(), 1 / dt, nperseg=size)
    inside = frequency > 0.15
    at = int(np.argmax(power[inside]))
    return float(frequency[inside][at]), float(power[inside][at] / max(np.median(power[inside]), 1e-12))


def _coherence(r: FloatArray, x: FloatArray, dt: float, at_hz: float) -> float:
    size = min(len(r), int(5.0 / dt))
    frequency, coherence = signal.coherence(r, x, 1 / dt, nperseg=size)
    return float(np.max(coherence[np.abs(frequency - at_hz) <= 0.3], initial=0.0))


def _steady(r: FloatArray, t: FloatArray, blocks: IntArray, near_hz: float) -> float:
    """Return the share of the variance of r (T,) that a sine wave near a frequency predicts on blocks left out.

    Something external keeps its phase; what the robot's own motion makes comes and goes with it.
    """
    span = float(t[-1] - t[0])
    best, wave = -1.0, np.zeros((len(r), 2))
    for frequency in np.arange(max(near_hz - 0.15, 0.1), near_hz + 0.15, 0.25 / span):
        angle = 2 * np.pi * frequency * t
        a = np.stack([np.cos(angle), np.sin(angle)], -1)
        fitted = a @ np.linalg.lstsq(a, r, rcond=None)[0]
        if (found := float(fitted @ r)) > best:
            best, wave = found, a
    error, total = 0.0, 0.0
    for fold in range(5):
        test = blocks % 5 == fold
        w = np.linalg.lstsq(wave[~test], r[~test], rcond=None)[0]
        error += float(np.sum((r[test] - wave[test] @ w) ** 2))
        total += float(np.sum(r[test] ** 2))
    return 1.0 - error / max(total, 1e-12)


def _bursts(r: FloatArray, dt: float) -> bool:
    """Return whether most of what noise does not explain of r (T,), in noise floors, is in a few fifths of a second."""
    rows = max(int(0.2 / dt), 1)
    squares = (r[: len(r) // rows * rows] ** 2).reshape(-1, rows).mean(1) - 1.0
    top = np.sort(squares)[::-1][: max(int(BURST_TIME * len(squares)), 1)]
    return bool(top.sum() > BURST_SHARE * np.maximum(squares, 0.0).sum() and squares.sum() > 0)


def _low_pass(r: FloatArray, dt: float, cutoff: float = 15.0) -> FloatArray:
    if cutoff >= 0.45 / dt or len(r) < 60:
        return r
    return signal.sosfiltfilt(signal.butter(2, cutoff, fs=1 / dt, output="sos"), r)


def predicted(r: FloatArray, inputs: dict[str, FloatArray], blocks: IntArray, folds: int = 5) -> float:
    """Return the share of the variance of r (T,) that inputs predict on blocks left out; negative where they mislead.

    Ridge regression on random Fourier features of the scaled inputs; whole blocks are left out, because neighbouring
    readings are alike.
    """
    x = np.concatenate(list(inputs.values()), -1)
    x = (x - x.mean(0)) / (x.std(0) + 1e-9)
    rng = np.random.default_rng(0)
    weights = rng.standard_normal((x.shape[1], FEATURES)) / np.sqrt(x.shape[1]) * rng.choice([0.5, 1.5, 4.0], FEATURES)
    a = np.concatenate([x, np.cos(x @ weights + rng.uniform(0, 2 * np.pi, FEATURES)), np.ones((len(x), 1))], -1)
    every = max(1, len(r) // 12000)
    fold = (blocks % folds).astype(int)
    error, total = 0.0, 0.0
    for k in range(folds):
        train, test = (fold != k), (fold == k)
        if not test.any() or not train.any():
            continue
        b = a[train][::every]
        ridge = 1e-3 * len(b) * np.eye(a.shape[1])
        w = np.linalg.solve(b.T @ b + ridge, b.T @ r[train][::every])
        error += float(np.sum((r[test] - a[test] @ w) ** 2))
        total += float(np.sum((r[test] - r[train].mean()) ** 2))
    return 1.0 - error / max(total, 1e-12)
