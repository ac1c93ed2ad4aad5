"""What a policy senses in an evaluation: readings with noise, or commands that it does not hear. The log stays true."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mimic.policy.contract import PolicyContract
from mimic.policy.runtime import Policy
from mimic.records import FloatArray


@dataclass(frozen=True, kw_only=True)
class Senses:
    """Noise on what a policy sees, drawn from -noise to +noise for each number at each control step."""

    noise_q: float = 0.0
    """Of joint positions [rad]."""
    noise_axes: float = 0.0
    """Of the world's axes seen from the base."""
    deaf: bool = False
    """Whether it sees a velocity command of zero, whatever is asked."""


SENSES = {
    "the paper's noise": Senses(noise_q=0.01, noise_axes=0.05),
    "a third of it": Senses(noise_q=0.0033, noise_axes=0.0167),
    "no noise": Senses(),
    "deaf to velocity": Senses(noise_q=0.01, noise_axes=0.05, deaf=True),
}
"""By name, the one that counts first. The paper's: IrisLi17/legged_stand_dance, commit 5515c10, ``add_noise``, which
its player leaves on."""


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
        self._half = _half_widths(policy.contract, senses)
        self._hears = np.ones_like(self._half)
        if senses.deaf:
            self._hears[_columns(policy.contract, "velocity_command")] = 0.0
        self._noise: FloatArray | None = None

    def act(self, observation: FloatArray) -> FloatArray:
        """Return the action (12,) for an observation (observation_size,), of which it senses the newest frame anew."""
        drawn = self._rng.uniform(-1.0, 1.0, self._half.shape) * self._half
        history = self.contract.history
        self._noise = np.tile(drawn, (history, 1)) if self._noise is None else np.vstack([self._noise[1:], drawn])
        return super().act((observation.reshape(history, -1) * self._hears + self._noise).ravel())


def _columns(contract: PolicyContract, name: str) -> slice:
    """Return where a term stands in a frame."""
    begin = 0
    for term, width in contract.terms:
        if term == name:
            return slice(begin, begin + width)
        begin += width
    raise KeyError(name)


def _half_widths(contract: PolicyContract, senses: Senses) -> FloatArray:
    half = np.zeros(sum(width for _, width in contract.terms))
    half[_columns(contract, "joint_position")] = senses.noise_q
    for axis in ("down", "forward"):
        half[_columns(contract, axis)] = senses.noise_axes
    return half
