"""Motions that make a machine show its effects: position targets for calibration, the same for the same seed.

``probe`` holds what docs/manual/calibration.md asks for: the same multisine at both ends (noise floor, heat and
drift), a chirp (inertia, elasticity, lags), random steps (delay), slow triangles over the whole range (friction,
cogging), still poses (gravity, tilt, offsets), small reversals without and with load (backlash, Stribeck) and large
fast moves (torque limit). Each of these can be had alone. ``random`` is smoothed noise of mixed bandwidth with holds,
for a second log.

Joints move at the same time and independently, so any combination inside the given ranges must be safe. Targets jump
in ``steps`` and ``large``; start a machine that nobody has moved yet with a small ``size``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mimic.errors import ConfigError
from mimic.geometry import smoothstep
from mimic.records import FloatArray
from mimic.robot.description import RobotDescription

Kind = Literal["probe", "random", "chirp", "steps", "triangles", "poses", "small", "large"]

SHORTEST = 10.0
"""Below this no section has room to show anything [s]."""

LONGEST = 1e5
"""[s]"""

_HOLD = 0.5
"""Rest at the centre before each multisine [s]."""
_BLEND = 0.4
"""Time from one section to the next [s]."""

SECTIONS = ("chirp", "steps", "triangles", "poses", "small", "large")
"""Kinds that show one thing each."""

_SHARES = {"chirp": 0.2, "steps": 0.2, "triangles": 0.3, "poses": 0.1, "small": 0.1, "large": 0.1}
"""Sections between the two multisines, as shares of that time."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Excitation:
    """Targets over time."""

    t: FloatArray
    """When each target is sent (T,) [s], uniform, from 0."""
    q_des: FloatArray
    """Targets (T, J) [rad or m]."""


def hung_ranges(description: RobotDescription) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return low, high and centre (12,) [rad]: joint ranges of the hung robot in which nothing can touch."""
    probe = description.probe
    return probe.low, probe.high, probe.centre


def probe_targets(
    low: FloatArray,
    high: FloatArray,
    centre: FloatArray,
    *,
    seconds: float = 120.0,
    rate_hz: float = 50.0,
    seed: int = 0,
    kind: Kind = "probe",
    size: float = 1.0,
) -> Excitation:
    """Return targets that never leave the ranges.

    Args:
        low: Least target of each joint (J,) [rad or m]; see `hung_ranges`.
        high: Greatest target (J,).
        centre: Where the motion begins, and around which it is small where it is small (J,).
        seconds: Length; sections shrink in proportion, the multisines last 10 s from 60 s on.
        rate_hz: Targets per second.
        seed: Draws phases, levels and times.
        kind: ``probe``, one of its sections, or ``random``.
        size: Share of the range that is used, from 0 to 1.

    Raises:
        ConfigError: If the time is too short, the centre lies outside the ranges, or the kind is unknown.
    """
    low, high, centre = (np.asarray(v, dtype=np.float64) for v in (low, high, centre))
    if not np.all((low < centre) & (centre < high)):
        raise ConfigError("the centre of a joint must lie between its low and its high")
    if not SHORTEST <= seconds < LONGEST or rate_hz < 20.0 or not 0.0 < size <= 1.0:
        raise ConfigError(
            f"an excitation of {seconds:g} s at {rate_hz:g} Hz and size {size:g} is not possible; "
            f"it takes {SHORTEST:g} s to {LONGEST:g} s, 20 Hz and a size above 0 and up to 1"
        )
    rng = np.random.default_rng(seed)
    draw = _Draw(len(low), rate_hz, rng)
    if kind == "probe":
        signals = _probe(draw, seconds)
    elif kind == "random":
        signals = _random(draw, seconds)
    elif kind in SECTIONS:
        signals = [draw.rest(_HOLD), _sections(draw)[kind](seconds)]
    else:
        raise ConfigError(f"excitation {kind!r} does not exist; it is probe, random, {', '.join(SECTIONS)}")
    count = round(seconds * rate_hz)
    u = _joined(signals, count, round(_BLEND * rate_hz))
    q = centre + size * np.where(u > 0, u * (high - centre), u * (centre - low))
    return Excitation(t=np.arange(count) / rate_hz, q_des=np.clip(q, low, high))


@dataclass(frozen=True)
class _Draw:
    """Signals (n, J) between -1 (low) and 1 (high), 0 at the centre."""

    joints: int
    rate: float
    rng: np.random.Generator

    def times(self, seconds: float) -> FloatArray:
        return np.arange(max(2, round(seconds * self.rate)))[:, None] / self.rate

    def rest(self, seconds: float) -> FloatArray:
        return np.zeros((len(self.times(seconds)), self.joints))

    def multisine(self, seconds: float) -> FloatArray:
        """Nine sines from 0.1 to 6 Hz, 1/f above 0.5 Hz; fades in and out."""
        t = self.times(seconds)
        f = np.geomspace(0.1, 6.0, 9) * self.rng.uniform(0.9, 1.1, (self.joints, 9))
        phase = self.rng.uniform(0, 2 * np.pi, (self.joints, 9))
        waves = np.sin(2 * np.pi * f * t[:, :, None] + phase) * np.minimum(1.0, 0.5 / f)
        u = waves.sum(-1)
        fade = np.clip(np.minimum(t, t[-1] - t) / 0.5, 0, 1)
        return 0.8 * u / np.abs(u).max(0) * fade

    def chirp(self, seconds: float) -> FloatArray:
        """0.2 to 8 Hz and back, each joint elsewhere on the way; the amplitude falls with frequency."""
        t = self.times(seconds)
        s = (t / seconds + self.rng.random(self.joints)) % 1.0
        f = 0.2 * 40.0 ** (1.0 - np.abs(2.0 * s - 1.0))
        return np.sin(2 * np.pi * np.cumsum(f, 0) / self.rate) * np.minimum(0.7, 0.8 / f)

    def steps(self, seconds: float, reach: float, shortest: float, longest: float) -> FloatArray:
        """Random levels, each held for a random time."""
        n = len(self.times(seconds))
        u = np.empty((n, self.joints))
        for joint in range(self.joints):
            row = 0
            level = 0.0
            while row < n:
                stop = row + max(1, round(self.rng.uniform(shortest, longest) * self.rate))
                new = self.rng.uniform(0.4, 1.0) * reach * (-1 if level > 0 else 1)
                level = new if self.rng.random() < 0.8 else -0.5 * new
                u[row:stop, joint] = level
                row = stop
        return u

    def triangles(self, seconds: float, amplitude: float, slow: float, fast: float) -> FloatArray:
        t = self.times(seconds)
        f = self.rng.uniform(slow, fast, self.joints)
        phase = (f * t + self.rng.random(self.joints)) % 1.0
        return amplitude * (4.0 * np.abs(phase - 0.5) - 1.0)

    def poses(self, seconds: float) -> FloatArray:
        """Still poses of 0.8 to 1.2 s all over the range, all joints at once, reached by smooth moves of 0.3 s."""
        n = len(self.times(seconds))
        u = []
        level = np.zeros(self.joints)
        ease = _ease(max(2, round(0.3 * self.rate)))
        while sum(map(len, u)) < n:
            new = self.rng.uniform(-0.9, 0.9, self.joints)
            u.append(level + ease * (new - level))
            u.append(np.repeat(new[None], round(self.rng.uniform(0.8, 1.2) * self.rate), 0))
            level = new
        return np.concatenate(u)[:n]

    def small(self, seconds: float) -> FloatArray:
        """Triangles of 3 and 6 % of the range at 0.4 to 1 Hz: around the centre, then in a loaded pose."""
        half = seconds / 2
        loaded = self.rng.choice((-0.8, 0.8), self.joints)
        parts = [self.triangles(s / 2, a, 0.4, 1.0) for s in (half, half) for a in (0.06, 0.12)]
        n = len(self.times(seconds))
        u = np.concatenate(parts)
        u[len(parts[0]) + len(parts[1]) :] += loaded
        return np.concatenate((u, np.repeat(u[-1:], max(0, n - len(u)), 0)))[:n]

    def noise(self, seconds: float, cutoff: float, amplitude: float) -> FloatArray:
        """Gaussian noise through a low-pass of this frequency [Hz], as wide as amplitude."""
        n = len(self.times(seconds))
        spectrum = np.fft.rfft(self.rng.standard_normal((2 * n, self.joints)), axis=0)
        f = np.fft.rfftfreq(2 * n, 1.0 / self.rate)[:, None]
        u = np.fft.irfft(spectrum * np.exp(-((f / cutoff) ** 2)), axis=0)[:n]
        return np.clip(amplitude * u / np.abs(u).max(0), -1, 1)


def _probe(draw: _Draw, seconds: float) -> list[FloatArray]:
    sine = min(10.0, seconds / 6)
    between = seconds - 2 * (sine + _HOLD) - _BLEND
    same = np.concatenate((draw.rest(_HOLD), draw.multisine(sine)))
    make = _sections(draw)
    middle = [make[name](share * between) for name, share in _SHARES.items()]
    count = round(seconds * draw.rate) - 2 * len(same) - sum(map(len, middle))
    return [same, *middle, np.zeros((count, draw.joints)), same]


def _sections(draw: _Draw) -> dict[str, Callable[[float], FloatArray]]:
    """Return what makes each section of a length [s]."""
    return {
        "chirp": draw.chirp,
        "steps": lambda s: draw.steps(s, 0.4, 0.3, 1.0),
        "triangles": lambda s: draw.triangles(s, 0.97, 0.1, 0.25),
        "poses": draw.poses,
        "small": draw.small,
        "large": lambda s: draw.steps(s, 0.95, 0.35, 0.8),
    }


def _random(draw: _Draw, seconds: float) -> list[FloatArray]:
    signals = [draw.rest(_HOLD)]
    left = seconds - _HOLD
    while left > 0:
        for cutoff, amplitude in draw.rng.permutation([(0.3, 0.95), (1.0, 0.8), (2.5, 0.5), (5.0, 0.2)]):
            span = draw.rng.uniform(2.0, 5.0)
            noise = draw.noise(span, cutoff, amplitude)
            hold = np.repeat(noise[-1:], round(draw.rng.uniform(0.4, 1.0) * draw.rate), 0)
            signals += [noise, hold]
            left -= span + len(hold) / draw.rate
    return signals


def _ease(n: int) -> FloatArray:
    """Return 0 to 1 (n, 1) with rest at both ends."""
    return smoothstep(np.linspace(0.0, 1.0, n)[:, None])


def _joined(signals: list[FloatArray], count: int, blend: int) -> FloatArray:
    """Signals one after another; the first rows of each lead over from the last target before."""
    rows: list[FloatArray] = []
    for u in signals:
        if rows and not np.array_equal(rows[-1][-1], u[0]):
            n = min(blend, len(u))
            u = u.copy()
            u[:n] = rows[-1][-1] + _ease(n) * (u[:n] - rows[-1][-1])
        rows.append(u)
    return np.concatenate(rows)[:count]
