"""From where the robot is looked at: as the camera looked at the person, so that both can be compared at a glance."""

from __future__ import annotations

import numpy as np

from mimic.config.retarget import RetargetSettings
from mimic.records import PoseTrack, TargetTrack
from mimic.retargeting.wrists import torso_heading

SIDEWAYS = float(np.radians(22.0))
"""Angle of a camera that has no person to compare with, from straight ahead to the left; it makes depth visible [rad].
"""


def seen_from(pose: PoseTrack | None, targets: TargetTrack | None) -> float:
    """Return from which side the camera saw the person [rad]: 0 in front, positive to the left of the person.

    Of a mirrored motion it is the other side. Without a camera it is SIDEWAYS.
    """
    if pose is None or not any(pose.size):
        return SIDEWAYS
    turns = targets is not None and bool(np.ptp(targets.heading) > 1e-6)
    heading = float(torso_heading(pose, RetargetSettings(turns=turns))[0])
    mirrored = targets is not None and bool(targets.report.get("mirror"))
    return heading if mirrored else -heading
