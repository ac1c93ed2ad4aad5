"""Sensor dropouts: what a log shows in place of readings that are missing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mimic.config.play import RunSettings
from mimic.control.dropouts import RESTS, DropoutFilter, fill_dropouts
from mimic.records import RobotState, RunLog
from mimic.simulation.plant import SimulatedPlant

SHORT = RunSettings(stand_up=1.0, blend=0.1, hold_last=0.0)


@pytest.fixture
def log(play, fixed_policy, track, description) -> RunLog:
    return play(SimulatedPlant(description, samples=False), fixed_policy(), track(2), SHORT).log


def test_a_log_without_dropouts_stays_as_it_is(log, description):
    filled = fill_dropouts(log, description)
    for f in dataclasses.fields(RunLog):
        if "axes" in f.metadata:
            assert np.array_equal(getattr(filled, f.name), getattr(log, f.name), equal_nan=True), f.name


def test_a_missing_reading_is_the_one_before_it(log, description):
    q = log.q.copy()
    q[10:13, 4] = np.nan
    filled = fill_dropouts(dataclasses.replace(log, q=q), description).q
    assert np.all(filled[10:13, 4] == log.q[9, 4])


def test_a_base_position_that_is_not_measured_puts_a_foot_on_the_ground(log, description):
    missing = np.full_like(log.p_WB, np.nan)
    filled = fill_dropouts(dataclasses.replace(log, p_WB=missing, v_WB=missing), description)
    assert np.isfinite(filled.p_WB).all()
    assert np.abs(filled.p_WB[:, 2] - log.p_WB[:, 2]).max() < 0.03


def lying(description) -> RobotState:
    return SimulatedPlant(description, samples=False).start()


def test_a_gyro_shows_its_bias_while_the_robot_lies_and_not_afterwards(description):
    filter_, state = DropoutFilter(description), lying(description)
    bias, rng = np.array([0.05, -0.03, 0.02]), np.random.default_rng(0)
    for _ in range(100):
        filter_.rest(dataclasses.replace(state, omega_B=bias + rng.uniform(-0.02, 0.02, 3)))
    filter_.rest(dataclasses.replace(state, omega_B=bias + 10 * RESTS))  # somebody lifts it
    turning = dataclasses.replace(state, omega_B=bias + [1.0, 2.0, 3.0])
    assert filter_.fill(turning).omega_B == pytest.approx([1.0, 2.0, 3.0], abs=0.005)


def test_velocities_that_are_missing_are_held_for_two_ticks_and_are_then_zero(description):
    filter_, state = DropoutFilter(description), lying(description)
    filter_.fill(dataclasses.replace(state, omega_B=np.full(3, 0.5), dq=np.full(12, 0.2)))
    nothing = np.full(12, np.nan)
    gone = dataclasses.replace(state, omega_B=nothing[:3], dq=nothing, q=nothing)
    seen = [filter_.fill(gone) for _ in range(4)]
    assert [s.omega_B[0] for s in seen] == [0.5, 0.5, 0.0, 0.0]
    assert [s.dq[3] for s in seen] == [0.2, 0.2, 0.0, 0.0]
    assert all(np.isfinite(s.q).all() for s in seen)


def test_a_gyro_that_is_doubted_is_not_used(description):
    filter_, state = DropoutFilter(description), lying(description)
    filter_.fill(dataclasses.replace(state, omega_B=np.full(3, 0.5)))
    assert filter_.fill(dataclasses.replace(state, omega_B=np.full(3, 9.0)), doubted=True).omega_B[0] == 0.5
