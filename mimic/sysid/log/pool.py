"""Which samples of a log count, the blocks of time that they are in, and several logs of one machine as one."""

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

SHORT, LEAST_BLOCKS = 9.5, 16
"""A log up to so long [s] is cut into so many blocks; fewer could not say how sure anything is."""

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


@dataclass(frozen=True, kw_only=True, eq=False)
class Blocks:
    """Blocks of time, and which are held out."""

    index: IntArray
    """Block of each reading, -1 where it does not count (T,)."""
    held_out: BoolArray
    """True for blocks that nothing is fitted to (B,)."""
    switched: BoolArray | None = None
    """True for blocks in which a drive is switched: they are always fitted and judge nothing, since
    no other says what happens then (B,)."""

    @property
    def train(self) -> IntArray:
        """Blocks that are fitted."""
        return np.flatnonzero(~self.held_out)

    @property
    def fitted(self) -> BoolArray:
        """Readings in blocks that are fitted (T,)."""
        return np.isin(self.index, self.train)


def make_blocks(
    t: FloatArray,
    counts: BoolArray,
    logs: Sequence[slice] = (),
    enabled: BoolArray | None = None,
) -> Blocks:
    """Cut time into equal blocks of about a second and hold every fourth of each log out, whatever logs are before it.

    Where a drive is switched in that one, the next is held out: a joint that is let go moves as in no other block, so
    that nothing fitted to the others says how.

    Args:
        t: Time of each reading (T,) [s].
        counts: Readings that count (T,).
        logs: Rows of each log, of several.
        enabled: Where drives were switched on (T, J); always by default.
    """
    logs = logs or [slice(0, len(t))]
    total = float(sum(t[rows][-1] - t[rows][0] for rows in logs))
    seconds = 1.0 if total > SHORT else total / LEAST_BLOCKS
    index, held_out, switched, count = np.zeros(len(t), dtype=int), [], [], 0
    for rows in logs:
        since = t[rows] - t[rows][0]
        last = max(round(since[-1] / seconds), 1) - 1
        own = np.minimum(since * (last + 1) / since[-1], last).astype(int)
        index[rows] = count + own
        count += last + 1
        rest = np.ones(last + 1, dtype=bool)
        if enabled is not None:
            rest[own[1:][np.any(np.diff(enabled[rows], axis=0), axis=1)]] = False
        held = [np.flatnonzero(rest[b : b + 4])[:1] + b for b in range(2, last + 1, 4)]
        held_out.append(np.isin(np.arange(last + 1), np.concatenate([[-1], *held])))
        switched.append(~rest)
    return Blocks(
        index=np.where(counts, index, -1), held_out=np.concatenate(held_out), switched=np.concatenate(switched)
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Sums:
    """Normal equations of each block over whitened residuals."""

    hessian: FloatArray
    """(B, P, P)"""
    gradient: FloatArray
    """(B, P)"""
    weighed: tuple[FloatArray, FloatArray]
    """Hessian (B, P, P) and gradient (B, P) in which each chain has its weight, see `Problem.weighed`."""
    weight: FloatArray
    """Weight of the chain of each free parameter, 1 for those of the whole machine (P,)."""

    def over(self, blocks: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return Hessian (P, P) and gradient (P,) over some blocks."""
        return self.hessian[blocks].sum(0), self.gradient[blocks].sum(0)

    def weighed_over(self, blocks: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the same in which each chain has its weight."""
        return self.weighed[0][blocks].sum(0), self.weighed[1][blocks].sum(0)


def spikes(log: JointLog) -> BoolArray:
    """Return the position readings (T, J) that are far off the line through their neighbours: corrupt frames.

    Far is what neither the motion there nor the noise of the log comes near.
    """
    t, q = log.t[:, None], np.where(np.isfinite(log.q), log.q, np.nan)
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

ENABLED = "enabled"
"""Column, of all joints or with a joint's name after a point: 0 while the drive is switched off."""

PAYLOAD, VOLTAGE = "payload", "voltage"
"""Metadata: mass at the end of links [kg], and supply voltage [V], which is a column too."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """One of the logs of a pool, and the drives as they were."""

    name: str
    first: int
    """Its first row."""
    rows: int
    begin: float
    """Of the first row, from that of the pool [s]."""
    end: float
    """Of the last row [s]."""
    kp: FloatArray
    """(J,)"""
    kd: FloatArray
    """(J,)"""
    payload: FloatArray
    """Mass at the end of each link beside the model's (J,) [kg]."""
    supply: float = 1.0
    """Supply voltage over that of the first log."""

    @property
    def slice(self) -> slice:
        """Return the rows of the pool that are this log's."""
        return slice(self.first, self.first + self.rows)


@dataclass(frozen=True, kw_only=True, eq=False)
class Pool:
    """Logs of one machine."""

    log: JointLog
    """All rows."""
    parts: tuple[Part, ...]
    step: float
    """Physics step of which each begins at a multiple [s]."""
    sending: tuple[SendingTimes, ...]
    """All that the logs allow (`mimic.sysid.log.timing.sending_times`)."""


def enabled(log: JointLog) -> BoolArray:
    """Return where drives were switched on (T, J)."""
    everywhere = log.extra.get(ENABLED, np.ones(len(log.t)))
    return np.stack([np.nan_to_num(log.extra.get(f"{ENABLED}.{j}", everywhere), nan=1.0) != 0 for j in log.joints], -1)


def followed(log: JointLog) -> FloatArray | None:
    """Return the targets (T, J), and readings where no drive follows them."""
    return None if log.q_des is None else np.where(enabled(log), log.q_des, log.q)


def pool(logs: Sequence[JointLog], model: MachineModel, step: float, names: Sequence[str] = ()) -> Pool:
    """Return logs of the machine's joints as one.

    Args:
        logs: Readings of the machine's joints, in its order.
        model: The machine.
        step: Physics step [s]: logs begin at a multiple of it.
        names: Of the logs, for messages.

    Raises:
        CalibrationError: If they contradict each other.
    """
    names = tuple(names) or tuple(f"log {i + 1}" for i in range(len(logs)))
    refuse_contradictions(logs, names)
    if any(log.force is not None for log in logs):  # added to what the drive gives: none is a force of zero
        logs = [log if log.force is not None else replace(log, force=np.zeros(log.q.shape)) for log in logs]
    parts, times, pieces = [], [], []
    row, at = 0, 0.0
    volts = [_number(log.metadata.get(VOLTAGE), VOLTAGE, name) for log, name in zip(logs, names, strict=True)]
    for log, name, supply in zip(logs, names, volts, strict=True):
        machine = as_logged(model, log.metadata, by_force=log.q_des is None)
        t = log.t - log.t[0] + at
        parts.append(
            Part(
                name=name,
                first=row,
                rows=len(t),
                begin=at,
                end=float(t[-1]),
                kp=np.array(machine.drives.kp, dtype=float),
                kd=np.array(machine.drives.kd, dtype=float),
                payload=_payload(log.metadata, machine, name),
                supply=1.0 if supply is None or volts[0] is None else supply / volts[0],
            )
        )
        times.append(sending_times(log))
        pieces.append(replace(log, t=t))
        row, at = row + len(t), float(np.ceil((t[-1] + BETWEEN) / step) * step)
    if len(logs) == 1:
        return Pool(log=logs[0], parts=tuple(parts), step=step, sending=times[0])
    common = [n for n in CHANNELS if all(getattr(log, n) is not None for log in logs)]
    keep = {n for log in logs for n in log.extra if n in (UNREAD, VOLTAGE) or n.split(".")[0] == ENABLED}
    extra = {
        n: np.concatenate(
            [p.extra.get(n, np.full(len(p.t), {UNREAD: 0.0, VOLTAGE: np.nan}.get(n, 1.0))) for p in pieces]
        )
        for n in keep
    }
    whole = JointLog(
        joints=logs[0].joints,
        t=np.concatenate([p.t for p in pieces]),
        extra=extra,
        metadata=logs[0].metadata,
        **{n: np.concatenate([getattr(p, n) for p in pieces]) for n in common},
    )
    sending = joined(times, [(p.first, p.begin) for p in parts])
    return Pool(log=whole, parts=tuple(parts), step=step, sending=sending)


def single(log: JointLog, machine: MachineModel) -> Part:
    """Return the part that a log alone is, with the drives of its machine."""
    joints = len(machine.joints)
    return Part(
        name="",
        first=0,
        rows=len(log.t),
        begin=0.0,
        end=float(log.t[-1] - log.t[0]),
        kp=np.asarray(machine.drives.kp) * np.ones(joints),
        kd=np.asarray(machine.drives.kd) * np.ones(joints),
        payload=np.zeros(joints),
    )


def refuse_contradictions(logs: Sequence[JointLog], names: Sequence[str]) -> None:
    """Refuse logs that are not of one machine, or do not say the same things.

    Args:
        logs: As they were read; their joints may be in any order.
        names: Of the logs, for messages.

    Raises:
        CalibrationError: With the names of two that differ.
    """
    first, one = logs[0], names[0]
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
    given, row = notes.get(PAYLOAD, 0.0), np.zeros(len(machine.joints))
    if not isinstance(given, Mapping):
        given = {machine.joints[-1]: given}
    for joint, mass in given.items():
        if joint not in machine.joints:
            raise CalibrationError(f"{name}: payload at {joint!r}; the joints are {', '.join(machine.joints)}")
        if isinstance(mass, bool) or not isinstance(mass, int | float) or not 0.0 <= mass < np.inf:
            raise CalibrationError(f"{name}: the payload at {joint} is {mass!r}; expected a mass in kg")
        row[machine.joints.index(joint)] = mass
    return row


def rows_of(parts: Sequence[Part], values: Sequence[FloatArray]) -> FloatArray:
    """Return a row (J,) of each part for each of its rows of the pool (T, J)."""
    return np.concatenate([np.broadcast_to(v, (p.rows, len(v))) for p, v in zip(parts, values, strict=True)])
