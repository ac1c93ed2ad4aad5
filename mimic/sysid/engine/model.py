"""A machine with some of the catalogue's numbers free: passes in parallel, derivatives, and maximum likelihood."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np

from mimic.dynamics.catalogue import CATALOGUE, scale_of
from mimic.dynamics.catalogue.kinds import MODEL, Parameter
from mimic.dynamics.machine import MachineModel
from mimic.dynamics.servo import neutral
from mimic.records import BoolArray, FloatArray, IntArray
from mimic.sysid.engine.data import Data
from mimic.sysid.engine.laws import DROP, KEYS, ROW
from mimic.sysid.engine.likelihood import Gains, misfit, scales, weights
from mimic.sysid.engine.predictor import predict
from mimic.sysid.log.noise import smooth

STEP = 1.25e-3
"""Longest step of a pass [s]: a clean log replays at .31 mrad, its noise; at .32 with twice of it (design notes)."""

COARSE = 2.0 * STEP
"""The same for derivatives [s]: with twice of it fits end beside the greatest likelihood."""

PART = 0.5, 0.1
"""Change of a number for a derivative, in differences that matter: of an effect with a threshold, and of others."""

LEVELS = np.concatenate([[0.0], 10.0 ** np.arange(-4.0, 0.6, 0.5)])
"""Sizes of the unknown torque that are tried, as shares of the torque of a joint: factors of 3.2."""

MEMORY = 2.0**28
"""Of passes that are kept [B]: those of a derivative of twelve joints over two minutes."""

IDLE = 0.01
"""Share of the gain of a step below which the numbers of a chain stay where they are, which saves its pass."""

MOST_ALIKE = 0.9
"""Most correlation of errors in blocks that follow each other: nearer to 1, a log is too short to tell it."""

Key = tuple[str, str]


@dataclass(frozen=True)
class Free:
    """One number that is fitted."""

    key: Key
    """Effect and parameter."""
    joint: int
    """-1 for the whole machine."""
    width: float
    """Standard deviation of what is plausible about the model's value, in what is fitted; inf without."""
    centre: float = 0.0
    """The model's value, in what is fitted."""
    within: float = np.inf
    """Most by which it may differ from that."""

    @property
    def parameter(self) -> Parameter:
        """What the catalogue says of it."""
        return CATALOGUE[self.key[0]].parameter(self.key[1])

    @property
    def cell(self) -> tuple[int, int]:
        """Where it is in a table of numbers; one of the whole machine is the same in all joints."""
        return ROW[self.key], self.joint


class Passes:
    """Runs passes over data, chain by chain: what a chain did at the same numbers before is known."""

    def __init__(self, data: Data, threads: int = 1) -> None:
        self.threads = threads
        self._counted = [0.0]
        self._over(data)

    def _over(self, data: Data) -> None:
        self.data = data
        self._parts = {}
        for own in (slice(0, data.joints), *data.chains):
            self._parts[own.start, own.stop] = data.tree.part(own), data.record.part(own)
        self._known: OrderedDict[tuple[Any, ...], FloatArray] = OrderedDict()

    @property
    def count(self) -> int:
        """Number of passes so far; one of a single chain is a part of one."""
        return round(self._counted[0])

    def of(self, data: Data) -> Passes:
        """Return passes over other data, counted together; those over the same record are known."""
        made = copy(self)
        made.data = data
        if data.record is not self.data.record:
            made._over(data)
        return made

    def run(
        self, points: Sequence[FloatArray], gains: FloatArray, step: float = STEP, follow: bool = False
    ) -> list[FloatArray]:
        """Return errors (T, J) of some tables of numbers."""
        return [self.data.record.y - made[0] for made in self.whole(points, gains, step, follow, 1)]

    def whole(
        self, points: Sequence[FloatArray], gains: FloatArray, step: float = STEP, follow: bool = False, kept: int = 3
    ) -> list[FloatArray]:
        """Return predicted readings, unknown torques and torques of the motors (3, T, J) of each, or the first kept."""
        shared = any((table[DROP] != 0.0).any() for table in points)  # motors that draw from one supply
        parts = (slice(0, self.data.joints),) if shared else self.data.chains
        wanted: list[list[tuple[Any, ...]]] = []
        numbers = {}
        for table in points:
            wanted.append([])
            for own in parts:
                given = np.ascontiguousarray(table[:, own]), np.ascontiguousarray(gains[..., own, :])
                key = own.start, own.stop, step, follow, kept, *(each.tobytes() for each in given)
                wanted[-1].append(key)
                numbers[key] = given

        def made(key: tuple[Any, ...]) -> FloatArray:
            tree, record = self._parts[key[:2]]
            p, corrections = numbers[key]
            return predict(tree, record, p, corrections, step, follow)[:kept].copy()

        lacking = [key for key in numbers if key not in self._known]
        with ThreadPoolExecutor(self.threads) as pool:
            self._known.update(zip(lacking, pool.map(made, lacking), strict=True))
        self._counted[0] += len(lacking) / len(parts)
        for key in numbers:
            self._known.move_to_end(key)
        out = [np.concatenate(list(map(self._known.__getitem__, keys)), axis=-1) for keys in wanted]
        most = max(int(MEMORY / (8.0 * self.data.record.y.size)), 1) * len(self.data.chains)
        while len(self._known) > most:
            self._known.popitem(last=False)
        return out


@dataclass(frozen=True, kw_only=True, eq=False)
class Setting:
    """What all models of one search share."""

    passes: Passes
    gains: Gains
    scale: dict[str, FloatArray]
    """How large position, speed, acceleration and torque are in each joint: root mean squares (J,)."""
    fastest: FloatArray
    """Largest speed in each joint (J,) [rad/s]."""
    blank: FloatArray
    """The table of numbers without any effect (S, J)."""

    @property
    def data(self) -> Data:
        """The logs."""
        return self.passes.data

    def width(self, key: Key, j: int) -> tuple[float, float]:
        """Return how far from where a number is plausible, in what is fitted, and where; inf where anything is."""
        p = CATALOGUE[key[0]].parameter(key[1])
        centre = to_fit(p, float(self.blank[ROW[key], j]))
        if relative(p):
            return float(np.log(10.0)), centre
        if p.inverse or (CATALOGUE[key[0]].structural and p.neutral == MODEL):
            return np.inf, centre
        return p.spread * p.step * self.size(p.unit, j), centre

    def size(self, unit: str, j: int) -> float:
        """Return how large a number of this unit is in a joint."""
        j = max(j, 0)
        return scale_of(unit, *(float(self.scale[k][j]) for k in ("position", "speed", "acceleration", "torque")))

    def difference(self, key: Key, j: int) -> float:
        """Return a difference that matters, in what is fitted."""
        p = CATALOGUE[key[0]].parameter(key[1])
        if relative(p):
            return p.step if p.unit == "1" else 5.0 * 0.01
        if p.inverse:
            return 0.02 / (self.size(p.unit, j))
        return p.step * self.size(p.unit, j)


def relative(p: Parameter) -> bool:
    """Return whether the logarithm of a number is fitted: those that say where or when, and have no zero."""
    return p.shape and p.low > 0.0


def to_fit(p: Parameter, x: float) -> float:
    """Return what is fitted of a value."""
    return float(np.log(x)) if relative(p) else p.turned(x)


def from_fit(p: Parameter, x: float) -> float:
    """Return the value of what is fitted, within its bounds."""
    if relative(p):
        return float(np.exp(np.clip(x, np.log(p.low), np.log(p.high))))
    low, high = p.bounds
    return float(p.turned(np.clip(x, low, high)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Model:
    """Free numbers, their values and those of all others, and what a pass says of them."""

    setting: Setting
    free: tuple[Free, ...]
    table: FloatArray
    """Numbers (S, J)."""
    unknown: FloatArray
    """Size of the unknown torque with which the starts of blocks are found (J,) [N m]."""
    effects: tuple[tuple[str, tuple[int, ...]], ...] = ()
    """Effects beside the baseline, with their joints."""
    e: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """Innovations (T, J)."""
    scale: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """(L, J)"""
    cost: float = np.inf
    """Minus the log density, with what is plausible of the numbers."""
    columns: tuple[FloatArray, ...] | None = None
    """Derivatives of the innovations: of each number (T, C) in the joints that it moves."""

    @property
    def data(self) -> Data:
        """The logs."""
        return self.setting.data

    @property
    def gains(self) -> FloatArray:
        """Corrections of a pass (L, 2, 2, J, 3)."""
        return self.setting.gains.of(self.unknown, self.data)

    def over(self, data: Data) -> Model:
        """Return the model after a pass over other data."""
        setting = replace(self.setting, passes=self.setting.passes.of(data))
        return replace(self, setting=setting, columns=None).evaluated()

    def values(self) -> FloatArray:
        """Return what is fitted (P,)."""
        return np.array([to_fit(f.parameter, float(self.table[f.cell])) for f in self.free])

    def at(self, x: FloatArray) -> FloatArray:
        """Return the table of numbers at these values (P,)."""
        table = self.table.copy()
        for f, value in zip(self.free, x, strict=True):
            where = slice(None) if f.joint < 0 else f.joint
            table[ROW[f.key], where] = from_fit(f.parameter, float(np.clip(value, *_ends(f))))
        return table

    def implausible(self, x: FloatArray) -> float:
        """Return minus the log of how plausible values (P,) are beside the model's."""
        return 0.5 * float(sum(((v - f.centre) / f.width) ** 2 for f, v in zip(self.free, x, strict=True)))

    def stopped(self, descent: FloatArray) -> BoolArray:
        """Return which numbers are at an end of what they may be, and would go on (P,)."""
        out = np.zeros(len(self.free), dtype=bool)
        for k, (f, x) in enumerate(zip(self.free, self.values(), strict=True)):
            low, high = _ends(f)
            near = 1e-6 * min(high - low, 1.0)
            out[k] = (x <= low + near and descent[k] < 0.0) or (x >= high - near and descent[k] > 0.0)
        return out

    def evaluated(self, step: float = STEP) -> Model:
        """Return the model after a pass."""
        (e,) = self.setting.passes.run([self.table], self.gains, step)
        made = replace(self, e=e, scale=scales(e, self.data), columns=None)
        cost = float(misfit(e, made.scale, self.data).sum()) + made.implausible(made.values())
        return replace(made, cost=cost if np.isfinite(cost) else np.inf)

    def in_chain(self, own: slice, rows: slice | BoolArray = slice(None)) -> tuple[list[int], FloatArray]:
        """Return which numbers move a chain, and their derivatives there (C, N, J of the chain) over some rows."""
        assert self.columns is not None
        chosen = []
        columns = []
        for k, (f, column) in enumerate(zip(self.free, self.columns, strict=True)):
            if f.joint < 0:
                columns.append(column[rows, own])
            elif own.start <= f.joint < own.stop:
                columns.append(column[rows])
            else:
                continue
            chosen.append(k)
        return chosen, np.stack(columns) if columns else np.zeros((0, *self.e[rows, own].shape))

    def differentiated(self, known: Sequence[FloatArray] = ()) -> Model:
        """Return the model with derivatives; those of the first numbers may be known."""
        if self.columns is not None:
            return self
        first = len(known)
        x = self.values()
        shift = np.zeros(len(x))
        for k, f in enumerate(self.free):
            rough = CATALOGUE[f.key[0]].structural
            by = PART[0 if rough else 1] * self.setting.difference(f.key, f.joint)
            shift[k] = by if x[k] + by <= _ends(f)[1] else -by
        tables = [self.at(x + row) for row in np.diag(shift)[first:]]
        *moved, still = self.setting.passes.run([*tables, self.table], self.gains, COARSE)
        columns = list(known)
        for f, e, by in zip(self.free[first:], moved, shift[first:], strict=True):
            own = self.data.moved(f.joint)
            columns.append(np.nan_to_num((e[:, own] - still[:, own]) / by))
        return replace(self, columns=tuple(columns))

    def normal(self, rows: BoolArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Return Hessian (P, P) and descent (P,) of the cost over some rows, plausibility left out."""
        at = slice(None) if rows is None else rows
        root = np.sqrt(weights(self.e, self.scale, self.data))[at]
        e = np.nan_to_num(self.e)[at] * root
        hessian = np.zeros((len(self.free), len(self.free)))
        descent = np.zeros(len(self.free))
        for own in self.data.chains:
            chosen, columns = self.in_chain(own, at)
            white = (columns * root[:, own]).reshape(len(chosen), -1)
            hessian[np.ix_(chosen, chosen)] += white @ white.T
            descent[chosen] -= white @ e[:, own].ravel()
        return hessian, descent

    def numbers(self) -> float:
        """Return how many numbers the logs determine, beside what is plausible of them, those of targets too."""
        now = self.differentiated()
        return now._share(now.normal()[0]) + self.data.times.told

    def _share(self, of: FloatArray) -> float:
        """Return the trace of a matrix (P, P) over the Hessian of the cost."""
        total = self.normal()[0] + self.plausibility(self.values())[0]
        return float(np.trace(np.linalg.solve(total + 1e-12 * np.eye(len(total)), of)))

    def repeats(self) -> float:
        """Return how often errors repeat themselves within a block, as the numbers feel it: how much more the descents
        of blocks vary than those of independent readings would. Source: Takeuchi 1976; Varin and Vidoni 2005.
        """
        now = self.differentiated()
        felt = now._felt()
        return max(now._share(np.cov(felt) * felt.shape[1]) / max(now._share(now.normal()[0]), 1.0), 1.0)

    def _felt(self) -> FloatArray:
        """Return minus the descent of each number in each block (P, B)."""
        assert self.columns is not None
        pull = weights(self.e, self.scale, self.data) * np.nan_to_num(self.e)
        felt = np.zeros((len(self.free), len(self.data.fold)))
        for k, (f, column) in enumerate(zip(self.free, self.columns, strict=True)):
            rows = (column * pull[:, self.data.moved(f.joint)]).sum(axis=1)
            felt[k] = np.bincount(self.data.block, rows, len(self.data.fold))
        return felt

    def covariance(self) -> FloatArray:
        """Return how uncertain numbers are together (P, P), in what is fitted, where errors go on between blocks.

        Never less than with independent readings. Source: Andrews 1991, for errors of first order.
        """
        now = self.differentiated()
        total = now.normal()[0] + now.plausibility(now.values())[0]
        size = np.sqrt(np.diag(total)) + 1e-100
        stiff, turned = np.linalg.eigh(total / np.outer(size, size))
        root = turned / np.sqrt(np.maximum(stiff, 1e-12)) / size[:, None]
        felt = now._felt()
        felt = root.T @ (felt - felt.mean(axis=1, keepdims=True))  # a number at its bound is pulled in all
        varied, turned = np.linalg.eigh(felt @ felt.T)
        felt = turned.T @ felt
        root = root @ turned
        log = now.data.record.log[np.searchsorted(now.data.block, np.arange(felt.shape[1]))]
        next_to = (felt[:, 1:] * felt[:, :-1] * (log[1:] == log[:-1])).sum(axis=1)
        alike = next_to / np.maximum(varied, 1e-300)
        alike = np.clip(alike + (1.0 + 3.0 * alike) / felt.shape[1], 0.0, MOST_ALIKE)  # Kendall 1954: few tell less
        return (root * np.maximum(varied * (1.0 + alike) / (1.0 - alike), 1.0)) @ root.T

    def plausibility(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the same of what is plausible, at values (P,)."""
        width = np.array([f.width for f in self.free])
        return np.diag(1.0 / width**2), -(x - np.array([f.centre for f in self.free])) / width**2

    def fitted(self, most: int = 6, enough: float = 1.0) -> Model:
        """Return the model at the greatest likelihood that so many steps of Gauss and Newton find, each at the size of
        the unknown torque that predicts best.

        Args:
            most: Steps.
            enough: Gain of the log density of a step after which to stop.
        """
        now = self if len(self.e) else self.evaluated()
        damping = 1e-3
        fresh = now.columns is not None
        while now.columns is not None or most > 0:
            if now.columns is None:
                now = now.sized().differentiated()  # a torque as large as what lacked before hides what is left
                fresh = True
                most = most - 1
            better, damping = now._step(damping, 5 if fresh else 1)
            gained = 0.0
            if better is not None:
                gained = now.cost - better.cost
                now = replace(better, columns=now._secant(better))
            if gained < enough:
                if fresh:
                    break
                now = replace(now, columns=None)
            fresh = False
        return now

    def _secant(self, new: Model) -> tuple[FloatArray, ...]:
        """Return the derivatives such that they tell the way to a new model. Source: Broyden 1965."""
        assert self.columns is not None
        by = new.values() - self.values()
        weighed = np.diag(self.normal()[0]) * by
        missed = np.nan_to_num(new.e - self.e)
        total = np.full(self.data.joints, 1e-300)
        for f, column, x, share in zip(self.free, self.columns, by, weighed, strict=True):
            own = self.data.moved(f.joint)
            total[own] += x * share
            if x != 0.0:
                missed[:, own] -= x * column
        made = []
        for f, column, share in zip(self.free, self.columns, weighed, strict=True):
            own = self.data.moved(f.joint)
            made.append(column + share / total[own] * missed[:, own] if share != 0.0 else column)
        return tuple(made)

    def _step(self, damping: float, most: int) -> tuple[Model | None, float]:
        """Return a better model that a damped step leads to, if one does, and the damping of the next."""
        x = self.values()
        hessian, descent = (a + b for a, b in zip(self.normal(), self.plausibility(x), strict=True))
        moves = ~self.stopped(descent)
        for _ in range(most):
            by = self._towards(hessian, descent, moves, damping)
            trial = replace(self, table=self.at(x + by)).evaluated()
            if trial.cost < self.cost:
                return trial, max(damping / 8.0, 1e-6)
            damping *= 8.0
        return None, damping

    def _towards(self, hessian: FloatArray, descent: FloatArray, moves: BoolArray, damping: float) -> FloatArray:
        """Return a damped step (P,) of the numbers that move, but for those of chains that gain next to nothing."""
        by = _damped(hessian, descent, moves, damping)
        if len(self.data.chains) == 1:
            return by
        gain = by * descent
        parts = np.array([self.data.moved(f.joint).start if f.joint >= 0 else -1 for f in self.free])
        worth = np.array([gain[parts == part].sum() > IDLE * gain.sum() for part in parts])
        return _damped(hessian, descent, moves & worth, damping)

    def sized(self) -> Model:
        """Return the model with the size of the unknown torque in each joint that predicts best."""
        now = self if len(self.e) else self.evaluated()
        for j in range(self.data.joints):
            for way in (-1, 1):
                trial = now._other_size(j, way)
                while trial is not None and trial.cost < now.cost - 0.5:
                    now = trial
                    trial = now._other_size(j, way)
        return now

    def _other_size(self, j: int, way: int) -> Model | None:
        levels = LEVELS * self.setting.gains.torque[j]
        k = int(np.argmin(np.abs(levels - self.unknown[j]))) + way
        if not 0 <= k < len(levels):
            return None
        unknown = self.unknown.copy()
        unknown[j] = levels[k]
        return replace(self, unknown=unknown, columns=None).evaluated()

    def settled(self, most: int = 8, enough: float = 1.0) -> Model:
        """Return the model with numbers and unknown torque at their likeliest, in turn."""
        now = self.fitted(most, enough)
        sized = now.sized()
        return now if sized is now else sized.fitted(most // 2, enough)

    def left_out(self, fold: IntArray | None = None) -> FloatArray:
        """Return the errors (T, J) in each fold of blocks (B,), by default the data's, after a fit to the others from
        where it is with them.
        """
        now = self.differentiated()
        fold = now.data.fold if fold is None else fold
        e = now.e.copy()
        for k in range(fold.max() + 1):
            rows = (fold == k)[now.data.block]
            data = replace(now.data, counts=now.data.counts & ~rows[:, None])
            setting = replace(now.setting, passes=now.setting.passes.of(data))
            known = replace(now, setting=setting).evaluated()
            e[rows] = replace(known, columns=now.columns).fitted(0).e[rows]
        return e


def _damped(hessian: FloatArray, descent: FloatArray, moves: BoolArray, damping: float) -> FloatArray:
    """Return a step of Levenberg and Marquardt (P,) of the numbers that move."""
    by = np.zeros(len(descent))
    own = hessian[np.ix_(moves, moves)]
    by[moves] = np.linalg.solve(own + damping * np.diag(np.diag(own) + 1e-12), descent[moves])
    return by


def _ends(f: Free) -> tuple[float, float]:
    """Return the least and greatest of what is fitted."""
    p = f.parameter
    low, high = (float(np.log(p.low)), float(np.log(p.high))) if relative(p) else p.bounds
    return max(low, f.centre - f.within), min(high, f.centre + f.within)


def blank_table(machine: MachineModel) -> FloatArray:
    """Return the table of numbers without any effect (S, J)."""
    table = np.zeros((len(KEYS), len(machine.joints)))
    for row, (name, parameter) in enumerate(KEYS):
        control_torque = name == "motor" and machine.drives.volts is None
        table[row] = 1.0 if control_torque else neutral(name, parameter, machine)
    return table


def setting_of(data: Data, threads: int = 1) -> Setting:
    """Return what all models of a search share, from how the readings move."""
    blank = blank_table(data.machine)
    record = data.record
    known = np.isfinite(record.y).T
    whole = np.stack([np.interp(record.t, record.t[k], y[k]) for k, y in zip(known, record.y.T, strict=True)], -1)
    calm = smooth(record.t, whole)
    speed = np.gradient(calm, record.t, axis=0)
    faster = np.gradient(speed, record.t, axis=0)
    used = data.counts & (np.abs(speed) < 1e3)
    model = data.machine.model
    state = mujoco.MjData(model)
    state.qpos[:] = np.median(whole, axis=0)
    mujoco.mj_forward(model, state)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, state, mass)
    inertia = np.diag(mass)
    if not record.kp.any():  # no drive holds the other joints, which give way
        inertia = 1.0 / np.diag(np.linalg.inv(mass))
    needed = model.dof_armature * faster
    own = np.zeros(model.nv)
    for i in range(0, len(whole), 5):
        state.qpos[:] = calm[i]
        state.qvel[:] = speed[i]
        state.qacc[:] = faster[i]
        for part in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel):
            part(model, state)
        mujoco.mj_rne(model, state, 1, own)
        needed[i : i + 5] += own

    def rms(x: FloatArray) -> FloatArray:
        return np.sqrt(np.where(used, x**2, 0.0).sum(0) / np.maximum(used.sum(0), 1)) + 1e-9

    scale = {
        "position": np.maximum(rms(calm - calm.mean(0)), 10.0 * data.noise),
        "speed": rms(speed),
        "acceleration": rms(faster),
        "torque": np.maximum(rms(needed) + blank[ROW["coulomb", "level"]], 1e-6),
    }
    fastest = np.nanquantile(np.where(used, np.abs(speed), np.nan), 0.999, axis=0)
    gains = Gains(inertia=inertia, damping=blank[ROW["viscous", "coefficient"]], torque=scale["torque"])
    return Setting(passes=Passes(data, threads), gains=gains, scale=scale, fastest=fastest, blank=blank)
