"""What a pull asks for, in numpy and in PyTorch."""

from __future__ import annotations

import numpy as np
import pytest

from mimic.config.leading import LeadingSettings
from mimic.policy.leading import answer_to_pull

SETTINGS = LeadingSettings()


def answer(size: float, angle: float) -> tuple[float, float, float]:
    """The answer to a pull of so many newtons, so many degrees to the left of straight ahead."""
    forward, left = size * np.cos(np.deg2rad(angle)), size * np.sin(np.deg2rad(angle))
    return tuple(float(v) for v in answer_to_pull(forward, left, SETTINGS, np))  # type: ignore[return-value]


def test_a_weak_pull_asks_for_nothing():
    assert answer(SETTINGS.threshold - 0.01, 60.0) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("angle", [0.0, 10.0, -60.0, 90.0, 110.0])
def test_it_walks_forward_and_turns_to_a_pull_from_the_front_or_the_side(angle):
    speed, rate, share = answer(2 * SETTINGS.full, angle)
    assert share == 1.0
    assert speed == pytest.approx(SETTINGS.speed * max(np.cos(np.deg2rad(angle)), 0.0), abs=1e-9)
    assert abs(rate) <= SETTINGS.turn_rate
    assert np.sign(rate) == np.sign(angle)


@pytest.mark.parametrize(("angle", "turn"), [(180.0, 0), (170.0, -1), (-150.0, 1)])
def test_it_backs_away_from_a_pull_from_behind_and_turns_its_back_to_it(angle, turn):
    speed, rate, _ = answer(2 * SETTINGS.full, angle)
    assert speed < 0.0
    assert rate * turn > 0.0 or (turn == 0 and rate == pytest.approx(0.0, abs=1e-9))


@pytest.mark.train
def test_it_answers_in_torch_as_in_numpy():
    torch = pytest.importorskip("torch", reason="training needs the extra 'train'")
    pulls = np.random.default_rng(3).uniform(-6.0, 6.0, size=(200, 2))
    here = answer_to_pull(pulls[:, 0], pulls[:, 1], SETTINGS, np)
    tensor = torch.as_tensor(pulls)
    there = answer_to_pull(tensor[:, 0], tensor[:, 1], SETTINGS, torch)
    for one, other in zip(here, there, strict=True):
        assert other.numpy() == pytest.approx(one, abs=1e-12)
