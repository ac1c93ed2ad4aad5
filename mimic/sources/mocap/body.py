"""What every body keeps, whatever file it is in: the length of its bones, one motion, and the way its limbs bend."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from mimic.records import SIDES, FloatArray
from mimic.sources.mocap.points import Points

LONGER = 1.6
"""A bone longer than this many times the usual has an end where nothing was seen. Of two men seen by four cameras it
was 1.46 times as long at most, but once; of people seen by one, 1.41."""
SHORTER = 0.2
"""… and so has one shorter than this many times the usual."""
FIRST = 5
"""Rows at the beginning in which a pose before the motion may end."""
BESIDE = 8
"""Steps that its end is compared with."""
LEAP = 0.15
"""There a wrist leaps by this much at once [arm lengths]."""
ALONE = 4.0
"""… and this many times as far as in any step beside it."""
SLOWEST = 0.07
"""Rows farther apart say nothing about a leap [s]."""
BENT = 0.03
"""A limb whose middle is less far before or behind its ends is straight [its length]."""
SURE = 0.8
"""Share of the rows that decides where the front of a body is."""

_ORDER = [f"{side}_{part}" for part in ("wrist", "ankle", "elbow", "knee", "shoulder", "hip") for side in SIDES]
"""From the ends of the limbs inward: of the two ends of a broken bone the outer one was not seen."""
_BONES = np.array([[[0, 4], [1, 5]], [[4, 8], [5, 9]], [[2, 6], [3, 7]], [[6, 10], [7, 11]], [[8, 10], [9, 11]]])
"""Ends of the bones on both sides: forearm, upper arm, shank, thigh, trunk."""
_ACROSS = np.array([[[8, 9], [8, 9]], [[10, 11], [10, 11]]])

FRONTS = (
    ("nose left_ear right_ear", "left_foot_index left_ankle", "right_foot_index right_ankle"),
    ("left_knee left_hip left_ankle", "right_knee right_hip right_ankle"),
    ("nose left_shoulder right_shoulder",),
    ("left_elbow left_shoulder left_wrist", "right_elbow right_shoulder right_wrist"),
)
"""What tells the front, the surest first: a point that is before the middle of others; elbows are behind it."""
MIRRORED = (
    "nose, feet, knees or elbows point backwards, so the axes of the file are taken as left-handed and turned over; if "
    "its names of left and right are exchanged instead, the robot moves the wrong leg: play it with --mirror"
)
UNTOLD = (
    "whether left and right of the file are true cannot be told, for it has no nose or feet and no bent elbows or "
    "knees; if the robot moves the wrong leg, play it with --mirror"
)


def without_marks(points: Points) -> Points:
    """Return points with NaN where all three coordinates are one number, such as 0, -1 or 9999: that is no place."""
    mark = (points.xyz == points.xyz[..., :1]).all(axis=-1)
    return replace(points, xyz=np.where(mark[..., None], np.nan, points.xyz))


def with_steady_bones(body: Points) -> Points:
    """Return landmarks with NaN at the ends of bones that are longer than they usually are; both sides are alike."""
    xyz = np.full((len(body.t), len(_ORDER), 3), np.nan)
    columns = [(i, body.names.index(name)) for i, name in enumerate(_ORDER) if name in body.names]
    ours, theirs = np.transpose(columns)
    xyz[:, ours] = body.xyz[:, theirs]
    bones = np.concatenate([_BONES, _ACROSS])

    def lengths() -> FloatArray:
        return np.linalg.norm(xyz[:, bones[..., 0]] - xyz[:, bones[..., 1]], axis=-1)

    usual = _usual(lengths())
    for _ in _ORDER:
        length = lengths()
        broken = (length > LONGER * usual) | (length < SHORTER * usual)
        blame = np.stack([broken[:, (bones == i).any(axis=-1)].sum(axis=1) for i in range(len(_ORDER))], axis=1)
        rows = np.flatnonzero(broken.any(axis=(1, 2)))
        xyz[rows, blame[rows].argmax(axis=1)] = np.nan
    cleaned = body.xyz.copy()
    cleaned[:, theirs] = xyz[:, ours]
    return replace(body, xyz=cleaned)


def _usual(lengths: FloatArray) -> FloatArray:
    """Return the usual length of each bone (B, 1) of lengths (T, B, 2): the median, of the side that has less."""
    seen = np.isfinite(lengths).any(axis=0)
    medians = np.full(lengths.shape[1:], np.inf)
    medians[seen] = np.nanmedian(lengths[:, seen], axis=0)
    least = medians.min(axis=1, keepdims=True)
    return np.where(np.isfinite(least), least, np.nan)


def marks_said(before: Points, after: Points) -> Iterator[str]:
    """Yield which landmarks were taken as not seen, and when."""
    lost = np.logical_and(np.isfinite(before.xyz).all(axis=-1), np.isnan(after.xyz).any(axis=-1))
    said = []
    for i in np.flatnonzero(lost.any(axis=0)):
        rows = np.flatnonzero(lost[:, i])
        said.append(f"{after.names[i]} in {len(rows)} rows ({after.t[rows[0]]:.2f} to {after.t[rows[-1]]:.2f} s)")
    if said:
        yield f"taken as not seen, for a mark stands there or a bone has another length: {', '.join(said)}"


def without_first_pose(body: Points) -> tuple[Points, tuple[str, ...]]:
    """Return a body without a pose before its motion, such as the rest pose of a skeleton, and a note if it has one."""
    arms = np.stack([body.of(f"{side}_wrist", f"{side}_shoulder") for side in SIDES], axis=1)
    reach = arms[:, :, 0] - arms[:, :, 1]
    if len(reach) <= FIRST + BESIDE or np.median(np.diff(body.t)) > SLOWEST or not np.isfinite(reach).any():
        return body, ()
    steps = np.nan_to_num(np.linalg.norm(np.diff(reach, axis=0), axis=-1).max(axis=1))
    steps = steps / np.nanmax(np.linalg.norm(reach, axis=-1))
    end = int(steps[:FIRST].argmax())
    beside = np.delete(steps[: end + 1 + BESIDE], end).max()
    if steps[end] < max(LEAP, ALONE * beside):
        return body, ()
    xyz = body.xyz.copy()
    xyz[: end + 1] = np.nan
    rows = "row 1 is" if end == 0 else f"rows 1 to {end + 1} are"
    return replace(body, xyz=xyz), (f"{rows} left out: a pose from which the arms leap into the motion at once",)


def handedness(body: Points) -> tuple[bool, tuple[str, ...]]:
    """Return whether a body in camera axes is a mirror image, and what the user should know about that."""
    left = (body.of("left_shoulder") - body.of("right_shoulder"))[:, 0]
    across = np.hypot(left[:, 0], left[:, 2])
    for limbs in FRONTS:
        votes = np.zeros(0)
        for middle, *ends in map(str.split, limbs):
            if not {middle, *ends} <= set(body.names):
                continue
            line = body.of(middle)[:, 0] - body.of(*ends).mean(axis=1)
            size = np.linalg.norm(body.of(ends[0])[:, 0] - body.of(ends[-1])[:, 0], axis=-1)
            ahead = (line[:, 0] * left[:, 2] - line[:, 2] * left[:, 0]) / across
            bent = np.abs(ahead) > BENT * np.maximum(size, np.linalg.norm(line, axis=-1))
            votes = np.append(votes, ahead[bent] * (-1.0 if "elbow" in middle else 1.0))
        share = float((votes < 0).mean()) if len(votes) else 0.5
        if share > SURE:
            return True, (MIRRORED,)
        if share < 1.0 - SURE:
            return False, ()
    return False, (UNTOLD,)
