"""Noise floor of a signal: how small its error can become."""

from __future__ import annotations

import numpy as np

from mimic.types import FloatArray


def noise_floor(values: FloatArray, block: int = 50) -> FloatArray:
    """Return the standard deviation of the noise of each column (J,).

    Third differences of a smooth motion vanish; those of white noise have 20 times its variance. A low quantile over
    short blocks passes over jerks.

    Args:
        values: Readings (T, J).
        block: Readings in a block.
    """
    d = np.diff(values, 3, axis=0)
    count = max(1, len(d) // block)
    blocks = d[: count * block].reshape(count, -1, values.shape[1])
    return np.sqrt(np.quantile(np.mean(blocks**2, axis=1), 0.3, axis=0) / 20.0)
