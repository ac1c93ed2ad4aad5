"""The step of a coarse encoder, estimated from its readings."""

from __future__ import annotations

import numpy as np

from mimic.records import FloatArray

AGREEMENT = 0.5
"""Mean of the unit vectors of the readings from which on they are multiples of a step."""

FINEST_STEP = 2.5
"""Least step of a coarse encoder that is looked for, in noise floors.

Rounding is a 3.5th of a step and in the floor too: where readings agree by a half, a step is 2.9 floors.
"""

COARSEST_STEP = 0.1
"""Greatest step that is looked for [rad]."""

WINDS = 8.0
"""Bins in the finest step."""

LEAST_CHANGE = 4.0
"""Change between the readings before and after, in noise floors, from which on a joint moves: where it rests, readings
agree with each other whatever the encoder.
"""

MOST_BINS = 1 << 24
"""Steps are not looked for in a motion over more bins: it turns a hundred times and more."""

LEAST_LEVELS = 6
"""Fewest steps in the range of motion: few places of a slow joint agree by themselves."""


def coarse_steps(q: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the encoder steps (J,), 0 where none is found, and noise floors that include the rounding (J,) [rad].

    Args:
        q: Readings (T, J) [rad].
        noise: Noise floors (J,) [rad]; they have a part of the rounding, as far as joints move in the time that they
            are taken from.
    """
    found = [_step_of(column, float(floor)) for column, floor in zip(q.T, noise, strict=True)]
    step, agreement = (np.array(row) for row in zip(*found, strict=True))
    beside = step / (2.0 * np.pi) * np.sqrt(-2.0 * np.log(np.clip(agreement, AGREEMENT, 1.0)))  # of a wrapped normal
    return step, np.maximum(noise, np.hypot(step / np.sqrt(12.0), beside))


def _step_of(q: FloatArray, noise: float) -> tuple[float, float]:
    """Return the step of a coarse encoder with readings q (T,), 0 if none, and how well they agree with it.

    Readings that are multiples of a step agree in phase when they are wound round a circle of that length.
    """
    every = max(1, len(q) // 3000)
    there = np.zeros(len(q), dtype=bool)
    there[1:-1] = np.abs(q[2:] - q[:-2]) > LEAST_CHANGE * noise
    moving, q = (q - q.mean())[there], (q - q.mean())[::every]
    most, spacing = 1.0 / max(FINEST_STEP * noise, 1e-4), 1.0 / (6.0 * max(float(np.ptp(q)), 1e-6))
    if most <= 1.0 / COARSEST_STEP or not len(moving):
        return 0.0, 1.0
    width = 1.0 / (WINDS * most)  # of a bin: readings in it agree in phase by more than 0.99
    bins = max(1.0 / (spacing * width), np.ptp(q) / width)
    if bins > MOST_BINS:
        return 0.0, 1.0
    counts = np.bincount(((q - q.min()) / width).astype(int))
    size = int(2 ** np.ceil(np.log2(max(bins, len(counts)))))
    around = np.fft.rfftfreq(size, width)
    agreement = np.abs(np.fft.rfft(counts, size)) / len(q)
    agreement[(around < 1.0 / COARSEST_STEP) | (around > most)] = 0.0
    best = around[int(np.argmax(agreement))]
    near = best + np.linspace(-1, 1, 41) * spacing
    agree = [_agreement(q, f) for f in near]
    found = float(near[int(np.argmax(agree))])
    sure = max(agree) >= AGREEMENT and _agreement(moving, found) >= AGREEMENT
    return (1.0 / found, max(agree)) if sure and np.ptp(moving) * found >= LEAST_LEVELS else (0.0, 1.0)


def _agreement(q: FloatArray, around: float) -> float:
    return float(abs(np.mean(np.exp(2j * np.pi * around * q))))
