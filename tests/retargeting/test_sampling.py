from __future__ import annotations

import numpy as np

from mimic.retargeting.sampling import EASE, HOLD, between, fill_gaps, target_times, turning_points

NEUTRAL = np.array([0.1, 0.2, -0.1])


def punch(t: np.ndarray, at: float, width: float = 0.11) -> np.ndarray:
    return 0.2 * np.exp(-0.5 * ((t - at) / width) ** 2)


def test_targets_come_every_step_and_end_with_the_track():
    t = np.arange(0.0, 2.03, 0.033)
    times = target_times(t, np.zeros((len(t), 3)), 0.1)
    assert np.allclose(np.diff(times)[:-1], 0.1)
    assert times[0] == t[0]
    assert times[-1] == t[-1]


def test_peaks_are_kept_at_any_phase():
    t = np.arange(0.0, 4.0, 1 / 30)
    for at in np.arange(1.0, 1.3, 0.02):
        p = np.stack([0 * t, 0 * t, -punch(t, at)], axis=1)
        times = target_times(t, p, 0.3)
        kept = between(times, between(t, p, times), t)
        assert -kept[:, 2].min() >= 0.95 * -p[:, 2].min()
        assert np.all(np.diff(times) > 0)
        assert len(times) == len(target_times(t, 0 * p, 0.3))


def test_of_two_punches_and_the_return_between_them_both_punches_stay():
    t = np.arange(0.0, 3.0, 1 / 30)
    p = np.stack([0 * t, 0 * t, -punch(t, 1.27, 0.05) - punch(t, 1.6, 0.05)], axis=1)
    times = target_times(t, p, 0.3)
    for at in (1.27, 1.6):
        assert np.min(np.abs(times - at)) < 0.02


def test_still_hands_have_no_turning_points():
    rng = np.random.default_rng(0)
    assert len(turning_points(0.002 * rng.normal(size=(200, 3)))) == 0


def test_a_short_gap_is_bridged_and_in_a_long_one_the_hand_waits():
    t = np.arange(0.0, 8.0, 0.02)
    p = np.tile([0.3, 0.1, 0.0], (len(t), 1))
    valid = ~(((t > 1.0) & (t < 1.2)) | ((t > 3.0) & (t < 6.0)))
    filled = fill_gaps(t, np.where(valid[:, None], p, np.nan), valid, NEUTRAL)
    assert np.isfinite(filled).all()
    assert np.abs(filled[(t > 1.0) & (t < 1.2)] - p[0]).max() < 1e-9
    middle = (t > 3.0 + HOLD + EASE + 0.05) & (t < 6.0 - HOLD - EASE - 0.05)
    assert np.abs(filled[middle] - NEUTRAL).max() < 1e-9
    assert np.abs(np.diff(filled, axis=0)).max() < 0.02


def test_gaps_at_the_ends_start_and_finish_at_neutral():
    t = np.arange(0.0, 6.0, 0.02)
    valid = (t > 2.5) & (t < 3.5)
    filled = fill_gaps(t, np.where(valid[:, None], 0.3, np.nan) * np.ones(3), valid, NEUTRAL)
    assert np.allclose(filled[0], NEUTRAL)
    assert np.allclose(filled[-1], NEUTRAL)
    assert np.array_equal(fill_gaps(t, filled, np.zeros(len(t), bool), NEUTRAL)[7], NEUTRAL)
