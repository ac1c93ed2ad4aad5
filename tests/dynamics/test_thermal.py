from __future__ import annotations

import numpy as np
import pytest

from mimic.dynamics.thermal import MotorHeat, seconds_to_limit, winding_rise


def limit_of(torque: float, description, *, ticks: int = 100, dt: float = 0.02) -> np.ndarray:
    return seconds_to_limit(np.full((ticks, 12), torque), dt, description)


@pytest.mark.parametrize("point", range(9))
def test_the_times_of_the_overload_table_come_back(point, description, overload):
    torque, seconds = overload[0][point], overload[1][point]
    for sign in (1.0, -1.0):
        assert np.allclose(np.log(limit_of(sign * torque, description) / seconds), 0.0, atol=0.17)


@pytest.mark.parametrize("share", [0.0, 0.5, 0.999])
def test_a_motor_below_its_rated_torque_never_reaches_its_limit(share, description):
    assert np.all(np.isinf(limit_of(share * description.torque_rated, description)))


def test_more_torque_is_borne_for_less_time(description):
    seconds = [limit_of(torque, description)[0] for torque in np.linspace(4.1, 12.0, 40)]
    assert np.all(np.diff(seconds) < 0)


def test_repeating_a_log_is_the_same_as_a_long_log(description):
    rng = np.random.default_rng(0)
    tau, dt = rng.uniform(0.0, 12.0, (150, 12)), 0.1
    found = seconds_to_limit(tau, dt, description)
    long = winding_rise(np.tile(tau, (40, 1)), dt, description)
    reached = (np.argmax(long >= 1.0, axis=0) + 1) * dt
    assert np.all(long[-1] > 1.0)
    assert np.allclose(found, reached, atol=1e-6)


def test_a_motor_cools_when_it_rests(description):
    tau = np.concatenate([np.full((100, 1), 10.0), np.zeros((10_000, 1))])
    rise = winding_rise(tau, 1.0, description)[:, 0]
    assert rise[99] > 1.0
    assert np.all(np.diff(rise[100:]) < 0)
    assert rise[-1] < 0.05


def test_rest_in_between_lets_a_motor_last_longer(description):
    half = np.tile([[8.0], [0.0]], (500, 1))
    assert seconds_to_limit(half, 0.02, description)[0] > 4 * limit_of(8.0, description)[0]


def test_one_torque_at_a_time_gives_the_same_rise_as_all_at_once(description):
    tau = np.random.default_rng(0).uniform(-12.0, 12.0, (500, 12))
    heat = MotorHeat(description, np.full(12, 25.0))
    rise = [heat.add(row, 0.02) for row in tau]
    assert np.allclose(rise, winding_rise(tau, 0.02, description), rtol=1e-9)


def test_a_torque_that_is_not_known_counts_as_the_one_before(description):
    known, gap = MotorHeat(description, np.full(12, 25.0)), MotorHeat(description, np.full(12, 25.0))
    for tick in range(20):
        rise = known.add(np.full(12, 9.0), 0.02), gap.add(np.full(12, 9.0 if tick % 2 == 0 else np.nan), 0.02)
    assert np.array_equal(*rise)


def test_a_motor_that_is_warm_already_reaches_its_limit_sooner(description):
    warm = MotorHeat(description, np.array([70.0, np.nan, 25.0, 10.0] + [25.0] * 8))
    rise = warm.add(np.zeros(12), 0.02)
    assert 0.3 < rise[0] < 0.6
    assert np.array_equal(rise[1:], np.zeros(11))
