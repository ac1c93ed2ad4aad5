"""From toe targets to what the policy is asked for."""

from __future__ import annotations

import numpy as np

from mimic.records import CommandTrack, TargetTrack


def command_track(targets: TargetTrack) -> CommandTrack:
    """Return commands that stand in place, turn, crouch and lean with the track and bring the toes to its targets."""
    v = np.zeros((len(targets.t), 2))
    return CommandTrack(
        t=targets.t, v=v, heading=targets.heading, p_BE=targets.p_BE, trunk=targets.trunk, robot=targets.robot
    )
