"""What a policy senses, and what it does not hear."""

from __future__ import annotations

import numpy as np
import pytest

from mimic.config.evaluation import TableSettings
from mimic.evaluation.senses import SENSES, Senses, SensingPolicy
from mimic.policy.contract import FRAME_SIZE, TERMS
from mimic.policy.runtime import Policy, load_policy


@pytest.fixture
def seen(monkeypatch, description):
    """Return a function that makes a policy behind senses, and the list of what the network is given."""
    given: list[np.ndarray] = []

    def act(self, observation):
        given.append(observation.reshape(-1, FRAME_SIZE))
        return np.zeros(12)

    monkeypatch.setattr(Policy, "act", act)
    return lambda senses, seed=1: (SensingPolicy(load_policy(None, description), senses, seed), given)


def columns(name):
    begin = 0
    for term, width in TERMS:
        if term == name:
            return slice(begin, begin + width)
        begin += width
    raise KeyError(name)


def test_noise_is_on_joints_and_axes_only_and_stays_with_its_frame(seen):
    policy, given = seen(Senses(noise_q=0.01, noise_axes=0.05))
    for _ in range(300):
        policy.act(np.ones(policy.contract.observation_size))
    noise = np.array(given) - 1.0
    noisy = np.zeros(FRAME_SIZE)
    noisy[columns("joint_position")] = 0.01
    noisy[columns("down")] = noisy[columns("forward")] = 0.05
    most = np.abs(noise).max(axis=(0, 1))
    assert np.all(most <= noisy)
    assert np.all(most >= 0.95 * noisy)
    assert np.allclose(noise[1:, :-1], noise[:-1, 1:])
    assert np.allclose(noise[0], noise[0, 0])
    assert np.abs(noise.mean(axis=0)[:, 0]).max() < 0.002


def test_a_seed_draws_the_same_noise(seen):
    first, given = seen(SENSES["the paper's noise"], 5)
    again, _ = seen(SENSES["the paper's noise"], 5)
    other, _ = seen(SENSES["the paper's noise"], 6)
    for policy in (first, again, other):
        policy.act(np.zeros(policy.contract.observation_size))
    assert np.array_equal(given[0], given[1])
    assert not np.array_equal(given[0], given[2])


def test_the_deaf_see_no_velocity_and_everything_else(seen):
    policy, given = seen(Senses(deaf=True))
    policy.act(np.ones(policy.contract.observation_size))
    heard = np.ones(FRAME_SIZE)
    heard[columns("velocity_command")] = 0.0
    assert np.array_equal(given[0], np.tile(heard, (policy.contract.history, 1)))


def test_the_table_plays_all_of_them_the_paper_s_first():
    assert TableSettings().senses == tuple(SENSES)
    assert (SENSES["the paper's noise"].noise_q, SENSES["the paper's noise"].noise_axes) == (0.01, 0.05)
