"""One linear step towards an effect."""

import numpy as np
import pytest

from mimic.dynamics.catalogue import BASELINE
from mimic.dynamics.effect_set import EffectValues
from mimic.dynamics.machine import MachineModel
from mimic.sysid.fit.least_squares import fit, fit_all, left_out_all, stepping


def test_one_step_says_most_of_the_hidden_effect_and_nearly_how_large_it_is(pair: MachineModel, log_of, problem_of):
    stiffness = np.array([0.3, -0.2])
    log = log_of(pair, EffectValues(name="spring", joints=pair.joints, values={"stiffness": stiffness, "moment": 0.05}))
    problem, point = problem_of(pair, log)
    fitted = fit(problem, point, BASELINE, {}, most=3)
    names = ("spring", "quadratic_drag", "coupling")
    asked = [stepping(problem, fitted.point, BASELINE, {}, fitted)]
    asked += [stepping(problem, fitted.point.with_effect(n, pair), [*BASELINE, n], {}, fitted) for n in names]
    fits = fit_all(problem, asked)
    none, *left = [squares.sum() for squares, _ in left_out_all(fits, problem, replays=False)]
    assert left[0] < 0.1 * none
    assert min(left[1:]) > 0.3 * none
    assert fits[1].point.values["spring", "stiffness"] == pytest.approx(stiffness, abs=0.1)


def test_what_a_step_says_is_what_a_replay_of_it_leaves(pair: MachineModel, log_of, problem_of):
    log = log_of(pair, EffectValues(name="spring", joints=("a",), values={"stiffness": 0.2, "moment": 0.0}))
    problem, point = problem_of(pair, log)
    fitted = fit(problem, point, BASELINE, {}, most=3)
    names = [*BASELINE, "spring"]
    (step,) = fit_all(problem, [stepping(problem, fitted.point.with_effect("spring", pair), names, {}, fitted)])
    said, replayed = (problem.mean_squares(r, False) for r in (step.residual, problem.residuals([step.point])[0]))
    assert replayed == pytest.approx(said, rel=0.1)
