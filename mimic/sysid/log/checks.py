"""Checks of a log before anything is fitted: each fault yields a line."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mimic.errors import CalibrationError
from mimic.io.joint_log import CHANNELS, JointLog, jump_fault, unit_fault, without_marks
from mimic.records import BoolArray, FloatArray
from mimic.sysid.log.noise import (
    FOLLOWS,
    MEMORY,
    MOST,
    SURE,
    Following,
    following,
    noise_floor,
    resolution,
    rounding,
    speed,
)
from mimic.sysid.log.pool import (
    BETWEEN,
    SHORTEST,
    at_odd_times,
    filled,
    followed,
    lasts,
    missing,
    spikes,
    valid_samples,
)
from mimic.sysid.log.timing import MOST_WRONG

LEAST = 0.1
"""A shorter log shows no motion [s]."""

STRANGER = float(np.sqrt(MOST))
"""With one that it follows badly: the target does not explain most of its squares."""


def gaps(log: JointLog) -> Iterator[str]:
    """Readings that are missing, too few, or read more slowly than logged."""
    steps = np.diff(log.t)
    usual = float(np.median(steps))
    missing = int(np.maximum(np.round(steps / usual) - 1, 0).sum())
    if missing:
        longest = int(steps.argmax())
        yield (
            f"about {missing} readings are missing ({missing / (missing + len(log.t)):.1%}); the longest gap is"
            f" {1e3 * steps[longest]:.0f} ms at t = {log.t[longest]:.2f} s"
        )
    repeated = (np.diff(log.q, axis=0) == 0).all(axis=1)
    finest = np.array([resolution(x) for x in log.q.T])
    moving = np.any(np.abs(speed(log.t, log.q))[1:] * usual > finest, axis=1)
    stale = float(repeated[moving].mean()) if moving.any() else 0.0
    if stale > MOST_WRONG:
        yield (
            f"{stale:.0%} of the rows repeat the reading before while the machine moves: it is read more slowly than"
            " logged, or rows are duplicated"
        )


def units(log: JointLog) -> Iterator[str]:
    """Degrees against radians, thousandths against units."""
    if log.q_des is None:
        return
    spread = log.q.std(axis=0)
    wanted = log.q_des.std(axis=0)
    moves = (spread > SURE * noise_floor(log.q, log.rate)) & (wanted > 0)
    ratio = np.divide(spread, wanted, out=np.ones(len(moves)), where=moves)
    for factor, what in ((180.0 / np.pi, "degrees against radians"), (1000.0, "thousandths against units")):
        for larger, of in (("q", ratio), ("q_des", 1.0 / ratio)):
            found = [joint for joint, r in zip(log.joints, of, strict=True) if round(np.log(r / factor)) == 0]
            if found:
                yield (
                    f"{larger} of {_list(found)} moves about {factor:.0f} times as far as the other of q and q_des:"
                    f" {what}; divide {larger} by {factor:.6g}"
                )


def wrapped(log: JointLog) -> str | None:
    """Return where an encoder wraps around, None if none does: by a turn, give or take a step as it makes elsewhere."""
    for name in ("q", "q_des"):
        if (value := getattr(log, name)) is None:
            continue
        jump = np.diff(value, axis=0)
        size = np.abs(jump)
        step = np.max(size, axis=0, where=size < np.pi, initial=0.0)
        for row, i in np.argwhere((size > 2 * step) & (np.abs(size - 2 * np.pi) <= step))[:1]:
            when = f"by {jump[row, i]:+.2f} rad at t = {log.t[row]:.2f} s"
            return f"{name}.{log.joints[i]} jumps {when}: the encoder wraps around; unwrap it"
    return None


def misassigned(log: JointLog, correlation: FloatArray, moves: BoolArray) -> Iterator[str]:
    """Joints that follow another's target, or their own backwards."""
    from scipy.optimize import linear_sum_assignment

    own = np.diag(correlation)
    for i in np.flatnonzero(moves & (own < -STRANGER)):
        yield (
            f"{log.joints[i]} moves against its target (correlation {own[i]:+.2f}): its sign is wrong;"
            f" multiply q.{log.joints[i]} or q_des.{log.joints[i]} by -1, whichever differs from the model"
        )
    _, match = linear_sum_assignment(-np.abs(correlation))
    lost = [i for i in np.flatnonzero(moves) if abs(own[i]) < STRANGER and abs(correlation[i, match[i]]) > FOLLOWS]
    done: set[int] = set()
    for i in lost:
        j = int(match[i])
        if j == i or i in done:
            continue
        sign = "" if correlation[i, j] > 0 else ", with the other sign"
        follows = (
            f"{log.joints[i]} follows the target of {log.joints[j]}{sign}"
            f" (correlation {correlation[i, j]:+.2f}, with its own {own[i]:+.2f})"
        )
        if match[j] == i:
            done.add(j)
            yield f"{follows} and the other way round: exchange q.{log.joints[i]} and q.{log.joints[j]}"
        else:
            yield f"{follows}: name q.{log.joints[i]} q.{log.joints[j]}"


def weak_following(log: JointLog, correlation: FloatArray, lag: FloatArray, moves: BoolArray) -> Iterator[str]:
    """Joints that follow their target badly, or before it comes."""
    own = np.diag(correlation)
    weak = np.flatnonzero(moves & (own < STRANGER))
    if len(weak):
        worst = weak[own[weak].argmin()]
        yield (
            f"{_list([log.joints[i] for i in weak])}: target badly followed (correlation {own[worst]:.2f} at"
            f" {log.joints[worst]}): weak gains, a blocked joint, or targets that do not belong to these readings"
        )
    early = np.flatnonzero(moves & (own > FOLLOWS) & (np.round(lag * log.rate) < -1))
    if len(early):
        i = int(early[0])
        yield (
            f"{log.joints[i]} moves {-1e3 * lag[i]:.0f} ms before its target: the clocks of targets and readings"
            " differ; give the target in effect when the row was read"
        )


def stuck(log: JointLog) -> Iterator[str]:
    """Readings that are frozen or clipped."""
    asked = log.q_des if log.q_des is not None else log.force
    assert asked is not None
    fastest = np.abs(speed(log.t, log.q)).max(axis=0) / log.rate
    for i, joint in enumerate(log.joints):
        x = log.q[:, i]
        wanted = asked[:, i]
        if np.ptp(wanted) <= rounding(wanted):
            continue
        if np.ptp(x) == 0:
            yield (
                f"q.{joint} reads {x[0]:g} for the whole log while its target moves: a dead encoder or a blocked joint"
            )
            continue
        still = np.diff(x) == 0
        edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            asked_of_it = wanted[start : stop + 1][log.t[start : stop + 1] <= log.t[stop] - MEMORY]
            if not len(asked_of_it) or np.ptp(asked_of_it) < wanted.std() / 2:
                continue
            where = "its highest value" if x[start] == x.max() else "its lowest value" if x[start] == x.min() else ""
            if not where and abs(x[min(stop + 1, len(x) - 1)] - x[start]) <= fastest[i]:
                continue  # it sticks
            when = f"{log.t[stop] - log.t[start]:.2f} s from t = {log.t[start]:.2f} s while its target moves"
            if where:
                yield f"q.{joint} stays at {where}, {x[start]:.4g}, for {when}: clipped, or at a stop"
            else:
                yield f"q.{joint} is frozen at {x[start]:.4g} for {when}: readings were lost"
            break


def excitation(log: JointLog, moves: BoolArray) -> Iterator[str]:
    """Joints that this motion shows nothing of.

    Raises:
        CalibrationError: If nothing moves.
    """
    idle = [joint for joint, moving in zip(log.joints, moves, strict=True) if not moving]
    if len(idle) == len(log.joints):
        raise CalibrationError(
            "no target of the log moves, so that nothing can be fitted; see the motion to log in docs"
        )
    if idle:
        yield f"the target of {_list(idle)} never moves: nothing can be fitted to {'it' if len(idle) == 1 else 'them'}"


def beyond(log: JointLog, limits: FloatArray | None) -> Iterator[str]:
    """Targets outside the joint limits."""
    if limits is None or log.q_des is None:
        return
    for i, joint in enumerate(log.joints):
        low, high = limits[i]
        past = np.maximum(low - log.q_des[:, i], log.q_des[:, i] - high)
        share = float((past > rounding(log.q_des[:, i])).mean())
        if share > 0:
            yield (
                f"the target of {joint} is beyond its limits ({low:.3f} to {high:.3f}) by up to {past.max():.3f} in"
                f" {share:.1%} of the rows: the joint may rest on its stop there"
            )


def _list(names: list[str]) -> str:
    return ", ".join(names)


@dataclass(frozen=True, kw_only=True, eq=False)
class LogCheck:
    """What a usable log holds; arrays are (J,) in the order of its joints."""

    log: JointLog
    """The log without repeated and unreadable rows: the one to fit."""
    noise: FloatArray
    """Standard deviation of white noise on the positions, no less than the encoder's step allows."""
    warnings: tuple[str, ...]
    """What the user should know, a line each."""


def check_log(log: JointLog, limits: FloatArray | None = None, unit: str = "rad") -> LogCheck:
    """Return the properties of a usable log, with warnings.

    Args:
        log: Readings of a machine.
        limits: Lower and upper joint limit (J, 2), infinite where there is none.
        unit: Of the positions: "rad", or "m" where the joints slide.

    Raises:
        CalibrationError: If nothing can be fitted to it; a line for each reason.
    """
    log, warnings = _readable(log)
    warnings += gaps(log)
    if wrong := list(units(log)):
        raise CalibrationError("\n".join(wrong))
    if unit == "rad" and (fault := unit_fault(log, limits) or jump_fault(log) or wrapped(log)):
        raise CalibrationError(fault)
    target = followed(log)
    if target is not None and lasts(log):
        found = following(log.t, log.q, target)
        wrong = list(misassigned(log, found.correlation, found.moves))
        if wrong:
            raise CalibrationError("\n".join(wrong))
        warnings += weak_following(log, found.correlation, found.lag, found.moves)
    noise = noise_floor(log.q, log.rate, valid_samples(log))
    asked = target if target is not None else log.force
    assert asked is not None  # the reader refuses a log with neither
    if target is not None and log.force is not None:
        asked = np.concatenate([target, log.force], axis=1)  # a force added to the drive
    moves = (np.ptp(asked, axis=0) > rounding(asked)).reshape(-1, len(log.joints)).any(axis=0)
    if lasts(log):
        warnings += excitation(log, moves)
    else:
        warnings.append(f"the log lasts {log.duration:.2f} s by its column t; {SHORTEST:g} s are needed in all")
    warnings += [*stuck(log), *beyond(log, limits)]
    return LogCheck(log=log, noise=noise, warnings=tuple(warnings))


def targets_match_log(log: JointLog) -> tuple[bool, str]:
    """Return whether the targets can belong to the positions, and why not.

    Only what is certain is refused: targets that a position precedes, or that nothing follows, unless reversed or
    shifted in time. Whether log and model belong together is for the fit to say.
    """
    if log.q_des is None:
        return True, ""
    asked = followed(log)
    assert asked is not None
    near = following(log.t, log.q, asked)
    moving = near.moves & (np.ptp(log.q, axis=0) > 0)
    if not moving.any():
        return False, "no target of the log moves"

    def median(of: Following) -> float:
        return float(np.median(np.maximum(np.diag(of.correlation), 0.0)[moving]))

    follows = median(near)
    lag = near.lag[moving]
    if follows > FOLLOWS and (np.round(np.nan_to_num(lag) * log.rate) < -1).all():
        early = -1e3 * float(np.median(lag))
        return False, f"positions come {early:.0f} ms before their targets; the log runs backwards in time"
    if follows >= STRANGER:
        return True, ""
    back = median(following(log.t, log.q, asked[::-1]))
    if back > FOLLOWS:
        return False, f"positions follow the targets read backwards (correlation {back:.3f}, forwards {follows:.3f})"
    far = following(log.t, log.q, asked, (-log.duration / 2, log.duration / 2))
    if median(far) > FOLLOWS:
        late = float(np.nanmedian(far.lag[moving]))
        when = f"{abs(late):.2f} s {'before' if late > 0 else 'after'} them"
        return False, f"positions follow the targets logged {when}: two clocks, or rows that do not match"
    return False, f"positions do not follow the targets (correlation {follows:.2f})"


def _readable(log: JointLog) -> tuple[JointLog, list[str]]:
    """Return the log without rows that cannot be used, and what was wrong with them.

    Raises:
        CalibrationError: If too little is left.
    """
    log, warnings = without_marks(log)
    if len(log.t) < 2:
        raise CalibrationError(f"the log has {len(log.t)} rows; a calibration needs {SHORTEST:g} s of readings")
    empty = [n for n in ("dq", "tau") if getattr(log, n) is not None and not np.isfinite(getattr(log, n)).any()]
    if empty:
        nothing: dict[str, Any] = dict.fromkeys(empty)
        log = replace(log, **nothing)
    if log.tau is not None and not (np.fmax.reduce(log.tau) > np.fmin.reduce(log.tau)).any():
        warnings.append("the measured torque never changes: the drives do not report it; left out")
        log = replace(log, tau=None)
    ok = np.isfinite(log.t)
    told = np.zeros(len(log.t), dtype=bool)
    for name in CHANNELS:
        value = getattr(log, name)
        if value is None or name == "dq":  # which nothing is fitted to
            continue
        finite = np.isfinite(value)
        for i in np.flatnonzero(finite.mean(axis=0) < 1.0 - MOST_WRONG):
            share = 1.0 - finite[:, i].mean()
            what = f"{name}.{log.joints[i]} is not a number in {share:.0%} of the rows; log it, or "
            raise CalibrationError(
                what + ("leave tau out for all joints" if name == "tau" else "take the joint out of log and model")
            )
        told |= ~finite.all(axis=1)
        if name in ("q_des", "force"):
            ok &= finite.all(axis=1)
    lost = float((told | ~ok).mean())
    if lost > 0:
        what = f"hold something that is not a number, the first of them {_first_gap(log)}"
        if lost > MOST_WRONG:
            raise CalibrationError(f"{lost:.0%} of the rows {what}; expected readings")
        warnings.append(f"{round(lost * len(log.t))} rows ({lost:.1%}) {what}; left out")
        log = log.part(ok)
    if (spiked := spikes(log)).any():
        i, j = (int(x[0]) for x in np.nonzero(spiked))
        rows = spiked.any(axis=1)
        warnings.append(
            f"{int(rows.sum())} rows ({rows.mean():.1%}) have a reading far off those around it, as in corrupt frames,"
            f" such as q.{log.joints[j]} {log.q[i, j]:g} at t = {log.t[i]:.3f} s; left out"
        )
        log = replace(log, q=np.where(spiked, np.nan, log.q))
    gone = missing(log)
    odd = at_odd_times(log, MOST_WRONG) & ~gone
    if odd.any():
        warnings.append(
            f"{int(odd.sum())} rows ({odd.mean():.1%}) were answered at another time than the others; left out"
        )
    if (unseen := gone | odd).any():
        log = filled(log, unseen).part(np.cumsum(~unseen) > 0)  # from the first reading on, where filters begin
    back = np.flatnonzero(np.diff(log.t) < 0)
    if len(back):
        i = int(back[0])
        raise CalibrationError(
            f"the clock of the log goes back in row {i + 2}, from {log.t[i]:.4f} s to {log.t[i + 1]:.4f} s"
            f" ({len(back)} times in all); give one run per log, with rows in the order of time"
        )
    twice = np.flatnonzero(np.diff(log.t) == 0) + 1
    if len(twice):
        warnings.append(f"{len(twice)} rows have the same time as the row before; left out")
        log = log.part(np.delete(np.arange(len(log.t)), twice))
    distance = float(np.median(np.diff(log.t)))
    if 2 * distance >= BETWEEN:
        raise CalibrationError(
            f"the log has a reading each {distance:g} s by its column t; seconds are expected, and 50 readings a second"
            " or more. If t is in milliseconds, divide it by 1000"
        )
    if log.duration < LEAST:
        raise CalibrationError(
            f"the log lasts {log.duration:.2f} s by its column t (in seconds); {LEAST:g} s are needed, and"
            f" {SHORTEST:g} s in all logs to calibrate"
        )
    return log, warnings


def _first_gap(log: JointLog) -> str:
    """Return column and time of the first value that is not a number."""
    for name in ("q", "tau", "q_des", "force"):
        value = getattr(log, name)
        if value is not None and not np.isfinite(value).all():
            i, j = (int(x[0]) for x in np.nonzero(~np.isfinite(value)))
            return f"{name}.{log.joints[j]} at t = {log.t[i]:.3f} s"
    return "t"
