"""Being led by the hand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from mimic.config.ranges import check_range

LONGEST_WATCH = 600.0
"""How long a robot can be watched when the hand has let go [s]."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LeadingSettings:
    """How a robot answers a pull on a front toe."""

    threshold: float = 1.5
    """Smaller pulls are ignored [N]. A standing robot that nobody touches feels up to 1 N."""
    full: float = 4.0
    """Pull at which the robot walks at full speed [N]."""
    speed: float = 0.3
    """Fastest velocity command [m/s]."""
    turn_rate: float = 0.6
    """Fastest turn toward a sideways pull [rad/s]."""
    smoothing: float = 0.4
    """Time constant of the low pass on the pull [s]."""

    def __post_init__(self) -> None:
        check_range("threshold", self.threshold, 0.0, 20.0, "N")
        check_range("full", self.full, self.threshold + 0.1, 50.0, "N")
        check_range("speed", self.speed, 0.0, 1.0, "m/s")
        check_range("turn-rate", self.turn_rate, 0.0, 2.0, "rad/s")
        check_range("smoothing", self.smoothing, 0.0, 5.0, "s")


@dataclass(frozen=True, kw_only=True, slots=True)
class HandSettings:
    """A simulated hand that takes a front toe, walks off with it on a straight line, and lets go."""

    toe: Literal["left", "right"] = "left"
    """Toe that the hand takes."""
    direction: float = 0.0
    """Direction of the hand, relative to where the belly faces; positive to the left [deg]."""
    way: float = 5.0
    """Distance that the hand moves [m]."""
    speed: float = 0.2
    """Speed of the hand [m/s]."""
    most: float = 8.0
    """Maximum pull [N]; beyond it the toe slips through the fingers."""
    stiffness: float = 60.0
    """Stiffness of the spring between hand and toe [N/m]."""
    begin: float = 4.0
    """Time at which the hand takes the toe [s]."""
    after: float = 3.0
    """Time after the hand lets go [s]."""

    def __post_init__(self) -> None:
        check_range("direction", self.direction, -360.0, 360.0, "deg")
        check_range("way", self.way, 0.1, 100.0, "m")
        check_range("speed", self.speed, 0.01, 2.0, "m/s")
        check_range("most", self.most, 0.1, 50.0, "N")
        check_range("stiffness", self.stiffness, 1.0, 1000.0, "N/m")
        check_range("begin", self.begin, 2.0, 60.0, "s")
        check_range("after", self.after, 2.0, LONGEST_WATCH, "s")

    @property
    def end(self) -> float:
        """When it lets go [s]."""
        return self.begin + self.way / self.speed
