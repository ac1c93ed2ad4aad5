"""What logs and a model give a pass: rows, targets with the times at which they were sent, gains, and blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from mimic.dynamics.machine import MachineModel, as_logged
from mimic.io.joint_log import JointLog
from mimic.records import BoolArray, FloatArray, IntArray
from mimic.sysid.engine.predictor import Record
from mimic.sysid.engine.tree import Tree, tree_of
from mimic.sysid.log.noise import coarse_steps, noise_floor
from mimic.sysid.log.pool import VOLTAGE, Pool, enabled, pool, valid_samples
from mimic.sysid.log.timing import SendingTimes, at_rows

SEEK = 0.3
"""Time in which strong corrections find the start of a pass [s]."""

FORGET = 0.4
"""Time after which rows count: what the strong corrections left is over [s]."""

SHARE = 0.2
"""Most of a short log that these may take."""

GAP = 0.25
"""Time between two rows from which on a pass begins anew [s]: longer than any lag of a drive."""

BLOCK = 1.5
"""Length of the blocks that are judged [s]: longer than what an innovation remembers."""

FOLDS = 6
"""Parts into which blocks, or logs, are dealt."""

NEAR = 0.3
"""Length of blocks of the first fit of a baseline [s]: what numbers far off predict may be lost in a longer one."""

BEFORE = 0.5
"""Time before the first row of a log at which its first target was sent [s]: half of the time between logs."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Data:
    """Logs of one machine, ready for passes."""

    machine: MachineModel
    log: JointLog
    """All logs, one after another."""
    tree: Tree
    record: Record
    names: tuple[str, ...]
    """Of the logs."""
    counts: BoolArray
    """Readings that count (T, J)."""
    noise: FloatArray
    """Standard deviation of a reading (J,) [rad or m]."""
    encoder_steps: FloatArray
    """Of encoders so coarse that readings show it (J,), else 0 [rad or m]."""
    block: IntArray
    """Block of each row (T,)."""
    fold: IntArray
    """Fold of each block (B,): blocks that are left out together while effects are looked for."""
    apart: IntArray
    """The same of whole logs (B,): those of some gains, loads, or single ones; one fold where there is one log."""
    sending: tuple[SendingTimes, ...]
    """All that the logs allow."""
    times: SendingTimes
    """Those in use."""

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.machine.joints)

    @property
    def logs(self) -> int:
        """Number of logs."""
        return len(self.names)

    def sent_at(self, times: SendingTimes) -> Data:
        """Return the data with targets sent at these times."""
        sent = times.at.copy()
        first = np.isin(times.rows, np.flatnonzero(np.concatenate([[True], np.diff(self.record.log) > 0])))
        sent[first] = self.record.t[times.rows[first]] - BEFORE
        asked = self.log.q_des if self.log.q_des is not None else np.zeros_like(self.log.q)
        goal = np.ascontiguousarray(asked[times.rows])
        return replace(self, times=times, record=self.record._replace(sent=sent, goal=goal))

    def near(self) -> Data:
        """Return the data with predictions to the end of shorter blocks."""
        record = self.record
        block = np.cumsum(np.concatenate([[1], np.diff(self.block * 1000 + (record.since / NEAR).astype(int)) != 0]))
        return replace(self, record=record._replace(lead=_leads(record.t, block, record.fresh)))

    @cached_property
    def chains(self) -> tuple[slice, ...]:
        """Joints of each chain."""
        begins = np.flatnonzero(self.tree.parent < 0).tolist()
        return tuple(slice(*ends) for ends in pairwise([*begins, self.joints]))

    @cached_property
    def periods(self) -> list[float]:
        """Usual time between two rows of each log (L,) [s]."""
        steps = np.diff(self.record.t)
        on = ~self.record.fresh[1:]
        return [float(np.median(steps[(self.record.log[1:] == log) & on])) for log in range(self.logs)]

    def moved(self, joint: int) -> slice:
        """Return the joints that a number of a joint moves: those of its chain, all where it is of the machine (-1)."""
        return slice(0, self.joints) if joint < 0 else self.chains[self.machine.chain[joint]]

    @property
    def moves(self) -> BoolArray:
        """Which joints move at all (J,)."""
        return np.ptp(np.nan_to_num(self.log.q), axis=0) > 0.0


def data_of(logs: Sequence[JointLog], model: MachineModel, names: Sequence[str] = ()) -> Data:
    """Return logs of a machine ready for passes.

    Args:
        logs: Readings.
        model: The machine, with the gains of its own.
        names: Of the logs.

    Raises:
        CalibrationError: If the logs contradict each other, or lack a joint.
    """
    names = tuple(names) or tuple(f"log {i + 1}" for i in range(len(logs)))
    together = pool([log.of(model.joints) for log in logs], model, names)
    log = together.log
    machine = as_logged(model, logs[0].metadata, by_force=log.q_des is None)
    t = log.t.copy()
    which = together.which
    known = valid_samples(log)[:, None] & np.isfinite(log.q)
    begin = t[np.searchsorted(which, which)]
    length = t[np.searchsorted(which, which, side="right") - 1] - begin
    fresh = np.concatenate([[True], (np.diff(which) > 0) | (np.diff(t) > GAP)])
    since = t - t[np.maximum.accumulate(np.where(fresh, np.arange(len(t)), 0))]
    block = _blocks(t, which)
    drives = machine.drives
    none = np.zeros(len(machine.joints))
    volts = none if drives.volts is None else np.asarray(drives.volts, dtype=float)
    record = Record(
        t=t,
        y=np.where(known, log.q, np.nan),
        log=which,
        since=t - begin,
        fresh=fresh,
        settled=since >= np.minimum(SEEK, SHARE * length),
        lead=_leads(t, block, fresh),
        sent=np.zeros(0),
        goal=np.zeros((0, len(machine.joints))),
        force=np.zeros_like(log.q) if log.force is None else np.array(log.force),
        on=enabled(log).astype(float),
        supply=_supply(together, volts),
        kp=together.kp,
        kd=together.kd,
        payload=together.payload,
        volts=volts,
        kt=none + (1.0 if drives.kt is None else drives.kt),
        ohm=none + (1.0 if drives.resistance is None else drives.resistance),
        neighbour=np.asarray(drives.neighbour),
        gravity=np.array(machine.model.opt.gravity),
    )
    steps, noise = _encoders(log)
    sending = together.sending if log.q_des is not None else (at_rows(log),)
    made = Data(
        machine=machine,
        log=log,
        tree=tree_of(machine),
        record=record,
        names=names,
        counts=known & (since >= np.minimum(FORGET, SHARE * length))[:, None],
        noise=noise,
        encoder_steps=steps,
        block=block,
        fold=np.arange(block[-1] + 1) % FOLDS,
        apart=_apart(record, block),
        sending=sending,
        times=sending[0],
    )
    return made.sent_at(sending[0])


def _encoders(log: JointLog) -> tuple[FloatArray, FloatArray]:
    """Return the steps of coarse encoders (J,), and the noise of readings (J,): the most of others for what rests."""
    read = valid_samples(log)
    q = np.where(np.isfinite(log.q), log.q, 0.0)
    steps, noise = coarse_steps(q[read], noise_floor(q, log.rate, read))
    moves = (np.ptp(q, axis=0) > 0.0) & (noise > 0.0)
    return steps, np.where(moves, noise, noise[moves].max(initial=1e-9))


def _supply(together: Pool, volts: FloatArray) -> FloatArray:
    """Return the supply in each row over the nominal one (T,)."""
    share = together.supply[together.which]
    given = together.log.extra.get(VOLTAGE)
    if given is None or not (volts > 0).any():
        return np.ascontiguousarray(share)
    return np.where(np.isfinite(given), given / float(volts[volts > 0].mean()), share)


def _blocks(t: FloatArray, which: IntArray) -> IntArray:
    """Return the block of each row: each log in equal ones, two at least."""
    block = np.zeros(len(t), dtype=int)
    count = 0
    for log in range(which[-1] + 1):
        rows = which == log
        since = t[rows] - t[rows][0]
        pieces = max(round(since[-1] / BLOCK), 2)
        block[rows] = count + np.minimum(since / since[-1] * pieces, pieces - 1).astype(int)
        count += pieces
    return block


def _leads(t: FloatArray, block: IntArray, fresh: BoolArray) -> IntArray:
    """Return for each row what a second state does, which finds the start of the next block in the last `SEEK`."""
    lead = np.zeros(len(t), dtype=int)
    for rows in np.split(np.arange(len(t)), np.flatnonzero(np.diff(block) > 0) + 1):
        after = int(rows[-1]) + 1
        if after == len(t) or fresh[after]:
            continue
        begin = max(
            int(np.searchsorted(t, t[after - 1] - SEEK)), int(rows[0]), int(np.flatnonzero(fresh[:after])[-1]) + 1
        )
        if begin < after - 1:
            lead[begin:after] = 2
            lead[begin] = 1
            lead[after - 1] = 3
    return lead


def _apart(record: Record, block: IntArray) -> IntArray:
    """Return the fold of each block where whole logs are left out: by gains or loads where three are there.

    Of two, one would be left to fit what depends on them.
    """
    log = record.log[np.searchsorted(block, np.arange(block[-1] + 1))]
    for rows in (record.kp, record.payload):
        kinds = np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1)
        if kinds.max() > 1:
            return kinds[log]
    return log % FOLDS if log[-1] > 1 else np.zeros_like(log)
