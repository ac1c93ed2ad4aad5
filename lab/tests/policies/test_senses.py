"""What a policy senses, and what it does not hear."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lab.policies.studies.senses import SENSES, Senses, SensingPolicy
from lab.policies.studies.settings import TableSettings
from mimic.policy.contract import AVERAGED, DQ_SCALE, GYRO_SCALE, PAPER_TERMS, TERMS
from mimic.policy.runtime import Policy, load_policy


@pytest.fixture(params=[PAPER_TERMS, TERMS], ids=["paper", "sensing"])
def seen(request, monkeypatch, description):
    """Return a function that makes a policy behind senses, and the list of what the network is given."""
    given: list[np.ndarray] = []

    def act(self, observation):
        given.append(observation.reshape(self.contract.history, -1))
        return np.zeros(12)

    monkeypatch.setattr(Policy, "act", act)

    def make(senses, seed=1):
        policy = load_policy(None, description)
        policy.contract = dataclasses.replace(policy.contract, terms=request.param, once=())
        return SensingPolicy(policy, senses, seed), given

    return make


def test_noise_is_on_what_is_measured_and_stays_with_its_frame(seen):
    policy, given = seen(Senses(noise_q=0.01, noise_axes=0.05, noise_gyro=0.2, noise_dq=1.0))
    columns = policy.contract.columns
    for _ in range(300):
        policy.act(np.ones(policy.contract.observation_size))
    noise = np.array(given) - 1.0
    noisy = np.zeros(policy.contract.frame_size)
    noisy[columns("joint_position")] = 0.01
    noisy[columns("down", "forward")] = 0.05
    noisy[columns("gyro")] = 0.2 * GYRO_SCALE
    noisy[columns("joint_velocity")] = 1.0 * DQ_SCALE
    slow = noise[280:, :, columns("slow_mean")]
    noise = np.delete(noise, columns("slow_mean"), axis=2)
    most, noisy = np.abs(noise).max(axis=(0, 1)), np.delete(noisy, columns("slow_mean"))
    if slow.size:  # it averages the noise away, the first of it slowly
        assert np.all(np.abs(slow) < 0.4 * noisy[columns(*AVERAGED)] + 1e-12)
        assert np.abs(slow).max() > 1e-3
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
    heard = np.ones(policy.contract.frame_size)
    heard[policy.contract.columns("velocity_command")] = 0.0
    heard[policy.contract.columns("slow_mean")[-2:]] = 0.0
    assert np.array_equal(given[0], np.tile(heard, (policy.contract.history, 1)))


def test_the_table_plays_all_of_them_the_paper_s_first():
    assert TableSettings().senses == tuple(SENSES)
    assert (SENSES["the paper's noise"].noise_q, SENSES["the paper's noise"].noise_axes) == (0.01, 0.05)
