"""How certain fitted parameters are, and which combinations the log does not determine."""

from __future__ import annotations

import numpy as np

from mimic.records import FloatArray
from mimic.sysid.fit.least_squares import Fit, prior
from mimic.sysid.residuals import Key, Problem
from mimic.sysid.result import Correlations


def deviations(fitted: Fit, problem: Problem, moves: FloatArray) -> FloatArray:
    """Return jackknife standard deviations of the free parameters (P,), robust to coloured residuals.

    Args:
        fitted: The fit.
        problem: Log and model.
        moves: Changes of the free parameters without each block, from `left_out` (B_train, P).
    """
    count = len(moves)
    if count < 2 or not fitted.free_parameters:
        return np.full(len(fitted.free_parameters), np.inf)
    jackknife = np.sqrt((count - 1) / count * ((moves - moves.mean(0)) ** 2).sum(0))
    return np.maximum(jackknife, of_white_noise(fitted, problem))


def of_white_noise(fitted: Fit, problem: Problem) -> FloatArray:
    """Return the standard deviation of each free parameter (P,) for a white residual."""
    hessian = _information(fitted, problem)
    return np.sqrt(np.maximum(np.diag(np.linalg.pinv(hessian)), 0.0))


def correlations(fitted: Fit, problem: Problem) -> Correlations | None:
    """Return how the errors of the free parameters hang together for a white residual; none if nothing is free."""
    if not fitted.free_parameters:
        return None
    hessian, scale = _information(fitted, problem), np.array([k.step for k in fitted.free_parameters])
    covariance = np.linalg.pinv(hessian * scale[:, None] * scale[None], hermitian=True)
    spread = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    matrix = np.clip(covariance / spread[:, None] / spread[None], -1.0, 1.0)
    np.fill_diagonal(matrix, 1.0)
    names = tuple(k.called(problem.machine.joints) for k in fitted.free_parameters)
    return Correlations(names=names, matrix=matrix)


def _information(fitted: Fit, problem: Problem) -> FloatArray:
    """Return what data and prior say of the free parameters (P, P)."""
    return fitted.sums.over(problem.blocks.train)[0] + np.diag(prior(fitted.free_parameters))


def weak_directions(fitted: Fit, problem: Problem, condition: float = 1e6) -> list[dict[Key, list[int]]]:
    """Return combinations of free parameters that the log does not determine."""
    if not fitted.free_parameters:
        return []
    hessian, _ = fitted.sums.over(problem.blocks.train)
    scale = np.array([k.step for k in fitted.free_parameters])
    values, vectors = np.linalg.eigh(hessian * scale[:, None] * scale[None])
    found = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value * condition > values[-1]:
            break
        heavy: dict[Key, list[int]] = {}
        for i in np.flatnonzero(np.abs(vector) > 0.3):
            heavy.setdefault(fitted.free_parameters[i].key, []).append(fitted.free_parameters[i].joint)
        found.append(heavy)
    return found
