"""Being led by the hand."""

from __future__ import annotations

from mimic.config.ranges import Limited, check_range, within
from mimic.frozen import frozen


@frozen
class LeadingSettings(Limited):
    """How a robot answers a pull on a front toe."""

    threshold: float = within(1.5, 0.0, 20.0, "N")
    """Smaller pulls are ignored [N]. A standing robot that nobody touches feels up to 1 N."""
    full: float = 4.0
    """Pull at which the robot walks at full speed [N]."""
    speed: float = within(0.3, 0.0, 1.0, "m/s")
    """Fastest velocity command [m/s]."""
    turn_rate: float = within(0.6, 0.0, 2.0, "rad/s")
    """Fastest turn toward a sideways pull [rad/s]."""
    smoothing: float = within(0.4, 0.0, 5.0, "s")
    """Time constant of the low pass on the pull [s]."""

    def __post_init__(self) -> None:
        Limited.__post_init__(self)
        check_range("full", self.full, self.threshold + 0.1, 50.0, "N")
