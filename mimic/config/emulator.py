"""Settings of the emulated robot."""

from __future__ import annotations

from dataclasses import dataclass

from mimic.config.ranges import check_range


@dataclass(frozen=True, kw_only=True, slots=True)
class EmulateSettings:
    """How the emulated robot behaves."""

    suspended: bool = False
    """Hang the robot by its trunk, feet free; otherwise it lies on the floor."""
    zeroed: bool = False
    """Start with the zeros set; otherwise they are lost, as after every power-up."""
    placement: float = 0.05
    """Largest distance of the joints from the lying pose at the start [rad]."""
    seed: int = 0
    """Seed of the encoders' mounting, the placement, noise and losses."""
    position_range: float = 12.566370614359172
    """Position range of the motors [rad]: 4 pi, or 12.5 as in the maker's sample code."""
    can_timeout: bool = False
    """The firmware supports CAN_TIMEOUT; otherwise writing it has no effect. A Go2: it damps after 0.5 s without a
    command; otherwise it holds the last one."""
    reply: float = 250e-6
    """Delay of the answer to a command [s]. Source: cybergear_m5, its response time."""
    imu_noise: float = 0.003
    """Standard deviation of the gyro noise [rad/s]."""

    def __post_init__(self) -> None:
        check_range("placement", self.placement, 0.0, 0.4, "rad")
        check_range("position-range", self.position_range, 1.0, 100.0, "rad")
        check_range("reply", self.reply, 0.0, 0.01, "s")
        check_range("imu-noise", self.imu_noise, 0.0, 1.0, "rad/s")
