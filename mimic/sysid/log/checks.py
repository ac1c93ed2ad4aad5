"""Checks of a log before anything is fitted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mimic.errors import CalibrationError
from mimic.io.joint_log import CHANNELS, JointLog
from mimic.records import BoolArray, FloatArray
from mimic.sysid.log.faults import (
    FOLLOWS,
    beyond,
    excitation,
    full,
    gaps,
    misassigned,
    stuck,
    turns,
    units,
    weak_following,
)
from mimic.sysid.logs import at_odd_times, filled, followed, missing, spikes, valid_samples
from mimic.sysid.noise import Following, Repeat, find_repeat, following, noise_floor, repeatability, resolution

MOST_LOST = 0.2
"""Greatest share of rows that may be left out."""

SHORTEST = 5.0
"""Shortest log that is accepted [s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LogCheck:
    """What a usable log holds; arrays are (J,) in the order of its joints."""

    log: JointLog
    """The log without repeated and unreadable rows: the one to fit."""
    noise: FloatArray
    """Standard deviation of white noise on the positions, no less than the encoder's step allows."""
    step: FloatArray
    """Smallest step of the reading; 0 where none is seen."""
    lag: FloatArray
    """Of the position behind its target [s]; NaN where it does not follow."""
    correlation: FloatArray
    """Of the position with its target at that lag; NaN in a log of forces."""
    moves: BoolArray
    """Joints that are excited."""
    repeat: Repeat | None
    """An excitation that comes twice."""
    repeatability: FloatArray | None
    """Difference of the two repetitions over the square root of 2; with heat or drift it is more than noise."""
    warnings: tuple[str, ...]
    """What the user should know, a line each."""


def check_log(
    log: JointLog, limits: FloatArray | None = None, torque: FloatArray | None = None, unit: str = "rad"
) -> LogCheck:
    """Return the properties of a usable log, with warnings.

    Args:
        log: Readings of a machine.
        limits: Lower and upper joint limit (J, 2), infinite where there is none.
        torque: Largest torque of each motor (J,), where known.
        unit: Of the positions: "rad", or "m" where the joints slide.

    Raises:
        CalibrationError: If nothing can be fitted to it; a line for each reason.
    """
    log, warnings = _readable(log)
    warnings += gaps(log)
    wrong = [*units(log, limits, unit)] or [*turns(log, unit)]
    if wrong:
        raise CalibrationError("\n".join(wrong))
    target = followed(log)
    found = None if target is None else following(log.t, log.q, target)
    if found is not None:
        wrong = list(misassigned(log, found.correlation, found.moves))
        if wrong:
            raise CalibrationError("\n".join(wrong))
        warnings += weak_following(log, found.correlation, found.lag, found.moves)
    known = valid_samples(log)
    noise = noise_floor(log.q, log.rate, known)
    step = np.array([resolution(c) for c in log.q[known].T])
    asked = target if target is not None else log.force
    assert asked is not None  # the reader refuses a log with neither
    if target is not None and log.force is not None:
        asked = np.concatenate([target, log.force], axis=1)  # a force added to the drive
    moves = (np.ptp(asked, axis=0) > 1e-9).reshape(-1, len(log.joints)).any(axis=0)
    warnings += [
        *stuck(log),
        *excitation(log, moves, noise, unit),
        *beyond(log, limits),
        *full(log, torque),
    ]
    repeat = find_repeat(log.t, asked)
    return LogCheck(
        log=log,
        noise=noise,
        step=step,
        lag=found.lag if found else np.full(len(log.joints), np.nan),
        correlation=np.diag(found.correlation).copy() if found else np.full(len(log.joints), np.nan),
        moves=moves,
        repeat=repeat,
        repeatability=None if repeat is None else repeatability(log.t, log.q, asked, repeat),
        warnings=tuple(warnings),
    )


def targets_match_log(log: JointLog) -> tuple[bool, str]:
    """Return whether the targets can belong to the positions, and why not.

    Only what is certain is refused: targets that nothing follows, that a position precedes, or that fit far better
    reversed or shifted in time. Whether log and model belong together is for the fit to say.
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

    follows, lag = median(near), near.lag[moving]
    if follows > FOLLOWS and (np.nan_to_num(lag) < -1.5 / log.rate).all():
        early = -1e3 * float(np.median(lag))
        return False, f"positions come {early:.0f} ms before their targets; the log runs backwards in time"
    back = median(following(log.t, log.q, asked[::-1]))
    if back > FOLLOWS and back > follows + 0.01:
        return False, f"positions follow the targets read backwards (correlation {back:.3f}, forwards {follows:.3f})"
    far = following(log.t, log.q, asked, (-0.4 * log.duration, 0.4 * log.duration))
    if median(far) > FOLLOWS and median(far) > follows + 0.1:
        late = float(np.nanmedian(far.lag[moving]))
        when = f"{abs(late):.2f} s {'before' if late > 0 else 'after'} them"
        return False, f"positions follow the targets logged {when}: two clocks, or rows that do not match"
    if follows < 0.7:
        return False, f"positions do not follow the targets (correlation {follows:.2f})"
    return True, ""


def _readable(log: JointLog) -> tuple[JointLog, list[str]]:
    """Return the log without rows that cannot be used, and what was wrong with them.

    Raises:
        CalibrationError: If too little is left.
    """
    warnings: list[str] = []
    if len(log.t) < 2:
        raise CalibrationError(f"the log has {len(log.t)} rows; a calibration needs {SHORTEST:g} s of readings")
    empty = [n for n in ("dq", "tau") if getattr(log, n) is not None and not np.isfinite(getattr(log, n)).any()]
    if empty:
        log = replace(log, **dict.fromkeys(empty))
    if log.tau is not None and not (np.fmax.reduce(log.tau) > np.fmin.reduce(log.tau)).any():
        warnings.append("the measured torque never changes: the drives do not report it; left out")
        log = replace(log, tau=None)
    ok, told = np.isfinite(log.t), np.zeros(len(log.t), dtype=bool)
    for name in CHANNELS:
        value = getattr(log, name)
        if value is None or name == "dq":  # which nothing is fitted to
            continue
        finite = np.isfinite(value)
        for i in np.flatnonzero(finite.mean(axis=0) < 0.5):
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
        if lost > MOST_LOST:
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
    odd = at_odd_times(log, MOST_LOST) & ~gone
    if odd.any():
        warnings.append(
            f"{int(odd.sum())} rows ({odd.mean():.1%}) were answered at another time than the others; left out"
        )
    if (unseen := gone | odd).any():
        log = filled(log, unseen)
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
    if distance >= 0.5:
        raise CalibrationError(
            f"the log has a reading each {distance:g} s by its column t; seconds are expected, and 50 readings a second"
            " or more. If t is in milliseconds, divide it by 1000"
        )
    if log.duration + 2.0 * distance + 0.02 < SHORTEST:  # a log of 5 s ends a target before
        raise CalibrationError(
            f"the log lasts {log.duration:.2f} s by its column t (in seconds);"
            f" {SHORTEST:g} s are needed, 120 s are good"
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
