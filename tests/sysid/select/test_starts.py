"""Where the fit of an effect begins."""

from dataclasses import replace

import numpy as np
import pytest

from mimic.dynamics.catalogue import BASELINE, CATALOGUE
from mimic.dynamics.effect_set import EffectValues
from mimic.dynamics.machine import MachineModel
from mimic.sysid.fit.least_squares import fit
from mimic.sysid.fit.problem import Point
from mimic.sysid.select.starts import PredictedMotion, starting_points, starts_of


def test_cogging_is_looked_for_near_its_order(pair: MachineModel, log_of, problem_of) -> None:
    """Two thirds of a wave in the range of motion is near enough for the fit that begins there."""
    ripple = {"cosine": np.array([0.03, 0.05]), "sine": np.array([0.04, -0.02]), "order": np.array([37.0, 61.0])}
    log = log_of(pair, EffectValues(name="cogging", joints=pair.joints, values=ripple))
    problem, point = problem_of(pair, log)
    fitted = fit(problem, point, BASELINE, {}, most=1)
    motion = PredictedMotion(t=log.t, q=log.q, dq=np.gradient(log.q, log.t, axis=0), tau=np.zeros_like(log.q))
    order = starts_of("cogging", fitted, problem, motion)[0].values["cogging", "order"]
    assert order == pytest.approx(ripple["order"], abs=4.0 / np.ptp(log.q, axis=0).max())


def test_cogging_is_not_looked_for_beyond_its_bound(pair: MachineModel, log_of, problem_of) -> None:
    """The range of motion would allow orders up to 180; here ripple of another 700 is left."""
    log = log_of(pair)
    problem, point = problem_of(pair, log)
    fitted = fit(problem, point, BASELINE, {}, most=1)
    left = replace(fitted, residual=np.cos(700.0 * log.q))
    slow = 0.1 * log.q
    motion = PredictedMotion(t=log.t, q=slow, dq=np.gradient(slow, log.t, axis=0), tau=np.zeros_like(log.q))
    order = starts_of("cogging", left, problem, motion)[0].values["cogging", "order"]
    assert np.all(order <= CATALOGUE["cogging"].parameter("order").high)


def test_a_low_pass_begins_with_a_delay_that_is_shorter_by_its_time(pair: MachineModel, log_of, problem_of) -> None:
    log = log_of(pair)
    problem, point = problem_of(pair, log)
    fitted = fit(problem, point, BASELINE, {}, most=1)
    delayed = replace(fitted, point=Point({**fitted.point.values, ("delay", "time"): np.array([0.03])}))
    motion = PredictedMotion(t=log.t, q=log.q, dq=np.gradient(log.q, log.t, axis=0), tau=np.zeros_like(log.q))
    starts = [start.values for start in starts_of("target_filter", delayed, problem, motion)]
    times = [float(v["target_filter", "time"].mean()) for v in starts]
    assert min(times) > 0.0
    least = CATALOGUE["delay"].parameter("time").low
    assert [float(v["delay", "time"][0]) for v in starts] == pytest.approx([max(0.03 - t, least) for t in times])


@pytest.mark.slow
def test_backlash_begins_near_its_gap(pair: MachineModel, log_of, problem_of) -> None:
    """The sum of squares over it is rough: a fit finds it only from nearby, and the derivative there may lead away."""
    log = log_of(pair, EffectValues(name="backlash", joints=("a",), values={"gap": np.array([0.03])}))
    problem, point = problem_of(pair, log)
    fitted = fit(problem, point, BASELINE, {}, most=3)
    motion = PredictedMotion(t=log.t, q=log.q, dq=np.gradient(log.q, log.t, axis=0), tau=np.zeros_like(log.q))
    start = starting_points(problem, fitted, ["backlash"], motion)[0]
    assert start.joints[0]
    assert start.point.values["backlash", "gap"][0] == pytest.approx(0.03, rel=0.2)
