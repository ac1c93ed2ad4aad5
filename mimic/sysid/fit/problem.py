"""Points, residuals there and their derivatives: which numbers are fitted, what a change of each does, and the sums
over blocks.

While the base is held, the legs (chains) do not influence each other. So the same parameter of all first joints is
changed in one replay, and the column of each leg is read from that leg's own joints.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy import signal

from mimic.dynamics.catalogue import CATALOGUE, Parameter, scale_of
from mimic.dynamics.machine import MachineModel
from mimic.dynamics.servo import neutral
from mimic.records import BoolArray, FloatArray, IntArray
from mimic.sysid.fit.replay import Replay, Targets
from mimic.sysid.log.noise import MEMORY
from mimic.sysid.log.pool import Blocks, Sums
from mimic.sysid.log.timing import SendingTimes
from mimic.sysid.result import RULES

Key = tuple[str, str]
"""(effect, parameter)"""


@dataclass(frozen=True, kw_only=True, eq=False)
class FreeParameter:
    """One fitted number."""

    key: Key
    joint: int
    """Index of the joint; -1 for the whole machine."""
    step: float
    """A difference that matters."""
    centre: float
    """Value before anything is known."""
    spread: float
    """Standard deviation of what is plausible before anything is known."""

    @property
    def parameter(self) -> Parameter:
        """What the catalogue says of it."""
        return CATALOGUE[self.key[0]].parameter(self.key[1])

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and greatest value."""
        return self.parameter.bounds

    def called(self, joints: Sequence[str]) -> str:
        """Return its name for a person: effect, parameter, and of which of the joints."""
        return ".".join(self.key) + ("" if self.joint < 0 else f" of {joints[self.joint]}")


@dataclass(frozen=True, eq=False)
class Point:
    """Values of all effects that are in the model: (effect, parameter) -> (J,) or (1,)."""

    values: Mapping[Key, FloatArray] = field(default_factory=dict)

    @classmethod
    def of(cls, names: Iterable[str], machine: MachineModel) -> Point:
        """Return the point with these effects, all neutral."""
        point = cls()
        for name in names:
            point = point.with_effect(name, machine)
        return point

    def with_effect(self, name: str, machine: MachineModel, start: Mapping[str, object] | None = None) -> Point:
        """Return the point with an effect added, neutral or at ``start`` (numbers or rows)."""
        values = dict(self.values)
        for p in CATALOGUE[name].parameters:
            row = neutral(name, p.name, machine)
            if p.fixed and p.starts:
                row = np.full_like(row, p.starts[0])
            if start and p.name in start:
                row = np.broadcast_to(np.asarray(start[p.name], dtype=np.float64), row.shape).copy()
            values[name, p.name] = row
        return Point(values)

    def without(self, name: str) -> Point:
        """Return the point without an effect."""
        return Point({k: v for k, v in self.values.items() if k[0] != name})

    def moved(self, free_parameters: Sequence[FreeParameter], by: FloatArray) -> Point:
        """Return the point with each free parameter changed, inside its bounds."""
        values = {k: v.copy() for k, v in self.values.items()}
        for free, delta in zip(free_parameters, by, strict=True):
            at = max(free.joint, 0)
            values[free.key][at] = free.parameter.turned(np.clip(self.at(free) + delta, *free.bounds))
        return Point(values)

    def at(self, free: FreeParameter) -> float:
        """Return the value of a free parameter."""
        return free.parameter.turned(self.values[free.key][max(free.joint, 0)])

    def read(self, free_parameters: Sequence[FreeParameter]) -> FloatArray:
        """Return the values of the free parameters."""
        return np.array([self.at(k) for k in free_parameters])


def stack(points: Sequence[Point], machine: MachineModel) -> dict[Key, FloatArray]:
    """Return points as the replay takes them; effects that a point lacks are neutral there."""
    keys = {key for point in points for key in point.values}
    return {
        key: np.stack([p.values[key] if key in p.values else neutral(*key, machine) for p in points])
        for key in sorted(keys)
    }


def scales(replay: Replay) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the root mean squares of position (about its mean), speed, acceleration and torque of each joint (J,)."""
    log, drives = replay.log, replay.machine.drives
    t = log.t - log.t[0]
    pieces, answers, q = [part.slice for part in replay.parts], 2 / MEMORY, log.q
    if log.rate > 2 * answers:  # slower readings show no more than a drive answers
        low_pass = signal.butter(2, answers, fs=log.rate, output="sos")
        q = np.concatenate([signal.sosfiltfilt(low_pass, q[rows], axis=0) for rows in pieces])
    dq = np.concatenate([np.gradient(q[rows], t[rows], axis=0) for rows in pieces])
    ddq = np.concatenate([np.gradient(dq[rows], t[rows], axis=0) for rows in pieces])
    tau = log.tau
    if tau is None:
        kp, kd = replay.row_gains
        tau = kp * ((q if log.q_des is None else log.q_des) - q) - kd * dq
        tau = tau + (0.0 if log.force is None else log.force)
    limit = np.asarray(drives.torque)
    rows = (q - q.mean(0), dq, ddq, np.clip(tau, -limit, limit))
    least = np.finfo(np.float32).eps
    position, speed, acceleration, torque = (np.maximum(np.sqrt(np.mean(r**2, axis=0)), least) for r in rows)
    return position, speed, acceleration, torque


FINE = 3
"""A fine replay has this many times more steps."""

EQUAL = 0.25
"""Chains of which less than four times as much is left, in squares, than of the best have the same weight."""

WIDE = 0.25
"""Share of a free parameter's step over which one-sided differences are taken; central ones over a third of that."""


UNSEEN: frozenset[Key] = frozenset({("backlash", "compliance")})
"""Numbers that replays in coarse steps do not see."""


class Problem:
    """One log and model as a least-squares problem; a change makes another one."""

    def __init__(self, replay: Replay, noise: FloatArray, torque_noise: FloatArray | None, blocks: Blocks) -> None:
        """Take the replay and what its residuals are measured in.

        Args:
            replay: Of the log in the model.
            noise: Noise floor of each joint's position (J,).
            torque_noise: Of each joint's torque (J,), where that is a channel.
            blocks: Blocks of the readings.
        """
        self.replay, self.machine, self.blocks = replay, replay.machine, blocks
        self.joints = joints = len(self.machine.joints)
        self.channel_joint = np.arange(joints)
        self.noise = noise
        if replay.torque and torque_noise is not None:
            self.channel_joint = np.concatenate([self.channel_joint, self.channel_joint])
            self.noise = np.concatenate([noise, torque_noise])
        self.channel_chain = self.machine.chain[self.channel_joint]
        self.channels = len(self.channel_joint)
        self.weight = np.ones(int(self.machine.chain.max()) + 1)
        """Of each chain (K,), see `weighed`."""
        self.sending: tuple[SendingTimes, ...] = (replay.sending,)
        """All that the logs allow."""
        self.log_scale = np.ones((len(replay.log.t), 1), dtype=np.float32)
        """Of each row's log: its residuals are divided by it, see `with_equal_logs`."""
        self.pinned: frozenset[Key] = UNSEEN
        """Numbers that are not fitted, since the log cannot tell them from others that are."""
        self.encoder_steps: FloatArray = np.zeros(joints)
        """Of coarse encoders (J,) [rad], 0 where none is seen; the noise floor has what they round off."""
        self.offsets = np.zeros(self.channels)
        """Share of its mean in each block that a residual goes without (C,), see `with_block_offsets`."""
        self._scales = scales(replay)
        self.correction: FloatArray | None = None
        """Fine replay - replay at these steps, whitened (T, C): what all residuals are corrected by."""

    def changed(self, **fields: Any) -> Problem:
        """Return the problem with other fields."""
        other = copy(self)
        for name, value in fields.items():
            setattr(other, name, value)
        return other

    def sent_at(self, sending: SendingTimes) -> Problem:
        """Return the problem with targets sent at these times."""
        return self.changed(replay=self.replay.sent_at(sending), correction=None)

    def poorly_explained(self, residual: FloatArray) -> bool:
        """Return whether so much is left (T, C) that fits are also begun in short segments."""
        return float(np.mean(self.mean_squares(residual, False))) > RULES.far

    def in_short_segments(self) -> Problem:
        """Return the problem of a replay in short segments, whose fits find the way from far off."""
        return self.changed(replay=self.replay.in_short_segments(), correction=None)

    @property
    def readings(self) -> IntArray:
        """Number of readings of each fitted block that judges (B_train,)."""
        there = self.blocks.index[self.blocks.index >= 0]
        return self.judged(np.bincount(there, minlength=len(self.blocks.held_out))[self.blocks.train, None])[:, 0]

    def residuals(self, points: Sequence[Point]) -> FloatArray:
        """Return whitened residuals (N, T, C), single precision; NaN where readings do not count or it blew up."""
        return self.corrected(self.uncorrected(points))

    def corrected(self, residual: FloatArray) -> FloatArray:
        """Return residuals (…, T, C) without what is known of the error of these steps."""
        return residual if self.correction is None else residual + self.correction

    def uncorrected(self, points: Sequence[Point], targets: Targets | None = None) -> FloatArray:
        """Return the residuals of these steps as they are, for targets of each point or those of the log."""
        return self._whitened(self._replayed(self.replay, points, targets))

    def in_fine_steps(self, points: Sequence[Point]) -> FloatArray:
        """Return whitened residuals (N, T, C), extrapolated to steps of length zero.

        From replays with ``FINE`` and twice as many times more steps: what is left of their error goes with the step
        where the motors are at their limits, and with its square elsewhere (Richardson).
        """
        some, more = self._in_finer_replays(points)
        return 2.0 * more - some

    def in_finer_replay(self, point: Point) -> Problem:
        """Return the problem of a replay with ``FINE`` times more steps, corrected at a point; see `in_fine_steps`."""
        some, more = self._in_finer_replays([point])
        return self.changed(replay=self.replay.finer(FINE), correction=2.0 * (more - some)[0])

    def _in_finer_replays(self, points: Sequence[Point]) -> tuple[FloatArray, FloatArray]:
        """Return whitened residuals (N, T, C) in ``FINE`` and twice as many times more steps."""
        some, more = (
            self._whitened(self._replayed(self.replay.finer(FINE * times, len(points)), points)) for times in (1, 2)
        )
        return some, more

    def columns_in_fine_steps(self, point: Point, free_parameters: Sequence[FreeParameter]) -> list[FloatArray]:
        """Return the derivatives (T, C) for each free parameter in finer steps; see `columns`.

        They are central differences, where the bounds leave room. What one-sided ones are wrong by is small beside each
        derivative, but not beside their sum along a direction that the log hardly determines: it seems determined then.
        """
        points, groups, sizes = self.difference_points(point, free_parameters, WIDE / FINE)
        if not points:
            return []
        low, high = (np.array([k.bounds[i] for k in free_parameters]) for i in (0, 1))
        at = point.read(free_parameters)
        back = np.clip(at - sizes, low, high) - at
        opposite = []
        for group in groups:
            by = np.zeros(len(free_parameters))
            by[group] = back[group]
            opposite.append(point.moved(free_parameters, by))
        asked = [*points, *opposite]
        made = self._whitened(self._replayed(self.replay.finer(FINE, len(asked)), asked))
        return self.columns(made[len(points) :], made[: len(points)], groups, free_parameters, sizes - back)

    def warmed_up(self, point: Point) -> Problem:
        """Return the problem whose segments begin with motors as warm as a finer replay says; see `in_fine_steps`."""
        fine = self.replay.finer(FINE)
        heat = np.sqrt(fine.mean_square_torque(stack([point], self.machine)))
        return self.changed(replay=self.replay.with_heat(heat))

    def _whitened(self, residual: FloatArray) -> FloatArray:
        """Return residuals (…, T, C) in noise floors, NaN where readings do not count; in place."""
        residual /= self.noise.astype(np.float32) * self.log_scale
        residual[..., self.blocks.index < 0, :] = np.nan
        return self._without_offsets(residual)

    def _without_offsets(self, residual: FloatArray) -> FloatArray:
        """Take the share ``offsets`` of their mean in each block from residuals (…, T, C); in place."""
        if self.offsets.any():
            rows, begin, size = self._counting()
            means = np.add.reduceat(residual[..., rows, :], begin, axis=-2) * (self.offsets / size[:, None])
            residual[..., rows, :] -= np.repeat(means, size, axis=-2).astype(residual.dtype)
        return residual

    def _counting(self) -> tuple[IntArray, IntArray, IntArray]:
        """Return the rows that count, where among them each block begins, and how many it has."""
        rows = np.flatnonzero(self.blocks.index >= 0)
        begin = np.flatnonzero(np.diff(self.blocks.index[rows], prepend=-1))  # blocks follow each other
        return rows, begin, np.diff(begin, append=len(rows))

    def with_block_offsets(self, residual: FloatArray) -> Problem:
        """Return the problem in which each block may have an offset of its own, of the size that a residual (T, C) has.

        They are random effects, as in panel data (Balestra and Nerlove 1966), and each is taken out as far as it is
        known (best linear unbiased prediction): what wanders slowly, because of a torque that no effect is, else seems
        to be explained by whatever is slow, too. It is this very problem where the means of blocks are no larger than
        those of a residual that is forgotten in ``MEMORY``.
        """
        rows, begin, size = self._counting()
        fitted = ~self.blocks.held_out[self.blocks.index[rows[begin]]]
        r = np.nan_to_num(residual[rows], nan=0.0).astype(np.float64)
        means, squares = (np.add.reduceat(x, begin)[fitted] / size[fitted, None] for x in (r, r**2))
        between, inside = (means**2).mean(0), (squares - means**2).mean(0)
        independent = max(float(size[fitted].mean()) / (MEMORY * self.replay.log.rate), 1.0)
        other = self.changed(
            offsets=1.0 - np.clip(inside / independent / np.maximum(between, np.finfo(float).tiny), 0.0, 1.0)
        )
        if not other.offsets.any():
            return self
        if self.correction is not None:
            other.correction = other._without_offsets(self.correction.copy())
        return other

    def _replayed(self, replay: Replay, points: Sequence[Point], targets: Targets | None = None) -> FloatArray:
        """Return the residuals of points in units of the log (N, T, C)."""
        joined = np.empty((len(points), len(replay.log.t), self.channels), dtype=np.float32)
        apart: dict[bool, list[int]] = {}  # all in one batch pay for the laws of each, and one is dear
        for i, point in enumerate(points):
            apart.setdefault(("supply_sag", "drop") in point.values, []).append(i)
        for rows in apart.values():
            values = stack([points[i] for i in rows], self.machine)
            made = replay.run(values or {("delay", "time"): np.zeros((len(rows), 1))}, len(rows), targets)
            joined[rows, :, : self.joints] = made.residual
            if self.channels > self.joints:
                joined[rows, :, self.joints :] = made.torque_residual
        return joined

    def block_squares(self, residual: FloatArray) -> FloatArray:
        """Return the sum of squares of each block and channel (B, C); inf where it blew up."""
        rows, begin, _ = self._counting()
        squares = np.where(np.isfinite(residual), residual, np.inf).astype(np.float64) ** 2
        out = np.zeros((len(self.blocks.held_out), residual.shape[-1]))
        out[self.blocks.index[rows[begin]]] = np.add.reduceat(squares[rows], begin, axis=0)
        return out

    def judged(self, values: Any) -> Any:
        """Return values of the fitted blocks (B_train, C), 0 in those in which a drive is switched."""
        there = self.blocks.switched
        return values if there is None else np.where(there[self.blocks.train][:, None], 0, values)

    def mean_squares(self, residual: FloatArray, held_out: bool) -> FloatArray:
        """Return the mean square of each channel (C,), over the fitted or the held-out blocks."""
        inside = self.blocks.held_out[np.maximum(self.blocks.index, 0)] == held_out
        rows = (self.blocks.index >= 0) & inside
        return np.mean(residual[rows].astype(np.float64) ** 2, axis=0)

    def without(self, rows: BoolArray) -> Problem:
        """Return the problem with these readings (T,) masked."""
        return self.changed(blocks=replace(self.blocks, index=np.where(rows, -1, self.blocks.index)))

    def holding_out(self, rows: BoolArray) -> Problem:
        """Return the problem in which the blocks of these readings (T,) are held out, and all others are fitted."""
        held = np.isin(np.arange(len(self.blocks.held_out)), self.blocks.index[rows & (self.blocks.index >= 0)])
        return self.changed(blocks=replace(self.blocks, held_out=held))

    def in_floors(self, residual: FloatArray) -> FloatArray:
        """Return a whitened residual (T, C) in noise floors, whatever the weight of its log."""
        return residual * self.log_scale

    def with_equal_logs(self, residual: FloatArray) -> Problem:
        """Return the problem in which each of several logs has the same say, whatever is left of it (residual (T, C)).

        Else the one log that no model explains, such as a joint that falls, is all that the others are fitted for. It
        is this very problem where all have.
        """
        parts, squares = self.replay.parts, self.in_floors(residual).astype(np.float64) ** 2
        train = self.blocks.fitted
        left = [float(np.mean(squares[p.slice][train[p.slice]])) if train[p.slice].any() else 1.0 for p in parts]
        least, scale = max(min(left), 1.0), self.log_scale.copy()
        for part, own in zip(parts, left, strict=True):
            scale[part.slice] = np.sqrt(max(own / least, 1.0))
        return self.changed(log_scale=scale) if (scale > 1.0).any() else self

    def weighed(self, residual: FloatArray) -> Problem:
        """Return the problem with less weight of poorly explained chains (residual (T, C)) in what all chains share.

        Otherwise a leg that lacks an effect bends the delay of the machine to make up for it, and the other legs then
        seem to lack something too. A chain's own numbers are what they were: its weight is on its priors as well. It is
        this very problem where no chain's weight changes as much.
        """
        left = np.maximum(self.mean_squares(residual, False), 1.0)
        chains = np.array([left[self.channel_chain == c].mean() for c in range(len(self.weight))])
        share = chains.min() / chains
        weight = np.where(share > EQUAL, 1.0, share)
        return self.changed(weight=weight) if np.any(np.abs(np.log(weight / self.weight)) > -np.log(EQUAL)) else self

    # ------------------------------------------------------------------ derivatives

    def free_parameters(
        self, point: Point, joints: Mapping[str, BoolArray], names: Sequence[str]
    ) -> list[FreeParameter]:
        """Return the fitted numbers of the named effects at a point.

        Args:
            point: Has the effects.
            joints: For an effect, which joints have it (J,); all where it is not there.
            names: Effects.
        """
        found = []
        for name in names:
            spec = CATALOGUE[name]
            for p in spec.parameters:
                if p.fixed or spec.random or (name, p.name) in self.pinned:
                    continue
                if spec.scope == "machine":
                    found.append(self._free_parameter(point, name, p, -1))
                    continue
                mask = joints.get(name, np.ones(self.joints, dtype=bool))
                mask = mask & self.machine.last if spec.tip else mask
                found += [self._free_parameter(point, name, p, int(j)) for j in np.flatnonzero(mask)]
        return found

    def _free_parameter(self, point: Point, name: str, p: Parameter, joint: int) -> FreeParameter:
        step = p.step * p.turned(self.scale(p.unit, joint))
        at = max(joint, 0)
        # where an effect is, or where a limit is, has no neutral value to be near: it begins where it starts
        unanchored = p.shape or name == "torque_speed"
        row = point.values[name, p.name] if unanchored else neutral(name, p.name, self.machine)
        centre = float(p.turned(row[at]))
        spread = p.spread * step
        if name in ("coulomb", "viscous", "armature"):
            spread = max(spread, centre)
        return FreeParameter(key=(name, p.name), joint=joint, step=step, centre=centre, spread=spread)

    def scale(self, unit: str, joint: int) -> float:
        """Return the machine's own scale of a unit at a joint; the mean over the joints for the whole machine."""
        values = [scale_of(unit, *(float(row[j]) for row in self._scales)) for j in range(self.joints)]
        return float(np.mean(values)) if joint < 0 else values[joint]

    def groups(self, free_parameters: Sequence[FreeParameter]) -> list[list[int]]:
        """Return indices of free parameters that one replay can change together."""
        found: dict[tuple[Key, int], list[int]] = {}
        for i, free in enumerate(free_parameters):
            place = -1 if free.joint < 0 else int(self.machine.place[free.joint])
            found.setdefault((free.key, place), []).append(i)
        return list(found.values())

    def difference_points(
        self, point: Point, free_parameters: Sequence[FreeParameter], share: float = WIDE
    ) -> tuple[list[Point], list[list[int]], FloatArray]:
        """Return the points for one-sided differences, the free parameters moved in each, and the moves."""
        groups = self.groups(free_parameters)
        sizes = np.zeros(len(free_parameters))
        points = []
        for group in groups:
            by = np.zeros(len(free_parameters))
            for i in group:
                high = free_parameters[i].bounds[1]
                value = point.at(free_parameters[i])
                size = share * free_parameters[i].step
                by[i] = size if value + size <= high else -size
                sizes[i] = by[i]
            points.append(point.moved(free_parameters, by))
        return points, groups, sizes

    def columns(
        self,
        base: FloatArray,
        moved: FloatArray,
        groups: Sequence[Sequence[int]],
        free_parameters: Sequence[FreeParameter],
        sizes: FloatArray,
    ) -> list[FloatArray]:
        """Return d(prediction)/d(free) (T, C) of each free parameter, whitened, zero outside its chain.

        From residuals at one point (T, C) or at one for each group (N, T, C), and at points where free parameters are
        larger by sizes.
        """
        found: list[FloatArray | None] = [None] * len(free_parameters)
        for number, (replayed, group) in enumerate(zip(moved, groups, strict=True)):
            change = (base if base.ndim == moved.ndim - 1 else base[number]) - replayed
            for i in group:
                column = change / np.float32(sizes[i])
                if free_parameters[i].joint >= 0:
                    mine = self.channel_chain == self.machine.chain[free_parameters[i].joint]
                    column = np.where(mine, column, np.float32(0.0))
                found[i] = column
        return [c for c in found if c is not None]

    def sums(
        self, residual: FloatArray, columns: Sequence[FloatArray], free_parameters: Sequence[FreeParameter]
    ) -> Sums:
        """Return the normal equations of each block.

        Args:
            residual: Whitened (T, C).
            columns: Derivatives of the predictions, whitened (T, C), one for each free parameter.
            free_parameters: Those (P,).
        """
        chain, count, total = self.machine.chain, len(free_parameters), len(self.blocks.held_out)
        hessian, gradient = np.zeros((total, count, count)), np.zeros((total, count))
        weighed = hessian.copy(), gradient.copy()
        of = np.array([-1 if k.joint < 0 else chain[k.joint] for k in free_parameters], dtype=int)
        rows_of = [np.flatnonzero(self.blocks.index == b) for b in range(total)]
        for c in np.unique(self.channel_chain):
            mine, index = np.flatnonzero(self.channel_chain == c), np.flatnonzero((of == c) | (of < 0))
            stacked = np.zeros((len(index) + 1, len(residual), len(mine)), dtype=np.float32)
            for i, k in enumerate(index.tolist()):
                stacked[i] = columns[k][:, mine]
            stacked[-1] = residual[:, mine]
            stacked[~np.isfinite(stacked)] = 0.0
            for b, rows in enumerate(rows_of):
                both = stacked[:, rows].reshape(len(stacked), -1).astype(np.float64)
                a, r = both[:-1], both[-1]
                outer, along = a @ a.T, a @ r
                for (h, g), w in (((hessian, gradient), 1.0), (weighed, self.weight[c])):
                    h[b][np.ix_(index, index)] += w * outer
                    g[b][index] += w * along
        weight = np.where(of < 0, 1.0, self.weight[of])
        return Sums(hessian=hessian, gradient=gradient, weighed=weighed, weight=weight)
