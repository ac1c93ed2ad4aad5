"""Converts landmarks of a person to shoulder -> wrist vectors in torso axes, in arm lengths.

Each hand is measured from its own shoulder. BlazePose leans the body toward the camera, and vectors from mid-hip would
contain that error (124 mm instead of 98 mm). Up is up in the image. Only the heading comes from the body, and only once
per clip: the depth of the shoulder line is noise from frame to frame and would ruin the sideways motion
(r 0.98 -> 0.62).

The mapping of arms to legs (mirroring) follows in `mimic.retargeting.targets`.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mimic.config.retarget import RetargetSettings
from mimic.errors import SourceError
from mimic.geometry import R_CT
from mimic.records import SIDES, BoolArray, FloatArray, PoseTrack, WristTrack
from mimic.retargeting.trunk import person_trunk

TURN_CUTOFF_HZ = 0.3
"""Cut-off of the heading; faster changes are depth noise [Hz]."""
MAX_TURN = np.radians(45)
"""A larger turn away from the clip's heading mixes forward and sideways motion [rad]."""
MIN_ARM_SHARE = 0.8
"""An arm that is visible in a smaller share of the frames is reported."""
SHOWN_GAPS = 4
"""At most this many of the times at which it is hidden are named, the longest ones."""
HEADING_KNOWN = "6° wrong of who stands, 17° at most; of who sits 11° and 18°"
"""By how much the heading is off, average and most of thirteen and of four views (lab/people/left_out.py)."""
DEPTH_VISIBLE = "20–65 %"
"""Share of the motion along the camera axis that BlazePose detects by itself, on rendered and on real videos."""
DOUBTFUL_DEPTH = 0.14
"""A standard deviation of a wrist's depth above this counts as doubtful: there the error was 18 cm and more [m]."""

_DEFAULT = RetargetSettings()
_GRID = 0.05


def wrist_track(pose: PoseTrack, settings: RetargetSettings = _DEFAULT) -> WristTrack:
    """Return the position of each hand relative to its own shoulder, one row per row of the pose.

    The heading is that of the torso: one constant value per clip, or with ``settings.turns`` the heading low-passed at
    TURN_CUTOFF_HZ. The robot starts at the heading of the first row, so it turns only with ``settings.turns``.

    Args:
        pose: Landmarks in camera axes.
        settings: Uses ``turns`` and ``reach_quantile``.

    Raises:
        SourceError: If no row shows a shoulder and its wrist.
        ContractError: If the track lacks a shoulder or a wrist.
    """
    heading = torso_heading(pose, settings)
    robot_heading = _without_steps(pose, heading) if settings.turns else np.full(len(heading), heading[0])
    valid = _arm_visible(pose)
    p_SH_T = torso_vectors(_arms(pose), heading)
    length = arm_length(p_SH_T, valid, settings.reach_quantile)
    return WristTrack(
        t=pose.t,
        p_SH=np.where(valid[..., None], p_SH_T / length, np.nan),
        heading=robot_heading,
        valid=valid,
        trunk=person_trunk(pose, heading),
        arm_length=length,
        warnings=(*pose.warnings, *_hidden_arm_warnings(pose), *_turn_warnings(pose, settings)),
    )


def torso_vectors(p_SH_C: FloatArray, heading: FloatArray | float) -> FloatArray:
    """Return vectors in camera axes (..., 2, 3) in the axes of a torso with this heading (...,); causal."""
    return np.einsum("...ij,...si->...sj", _camera_from_torso(heading), p_SH_C)


def arm_length(p_SH: FloatArray, valid: BoolArray, quantile: float) -> float:
    """Return the arm length in the clip: a high quantile of |shoulder -> wrist| over both arms.

    Both arms share one length, so that an arm that stays bent is not scaled up. Anthropometric tables, and the sum of
    upper arm and forearm, give larger errors (133 mm instead of 98 mm).

    Args:
        p_SH: Shoulder -> wrist (T, 2, 3) [m].
        valid: Which of them are usable (T, 2).
        quantile: 0 to 1.

    Raises:
        SourceError: If none is usable.
    """
    reach = np.linalg.norm(p_SH, axis=-1)[valid]
    if reach.size == 0:
        raise SourceError("no frame shows a shoulder and its wrist; film a person whose arms stay in the picture")
    return float(np.quantile(reach, quantile))


def torso_heading(pose: PoseTrack, settings: RetargetSettings = _DEFAULT) -> FloatArray:
    """Return the heading of the torso (T,) [rad]: 0 faces the camera, positive turns to the person's left.

    It follows from the direction of the right -> left line of shoulders and hips. The median over the clip is within
    9 degrees of the triangulated heading of a real person filmed from four sides, and of the exact heading of a
    rendered boxer. Each uninterrupted part of the track has a heading of its own. ``settings.heading`` is used instead
    where it is given; with ``settings.turns`` the median of the part is turned to it.
    """
    line, seen = _left_line(pose)
    heading = np.zeros(len(pose.t))
    for part in _parts(pose):
        if not seen[part].any():
            continue
        if settings.turns:
            heading[part] = _slow_heading(pose.t[part], line[part], seen[part])
        else:
            x, _, z = np.median(line[part][seen[part]], axis=0)
            heading[part] = np.arctan2(z, x)
        if settings.heading is not None:
            heading[part] += np.radians(settings.heading) - np.median(heading[part])
    return heading


def _parts(pose: PoseTrack) -> list[slice]:
    """Return the rows of each uninterrupted part."""
    starts = [0, *pose.cuts(), len(pose.t)]
    return [slice(int(a), int(b)) for a, b in pairwise(starts)]


def _without_steps(pose: PoseTrack, heading: FloatArray) -> FloatArray:
    """Return a heading that goes on after a cut where it was before it: the camera has moved, not the person."""
    result = np.unwrap(heading)
    for part in _parts(pose)[1:]:
        result[part.start :] += result[part.start - 1] - result[part.start]
    return result


def camera_axis(pose: PoseTrack, settings: RetargetSettings = _DEFAULT) -> tuple[float, float, float]:
    """Return the direction in which the camera looks, in torso axes, at the clip's median heading.

    The video shows little of the motion along this axis. (-1, 0, 0) is a camera in front of the person.
    """
    middle = float(np.median(torso_heading(pose, settings)))
    x, y, z = _camera_from_torso(middle).T @ np.array([0.0, 0.0, 1.0])
    return float(x), float(y), float(z)


def depth_note(axis: tuple[float, float, float], spread: FloatArray | None = None) -> str:
    """Return a sentence about the motion that a camera along this axis of the torso barely sees.

    Args:
        axis: Direction in which the camera looks, torso axes.
        spread: Standard deviation of the depth of both wrists where they were seen (N,) [m]; None or empty if it was
            not estimated.
    """
    off_forward = np.degrees(np.arctan2(abs(axis[1]), abs(axis[0])))
    if off_forward < 30:
        what = "reaching forward and back"
        better = "from the side or a three-quarter view"
    elif off_forward > 60:
        what = "reaching to the left and right"
        better = "from the front or a three-quarter view"
    else:
        what = "reaching along the diagonal toward the camera"
        better = "from the side that shows the motion best"
    where = "behind" if axis[0] > 0.5 else "in front of" if axis[0] < -0.5 else "beside"
    camera = f"The camera is {where} the person, {off_forward:.0f}° off the forward axis ({HEADING_KNOWN})."
    if spread is None or not len(spread):
        return f"{camera} It sees only {DEPTH_VISIBLE} of {what}; if that matters, film {better}."
    doubtful = float((spread > DOUBTFUL_DEPTH).mean())
    return (
        f"{camera} The depth of the wrists, so {what}, is estimated to ±{100 * np.sqrt(np.mean(spread**2)):.0f} cm; "
        f"{doubtful:.0%} of it is doubtful (above ±{100 * DOUBTFUL_DEPTH:.0f} cm). If that matters, film {better}."
    )


def pose_report(pose: PoseTrack, settings: RetargetSettings = _DEFAULT) -> dict[str, Any]:
    """Return the statistics of a pose for the run folder, as plain data."""
    seen = _arm_visible(pose)
    spread = pose.depth_spread[seen]
    return {
        "frames": len(pose.t),
        "frames_with_person": int(seen.any(axis=1).sum()),
        "frames_exchanged": int(pose.swapped.sum()),
        "unseen": depth_note(camera_axis(pose, settings), spread[np.isfinite(spread)]),
    }


def _camera_from_torso(heading: FloatArray | float) -> FloatArray:
    """Return R_CT (..., 3, 3) of a torso with this heading (...,)."""
    c = np.cos(heading)
    s = np.sin(heading)
    zero = np.zeros_like(c)
    one = np.ones_like(c)
    turn = np.stack([np.stack(row, axis=-1) for row in ([c, -s, zero], [s, c, zero], [zero, zero, one])], axis=-2)
    return R_CT @ turn


def _columns(pose: PoseTrack, part: str) -> list[int]:
    return [pose.index(f"{side}_{part}") for side in SIDES]


def _arms(pose: PoseTrack) -> FloatArray:
    """Return shoulder -> wrist of both sides (T, 2, 3), camera axes [m]."""
    return pose.landmarks[:, _columns(pose, "wrist")] - pose.landmarks[:, _columns(pose, "shoulder")]


def _arm_visible(pose: PoseTrack) -> BoolArray:
    return pose.valid[:, _columns(pose, "wrist")] & pose.valid[:, _columns(pose, "shoulder")]


def _left_line(pose: PoseTrack) -> tuple[FloatArray, BoolArray]:
    """Return the right -> left line of shoulders and visible hips (T, 3) [m], and which rows have one."""
    left, right = _columns(pose, "shoulder")
    seen = pose.valid[:, left] & pose.valid[:, right]
    line = pose.landmarks[:, left] - pose.landmarks[:, right]
    if {"left_hip", "right_hip"} <= set(pose.names):
        left, right = _columns(pose, "hip")
        hips_seen = (pose.valid[:, left] & pose.valid[:, right])[:, None]
        line = line + np.where(hips_seen, pose.landmarks[:, left] - pose.landmarks[:, right], 0.0)
    return line, seen


def _slow_heading(t: FloatArray, line: FloatArray, seen: BoolArray) -> FloatArray:
    """Return the heading low-passed at TURN_CUTOFF_HZ, without lag, for all rows (T,) [rad].

    A Gaussian of this width has a gain of 0.71 at the cut-off: |H(f)| = exp(-(2 pi f sigma)^2 / 2). It smooths the
    line, not its angle, which avoids wrap-around at half a turn.
    """
    sigma = np.sqrt(np.log(2)) / (2 * np.pi * TURN_CUTOFF_HZ)
    grid = np.arange(t[0], t[-1] + _GRID, _GRID)
    x, z = (
        np.interp(t, grid, gaussian_filter1d(np.interp(grid, t[seen], line[seen, i]), sigma / _GRID, mode="nearest"))
        for i in (0, 2)
    )
    return np.unwrap(np.arctan2(z, x))


def _hidden_arm_warnings(pose: PoseTrack) -> tuple[str, ...]:
    """Return a warning for each arm that is often hidden, with the times."""
    found = []
    for side, seen in zip(SIDES, _arm_visible(pose).T, strict=True):
        if seen.mean() >= MIN_ARM_SHARE:
            continue
        if not seen.any():
            found.append(f"the {side} arm is never visible")
            continue
        edges = np.diff(np.concatenate([[False], ~seen, [False]]).astype(int))
        ends = np.flatnonzero(edges < 0)
        starts = pose.t[edges[:-1] > 0]
        stops = pose.t[np.minimum(ends, len(seen) - 1)]
        longest = sorted(np.argsort(stops - starts)[::-1][:SHOWN_GAPS])
        times = ", ".join(f"{starts[i]:.1f}–{stops[i]:.1f} s" for i in longest)
        more = f" and {len(starts) - SHOWN_GAPS} shorter times" if len(starts) > SHOWN_GAPS else ""
        found.append(
            f"the {side} arm is visible in {seen.mean():.0%} of the frames, hidden at {times}{more}; there the robot's "
            "arm is not what the person did"
        )
    return tuple(found)


def _turn_warnings(pose: PoseTrack, settings: RetargetSettings) -> tuple[str, ...]:
    """Return a warning if one heading does not fit the clip."""
    if settings.turns or not _left_line(pose)[1].any():
        return ()
    away = torso_heading(pose, replace(settings, turns=True, heading=None)) - torso_heading(pose, settings)
    share = float((np.abs((away + np.pi) % (2 * np.pi) - np.pi) > MAX_TURN).mean())
    if share < 0.1:
        return ()
    warning = (
        f"the person is turned by more than {np.degrees(MAX_TURN):.0f}° from the clip's heading in {share:.0%} of the "
        "frames, which mixes forward and sideways motion; set [retarget] turns in --config, or film a person who keeps "
        "one heading"
    )
    return (warning,)
