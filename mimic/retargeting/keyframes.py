"""From key frames to toe targets and velocities, clamped and limited like a person's."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.interpolate import PchipInterpolator

from mimic.config.retarget import RetargetSettings
from mimic.io.keyframes import KeyFrames
from mimic.records import CommandTrack, TargetTrack
from mimic.retargeting.commands import command_track
from mimic.retargeting.targets import reachable_track
from mimic.robot.reach import FRONT, Reach


def keyframe_commands(motion: KeyFrames, reach: Reach, settings: RetargetSettings) -> tuple[CommandTrack, TargetTrack]:
    """Return what the policy is asked for, and how its toes were clamped.

    Joints go from key frame to key frame on a shape-preserving cubic and turn into toes by forward kinematics; these
    are clamped and limited as a person's are. The heading is interpolated linearly, and the velocity is
    that of the next frame. Scale, mirror and rate are a person's and have no say.
    """
    dt = reach.description.dt
    times = np.cumsum([0.0, *(frame.duration for frame in motion.frames)])
    t = dt * np.arange(int(times[-1] / dt + 1e-6) + 1)
    start = reach.description.poses["upright"][:FRONT]
    q = PchipInterpolator(times, np.stack([start, *(frame.q for frame in motion.frames)]), axis=0)(t)
    heading = np.interp(t, times, [0.0, *(frame.heading for frame in motion.frames)])
    row = np.minimum(np.searchsorted(times, t + 1e-9, side="right") - 1, len(motion.frames) - 1)
    targets = reachable_track(
        t,
        reach.toes(q),
        reach,
        settings,
        heading=heading,
        valid=np.ones((len(t), 2), dtype=np.bool_),
        times=[times, times],
    )
    report = {**targets.report, "rate_s": motion.seconds / len(motion.frames)}
    v = np.array([frame.velocity for frame in motion.frames])[row]
    goals = np.array([(0.0, 0.0), *(frame.trunk for frame in motion.frames)])
    targets = dataclasses.replace(targets, report=report, trunk=PchipInterpolator(times, goals, axis=0)(t))
    commands = dataclasses.replace(command_track(targets), v=v)
    return commands, targets
