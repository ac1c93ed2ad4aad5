"""Settings of the emulated robot."""

from __future__ import annotations

import math
from pathlib import Path

from mimic.config.ranges import Limited, within
from mimic.frozen import frozen


@frozen
class ServeOptions(Limited):
    """Where and how long the robot is served."""

    listen: str = "127.0.0.1:29536"
    """Address for socketcand; port 0 takes a free one. Keep it on this computer: whoever reaches it moves the robot."""
    slcan: bool = False
    """Also offer each bus as a serial adapter (slcan) on a pseudo-terminal, like a USB adapter."""
    buses: int = 1
    """Number of buses."""
    wiring: Path | None = None
    """Wiring file; default: the shipped one."""
    fault: tuple[str, ...] = ()
    """Faults to inject: `KIND[:PLACE][=VALUE][@[+]FROM[-UNTIL]]`, such as `motor_dead:FL_knee@12.5`, in seconds of the
    emulation, or with + since the first motor was switched on. An unknown kind prints the list."""
    seconds: float | None = within(None, 0.0, math.inf, "s")
    """End after this time [s]; default: at Ctrl-C."""
    every: float = within(10.0, 0.0, math.inf, "s")
    """Interval of the status lines [s]; 0 for none."""


@frozen
class EmulateSettings(Limited):
    """How the emulated robot behaves."""

    suspended: bool = False
    """Hang the robot by its trunk, feet free; otherwise it lies on the floor."""
    zeroed: bool = False
    """Start with the zeros set; otherwise they are lost, as after every power-up."""
    placement: float = within(0.05, 0.0, 0.4, "rad")
    """Largest distance of the joints from the lying pose at the start [rad]."""
    seed: int = within(0, 0, 2**63)
    """Seed of the encoders' mounting, the placement, noise and losses."""
    position_range: float = within(12.566370614359172, 1.0, 100.0, "rad")
    """Position range of the motors [rad]: 4 pi, or 12.5 as in the maker's sample code."""
    can_timeout: bool = False
    """The firmware supports CAN_TIMEOUT; otherwise writing it has no effect. A Go2: it damps after 0.5 s without a
    command; otherwise it holds the last one."""
    reply: float = within(250e-6, 0.0, 0.01, "s")
    """Delay of the answer to a command [s]. Source: cybergear_m5, its response time."""
    imu_noise: float = within(0.003, 0.0, 1.0, "rad/s")
    """Standard deviation of the gyro noise [rad/s]."""
