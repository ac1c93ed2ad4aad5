"""Settings of the emulated robot."""

from __future__ import annotations

from mimic.config.ranges import Limited, within
from mimic.frozen import frozen


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
