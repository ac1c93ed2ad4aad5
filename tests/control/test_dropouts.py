"""Sensor dropouts: what a log shows in place of readings that are missing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mimic.config.play import RunSettings
from mimic.control.dropouts import fill_dropouts
from mimic.records import RunLog
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
