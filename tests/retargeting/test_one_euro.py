from __future__ import annotations

import numpy as np
import pytest

from mimic.retargeting.one_euro import OneEuro

T = np.arange(120) / 30


def run(values: np.ndarray, min_cutoff: float = 1.5, beta: float = 4.0) -> np.ndarray:
    filtered = OneEuro(min_cutoff, beta)
    return np.array([filtered(t, x) for t, x in zip(T, values, strict=True)])


def test_what_does_not_move_is_not_changed():
    assert np.array_equal(run(np.tile([0.1, -0.2, 0.3], (120, 1))), np.tile([0.1, -0.2, 0.3], (120, 1)))


def test_noise_at_rest_is_calmed():
    noise = np.random.default_rng(0).normal(0, 0.01, (120, 3))
    assert run(noise)[30:].std() < 0.5 * noise[30:].std()


def test_a_quick_hand_lags_less_with_more_liveliness():
    way = np.stack([0.3 * np.sin(2 * np.pi * T), 0 * T, 0 * T], -1)
    calm, beta = (np.abs(run(way, beta=value) - way).mean() for value in (0.0, 4.0))
    assert beta < 0.6 * calm


def test_uneven_frames_give_the_same_motion():
    t = np.sort(np.random.default_rng(1).choice(np.arange(0, 4, 1 / 60), 160, replace=False))
    filtered = OneEuro(1.5, 4.0)
    got = np.array([filtered(time, np.array([0.2 * np.sin(3 * time)])) for time in t])[:, 0]
    even = run(0.2 * np.sin(3 * T)[:, None])[:, 0]
    np.testing.assert_allclose(np.interp(T[30:], t, got), even[30:], atol=0.03)


def test_it_begins_anew_where_it_was_asked_to_forget_or_time_stands_still():
    filtered = OneEuro(1.5, 4.0)
    filtered(0.0, np.zeros(3))
    assert filtered(0.1, np.ones(3)) == pytest.approx(np.full(3, filtered(0.1, np.ones(3))[0]), abs=1.0)
    filtered.forget()
    assert np.array_equal(filtered(0.2, np.full(3, 7.0)), np.full(3, 7.0))
    assert np.array_equal(filtered(0.2, np.full(3, 9.0)), np.full(3, 9.0))
