"""Logged commands through the model: what the machine would have done with these parameters. Pure and repeatable.

The log is cut into segments that run side by side, each from its measured position after a time of settling: a joint
under a position servo forgets its start in that time. So one replay of a long log is many short ones in one batch.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from typing import Any, Self

import mujoco
import numpy as np
from mujoco.batch import Batch

from mimic.dynamics.law import Law, Parameters
from mimic.dynamics.machine import SOLREF_STEPS, UNLIMITED, MachineModel
from mimic.dynamics.servo import Servo, static_fields, target_shift
from mimic.dynamics.timers import disable_timers
from mimic.io.joint_log import JointLog
from mimic.jobs.local import cores
from mimic.records import FloatArray, IntArray
from mimic.sysid.log.noise import MEMORY
from mimic.sysid.log.pool import VOLTAGE, Part, enabled, rows_of, single
from mimic.sysid.log.timing import SendingTimes, at_rows

LONGEST_STEP = 0.0025
"""[s]"""


def on_steps(times: Any) -> Any:
    """Return times in steps, whole where single precision does not tell."""
    return np.where(np.abs(times - np.round(times)) < np.finfo(np.float32).eps, np.round(times), times)


def physics_step(rate: float) -> float:
    """Return the longest step up to LONGEST_STEP [s] that divides the time between readings at ``rate`` [Hz]."""
    between = 1.0 / rate
    return between / max(1, int(np.ceil(on_steps(between / LONGEST_STEP))))


@dataclass(frozen=True, kw_only=True, eq=False)
class Readings:
    """Readings that the segments predict, in order of the step of its segment that each falls into; arrays (R,)."""

    row: IntArray
    """Of the log."""
    segment: IntArray
    step: IntArray
    """-1 for a reading at the very start of a segment."""
    part: FloatArray
    """How far into the step, up to 1 for its end."""
    since: IntArray
    """Steps of the segment that were over at the reading before; 0 for its first."""

    def at(self, steps: int) -> IntArray:
        """Return where the readings of each step begin (steps + 1,)."""
        return np.searchsorted(self.step, np.arange(steps + 1))


@dataclass(frozen=True, kw_only=True, eq=False)
class Prediction:
    """What the model did; arrays (N, T, J), NaN where a segment was still settling."""

    residual: FloatArray
    """Measured - predicted position, single precision."""
    torque_residual: FloatArray | None
    """Measured - predicted torque of the motor, its mean since the reading before, where the log has it."""


def stretch_starts(t: FloatArray) -> FloatArray:
    """Return the start of the gap-free stretch that each reading (T,) is in [s].

    In a gap of half of what a drive takes to answer, and of twice the usual, targets may have come and gone.
    """
    between = np.diff(t)
    gap = between > max(MEMORY / 2, 2 * float(np.median(between)))
    return np.maximum.accumulate(np.where(np.concatenate([[True], gap]), t, -np.inf))


@dataclass(frozen=True, kw_only=True, eq=False)
class Targets:
    """Targets of a replay, or of several (V, ...): one comes in effect during each physics step, or none."""

    held: Any
    """In effect at the end of each step (..., steps, J)."""
    begun: Any
    """Share of each step after which that one came in effect; 0 where it was there from the start (..., steps)."""


def on_grid(arrival: FloatArray, values: FloatArray, step: float, steps: int) -> Targets:
    """Return targets as physics steps see them.

    Several that come in effect within one step are taken as one, at their mean time weighted by the size of their
    jumps.

    Args:
        arrival: When each comes in effect, growing, the first at 0 (K,) [s].
        values: Targets (K, J).
        step: Physics step [s].
        steps: How many.
    """
    at = on_steps(arrival / step)
    cell = np.floor(at).astype(int)
    jump = np.sqrt((np.diff(values, axis=0, prepend=values[:1]) ** 2).sum(1))
    inside = (cell >= 0) & (cell < steps)
    size, moment = np.zeros(steps), np.zeros(steps)
    np.add.at(size, cell[inside], jump[inside])
    np.add.at(moment, cell[inside], (jump * (at - cell))[inside])
    last = np.clip(np.searchsorted(cell, np.arange(steps), side="right") - 1, 0, len(values) - 1)
    return Targets(held=values[last], begun=np.divide(moment, size, out=moment, where=size > 0))


def acting(
    before: Any, older: Any, newer: Any, begun: tuple[Any, Any], part: Any, xp: Any
) -> tuple[Any, list[tuple[Any, Any]]]:
    """Return the mean target of a step (N, J) that does not begin on the grid, and the targets with their shares of it.

    It takes ``part`` of one step of the grid and the rest of the next one.

    Args:
        before: Target held before the first of the two (N, J).
        older: At its end.
        newer: At the end of the second.
        begun: Shares of the two steps after which theirs came in effect (N, 1).
        part: How much of the first step is taken, from 0 to 1 (N, 1) or (N, J).
        xp: ``numpy`` or ``torch``.
    """
    first = xp.clip(begun[0] - (1.0 - part), 0.0, None)
    last = xp.clip(1.0 - part - begun[1], 0.0, None)
    mean = older + first * (before - older) + last * (newer - older)
    return mean, [(first, before), (1.0 - first - last, older), (last, newer)]


STIFFNESS = 0.999
"""Impedance of dry friction. With 0.99 a light link that a gap parts from its rotor creeps at 8 mrad/s; in single
precision, where robots play, more is not exact."""

LEAD_IN = 0.8
"""Time that a segment runs before its readings count [s]."""

SHOOT = 0.5
"""Length of short segments, which run ``MEMORY`` before [s]: filters and rotors settle, but a joint that sticks and
slips does not get far from where it was. What it does depends on all that it did before: over a long time the error has
many local minima, over a short one hardly any (multiple shooting; Ribeiro et al. 2020)."""

SEGMENTS, SEGMENT = 24, (1.5, 6.0)
"""Segments of a log, and the least and greatest length of one [s]: steps in sequence cost more than simulations."""

MOST_SIMULATIONS = 1536
"""Simulations in one batch: enough that Python's share of a step is small, few enough for the cache."""

AROUND = 0.01
"""The velocity that a segment begins with is that between readings so long before and after [s]."""


@contextmanager
def _unheard() -> Iterator[None]:
    """Silence MuJoCo's warnings about diverging simulations: extreme parameters are tried on purpose.

    They begin again at zero.
    """
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda text: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


class Replay:
    """Replays of one log in one model."""

    def __init__(
        self,
        machine: MachineModel,
        log: JointLog,
        *,
        timestep: float = 0.001,
        segment: float | None = None,
        lead_in: float = LEAD_IN,
        threads: int = 0,
        torque: bool = False,
        sending: SendingTimes | None = None,
        parts: Sequence[Part] = (),
    ) -> None:
        """Cut the log into segments.

        Args:
            machine: The model, with the gains of the log.
            log: Readings of the machine's joints, in its order.
            timestep: Physics step [s].
            segment: Length of a segment [s]; by default a share of the log.
            lead_in: Time that a segment runs before its readings count [s].
            threads: Threads; 0 takes one for each core.
            torque: Also predict the torque.
            sending: When targets were sent; without, when the row was written that first shows them.
            parts: Logs that this one is made of, with the drives of each; without, it is one, with the machine's.
        """
        disable_timers()
        self.parts: tuple[Part, ...] = tuple(parts) or (single(log, machine),)
        self.machine, self.log, self.dt, self.threads = machine, log, timestep, threads or cores()
        self.torque = torque and log.tau is not None
        t = log.t - log.t[0]
        steps = on_steps(t / timestep)
        self.total = math.ceil(steps[-1])
        self._lead = round(lead_in / timestep)
        if segment is None:
            total = sum(part.end - part.begin for part in self.parts)
            segment = float(np.clip(total / SEGMENTS, *SEGMENT))
        cuts = [self._cut(part, segment) for part in self.parts]
        longest = max(float(np.diff(c).max()) for c in cuts) * timestep
        if longest > 2 * segment:  # all run as long as one that cannot be cut
            cuts = [self._cut(part, longest) for part in self.parts]
        self._part_of = np.repeat(np.arange(len(cuts)), [len(c) - 1 for c in cuts])
        first, last = (np.concatenate([c[a : len(c) + b] for c in cuts]) for a, b in ((0, -1), (1, 0)))
        self._begin = np.maximum(first - self._lead, np.array([c[0] for c in cuts])[self._part_of])
        self._first = first
        self.length = int((last - self._begin).max())
        self._rows = np.floor(steps).astype(int)
        self._part = steps - self._rows
        self.counts = t - stretch_starts(t) >= lead_in
        """Readings that count: all but those of the settling at the beginning and after each gap (T,)."""
        asked = log.q_des if log.q_des is not None else log.q * 0.0
        self.sending = sending or at_rows(log)
        self.late: FloatArray | None = None
        """How long after the delay of all each target acts (K,) [s]; None where all act in time."""
        self._targets = asked
        self._grid = self.delayed(np.zeros(len(self.sent)))
        self._force = None if log.force is None else self._mean_over_steps(log.force)
        on = enabled(log)
        row = np.searchsorted(steps, np.arange(self.total), side="right") - 1
        self._most = None if on.all() else np.where(on[row], UNLIMITED, 0.0)
        self._supply = self._supply_share()
        self.readings = self._readings()
        self._count = [0]
        self.heat: FloatArray | None = None
        """Square torque at each reading (T, J), where it is known."""
        self._finer: dict[int, Replay] = {}

    def finer(self, times: int, count: int = 1) -> Replay:
        """Return this replay in finer steps and segments of the least length; counts ``count`` replays."""
        self.replays += times * count
        fine = self._finer.get(times) or self._again(self.dt / times, SEGMENT[0])
        if fine.late is not self.late:
            fine = fine.with_late(self.late)
        self._finer[times] = fine
        return fine if fine.heat is self.heat else fine._with(heat=self.heat)

    def in_short_segments(self) -> Self:
        """Return this replay in short segments, see `SHOOT`."""
        short = self._again(self.dt, SHOOT, MEMORY).with_late(self.late)
        return short._with(heat=self.heat, _count=self._count)

    def _again(self, timestep: float, segment: float, lead_in: float = LEAD_IN) -> Self:
        return type(self)(
            self.machine,
            self.log,
            timestep=timestep,
            segment=segment,
            lead_in=lead_in,
            threads=self.threads,
            torque=self.torque,
            sending=self.sending,
            parts=self.parts,
        )

    def _cut(self, part: Part, segment: float) -> IntArray:
        """Return the steps at which the segments of a part begin, and its last.

        No long one begins while a drive is switched off: a joint that swings freely does not forget where it began.
        """
        begin, end = round(part.begin / self.dt), math.ceil(on_steps(part.end / self.dt))
        cuts = np.linspace(begin, end, max(1, round((part.end - part.begin) / segment)) + 1).round().astype(int)
        off = np.concatenate([[0], np.cumsum(~enabled(self.log).all(axis=1))])
        t = self.log.t - self.log.t[0]
        rows = [np.searchsorted(t, np.maximum(cuts - back, begin) * self.dt) for back in (self._lead, 0)]
        free = (off[rows[0]] == off[rows[1]]) | (self._lead < round(LEAD_IN / self.dt))
        free[[0, -1]] = True
        return cuts[free]

    @property
    def row_gains(self) -> tuple[FloatArray, FloatArray]:
        """Kp and Kd in each row (T, J); 0 where a drive is switched off."""
        on = enabled(self.log)
        kp, kd = (rows_of(self.parts, [getattr(p, k) for p in self.parts]) * on for k in ("kp", "kd"))
        return kp, kd

    @property
    def sent(self) -> IntArray:
        """Rows that first show each target (K,)."""
        return self.sending.rows

    def sent_at(self, sending: SendingTimes) -> Self:
        """Return the replay with targets sent at these times."""
        return self._with(sending=sending, _finer={}).with_late(None)

    def _with(self, **fields: Any) -> Self:
        """Return the replay with other fields."""
        other = copy(self)
        for name, value in fields.items():
            setattr(other, name, value)
        return other

    @property
    def replays(self) -> int:
        """Number of replays so far, of this one and those that it was made into."""
        return self._count[0]

    @replays.setter
    def replays(self, count: int) -> None:
        self._count[0] = count

    @property
    def segments(self) -> int:
        """Number of segments."""
        return len(self._begin)

    def with_heat(self, tau: FloatArray) -> Self:
        """Return the replay of motors warm from a torque (T, J) at the start of each segment."""
        return self._with(heat=np.asarray(tau) ** 2)

    def with_late(self, late: FloatArray | None) -> Self:
        """Return the replay in which each target acts so much later (K,) [s]; one that the next overtakes is lost."""
        return self._with(late=late, _grid=self.delayed(np.zeros(len(self.sent)) if late is None else late))

    def delayed(self, late: FloatArray) -> Targets:
        """Return the targets when each acts so much later (K,) [s]."""
        arrival = self.sending.at + late
        arrival[0] = 0.0
        kept = arrival <= np.minimum.accumulate(np.append(arrival[1:], np.inf)[::-1])[::-1]
        return on_grid(arrival[kept], self._targets[self.sent[kept]], self.dt, self.total)

    def _mean_over_steps(self, values: FloatArray) -> FloatArray:
        """Return the mean over each physics step of what holds from each reading to the next (steps, J)."""
        t = self.log.t - self.log.t[0]
        area = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values[:-1] * np.diff(t)[:, None], axis=0)])
        at = np.arange(self.total + 1) * self.dt
        row = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 1)
        integral = area[row] + (at - t[row])[:, None] * values[row]
        return np.diff(integral, axis=0) / self.dt

    # ------------------------------------------------------------------ running

    @_unheard()
    def run(
        self, parameters: Parameters, count: int, targets: Targets | None = None, *, square: bool = False
    ) -> Prediction:
        """Return the predictions of ``count`` parameter sets.

        Args:
            parameters: Values (count, J) or (count, 1).
            count: How many.
            targets: Those of each of them (count, ...), instead of the log's.
            square: Instead of a torque residual return minus the mean square torque.
        """
        out = np.full((count, len(self.log.t), len(self.machine.joints)), np.nan, dtype=np.float32)
        torque = np.full_like(out, np.nan) if self.torque or square else None
        for begin in range(0, count, self.sets_per_batch):
            rows = slice(begin, begin + self.sets_per_batch)
            values: Parameters = {k: np.asarray(v, dtype=np.float64)[rows] for k, v in parameters.items()}
            own = self._grid if targets is None else Targets(held=targets.held[rows], begun=targets.begun[rows])
            made = Prediction(residual=out[rows], torque_residual=None if torque is None else torque[rows])
            self._run(values, own, made, square)
        self.replays += count
        out[~np.isfinite(out)] = np.nan
        return Prediction(residual=out, torque_residual=torque)

    def mean_square_torque(self, parameters: Parameters) -> FloatArray:
        """Return the mean square motor torque since the reading before (T, J), for one parameter set."""
        made = self.run(parameters, 1, square=True).torque_residual
        assert made is not None
        found = -made[0].astype(np.float64)
        known = np.isfinite(found)
        return np.where(known, found, np.mean(found, axis=0, where=known))

    @property
    def sets_per_batch(self) -> int:
        """How many parameter sets to replay in one batch."""
        return max(1, MOST_SIMULATIONS // self.segments)

    def _model(self) -> mujoco.MjModel:
        """Return the model with the steps of this replay."""
        model = self.machine.model
        model.opt.timestep = self.dt
        model.dof_solref[:] = [SOLREF_STEPS * self.dt, 1.0]
        model.dof_solimp[:] = [STIFFNESS, STIFFNESS, 0.001, 0.5, 2.0]
        return model

    def _run(self, parameters: Parameters, targets: Targets, made: Prediction, square: bool) -> None:
        """Write what the segments predict; with ``square`` minus the mean square torque instead of the residual."""
        out, torque = made.residual, made.torque_residual
        sets, segments, joints = len(out), self.segments, len(self.machine.joints)
        n = sets * segments
        part_of = np.tile(self._part_of, sets)
        p = {key: np.repeat(value, segments, 0) for key, value in parameters.items()}
        if any(part.payload.any() for part in self.parts):
            load = np.stack([part.payload for part in self.parts])[part_of]
            p["payload", "mass"] = load + p.get(("payload", "mass"), 0.0)
        law = Law(self.machine.drives, p, self.dt, (n, joints), np)
        kp, kd = (np.stack([getattr(part, gain) for part in self.parts])[part_of] for gain in ("kp", "kd"))
        if self._supply is not None:  # gains at the supply of the first log
            kp = kp / np.array([part.supply for part in self.parts])[part_of, None]
        law.set_gains(kp, kd)
        if any(part.supply != 1.0 for part in self.parts) and self.machine.drives.volts is None:
            law.scale_supply(np.array([part.supply for part in self.parts])[part_of, None])
        began = np.array([part.begin for part in self.parts])[part_of]
        batch = Batch(self._model(), n, self.threads)
        static_fields(batch, self.machine, law, p)
        fields = Servo.of_batch(batch)
        begin = np.tile(self._begin, sets)
        q, dq = batch.bind("qpos"), batch.bind("qvel")
        start_q, start_dq = self._starts(begin, part_of)
        batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        law.reset(start_q, start_dq, self._heat_at(parameters))
        q[:], dq[:] = law.unread(start_q), start_dq
        late = target_shift(p, self.dt)
        whole = np.floor(late).astype(int)
        shifts = (whole, late - whole)
        measured = None if square else self.log.tau
        shape = (sets, segments, joints)
        gone, seen = np.zeros(shape), np.zeros(shape)
        before = np.array(law.reading(q)).reshape(shape)  # q is the simulation, and moves on
        own = np.repeat(np.arange(sets), segments)
        which = own if targets.held.ndim > 2 else None
        plan = self.readings
        at = plan.at(self.length)
        for i in range(at[0]):
            out[:, plan.row[i]] = self.log.q[plan.row[i]] - before[:, plan.segment[i]]
            if torque is not None:
                torque[:, plan.row[i]] = 0.0
        for k, (target, shares) in enumerate(self._acting(begin, shifts, targets, which)):
            now = begin + k
            force = None if self._force is None else self._force[np.minimum(now, self.total - 1)]
            if self._supply is not None:
                law.set_supply(self._supply[np.minimum(now, self.total - 1)])
            if self._most is not None:
                law.limit_torque(self._most[np.minimum(now, self.total - 1)])
            inputs = law.step(q, dq, target, (now * self.dt - began)[:, None], force, shares)
            fields.write(inputs)
            asked = (inputs.tau**2 if square else inputs.tau).reshape(shape)
            if torque is not None:
                gone += asked
            batch.step()
            law.needed = fields.needed  # not before the first step: it is of the run before
            law.settle(dq)
            reading = law.reading(q).reshape(shape)
            mine = slice(at[k], at[k + 1])
            if mine.start < mine.stop:
                rows, of, part = plan.row[mine], plan.segment[mine], plan.part[mine, None]
                value = reading[:, of]
                if (part < 1).any():
                    value = before[:, of] * (1 - part) + value * part
                out[:, rows] = self.log.q[rows] - value
                if torque is not None:
                    since = plan.since[mine, None]
                    mean = (gone[:, of] - seen[:, of]) / (k + 1 - since)
                    mean = np.where(since > 0, mean, asked[:, of])
                    torque[:, rows] = (0.0 if measured is None else measured[rows]) - mean
                    seen[:, of] = gone[:, of]
            before = np.array(reading)

    def _supply_share(self) -> FloatArray | None:
        """Return the supply of voltage drives over that of the first log in each step (steps, 1); None for others."""
        if self.machine.drives.volts is None:
            return None
        share = rows_of(self.parts, [np.array([part.supply]) for part in self.parts])[:, 0]
        volts = self.log.extra.get(VOLTAGE, np.full(len(share), np.nan))
        share = np.where(np.isfinite(volts), volts / float(np.mean(self.machine.drives.volts)), share)
        at = (np.arange(self.total) + 0.5) * self.dt
        return np.interp(at, self.log.t - self.log.t[0], share)[:, None]

    def _readings(self) -> Readings:
        row = np.flatnonzero(self.counts)
        step, part = self._rows[row], self._part[row]
        whole = part == 0  # at the end of the step before
        step, part = np.where(whole, step - 1, step), np.where(whole, 1.0, part)
        segment = np.maximum(np.searchsorted(self._first, step, side="right") - 1, 0)
        step = step - self._begin[segment]
        inside = (step >= 0) & (step < self.length) | (row == 0) & (step == -1)
        row, segment, step, part = (x[inside] for x in (row, segment, step, part))
        since, last, over = np.zeros(len(row), dtype=int), np.zeros((2, self.segments), dtype=int), step + 1
        for i in range(len(row)):  # readings within one step share the one before
            known = last[:, segment[i]]
            if over[i] > known[1]:
                known[:] = known[1], over[i]
            since[i] = known[0]
        order = np.argsort(step, kind="stable")
        return Readings(
            row=row[order],
            segment=segment[order],
            step=step[order],
            part=np.asarray(part[order], dtype=np.float64),
            since=since[order],
        )

    def _starts(self, begin: IntArray, part: IntArray) -> tuple[FloatArray, FloatArray]:
        t = self.log.t - self.log.t[0]
        at = begin * self.dt
        q = np.stack([np.interp(at, t, column) for column in self.log.q.T], -1)
        low, high = (np.array([getattr(part, end) for part in self.parts]) for end in ("begin", "end"))
        around = np.clip(at + np.array([[-AROUND], [AROUND]]), low[part], high[part])
        before, after = (np.stack([np.interp(x, t, column) for column in self.log.q.T], -1) for x in around)
        return q, (after - before) / (around[1] - around[0])[:, None]

    def _heat_at(self, p: Parameters) -> FloatArray | None:
        """Return the mean square torque of each set of parameters (N, J) at the start of segments (N segments, J).

        None where no set has an effect of heat, or none is known.
        """
        if self.heat is None or ("kt_heat", "time") not in p:
            return None
        time = np.asarray(p["kt_heat", "time"])[:, None]
        dt = float(np.median(np.diff(self.log.t)))
        rows = np.clip(np.searchsorted(self.log.t - self.log.t[0], self._begin * self.dt), 0, len(self.log.t))
        heat = np.zeros((len(time), len(rows), self.heat.shape[1]))
        for i in range(1, len(rows)):
            own = self.heat[rows[i - 1] : rows[i]]
            age = np.arange(len(own))[::-1, None] * dt
            if self._part_of[i] != self._part_of[i - 1]:
                continue  # another log: cold again
            heat[:, i] = heat[:, i - 1] * np.exp(-len(own) * dt / time[:, 0])
            heat[:, i] += (own * np.exp(-age / time) * (dt / time)).sum(1)
        return heat.reshape(-1, heat.shape[2])

    def _acting(
        self, begin: IntArray, shifts: tuple[Any, Any], targets: Targets, which: IntArray | None
    ) -> Iterator[tuple[FloatArray, list[tuple[Any, Any]]]]:
        """Yield the mean target in each step of simulations that begin at these (n,), and the targets with their shares
        if several act.

        Of several targets (V, ...), those of ``which`` (n,).
        """
        whole, part = shifts
        own = () if which is None else (which[:, None],)
        last, joints = targets.held.shape[-2] - 1, np.arange(targets.held.shape[-1])
        alike = whole.shape[1] == 1  # all joints of a machine are as late
        first = begin[:, None] - whole
        together = max(1, MOST_SIMULATIONS // len(begin))  # NumPy takes longer to be called than to work on few
        for k in range(0, self.length, together):
            steps = np.arange(k - 2, min(k + together, self.length))
            row = np.minimum(np.maximum(first + steps[:, None, None], 0), last)
            held = targets.held[(*own, row)][..., 0, :] if alike else targets.held[(*own, row, joints)]
            begun, same = targets.begun[(*own, row)], (held[1:] == held[:-1]).all((1, 2))
            mean, shares = acting(held[:-2], held[1:-1], held[2:], (begun[1:-1], begun[2:]), part, np)
            for i in range(len(mean)):
                still = same[i] and same[i + 1]
                yield mean[i], [] if still else [(share[i], target[i]) for share, target in shares]
