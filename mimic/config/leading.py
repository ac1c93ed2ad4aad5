"""Being led by the hand."""

from __future__ import annotations

from typing import Literal

from mimic.config.ranges import Limited, check_range, within
from mimic.frozen import frozen

LONGEST_WATCH = 600.0
"""How long a robot can be watched when the hand has let go [s]."""


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


@frozen
class HandSettings(Limited):
    """A simulated hand that takes a front toe, walks off with it on a straight line, and lets go."""

    toe: Literal["left", "right"] = "left"
    """Toe that the hand takes."""
    direction: float = within(0.0, -360.0, 360.0, "deg")
    """Direction of the hand, relative to where the belly faces; positive to the left [deg]."""
    way: float = within(5.0, 0.1, 100.0, "m")
    """Distance that the hand moves [m]."""
    speed: float = within(0.2, 0.01, 2.0, "m/s")
    """Speed of the hand [m/s]."""
    most: float = within(8.0, 0.1, 50.0, "N")
    """Maximum pull [N]; beyond it the toe slips through the fingers."""
    stiffness: float = within(60.0, 1.0, 1000.0, "N/m")
    """Stiffness of the spring between hand and toe [N/m]."""
    begin: float = within(4.0, 2.0, 60.0, "s")
    """Time at which the hand takes the toe [s]."""
    after: float = within(3.0, 2.0, LONGEST_WATCH, "s")
    """Time after the hand lets go [s]."""

    @property
    def end(self) -> float:
        """When it lets go [s]."""
        return self.begin + self.way / self.speed
