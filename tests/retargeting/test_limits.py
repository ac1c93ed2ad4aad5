from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mimic.retargeting.limits import limit_step, limit_track

DT, SPEED, ACCELERATION = 0.02, np.array([7.0, 5.0]), np.array([400.0, 100.0])


def jumps(seed: int) -> np.ndarray:
    return np.repeat(np.random.default_rng(seed).uniform(-1, 1, (6, 2)), 25, axis=0)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10_000))
def test_limits_hold_and_time_has_no_direction(seed):
    q = jumps(seed)
    slow = limit_track(q, DT, SPEED, ACCELERATION)
    assert np.all(np.abs(np.diff(slow, axis=0)) <= SPEED * DT * 1.001)
    assert np.all(np.abs(np.diff(slow, 2, axis=0)) <= ACCELERATION * DT**2 * 1.001)
    assert np.allclose(limit_track(q[::-1], DT, SPEED, ACCELERATION)[::-1], slow, atol=1e-9)


def test_a_slow_motion_is_unchanged():
    q = np.outer(np.sin(np.arange(200) * DT), [1.0, -0.5])
    assert np.array_equal(limit_track(q, DT, SPEED, ACCELERATION), q)


def test_a_jump_is_crossed_in_the_middle():
    q = np.where(np.arange(101) < 50, 0.0, 1.0)[:, None] * [1.0, 1.0]
    slow = limit_track(q, DT, SPEED, ACCELERATION)
    assert np.allclose(slow[49] + slow[50], 1.0, atol=0.02)


def test_a_live_joint_arrives_and_keeps_its_limits():
    q, dq, rows = np.zeros(2), np.zeros(2), []
    for _ in range(100):
        q, dq = limit_step(q, dq, np.array([1.0, -1.0]), DT, SPEED, ACCELERATION)
        rows.append(q)
    track = np.array([np.zeros(2), *rows])
    assert np.allclose(q, [1.0, -1.0], atol=1e-6)
    assert np.all(np.abs(np.diff(track, axis=0)) <= SPEED * DT + 1e-12)
    assert np.all(np.abs(np.diff(track, 2, axis=0)) <= ACCELERATION * DT**2 + 1e-12)
    assert np.abs(track).max() < 1.02
