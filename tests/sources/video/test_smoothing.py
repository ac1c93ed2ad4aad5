import numpy as np

from mimic.sources.video.smoothing import smooth

NO_CUTS = np.array([], dtype=np.int64)


def wave(t, hz):
    return np.sin(2 * np.pi * hz * t)[:, None]


def test_slow_motion_passes_without_lag_or_loss():
    t = np.arange(120) / 30
    inner = slice(10, -10)
    np.testing.assert_allclose(smooth(t, wave(t, 1.0), NO_CUTS, 6.0)[inner], wave(t, 1.0)[inner], atol=0.01)


def test_jitter_is_removed():
    t = np.arange(120) / 30
    assert np.abs(smooth(t, wave(t, 13.0), NO_CUTS, 6.0)[10:-10]).max() < 0.05


def test_uneven_frames_give_the_same_curve_as_even_ones():
    even = np.arange(121) / 30
    kept = np.sort(np.random.default_rng(3).choice(np.arange(1, 120), 80, replace=False))
    t = even[np.r_[0, kept, 120]]
    np.testing.assert_allclose(smooth(t, wave(t, 1.0), NO_CUTS, 6.0)[5:-5], wave(t, 1.0)[5:-5], atol=0.05)


def test_millisecond_stamps_change_nothing_that_matters():
    t = np.arange(90) / 30
    rounded = np.round(t, 3)
    np.testing.assert_allclose(
        smooth(rounded, wave(t, 2.0), NO_CUTS, 6.0), smooth(t, wave(t, 2.0), NO_CUTS, 6.0), atol=0.01
    )


def test_rows_that_are_gaps_stay_gaps_and_the_others_stay_numbers():
    t = np.arange(60) / 30
    values = wave(t, 1.0)
    values[[5, 20, 21, 22]] = np.nan
    values[35:50] = np.nan
    smoothed = smooth(t, values, NO_CUTS, 6.0)
    np.testing.assert_array_equal(np.isnan(smoothed), np.isnan(values))
    assert np.nanmax(np.abs(smoothed - values)) < 0.1


def test_a_cut_or_a_long_gap_keeps_its_step():
    t = np.arange(60) / 30
    step = np.where(np.arange(60) < 30, 0.0, 1.0)[:, None]
    np.testing.assert_allclose(smooth(t, step, np.array([30]), 6.0), step, atol=1e-9)
    assert np.abs(smooth(t, step, NO_CUTS, 6.0) - step).max() > 0.1
    later = np.where(np.arange(60) < 30, t, t + 1.0)
    np.testing.assert_allclose(smooth(later, step, NO_CUTS, 6.0), step, atol=1e-9)


def test_what_is_too_slow_or_too_short_for_the_cutoff_is_left_alone():
    slow = np.arange(20) / 10
    np.testing.assert_array_equal(smooth(slow, wave(slow, 1.0), NO_CUTS, 6.0), wave(slow, 1.0))
    short = np.arange(4) / 30
    np.testing.assert_array_equal(smooth(short, wave(short, 1.0), NO_CUTS, 6.0), wave(short, 1.0))


def test_the_input_is_not_changed():
    t = np.arange(60) / 30
    values = wave(t, 10.0)
    smooth(t, values, NO_CUTS, 6.0)
    np.testing.assert_array_equal(values, wave(t, 10.0))
