"""Which samples of a log count, and several logs of one machine as one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import median_abs_deviation

from mimic.dynamics.machine import MachineModel, as_logged
from mimic.errors import CalibrationError
from mimic.io.joint_log import CHANNELS, JointLog
from mimic.records import BoolArray, FloatArray, IntArray
from mimic.sysid.log.noise import LOW
from mimic.sysid.log.timing import SendingTimes, joined, sending_times

UNREAD = "unread"
"""Column of such rows: 1 where nothing is compared with the reading, which is interpolated."""

RECEIVED = "t_receive."
"""Begins the name of the column with the time at which a joint's answer came."""

ODD = 5.0
"""An answer this many standard deviations from the usual time is of no known time, or of another row."""

LEAST_ODD = 0.5e-3
"""[s]; what is less hardly matters."""

FAR = 10.0
"""A reading is corrupt that is so many times as far off the line through its neighbours as theirs are."""


def spikes(log: JointLog) -> BoolArray:
    """Return the position readings (T, J) that are far off the line through their neighbours: corrupt frames.

    Far is what neither the motion there nor the noise of the log comes near.
    """
    t = log.t[:, None]
    q = np.where(np.isfinite(log.q), log.q, np.nan)
    found = np.zeros(q.shape, dtype=bool)
    if len(q) < 5:
        return found
    slope = (q[3:-1] - q[1:-3]) / (t[3:-1] - t[1:-3])
    before, off, after = (
        np.abs(q[k : len(q) - 4 + k] - q[1:-3] - slope * (t[k : len(q) - 4 + k] - t[1:-3])) for k in (0, 2, 4)
    )
    for j, own in enumerate(off.T):
        known = own[np.isfinite(own)]
        steps = known[known > np.finfo(known.dtype).eps * np.nanmax(np.abs(q[:, j]), initial=0.0)]
        if len(steps):  # the median is that of an encoder's steps, where the joint rests
            usual = max(np.quantile(known, 1.0 - LOW), np.median(steps))
            found[2:-2, j] = own > FAR * np.maximum(np.maximum(before[:, j], after[:, j]), usual)
    return found


def missing(log: JointLog) -> BoolArray:
    """Return the rows (T,) with a reading that is not a number."""
    rows = np.asarray(~np.isfinite(log.q).all(axis=1))
    if log.tau is not None and np.isfinite(log.tau).any():
        rows |= ~np.isfinite(log.tau).all(axis=1)
    return rows


def at_odd_times(log: JointLog, most: float) -> BoolArray:
    """Return the rows (T,) in which a joint answered much earlier or later than usual.

    Early ones are the answers to the row before.

    Args:
        log: With the times at which answers came; without, no row is.
        most: Greatest share of the rows; of more, those that are furthest off.
    """
    odd = np.zeros(len(log.t))
    for joint in log.joints:
        if (came := log.extra.get(RECEIVED + joint)) is None or not np.isfinite(came).any():
            continue
        after = came - log.t
        away = np.abs(after - np.nanmedian(after))
        usual = median_abs_deviation(after, scale="normal", nan_policy="omit")
        odd = np.fmax(odd, away / max(ODD * float(usual), LEAST_ODD))
    return np.asarray(odd > max(1.0, float(np.quantile(odd, 1.0 - most))))


def filled(log: JointLog, rows: BoolArray) -> JointLog:
    """Return the log with the readings of some rows (T,) interpolated and masked."""
    values: dict[str, Any] = {}
    for name in ("q", "dq", "tau"):
        channel = getattr(log, name)
        if channel is not None:
            values[name] = np.stack([_interpolated(log.t, column, rows) for column in channel.T], -1)
    mark = rows | (np.nan_to_num(log.extra.get(UNREAD, np.zeros(len(log.t)))) > 0)
    return replace(log, extra={**log.extra, UNREAD: mark.astype(float)}, **values)


def _interpolated(t: FloatArray, x: FloatArray, rows: BoolArray) -> FloatArray:
    known = ~rows & np.isfinite(x)
    return np.where(known, x, np.interp(t, t[known], x[known]) if known.any() else 0.0)


def valid_samples(log: JointLog) -> BoolArray:
    """Return the rows (T,) whose readings are not masked."""
    return np.asarray(np.nan_to_num(log.extra.get(UNREAD, np.zeros(len(log.t)))) == 0)


BETWEEN = 1.0
"""Time between the logs of a pool [s]: a gap, so that it must be more than two readings are apart."""

SHORTEST = 5.0
"""Least length of all logs together, and of one in which what follows what can be told [s]."""

ENABLED = "enabled"
"""Column, of all joints or with a joint's name after a point: 0 while the drive is switched off."""

PAYLOAD = "payload"
VOLTAGE = "voltage"
"""Metadata: mass at the end of links [kg], and supply voltage [V], which is a column too."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Pool:
    """Logs of one machine, and the drives as they were in each."""

    log: JointLog
    """All rows, from time zero."""
    which: IntArray
    """Log of each row (T,)."""
    kp: FloatArray
    """(L, J)"""
    kd: FloatArray
    """(L, J)"""
    payload: FloatArray
    """Mass at the end of each link beside the model's (L, J) [kg]."""
    supply: FloatArray
    """Supply voltage over that of the first log (L,)."""
    sending: tuple[SendingTimes, ...]
    """All that the logs allow (`mimic.sysid.log.timing.sending_times`)."""


def enabled(log: JointLog) -> BoolArray:
    """Return where drives were switched on (T, J)."""
    everywhere = log.extra.get(ENABLED, np.ones(len(log.t)))
    return np.stack([np.nan_to_num(log.extra.get(f"{ENABLED}.{j}", everywhere), nan=1.0) != 0 for j in log.joints], -1)


def lasts(*logs: JointLog) -> bool:
    """Return whether logs last long enough together; one of 5 s ends a target before."""
    return round(sum(log.duration for log in logs), 1) >= SHORTEST


def followed(log: JointLog) -> FloatArray | None:
    """Return the targets (T, J), and readings where no drive follows them."""
    return None if log.q_des is None else np.where(enabled(log), log.q_des, log.q)


def pool(logs: Sequence[JointLog], model: MachineModel, names: Sequence[str] = ()) -> Pool:
    """Return logs of the machine's joints as one.

    Args:
        logs: Readings of the machine's joints, in its order.
        model: The machine.
        names: Of the logs, for messages.

    Raises:
        CalibrationError: If they contradict each other.
    """
    names = tuple(names) or tuple(f"log {i + 1}" for i in range(len(logs)))
    refuse_contradictions(logs, names)
    if any(log.force is not None for log in logs):  # added to what the drive gives: none is a force of zero
        logs = [log if log.force is not None else replace(log, force=np.zeros(log.q.shape)) for log in logs]
    machines = [as_logged(model, log.metadata, by_force=log.q_des is None) for log in logs]
    volts = [_number(log.metadata.get(VOLTAGE), VOLTAGE, name) for log, name in zip(logs, names, strict=True)]
    loads = [_payload(log.metadata, one, name) for log, one, name in zip(logs, machines, names, strict=True)]
    ends = np.cumsum([log.t[-1] - log.t[0] + BETWEEN for log in logs])
    begins = np.concatenate([[0.0], ends[:-1]])
    rows = [len(log.t) for log in logs]
    common = [n for n in CHANNELS if all(getattr(log, n) is not None for log in logs)]
    keep = {n for log in logs for n in log.extra if n in (UNREAD, VOLTAGE) or n.split(".")[0] == ENABLED}
    extra = {}
    for n in keep:
        absent = {UNREAD: 0.0, VOLTAGE: np.nan}.get(n, 1.0)
        extra[n] = np.concatenate([log.extra.get(n, np.full(len(log.t), absent)) for log in logs])
    whole = JointLog(
        joints=logs[0].joints,
        t=np.concatenate([log.t - log.t[0] + begin for log, begin in zip(logs, begins, strict=True)]),
        extra=extra,
        metadata=logs[0].metadata,
        **{n: np.concatenate([getattr(log, n) for log in logs]) for n in common},
    )
    firsts = np.cumsum([0, *rows[:-1]]).tolist()
    return Pool(
        log=whole,
        which=np.repeat(np.arange(len(logs)), rows),
        kp=np.array([one.drives.kp for one in machines], dtype=float),
        kd=np.array([one.drives.kd for one in machines], dtype=float),
        payload=np.stack(loads),
        supply=np.array([1.0 if v is None or volts[0] is None else v / volts[0] for v in volts]),
        sending=joined([sending_times(log) for log in logs], list(zip(firsts, begins.tolist(), strict=True))),
    )


def refuse_contradictions(logs: Sequence[JointLog], names: Sequence[str]) -> None:
    """Refuse logs that are not of one machine, or do not say the same things.

    Args:
        logs: As they were read; their joints may be in any order.
        names: Of the logs, for messages.

    Raises:
        CalibrationError: With the names of two that differ.
    """
    first = logs[0]
    one = names[0]
    for log, other in zip(logs[1:], names[1:], strict=True):
        if set(log.joints) != set(first.joints):
            raise CalibrationError(
                f"{one} has joints {', '.join(first.joints)}, but {other} has {', '.join(log.joints)};"
                " give logs of one machine"
            )
        log = log.of(first.joints)
        if (first.q_des is None) != (log.q_des is None):
            has, lacks = (one, other) if log.q_des is None else (other, one)
            raise CalibrationError(f"{has} has targets (q_des), but {lacks} has none; calibrate them apart")
        for key in ("kp", "kd", "drive", "gain", VOLTAGE):
            if first.q_des is not None and (key in first.metadata) != (key in log.metadata):
                has, lacks = (one, other) if key in first.metadata else (other, one)
                raise CalibrationError(
                    f"{has} says its {key}, but {lacks} does not; give it in the metadata of both, or with --note"
                )
        if list(first.metadata.get("gravity", [])) != list(log.metadata.get("gravity", [])):
            raise CalibrationError(f"{one} and {other} have different gravity; calibrate each pose by itself")


def _number(given: Any, key: str, name: str) -> float | None:
    if given is None:
        return None
    if isinstance(given, bool) or not isinstance(given, int | float) or not 0.0 < given < np.inf:
        raise CalibrationError(f"{name}: {key} is {given!r}; expected a number above 0")
    return float(given)


def _payload(notes: Mapping[str, Any], machine: MachineModel, name: str) -> FloatArray:
    """Return the masses at the ends of the links (J,): one for the last joint, or by joint."""
    given = notes.get(PAYLOAD, 0.0)
    row = np.zeros(len(machine.joints))
    if not isinstance(given, Mapping):
        given = {machine.joints[-1]: given}
    for joint, mass in given.items():
        if joint not in machine.joints:
            raise CalibrationError(f"{name}: payload at {joint!r}; the joints are {', '.join(machine.joints)}")
        if isinstance(mass, bool) or not isinstance(mass, int | float) or not 0.0 <= mass < np.inf:
            raise CalibrationError(f"{name}: the payload at {joint} is {mass!r}; expected a mass in kg")
        row[machine.joints.index(joint)] = mass
    return row
