"""How a log is explained, and how one is simulated."""

from __future__ import annotations

from typing import Literal

from mimic.config.ranges import Limited, within
from mimic.errors import ConfigError
from mimic.frozen import frozen


@frozen
class CalibrateSettings(Limited):
    """How a log is explained."""

    baseline: tuple[str, ...] = ("coulomb", "viscous", "link_mass", "delay")
    """Effects that are always fitted, before the search. Source: Li et al. 2024, section IV."""
    effects: tuple[str, ...] = ()
    """Effects to search for; default: all but the experimental ones."""
    drive: Literal["log", "torque", "voltage"] = "log"
    """What the drives control: log takes it from the log's metadata; voltage, as in hobby servos, needs gain, voltage,
    kt and resistance there."""
    most_effects: int = within(4, 0, 20)
    """Maximum number of effects to report."""
    threads: int = within(0, 0, 1024)
    """Threads; 0: one per core."""

    def __post_init__(self) -> None:
        Limited.__post_init__(self)
        for option, names in (("baseline", self.baseline), ("effects", self.effects)):
            if len(set(names)) < len(names):
                raise ConfigError(f"--{option} names an effect twice: {', '.join(names)}")


@frozen
class LogMotion(Limited):
    """The motion of a simulated log."""

    motion: Literal["probe", "random"] = "probe"
    """probe shows every effect; random is for a second log."""
    seconds: float = 120.0
    """Length [s]."""
    amplitude: float = 1.0
    """Share of the joints' ranges that the motion uses."""
    kp: float | None = within(None, 0.0, 1e9, "N m/rad")
    """Position gain of the drives [N m/rad]; default: the model's."""
    kd: float | None = within(None, 0.0, 1e9, "N m s/rad")
    """Velocity gain of the drives [N m s/rad]; default: the model's."""


@frozen
class LogSettings(Limited):
    """How a log is simulated."""

    noise: float = within(0.00035, 0.0, 0.1, "rad")
    """Standard deviation of a position reading [rad]."""
    resolution: float = within(2 * 12.5 / 65535, 0.0, 0.1, "rad")
    """Step of a position reading [rad]; 16 bits over +-12.5 rad as in a CyberGear frame."""
    torque_noise: float = within(0.02, 0.0, 100.0, "N m")
    """Standard deviation of a torque reading [N m], which is the mean since the previous one."""
    rate_hz: float = within(200.0, 20.0, 2000.0, "Hz")
    """Readings per second [Hz]."""
    lost_samples: float = within(0.0, 0.0, 0.9)
    """Share of missing readings."""
    jitter: float = within(0.0, 0.0, 0.01, "s")
    """Standard deviation of the times of the readings [s]."""
    timestep: float = within(0.0002, 0.0001, 0.005, "s")
    """Physics step [s], 0.0001 to 0.005.

    Keep it short: calibration would report the error of long steps as an effect.
    """
    seed: int = within(0, 0, 2**63)
    """Seed of noise and losses."""
