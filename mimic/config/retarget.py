"""Settings of retargeting: wrists to toe targets."""

from __future__ import annotations

from typing import Literal

from mimic.config.ranges import Limited, within
from mimic.frozen import frozen

SLOWEST = 10.0
"""A motion is slowed down by at most this factor."""


@frozen
class RetargetSettings(Limited):
    """How wrist positions become toe targets."""

    rate: float = within(0.1, 0.05, 1.0, "s")
    """Time between two targets [s]."""
    mirror: bool = False
    """The person's left arm drives the right front leg, as in a mirror."""
    turns: bool = False
    """Follow slow turns of the person; otherwise the heading is constant."""
    heading: float | None = within(None, -180.0, 180.0, "degrees")
    """Heading of the person, instead of the estimate from shoulders and hips: 0 faces the camera, positive is turned
    to the person's left [deg]. With turns, the mean heading."""
    trunk: bool = True
    """Crouch and lean as the person does, as far as the robot can."""
    reach_quantile: float = within(0.98, 0.5, 1.0)
    """Quantile of the shoulder-wrist distance used as the arm length."""
    scale: float = within(1.0, 0.2, 2.0)
    """Scale of the motion in the robot's workspace."""
    slow_down: float | Literal["auto"] = within(1.0, 1.0, SLOWEST)
    """Play the motion this many times slower; auto: just enough to keep 95 % of the targets within the speed limit."""
