"""Converts a person's wrist track to front-toe targets within the robot's reach and motor limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from mimic.config.retarget import SLOWEST, RetargetSettings
from mimic.errors import SourceError
from mimic.records import BoolArray, FloatArray, TargetTrack, WristTrack
from mimic.retargeting.limits import limit_track
from mimic.retargeting.sampling import between, fill_gaps, target_times, without_glimpses
from mimic.retargeting.trunk import trunk_goals
from mimic.robot.arm_mapping import posture, toes_of_arms
from mimic.robot.reach import Closest, Reach

CLAMP_TOLERANCE = 1e-3
"""A target that moves by more than this counts as clamped or speed-limited [m]."""
MAX_ITERATIONS = 4
"""Maximum number of iterations between speed limits and leg clearance."""
FEW_LIMITED = 0.05
"""A motion in which the speed limit moves a larger share of the targets is too fast."""
SLOW_STEP = 1.05
"""Slowing down as needed is right to this factor."""


def wanted_toes(p_SH: FloatArray, reach: Reach, settings: RetargetSettings) -> FloatArray:
    """Return the toe positions that correspond to the person's arms, reachable or not; works row by row.

    With ``settings.mirror`` left and right arm are swapped; `mimic.robot.arm_mapping.toes_of_arms` does the rest.

    Args:
        p_SH: Shoulder -> wrist (..., 2, 3), torso axes [arm lengths].
        reach: The robot.
        settings: Scale and mirror.

    Returns:
        Base -> toe (..., 2, 3), base axes [m].
    """
    arms = np.asarray(p_SH, dtype=np.float64)
    if settings.mirror:
        arms = arms[..., ::-1, :] * (1.0, -1.0, 1.0)
    return toes_of_arms(arms, reach, settings.scale)


def target_track(wrists: WristTrack, reach: Reach, settings: RetargetSettings) -> TargetTrack:
    """Return reachable toe targets at the robot's control rate.

    Gaps are filled, and a target is sampled every ``settings.rate`` seconds. A shape-preserving cubic interpolates
    between targets. Each row is moved to the closest reachable point, and joint speed and acceleration are limited
    without lag. With ``settings.slow_down`` the time of the track is stretched first; the report has the factor.

    Raises:
        SourceError: If the track is shorter than a sampling step or shows no hand at all.
    """
    if settings.slow_down == "auto":
        return slowed_as_needed(lambda factor: _target_track(wrists, reach, settings, factor))
    targets = _target_track(wrists, reach, settings, settings.slow_down)
    if targets.report["limited_share"] <= FEW_LIMITED:
        return targets
    apart = np.linalg.norm(targets.p_BE - targets.within_reach, axis=-1)
    warning = (
        f"the motion is too fast for the robot: its speed limit moves {targets.report['limited_share']:.0%} of the "
        f"targets, by up to {100 * apart.max():.0f} cm; --slow-down auto plays it as slowly as needed"
    )
    return replace(targets, warnings=(*targets.warnings, warning))


def slowed_as_needed(make: Callable[[float], TargetTrack]) -> TargetTrack:
    """Return the least slowed track in which the speed limit moves few targets.

    Args:
        make: Returns the track that is slowed down by a factor.
    """
    fast = 1.0
    slow = 1.0
    found = make(slow)
    while found.report["limited_share"] > FEW_LIMITED and slow < SLOWEST:
        fast = slow
        slow = min(1.5 * slow, SLOWEST)
        found = make(slow)
    while slow / fast > SLOW_STEP:
        middle = round(float(np.sqrt(fast * slow)), 2)
        tried = make(middle)
        if tried.report["limited_share"] > FEW_LIMITED:
            fast = middle
        else:
            slow = middle
            found = tried
    return found


def _target_track(wrists: WristTrack, reach: Reach, settings: RetargetSettings, slow_down: float) -> TargetTrack:
    t = slow_down * np.asarray(wrists.t - wrists.t[:1], dtype=np.float64)
    seen = wrists.valid & np.isfinite(wrists.p_SH).all(axis=-1)
    if len(t) < 2 or t[-1] < settings.rate - 1e-9:
        length = f"{t[-1]:.2f} s" if len(t) else "empty"
        raise SourceError(f"the source is {length}, shorter than one step of {settings.rate:g} s; use a longer one")
    if not seen.any():
        raise SourceError(
            "the source shows no hand in any frame; film the person so that shoulders and wrists are seen"
        )
    toes = wanted_toes(wrists.p_SH, reach, settings)
    seen = seen[:, ::-1] if settings.mirror else seen
    steady = np.stack([without_glimpses(t, own) for own in seen.T], axis=1)
    seen = steady if steady.any() else seen
    hanging = hanging_toes(reach)
    dt = reach.description.dt
    grid = np.asarray(dt * np.arange(int(t[-1] / dt + 1e-6) + 1), dtype=np.float64)

    wanted = np.empty((len(grid), 2, 3))
    person = np.empty((len(grid), 2, 3))
    times = []
    for side in range(2):
        filled = fill_gaps(t, toes[:, side], seen[:, side], hanging[side])
        times.append(target_times(t, filled, settings.rate))
        wanted[:, side] = between(times[side], between(t, filled, times[side]), grid)
        person[:, side] = between(t, filled, grid)
    valid = np.stack([np.interp(grid, t, seen[:, side]) > 0.999 for side in range(2)], axis=1)
    heading = np.interp(grid, t, np.unwrap(wrists.heading - wrists.heading[0]))
    targets = reachable_track(
        grid,
        wanted,
        reach,
        settings,
        heading=-heading if settings.mirror else heading,
        valid=valid,
        times=times,
        warnings=wrists.warnings,
    )
    trunk = np.stack([np.interp(grid, t, column) for column in np.nan_to_num(wrists.trunk).T], axis=1)
    trunk = settings.trunk * trunk_goals(trunk, reach.description)
    return replace(targets, person=person, trunk=trunk, report={**targets.report, "slow_down": slow_down})


def hanging_toes(reach: Reach) -> FloatArray:
    """Return where the toes of arms that are not seen wait (2, 3), base axes [m]: as of arms that hang."""
    return reach.toes(posture("down", reach))


def reachable_track(
    t: FloatArray,
    wanted: FloatArray,
    reach: Reach,
    settings: RetargetSettings,
    *,
    heading: FloatArray,
    valid: BoolArray,
    times: list[FloatArray],
    warnings: tuple[str, ...] = (),
) -> TargetTrack:
    """Return the reachable toe targets closest to the wanted ones; all input sources use this function.

    Args:
        t: Times at the robot's control rate (T,) [s].
        wanted: Base -> toe (T, 2, 3), base axes [m].
        reach: The robot.
        settings: Used for the report.
        heading: Heading of the robot relative to its start (T,) [rad].
        valid: Whether the source shows the hand (T, 2).
        times: Times of the targets of each side [s], for the report.
        warnings: Warnings of the source.
    """
    closest = reach.closest_track(wanted)
    p_BE = limited(closest, reach)
    rate_limited = np.linalg.norm(p_BE - closest.p_BE, axis=-1) > CLAMP_TOLERANCE
    return TargetTrack(
        t=t,
        p_BE=p_BE,
        heading=heading,
        valid=valid,
        moved=closest.moved,
        limited=rate_limited,
        wanted=wanted,
        within_reach=closest.p_BE,
        robot=reach.description.name,
        report=_report(times, closest.moved, rate_limited, valid, reach.description.dt, settings),
        warnings=warnings,
    )


def limited(closest: Closest, reach: Reach) -> FloatArray:
    """Return toes (T, 2, 3) [m] within reach and motor limits.

    Joint positions stay within their bounds. If the legs come too close in a row, it moves to the closest point with
    clearance, and the motion is limited again. After MAX_ITERATIONS, clearance has priority over the speed limit.
    """
    q = closest.q
    p_BE = closest.p_BE.copy()
    for _ in range(MAX_ITERATIONS):
        before = q
        q = np.clip(
            limit_track(q, reach.description.dt, reach.speed_max, reach.acceleration_max), reach.q_min, reach.q_max
        )
        for row in np.flatnonzero(np.any(q != before, axis=1)):
            p_BE[row] = reach.toes(q[row])
            if not reach.is_clear(q[row]):
                found = reach.closest(p_BE[row], q[row])
                q[row] = found.q
                p_BE[row] = found.p_BE
        if np.array_equal(q, before):
            break
    return p_BE


def _report(
    times: list[FloatArray],
    moved: FloatArray,
    rate_limited: BoolArray,
    valid: BoolArray,
    dt: float,
    settings: RetargetSettings,
) -> dict[str, Any]:
    """Return the statistics of retargeting as plain data; shares are over the targets of both sides."""
    rows = [np.minimum(np.rint(own / dt).astype(int), len(moved) - 1) for own in times]
    moved_at_targets = np.concatenate([moved[own, side] for side, own in enumerate(rows)])
    limited_at_targets = np.concatenate([rate_limited[own, side] for side, own in enumerate(rows)])
    return {
        "targets": len(times[0]),
        "rate_s": settings.rate,
        "mirror": settings.mirror,
        "clamped_share": float(np.mean(moved_at_targets > CLAMP_TOLERANCE)),
        "moved_mean_cm": 100.0 * float(np.mean(moved_at_targets)),
        "moved_max_cm": 100.0 * float(np.max(moved_at_targets)),
        "limited_share": float(np.mean(limited_at_targets)),
        "filled_share": float(np.mean(~valid)),
    }
