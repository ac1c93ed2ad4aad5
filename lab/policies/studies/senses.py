"""What a policy senses in an evaluation: readings with noise, or commands that it does not hear. The log stays true."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mimic.policy.contract import AVERAGED, DQ_SCALE, GYRO_SCALE, PolicyContract, with_slow_mean
from mimic.policy.runtime import Policy
from mimic.records import FloatArray


@dataclass(frozen=True, kw_only=True)
class Senses:
    """Noise on what a policy sees, drawn from -noise to +noise for each number at each control step."""

    noise_q: float = 0.0
    """Of joint positions [rad]."""
    noise_axes: float = 0.0
    """Of the world's axes seen from the base."""
    noise_gyro: float = 0.0
    """Of the gyro, for a policy that has one [rad/s]."""
    noise_dq: float = 0.0
    """Of joint velocities, likewise [rad/s]."""
    deaf: bool = False
    """Whether it sees a velocity command of zero, whatever is asked."""


SENSES = {
    "the paper's noise": Senses(noise_q=0.01, noise_axes=0.05, noise_gyro=0.2, noise_dq=1.0),
    "a third of it": Senses(noise_q=0.0033, noise_axes=0.0167, noise_gyro=0.067, noise_dq=0.33),
    "no noise": Senses(),
    "deaf to velocity": Senses(noise_q=0.01, noise_axes=0.05, noise_gyro=0.2, noise_dq=1.0, deaf=True),
}
"""By name, the one that counts first. The paper's: IrisLi17/legged_stand_dance, commit 5515c10, ``add_noise``, which
its player leaves on; it has no gyro and no joint velocities."""


class SensingPolicy(Policy):
    """A policy behind its senses, for one episode."""

    def __init__(self, policy: Policy, senses: Senses, seed: int) -> None:
        """Put senses before a policy.

        Args:
            policy: Answers.
            senses: What it senses.
            seed: Draws the noise.
        """
        self.__dict__.update(policy.__dict__)
        self._senses, self._rng = senses, np.random.default_rng([seed, 17])
        c = policy.contract
        self._half = _half_widths(c, senses)
        self._averaged = c.columns(*AVERAGED) if c.columns("slow_mean").size else np.empty(0, dtype=np.int64)
        self._slow: FloatArray | None = None
        self._hears = np.ones(c.frame_size)
        if senses.deaf:
            self._hears[c.columns("velocity_command")] = 0.0
            self._hears[c.columns("slow_mean")] = self._hears[self._averaged]
        self._noise: FloatArray | None = None

    def act(self, observation: FloatArray) -> FloatArray:
        """Return the action (12,) for an observation (observation_size,), of which it senses the newest frame anew."""
        c = self.contract
        drawn = self._rng.uniform(-1.0, 1.0, self._half.shape) * self._half
        if self._averaged.size:
            before = drawn[self._averaged] if self._slow is None else self._slow
            drawn, self._slow = with_slow_mean(drawn, before, self._averaged, c.dt, np)
        self._noise = np.tile(drawn, (c.history, 1)) if self._noise is None else np.vstack([self._noise[1:], drawn])
        width = c.history * c.frame_size
        frames = observation[:width].reshape(c.history, -1) * self._hears + self._noise
        return super().act(np.concatenate([frames.ravel(), observation[width:]]))


def _half_widths(contract: PolicyContract, senses: Senses) -> FloatArray:
    """Return the half width of the noise on each number of a frame but its slow mean, which averages noise too."""
    half = np.zeros(contract.frame_size - len(contract.columns("slow_mean")))
    half[contract.columns("joint_position")] = senses.noise_q
    half[contract.columns("down", "forward")] = senses.noise_axes
    half[contract.columns("gyro")] = senses.noise_gyro * GYRO_SCALE
    half[contract.columns("joint_velocity")] = senses.noise_dq * DQ_SCALE
    return half
