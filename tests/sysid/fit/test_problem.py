"""A log and a model as a least-squares problem: fine steps, weights, blocks judged without themselves."""

import numpy as np
import pytest

from mimic.dynamics.catalogue import BASELINE
from mimic.dynamics.effect_set import EffectValues
from mimic.dynamics.machine import MachineModel
from mimic.sysid.fit.baseline import settled, with_fine_derivatives
from mimic.sysid.fit.least_squares import fit, left_out
from mimic.sysid.fit.problem import Point
from mimic.sysid.log.noise import coarse_steps, noise_floor


@pytest.mark.slow
def test_a_block_that_alone_shows_a_limit_is_not_judged_by_a_linear_model(
    pair: MachineModel, log_of, problem_of
) -> None:
    """Without it nothing determines the limit: what a straight line makes of that is worse than any replay."""
    weak = EffectValues(name="torque_speed", joints=("a", "b"), values={"torque": 2.5, "speed": 9.0, "flat": 0.0})
    problem, baseline = problem_of(pair, log_of(pair, weak, fast=1.0))
    start = baseline.with_effect("torque_speed", pair, {"torque": 3.5, "speed": 12.0, "flat": 0.0})
    fitted = fit(problem, start, [*BASELINE, "torque_speed"], {}, most=3)
    squares, _ = left_out(fitted, problem)
    without = problem.block_squares(fit(problem, baseline, BASELINE, {}, most=3).residual)[problem.blocks.train]
    assert squares.sum() < 0.5 * without.sum()
    assert np.all(squares < 10.0 * without.max())


def test_the_step_of_an_encoder_is_read_off_where_it_makes_most_of_the_noise(pair: MachineModel, log_of) -> None:
    log = log_of(pair, EffectValues(name="encoder_step", joints=("a",), values={"angle": np.array([0.0025])}))
    noise = noise_floor(log.q, log.rate)
    assert noise[0] > 1.3 * noise[1]
    assert coarse_steps(log.q, noise)[0] == pytest.approx([0.0025, 0.0], abs=1e-5)


@pytest.mark.slow
def test_a_chain_that_lacks_an_effect_does_not_bend_what_all_share(pair, log_of, problem_of):
    """A slow current loop in one chain looks like a delay of the machine; the other chain then seems early."""
    lag = EffectValues(name="torque_lag", joints=("a",), values={"time": np.array([0.03])})
    delay = EffectValues(name="delay", values={"time": np.array([0.011])})
    problem, start = problem_of(pair, log_of(pair, lag, delay, fast=1.0), 0.0025)
    first = fit(problem, start, BASELINE, {}, most=5)
    weighed = problem.weighed(first.residual)
    assert weighed is not problem
    again = fit(weighed, first.point, BASELINE, {}, most=5)
    errors = [abs(f.point.values["delay", "time"][0] - 0.011) for f in (first, again)]
    assert errors[1] < 0.5 * errors[0]
    left = [problem.mean_squares(f.residual, True)[1] for f in (first, again)]
    assert left[0] > 5.0
    assert left[1] < 1.3


@pytest.mark.slow
def test_chains_alike_have_equal_weights(pair, log_of, problem_of):
    problem, start = problem_of(pair, log_of(pair))
    fitted = fit(problem, start, BASELINE, {}, most=5)
    assert problem.weighed(fitted.residual) is problem
    assert problem.weight == pytest.approx([1.0, 1.0], abs=0.2)


@pytest.mark.slow
def test_what_goes_together_without_a_change_has_derivatives_that_cancel(
    pair: MachineModel, log_of, problem_of
) -> None:
    """Gains, masses, rotors and friction times the same number move alike; a fit may not seem sure of that number."""
    problem, _ = problem_of(pair, log_of(pair, fast=1.0), 0.0025)
    names = ["coulomb", "viscous", "link_mass", "armature", "gains"]
    point = Point.of(names, pair)
    free_parameters = problem.free_parameters(point, {}, names)
    columns = problem.columns_in_fine_steps(point, free_parameters)
    together = sum(value * column for value, column in zip(point.read(free_parameters), columns, strict=True))
    assert np.sqrt(np.nanmean(np.square(together))) < 0.2


@pytest.mark.slow
def test_a_fit_in_fine_steps_finds_what_coarse_ones_are_wrong_about(pair: MachineModel, log_of, problem_of) -> None:
    """The scale of all forces shows in a millisecond after each target only; see the last test."""
    soft = EffectValues(name="gains", joints=("a", "b"), values={"kp": np.full(2, 0.7), "kd": np.ones(2)})
    problem, baseline = problem_of(pair, log_of(pair, soft, fast=1.0, timestep=0.00025), 0.005)
    names = [*BASELINE, "gains"]
    start = baseline.with_effect("gains", pair, {"kp": 0.9, "kd": 1.0})
    ((problem, coarse),) = settled(problem, [(fit(problem, start, names, {}, most=10), names, {})])
    fine = problem.in_finer_replay(coarse.point)
    np.testing.assert_allclose(fine.residuals([coarse.point]), problem.in_fine_steps([coarse.point]), atol=1e-3)
    again = fit(fine, coarse.point, names, {}, most=10, frozen=with_fine_derivatives(problem, coarse), every=0)
    left = [np.nansum(problem.in_fine_steps([f.point])[0, problem.blocks.fitted] ** 2) for f in (coarse, again)]
    off = [np.abs(f.point.values["gains", "kp"] - 0.7).max() for f in (coarse, again)]
    assert left[1] < left[0]
    assert off[1] < 0.5 * off[0]


def test_blocks_have_offsets_where_what_is_left_wanders_but_not_beside_white_noise(
    pair: MachineModel, log_of, problem_of
) -> None:
    problem, start = problem_of(pair, log_of(pair))
    rng = np.random.default_rng(0)
    white = rng.standard_normal((len(problem.blocks.index), 2))
    assert problem.with_block_offsets(white) is problem
    steps = 4.0 * rng.standard_normal(len(problem.blocks.held_out))[problem.blocks.index]
    wandering = problem.with_block_offsets(white + np.stack([steps, np.zeros(len(steps))], -1))
    assert wandering.offsets[0] > 0.95
    assert wandering.offsets[1] == 0.0
    plain, less = (p.residuals([start])[0] for p in (problem, wandering))
    block = problem.blocks.index == 1
    means = plain[block].mean(0)
    assert less[block].mean(0) == pytest.approx((1.0 - wandering.offsets) * means, abs=1e-4)
    assert less[block, 0] - less[block, 0].mean() == pytest.approx(plain[block, 0] - means[0], abs=1e-4)
    assert np.array_equal(less[block, 1], plain[block, 1])
