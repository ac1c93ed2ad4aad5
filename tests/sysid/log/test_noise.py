"""The step of a coarse encoder is read off a log, and none is where there is none."""

import numpy as np
import pytest

from mimic.records import FloatArray
from mimic.sysid.log.noise import coarse_steps

NOISE = 0.35e-3
RATE = 200.0


def motion(seconds: float = 20.0) -> FloatArray:
    t = np.arange(0.0, seconds, 1 / RATE)
    return 0.4 * np.sin(2 * np.pi * 0.31 * t) + 0.15 * np.sin(2 * np.pi * 1.3 * t + 1.0)


def read(q: FloatArray, seed: int = 0) -> FloatArray:
    """Return readings (T, 1) with noise."""
    return (q + np.random.default_rng(seed).normal(0.0, NOISE, len(q)))[:, None]


def assert_none(readings: FloatArray) -> None:
    step, noise = coarse_steps(readings, np.array([NOISE]))
    assert step == [0.0]
    assert noise == [NOISE]


@pytest.mark.parametrize("step", [0.002, 0.0024, 0.0073, 0.0165])
def test_the_step_of_an_encoder_is_read_off(step: float) -> None:
    floor = np.hypot(NOISE, step / np.sqrt(12.0) / 3)
    found, noise = coarse_steps(read(step * np.round(motion() / step)), np.array([floor]))
    assert found == pytest.approx([step], rel=1e-3)
    assert noise == pytest.approx([np.hypot(NOISE, step / np.sqrt(12.0))], rel=0.02)


def test_where_rounding_makes_most_of_the_noise_too() -> None:
    step = 0.0025
    found, _ = coarse_steps(read(step * np.round(motion() / step)), np.array([0.35 * step]))
    assert found == pytest.approx([step], rel=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_a_fine_encoder_has_none(seed: int) -> None:
    assert_none(read(motion(), seed))


def test_places_where_a_joint_rests_are_no_steps() -> None:
    """Poses 30 mrad apart, and moves between them: all readings but a few are multiples of that."""
    rng = np.random.default_rng(1)
    poses = 0.03 * rng.integers(-10, 10, 12)
    at = np.arange(0.0, 24.0, 1 / RATE)
    q = np.interp(at, np.sort(np.concatenate([2.0 * np.arange(12), 2.0 * np.arange(12) + 1.5])), np.repeat(poses, 2))
    assert_none(read(q))


def test_a_narrow_motion_has_none() -> None:
    """It covers half of a tenth of a radian: that its readings agree says nothing."""
    assert_none(read(0.05 * motion()))


def test_each_joint_has_its_own() -> None:
    steps = 0.004, 0.0, 0.009
    q = np.concatenate([read(motion() if s == 0 else s * np.round(motion() / s)) for s in steps], axis=1)
    found, _ = coarse_steps(q, np.full(3, 2 * NOISE))
    assert found == pytest.approx(steps, rel=1e-3)


def test_a_joint_that_never_moves_has_none() -> None:
    assert_none(read(np.zeros(2000)))


def test_steps_are_not_looked_for_in_a_motion_of_many_turns() -> None:
    """It would take more memory than there is."""
    assert_none(read(1e5 * motion()))
