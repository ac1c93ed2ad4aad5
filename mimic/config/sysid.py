"""How a log is explained, and how one is simulated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from mimic.config.ranges import check_range
from mimic.errors import ConfigError


@dataclass(frozen=True, kw_only=True, slots=True)
class CalibrateSettings:
    """How a log is explained."""

    baseline: tuple[str, ...] = ("coulomb", "viscous", "link_mass", "delay")
    """Effects that are always fitted, before the search. Source: Li et al. 2024, section IV."""
    effects: tuple[str, ...] = ()
    """Effects to search for; default: all but the experimental ones."""
    drive: Literal["log", "torque", "voltage"] = "log"
    """What the drives control: log takes it from the log's metadata; voltage, as in hobby servos, needs gain, voltage,
    kt and resistance there."""
    most_effects: int = 4
    """Maximum number of effects to report."""
    threads: int = 0
    """Threads; 0: one per core."""

    def __post_init__(self) -> None:
        for option, names in (("baseline", self.baseline), ("effects", self.effects)):
            if len(set(names)) < len(names):
                raise ConfigError(f"--{option} names an effect twice: {', '.join(names)}")
        check_range("most-effects", self.most_effects, 0, 20)
        check_range("threads", self.threads, 0, 1024)


@dataclass(frozen=True, kw_only=True, slots=True)
class LogSettings:
    """How a log is simulated."""

    noise: float = 0.00035
    """Standard deviation of a position reading [rad]."""
    resolution: float = 2 * 12.5 / 65535
    """Step of a position reading [rad]; 16 bits over +-12.5 rad as in a CyberGear frame."""
    torque_noise: float = 0.02
    """Standard deviation of a torque reading [N m], which is the mean since the previous one."""
    rate_hz: float = 200.0
    """Readings per second [Hz]."""
    lost_samples: float = 0.0
    """Share of missing readings."""
    jitter: float = 0.0
    """Standard deviation of the times of the readings [s]."""
    timestep: float = 0.0002
    """Physics step [s], 0.0001 to 0.005.

    Keep it short: calibration would report the error of long steps as an effect.
    """
    seed: int = 0
    """Seed of noise and losses."""

    def __post_init__(self) -> None:
        check_range("noise", self.noise, 0.0, 0.1, "rad")
        check_range("resolution", self.resolution, 0.0, 0.1, "rad")
        check_range("torque-noise", self.torque_noise, 0.0, 100.0, "N m")
        check_range("seed", self.seed, 0, 2**63)
        check_range("rate-hz", self.rate_hz, 20.0, 2000.0, "Hz")
        check_range("lost-samples", self.lost_samples, 0.0, 0.9)
        check_range("jitter", self.jitter, 0.0, 0.01, "s")
        check_range("timestep", self.timestep, 0.0001, 0.005, "s")
