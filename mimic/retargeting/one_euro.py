"""One-Euro filter: a causal low-pass whose cut-off rises with speed.

Source: Casiez, Roussel and Vogel, "1 Euro Filter", CHI 2012, algorithms 1 and 2; the speed is that of the whole vector.
"""

from __future__ import annotations

import numpy as np

from mimic.records import FloatArray

SPEED_HZ = 1.0
"""Cut-off for the speed [Hz]; the paper's."""


class OneEuro:
    """Filters samples of one vector at their own times."""

    def __init__(self, min_cutoff: float, beta: float) -> None:
        """Set the filter's parameters.

        Args:
            min_cutoff: Cut-off at rest [Hz].
            beta: Rise of the cut-off with speed [Hz s/m].
        """
        self._min_cutoff = min_cutoff
        self._beta = beta
        self._t = float("nan")
        self._x: FloatArray | None = None
        self._speed: FloatArray = np.zeros(0)

    def __call__(self, t: float, x: FloatArray) -> FloatArray:
        """Return the filtered vector (n,) [m] at time t [s]; the first one, and one of no later time, as it is."""
        if self._x is None or not t > self._t:
            self._t = t
            self._x = np.array(x)
            self._speed = np.zeros_like(x)
            return self._x
        dt = t - self._t
        self._speed = self._speed + weight_of_new(SPEED_HZ, dt) * ((x - self._x) / dt - self._speed)
        cutoff = self._min_cutoff + self._beta * float(np.linalg.norm(self._speed))
        self._x = self._x + weight_of_new(cutoff, dt) * (x - self._x)
        self._t = t
        return self._x

    def forget(self) -> None:
        """Restart with the next sample."""
        self._x = None


def weight_of_new(cutoff_hz: float, dt: float) -> float:
    """Return the weight of a new value in a first-order low-pass."""
    tau = 1.0 / (2.0 * np.pi * cutoff_hz)
    return dt / (dt + tau)
