"""What a pull on a front toe asks of a robot that is led by the hand.

Written once for numpy and PyTorch: the robot answers in training as it does when it is led.
"""

from __future__ import annotations

import math
from typing import Any

from mimic.config.leading import LeadingSettings

BACKWARD = math.radians(120.0)
"""Pulled from further behind than this it walks backward; otherwise it turns its belly to the pull [rad]."""

MOST_AHEAD = 0.6
"""A turn is not asked for further ahead of the robot than this [rad]."""

TURNING_GAIN = 2.0
"""Turn rate for each radian that the pull is away from straight ahead or back [1/s]."""


def answer_to_pull(forward: Any, left: Any, settings: LeadingSettings, xp: Any) -> tuple[Any, Any, Any]:
    """Return what a smoothed pull asks for.

    Args:
        forward: Its component ahead in the heading frame (...,) [N].
        left: Its component to the left (...,) [N].
        settings: How the robot answers.
        xp: numpy, or torch for tensors.

    Returns:
        Velocity command forward (...,) [m/s], turn rate to the left (...,) [rad/s], and how strong the pull is, from 0
        at the threshold to 1 (...,).
    """
    share = xp.clip((xp.hypot(forward, left) - settings.threshold) / (settings.full - settings.threshold), 0.0, 1.0)
    away = xp.arctan2(left, forward)
    behind = xp.abs(away) > BACKWARD
    away = xp.where(behind, away - xp.sign(away) * math.pi, away)
    speed = settings.speed * share * xp.clip(xp.cos(away), 0.0, 1.0)
    rate = share * xp.clip(TURNING_GAIN * away, -settings.turn_rate, settings.turn_rate)
    return xp.where(behind, -speed, speed), rate, share
