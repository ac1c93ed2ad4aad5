"""Several logs of one machine as one, one after another in time, each with what was said of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mimic.dynamics.machine import MachineModel, as_logged
from mimic.errors import CalibrationError
from mimic.io.joint_log import CHANNELS, JointLog
from mimic.records import BoolArray, FloatArray
from mimic.sysid.log.blocks import UNREAD
from mimic.sysid.timing import SendingTimes, joined, sending_times

BETWEEN = 1.0
"""Time between the logs of a pool [s]; what is longer than a gap in a log is forgotten."""

ENABLED = "enabled"
"""Column, of all joints or with a joint's name after a point: 0 while the drive is switched off."""

PAYLOAD, VOLTAGE = "payload", "voltage"
"""Metadata: mass at the end of links [kg], and supply voltage [V]."""


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
    """All that the logs allow (`mimic.sysid.timing.sending_times`)."""


def enabled(log: JointLog) -> BoolArray:
    """Return where drives were switched on (T, J)."""
    everywhere = log.extra.get(ENABLED, np.ones(len(log.t)))
    return np.stack([np.nan_to_num(log.extra.get(f"{ENABLED}.{j}", everywhere), nan=1.0) > 0.5 for j in log.joints], -1)


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
    _refuse_contradictions(logs, names)
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
    keep = {n for log in logs for n in log.extra if n == UNREAD or n.split(".")[0] == ENABLED}
    extra = {
        n: np.concatenate([p.extra.get(n, np.full(len(p.t), 0.0 if n == UNREAD else 1.0)) for p in pieces])
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


def _refuse_contradictions(logs: Sequence[JointLog], names: Sequence[str]) -> None:
    """Refuse logs that are not of one machine, or do not say the same things.

    Raises:
        CalibrationError: With the names of two that differ.
    """
    first, one = logs[0], names[0]
    for log, other in zip(logs[1:], names[1:], strict=True):
        if log.joints != first.joints:
            raise CalibrationError(
                f"{one} has joints {', '.join(first.joints)}, but {other} has {', '.join(log.joints)};"
                " give logs of one machine"
            )
        for channel, what in (("q_des", "targets (q_des)"), ("force", "forces")):
            if (getattr(first, channel) is None) != (getattr(log, channel) is None):
                has, lacks = (one, other) if getattr(log, channel) is None else (other, one)
                raise CalibrationError(f"{has} has {what}, but {lacks} has none; calibrate them apart")
        for key in ("kp", "kd", VOLTAGE):
            if first.q_des is not None and (key in first.metadata) != (key in log.metadata):
                has, lacks = (one, other) if key in first.metadata else (other, one)
                raise CalibrationError(
                    f"{has} says its {key}, but {lacks} does not; give it in the metadata of both, or with --note"
                )
        if list(first.metadata.get("gravity", [])) != list(log.metadata.get("gravity", [])):
            raise CalibrationError(f"{one} and {other} have different gravity; calibrate each pose by itself")
        spread, widest = np.ptp(first.q, axis=0), np.ptp(log.q, axis=0)
        ratio = float(np.median(widest / np.maximum(spread, 1e-9)))
        if (
            min(abs(ratio * np.pi / 180.0 - 1.0), abs(np.pi / 180.0 / max(ratio, 1e-9) - 1.0)) < 0.2
            and max(float(spread.max()), float(widest.max())) > 4 * np.pi
        ):
            degrees, radians = (other, one) if ratio > 1.0 else (one, other)
            raise CalibrationError(
                f'{degrees} moves 57 times as far as {radians}: degrees against radians; say "units": "deg" of it'
            )


def _number(given: Any, key: str, name: str) -> float | None:
    if given is None:
        return None
    if isinstance(given, bool) or not isinstance(given, int | float) or not 0.0 < given < 1e6:
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
        if isinstance(mass, bool) or not isinstance(mass, int | float) or not 0.0 <= mass < 1e4:
            raise CalibrationError(f"{name}: the payload at {joint} is {mass!r}; expected a mass in kg")
        row[machine.joints.index(joint)] = mass
    return row


def rows_of(parts: Sequence[Part], values: Sequence[FloatArray]) -> FloatArray:
    """Return a row (J,) of each part for each of its rows of the pool (T, J)."""
    return np.concatenate([np.broadcast_to(v, (p.rows, len(v))) for p, v in zip(parts, values, strict=True)])
