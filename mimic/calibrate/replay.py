"""Logged commands through the model: what the machine would have done with these parameters. Pure and repeatable.

The log is cut into segments that run side by side, each from its measured position after a time of settling: a joint
under a position servo forgets its start in that time. So one replay of a long log is many short ones in one batch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch

from mimic.machine_log import MachineLog
from mimic.robot.law import Law, Parameters
from mimic.robot.machine import SOLREF_STEPS, MachineModel
from mimic.robot.servo import Servo, static_fields, target_shift
from mimic.types import FloatArray, IntArray

MOST_SIMULATIONS = 1536
"""Simulations in one batch: enough that Python's share of a step is small, few enough for the cache."""


FEW = 400
"""Joints in a batch up to which one thread is faster than several that wait for each other at every step."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Prediction:
    """What the model did; arrays (N, T, J), NaN where a segment was still settling."""

    residual: FloatArray
    """Measured - predicted position, single precision."""
    torque_residual: FloatArray | None
    """Measured - predicted torque of the motor, its mean since the reading before, where the log has it."""


class Replay:
    """Replays of one log in one model."""

    def __init__(
        self,
        machine: MachineModel,
        log: MachineLog,
        *,
        timestep: float = 0.001,
        segment: float = 6.0,
        settle: float = 0.8,
        threads: int = 0,
        torque: bool = False,
    ) -> None:
        """Cut the log into segments.

        Args:
            machine: The model, with the gains of the log.
            log: Readings of the machine's joints, in its order.
            timestep: Physics step [s].
            segment: Length of a segment [s].
            settle: Time that a segment runs before its readings count [s].
            threads: Of MuJoCo; 0 takes one for each core.
            torque: Also predict the torque.
        """
        self.machine, self.log, self.dt, self.threads = machine, log, timestep, threads
        self.torque = torque and log.tau is not None
        t = log.t - log.t[0]
        self.total = math.floor(t[-1] / timestep + 1e-6)
        count = max(1, round(t[-1] / segment))
        edges = np.linspace(0, self.total, count + 1).round().astype(int)
        self._lead = round(settle / timestep)
        self._begin = np.maximum(edges[:-1] - self._lead, 0)
        self._edges = edges
        self.length = int((edges[1:] - self._begin).max())
        self._rows = np.clip(np.floor(t / timestep + 1e-9).astype(int), 0, self.total)
        self._part = t / timestep - self._rows
        self.counts = t >= settle
        """Readings that count: all but those of the first settling (T,)."""
        asked = log.q_des if log.q_des is not None else log.q * 0.0
        self.sent = np.flatnonzero(np.concatenate([[True], (np.diff(asked, axis=0) != 0).any(1)]))
        """Rows at which a new target was sent (K,)."""
        self.late: FloatArray | None = None
        """How long after the delay of all each target acts (K,) [s]; None where all act in time."""
        self._targets = asked
        self._grid = self._on_grid(asked)
        self._force = None if log.force is None else self._on_grid(log.force)
        self._plan = self._reading_plan()
        self.replays = 0
        self._heat: FloatArray | None = None
        self._batches: dict[int, Batch] = {}

    @property
    def segments(self) -> int:
        """Number of segments."""
        return len(self._begin)

    def set_heat(self, tau: FloatArray) -> None:
        """Keep the torque (T, J) from which the mean square torque at the start of each segment follows."""
        self._heat = np.asarray(tau) ** 2

    def set_heat_of(self, other: Replay) -> None:
        """Keep the torques of another replay of the same log."""
        self._heat = other._heat

    def set_late(self, late: FloatArray | None) -> None:
        """Let each target act so much later (K,) [s]; one that the next overtakes is lost."""
        self.late = late
        self._grid = self._on_grid(self._targets) if late is None else self.delayed(late)

    def delayed(self, late: FloatArray) -> FloatArray:
        """Return the targets of each physics step (steps, J) when each acts so much later (K,) [s]."""
        arrival = (self.log.t - self.log.t[0])[self.sent] + late
        arrival[0] = 0.0
        kept = arrival <= np.minimum.accumulate(np.append(arrival[1:], np.inf)[::-1])[::-1]
        return self._mean_over_steps(arrival[kept], self._targets[self.sent[kept]])

    def _on_grid(self, values: FloatArray) -> FloatArray:
        """Return the mean over each physics step of what holds from each reading to the next (steps, J)."""
        return self._mean_over_steps(self.log.t - self.log.t[0], values)

    def _mean_over_steps(self, t: FloatArray, values: FloatArray) -> FloatArray:
        area = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values[:-1] * np.diff(t)[:, None], axis=0)])
        at = np.arange(self.total + 1) * self.dt
        row = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 1)
        integral = area[row] + (at - t[row])[:, None] * values[row]
        return np.diff(integral, axis=0) / self.dt

    # ------------------------------------------------------------------ running

    def run(
        self, parameters: Parameters, count: int, targets: FloatArray | None = None, pushed: FloatArray | None = None
    ) -> Prediction:
        """Return the predictions of ``count`` parameter sets.

        Args:
            parameters: Values (count, J) or (count, 1).
            count: How many.
            targets: Of each of them at each physics step (count, steps, J), instead of the log's.
            pushed: Torques on the joints from outside, in each of them at each physics step (count, steps, J) [N m].
        """
        size = max(1, MOST_SIMULATIONS // self.segments)
        parts = []
        for begin in range(0, count, size):
            rows = slice(begin, min(begin + size, count))
            values: dict[tuple[str, str], FloatArray] = {
                k: np.asarray(v, dtype=np.float64)[rows] for k, v in parameters.items()
            }
            parts.append(
                self._run(
                    values,
                    self._grid[None] if targets is None else targets[rows],
                    None if pushed is None else pushed[rows],
                )
            )
        self.replays += count
        joined = np.concatenate([p.residual for p in parts])
        torque = (
            np.concatenate([p.torque_residual for p in parts if p.torque_residual is not None]) if self.torque else None
        )
        return Prediction(residual=joined, torque_residual=torque)

    def _batch(self, size: int) -> Batch:
        if size not in self._batches:
            model = self.machine.model
            model.opt.timestep = self.dt
            model.dof_solref[:] = [SOLREF_STEPS * self.dt, 1.0]
            model.dof_solimp[:] = [0.99, 0.999, 0.001, 0.5, 2.0]
            self._batches.clear()
            self._batches[size] = Batch(model, size, self.threads if size * model.nv > FEW else 1)
        return self._batches[size]

    def _run(
        self, parameters: dict[tuple[str, str], FloatArray], targets: FloatArray, pushed: FloatArray | None
    ) -> Prediction:
        sets = len(next(iter(parameters.values()))) if parameters else 1
        segments, joints = self.segments, len(self.machine.joints)
        n = sets * segments
        p = {key: np.repeat(value, segments, 0) for key, value in parameters.items()}
        law = Law(self.machine.drives, p, self.dt, (n, joints), np)
        batch = self._batch(n)
        static_fields(batch, self.machine, law, p)
        fields = Servo.of_batch(batch)
        begin = np.tile(self._begin, sets)
        q, dq = batch.bind("qpos"), batch.bind("qvel")
        start_q, start_dq = self._starts(begin)
        batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        law.reset(start_q, start_dq, None if self._heat is None else self._heat_at(begin, law))
        q[:], dq[:] = law.unread(start_q), start_dq
        late = target_shift(p, self.dt)
        whole = np.floor(late).astype(int)
        shifts = (whole, late - whole)
        out = np.full((sets, len(self.log.t), joints), np.nan, dtype=np.float32)
        torque = np.full_like(out, np.nan) if self.torque else None
        gone, seen, last = np.zeros((n, joints)), np.zeros((n, joints)), np.zeros(n, dtype=int)
        before = np.array(law.reading(q))  # q is the simulation, and moves on
        order = np.arange(n).reshape(sets, segments)
        own = np.repeat(np.arange(sets), segments)
        which = own % len(targets)
        if self.counts[0] and self._rows[0] == 0 and self._part[0] < 1e-6:
            out[:, 0] = self.log.q[0] - before[order[:, 0]]
            if torque is not None:
                torque[:, 0] = 0.0
        for k in range(self.length):
            now = begin + k
            target = self._target(now, shifts, targets, which)
            force = None if self._force is None else self._force[np.minimum(now, self.total - 1)]
            inputs = law.step(q, dq, target, (now * self.dt)[:, None], force)
            if pushed is not None:
                shaken = pushed[own, np.minimum(now, self.total - 1)]
                inputs = replace(inputs, applied=inputs.applied + shaken)
            fields.write(inputs)
            if torque is not None:
                gone += inputs.tau
            batch.step()
            law.settle(dq)
            reading = law.reading(q)
            for segment, row, part in self._plan.get(k, ()):
                sims = order[:, segment]
                value = before[sims] * (1 - part) + reading[sims] * part if part < 1 else reading[sims]
                out[:, row] = self.log.q[row] - value
                if torque is not None and self.log.tau is not None:
                    fresh = last[sims[0]] > 0
                    mean = (gone[sims] - seen[sims]) / max(k + 1 - last[sims[0]], 1) if fresh else inputs.tau[sims]
                    torque[:, row] = self.log.tau[row] - mean
                    seen[sims], last[sims] = gone[sims], k + 1
            before = np.array(reading)
        out[~np.isfinite(out)] = np.nan
        return Prediction(residual=out, torque_residual=torque)

    def _reading_plan(self) -> dict[int, list[tuple[int, int, float]]]:
        """Return for each step the readings that fall into it: segment, row, and how far into the step."""
        plan: dict[int, list[tuple[int, int, float]]] = {}
        for row in np.flatnonzero(self.counts):
            step, part = int(self._rows[row]), float(self._part[row])
            if part < 1e-6:  # at the end of the step before
                step, part = step - 1, 1.0
            segment = int(np.clip(np.searchsorted(self._edges, step + 1e-9, side="right") - 1, 0, self.segments - 1))
            k = step - int(self._begin[segment])
            if 0 <= k < self.length:
                plan.setdefault(k, []).append((segment, int(row), part))
        return plan

    def _starts(self, begin: IntArray) -> tuple[FloatArray, FloatArray]:
        t = self.log.t - self.log.t[0]
        at = begin * self.dt
        q = np.stack([np.interp(at, t, column) for column in self.log.q.T], -1)
        ahead = np.stack([np.interp(at + 0.02, t, column) for column in self.log.q.T], -1)
        return q, (ahead - q) / 0.02

    def _heat_at(self, begin: IntArray, law: Law) -> FloatArray:
        assert self._heat is not None
        time = np.asarray(law.get("kt_heat", "time")) + np.zeros((len(begin), self._heat.shape[1]))
        dt = float(np.median(np.diff(self.log.t)))
        rows = np.clip(np.searchsorted(self.log.t - self.log.t[0], begin * self.dt), 0, len(self.log.t))
        heat = np.zeros_like(time)
        for i, row in enumerate(rows):
            age = np.arange(row)[::-1, None] * dt
            heat[i] = (self._heat[:row] * np.exp(-age / time[i]) * (dt / time[i])).sum(0) if row else 0.0
        return heat

    def _target(self, now: IntArray, shifts: tuple[Any, Any], targets: FloatArray, which: IntArray) -> FloatArray:
        """Return what acts at steps now (n,) of the rows ``which`` (n,) of targets (V, steps, J), that much shifted."""
        whole, part = shifts
        late = np.clip(now[:, None] - whole, 0, targets.shape[1] - 1)
        if late.shape[1] == 1:
            newer, older = targets[which, late[:, 0]], targets[which, np.maximum(late[:, 0] - 1, 0)]
        else:
            columns = np.arange(targets.shape[2])
            newer = targets[which[:, None], late, columns]
            older = targets[which[:, None], np.maximum(late - 1, 0), columns]
        return newer + part * (older - newer)
