"""Settings of retargeting: wrists to toe targets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from mimic.config.ranges import check_range

SLOWEST = 10.0
"""A motion is slowed down by at most this factor."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RetargetSettings:
    """How wrist positions become toe targets."""

    rate: float = 0.1
    """Time between two targets [s]."""
    mirror: bool = False
    """The person's left arm drives the right front leg, as in a mirror."""
    turns: bool = False
    """Follow slow turns of the person; otherwise the heading is constant."""
    heading: float | None = None
    """Heading of the person, instead of the estimate from shoulders and hips: 0 faces the camera, positive is turned
    to the person's left [deg]. With turns, the mean heading."""
    trunk: bool = True
    """Crouch and lean as the person does, as far as the robot can."""
    keep_peaks: bool = True
    """Move each target to the nearest reversal within half a step, so that slow rates keep the peak of a punch."""
    reach_quantile: float = 0.98
    """Quantile of the shoulder-wrist distance used as the arm length."""
    scale: float = 1.0
    """Scale of the motion in the robot's workspace."""
    slow_down: float | Literal["auto"] = 1.0
    """Play the motion this many times slower; auto: just enough to keep 95 % of the targets within the speed limit."""

    def __post_init__(self) -> None:
        check_range("rate", self.rate, 0.05, 1.0, "s")
        check_range("reach-quantile", self.reach_quantile, 0.5, 1.0)
        if self.heading is not None:
            check_range("heading", self.heading, -180.0, 180.0, "degrees")
        check_range("scale", self.scale, 0.2, 2.0)
        if self.slow_down != "auto":
            check_range("slow-down", self.slow_down, 1.0, SLOWEST)
