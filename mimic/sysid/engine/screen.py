"""Which effects would explain innovations: each at a few sizes, by one step of least squares of what is left.

An effect is moved to a few places; what each does to the innovations is a column, the numbers of the model are
projected out, and the gain of the log density is that of a linear step.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.catalogue.kinds import MODEL, Parameter
from mimic.records import FloatArray
from mimic.sysid.engine.laws import ROW
from mimic.sysid.engine.likelihood import weights
from mimic.sysid.engine.model import COARSE, STEP, Free, Model, Setting, from_fit, to_fit

PLACES = 4
"""Most places at which a number that has many is tried, from the first to the last."""

PEAKS = 3
"""Peaks of what is left over position at which a wave is tried."""

REACH = 5.0
"""Most by which a linear step may scale the place at which an effect was tried."""

NEARER = (1.0, 0.4)
"""Shares of a linear step from which an effect is fitted: the better one."""

RANGE = (1.5, 40.0)
"""Periods of a wave in the range of motion; a longer one is a spring."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Place:
    """Where an effect is tried in one joint, and what that does."""

    values: Mapping[str, float]
    """Numbers at the place."""
    moved: tuple[tuple[str, ...], ...]
    """Numbers that each column moves together."""
    own: slice
    """Joints that it moves."""
    columns: FloatArray
    """What each does to the whitened innovations of these (C, T, J of the chain)."""
    explained: FloatArray
    """The part of that which the model's numbers do as well, in coordinates of their own (C, P)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """An effect in some joints with the numbers of a linear step."""

    name: str
    joints: tuple[int, ...]
    values: tuple[Mapping[str, float], ...]
    """Numbers in each of them."""
    tried: tuple[Mapping[str, float], ...]
    """Where they were tried."""
    gain: float
    """Of the log density."""
    numbers: int

    @property
    def rough(self) -> bool:
        """Return whether a linear step may say nothing of it."""
        return CATALOGUE[self.name].structural


def applicable(setting: Setting, baseline: Sequence[str]) -> tuple[str, ...]:
    """Return the effects that may be looked for in a machine."""
    left_out = {*baseline, *(("motor",) if setting.data.machine.drives.volts is None else ("kt_gain", "supply_sag"))}
    if setting.data.joints == 1:
        left_out |= {"coupling", "joint_delay"}
    return tuple(e.name for e in CATALOGUE.values() if not e.read_off and e.name not in left_out)


def wanted(name: str) -> tuple[Parameter, ...]:
    """Return the numbers of an effect that are fitted."""
    return tuple(p for p in CATALOGUE[name].parameters if not p.fixed)


def _set_fixed(table: FloatArray, name: str, where: slice | int) -> None:
    """Give the numbers of an effect that are never fitted their values in a table."""
    for p in CATALOGUE[name].parameters:
        if p.fixed and p.starts:
            table[ROW[name, p.name], where] = p.starts[0]


def starts_of(
    p: Parameter, name: str, setting: Setting, j: int, peaks: FloatArray, most: Mapping[str, FloatArray]
) -> list[float | None]:
    """Return the values at which a number is tried; None where its derivative at the model's value tells."""
    if p.spectral:
        return list(peaks)
    if not p.starts:
        return [None]
    chosen = np.unique(np.linspace(0, len(p.starts) - 1, min(len(p.starts), PLACES)).round().astype(int))
    if CATALOGUE[name].structural and p.neutral == MODEL:
        unit = float(most[p.unit][max(j, 0)])
        return [p.starts[k] * unit for k in chosen]
    return [float(np.clip(p.starts[k] * p.step * setting.size(p.unit, j), p.low, p.high)) for k in chosen]


def peaks_of(q: FloatArray, x: FloatArray) -> FloatArray:
    """Return the wave numbers [1/rad] at which a torque (T,) over positions (T,) has the highest peaks."""
    span = float(np.ptp(q))
    if span <= 0.0:
        return np.zeros(0)
    orders = np.arange(RANGE[0], RANGE[1], 1.0 / 6.0) * 2.0 * np.pi / span
    left = x - np.polyval(np.polyfit(q, x, 3), q)
    left = np.clip(left, -3.0 * left.std(), 3.0 * left.std())
    power = np.abs(np.exp(1j * np.outer(orders, q[::3])) @ left[::3])
    found = []
    for _ in range(PEAKS):
        k = int(np.argmax(power))
        found.append(orders[k])
        power[max(k - 8, 0) : k + 9] = 0.0
    return np.array(found)


class Screen:
    """The innovations of a model with its numbers projected out, and what effects do to them."""

    def __init__(self, model: Model) -> None:
        """Take a model."""
        self.model = model.differentiated()
        self._root = np.sqrt(weights(model.e, model.scale, model.data))
        x = model.values()
        hessian, descent = (a + b for a, b in zip(self.model.normal(), self.model.plausibility(x), strict=True))
        fixed = self.model.stopped(descent)
        hessian[fixed] = hessian[:, fixed] = 0.0
        size = np.sqrt(np.diag(hessian)) + np.where(fixed, 1.0, 1e-150)
        alike = hessian / np.outer(size, size) + np.diag(np.where(fixed, 1.0, 1e-12))
        self._turn = np.linalg.inv(np.linalg.cholesky(alike)) / size * ~fixed
        step = self._turn.T @ (self._turn @ descent)
        self._left = np.nan_to_num(model.e) * self._root
        for own in model.data.chains:
            chosen, columns = self.model.in_chain(own)
            self._left[:, own] += np.einsum("p,ptj->tj", step[chosen], columns) * self._root[:, own]
        read, unknown, torque = model.setting.passes.whole([model.table], model.gains, follow=True)[0]
        self._peaks = [peaks_of(read[:, j], unknown[:, j]) for j in range(model.data.joints)]
        self._most = {"N m": np.abs(torque).max(axis=0), "rad/s": model.setting.fastest}

    def run(self, names: Sequence[str]) -> list[Found]:
        """Return what each effect would gain in each joint alone and in all together, best first."""
        out = []
        for name in names:
            tried = [(j, *self._place(name, j, start)) for j in self._joints(name) for start in self._grid(name, j)]
            tables = [self._table(name, j, values, names) for j, values, moved in tried for names in moved]
            changes = iter(self._changes(name, tables))
            own: dict[int, tuple[float, Place]] = {}
            for j, values, moved in tried:
                found = self._judged(name, j, values, moved, [next(changes) for _ in moved])
                if found is not None and found[0] > own.get(j, (-np.inf,))[0]:
                    own[j] = found
            out += [self._together(name, group, own) for group in _groups(name, own, self)]
        return out

    def _changes(self, name: str, tables: Sequence[FloatArray]) -> list[FloatArray]:
        """Return what each table does to the errors: in short steps where there are thresholds."""
        model = self.model
        fine = CATALOGUE[name].structural
        still, *moved = model.setting.passes.run([model.table, *tables], model.gains, STEP if fine else COARSE)
        return [e - still for e in moved]

    def _joints(self, name: str) -> list[int]:
        """Return the joints in which an effect can be tried; -1 for the whole machine."""
        taken = dict(self.model.effects).get(name, ())
        if CATALOGUE[name].scope == "machine":
            return [] if taken else [-1]
        able = self.model.data.moves & (self.model.data.machine.last | (not CATALOGUE[name].tip))
        return [j for j in np.flatnonzero(able).tolist() if j not in taken]

    def _grid(self, name: str, j: int) -> list[tuple[float | None, ...]]:
        """Return the values at which the numbers of an effect are tried in a joint."""
        peaks = self._peaks[max(j, 0)]
        axes = [starts_of(p, name, self.model.setting, j, peaks, self._most) for p in wanted(name)]
        return list(itertools.product(*axes))

    def _place(
        self, name: str, j: int, start: tuple[float | None, ...]
    ) -> tuple[dict[str, float], tuple[tuple[str, ...], ...]]:
        """Return the numbers of an effect at one place, and those of them that each column moves together."""
        setting = self.model.setting
        values = {}
        alone = []
        together = []
        for p, value in zip(wanted(name), start, strict=True):
            own = float(self.model.table[ROW[name, p.name], j])
            if value is not None:
                values[p.name] = value
                if not p.shape:
                    together.append(p.name)
            elif p.shape:
                values[p.name] = own
            else:
                by = setting.difference((name, p.name), j)
                x = to_fit(p, own)
                moved = from_fit(p, x + by)
                values[p.name] = moved if moved != own else from_fit(p, x - by)
                alone.append((p.name,))
        return values, ((tuple(together),) if together else ()) + tuple(alone)

    def _table(self, name: str, j: int, values: Mapping[str, float], moved: tuple[str, ...]) -> FloatArray:
        table = self.model.table.copy()
        where = slice(None) if j < 0 else j
        _set_fixed(table, name, where)
        for p in wanted(name):
            if p.shape or p.name in moved:
                table[ROW[name, p.name], where] = values[p.name]
        return table

    def _judged(
        self,
        name: str,
        j: int,
        values: Mapping[str, float],
        moved: tuple[tuple[str, ...], ...],
        changes: list[FloatArray],
    ) -> tuple[float, Place] | None:
        """Return a place with what it would gain; None where the machine flies apart there."""
        own = self.model.data.moved(j)
        columns = np.stack([np.nan_to_num(c[:, own]) * self._root[:, own] for c in changes])
        if not np.isfinite(columns).all() or np.abs(columns).max() > 1e6:
            return None
        made = Place(values=values, moved=moved, own=own, columns=columns, explained=self._explained(own, columns))
        steps, gain = self._step([made])
        if any(s < 0.0 and self._one_sided(name, m) for s, m in zip(steps, made.moved, strict=True)):
            least = float(np.sum(columns**2) - np.sum(made.explained**2))
            return -least, made  # on the other side of none; the least of these is the mildest
        return gain, made

    def _explained(self, own: slice, columns: FloatArray) -> FloatArray:
        out = np.zeros((len(columns), len(self._turn)))
        for chain in self.model.data.chains:
            if own.start <= chain.start < own.stop:
                chosen, known = self.model.in_chain(chain)
                here = slice(chain.start - own.start, chain.stop - own.start)
                white = (known * self._root[:, chain]).reshape(len(chosen), -1)
                across = columns[:, :, here].reshape(len(columns), -1) @ white.T
                out += across @ self._turn[:, chosen].T
        return out

    def _one_sided(self, name: str, moved: tuple[str, ...]) -> bool:
        """Return whether numbers have only one side of the model's value."""
        for p in wanted(name):
            value = float(self.model.setting.blank[ROW[name, p.name]].flat[0])
            if p.name in moved and (value in (p.low, p.high) or (p.neutral == MODEL and CATALOGUE[name].structural)):
                return True
        return False

    def _step(self, places: Sequence[Place]) -> tuple[FloatArray, float]:
        """Return by how much of each column least squares moves innovations, the model's numbers with them, and the
        gain.
        """
        count = [len(p.columns) for p in places]
        ends = np.cumsum(count)
        parts = [slice(end - n, end) for end, n in zip(ends, count, strict=True)]
        explained = np.concatenate([p.explained for p in places])
        square = -explained @ explained.T
        descent = np.zeros(len(square))
        for one, at in zip(places, parts, strict=True):
            flat = one.columns.reshape(len(one.columns), -1)
            descent[at] = -flat @ self._left[:, one.own].ravel()
            for other, there in zip(places, parts, strict=True):
                if one.own == other.own:
                    square[at, there] += flat @ other.columns.reshape(len(other.columns), -1).T
        square += 1e-9 * np.trace(square) * np.eye(len(square)) + 1e-12 * np.eye(len(square))
        step = np.linalg.solve(square, descent)
        return step, float(step @ descent - 0.5 * step @ square @ step)

    def _together(self, name: str, group: tuple[int, ...], own: Mapping[int, tuple[float, Place]]) -> Found:
        places = [own[j][1] for j in group]
        steps, gain = self._step(places)
        values = list[Mapping[str, float]]()
        at = 0
        for j, place in zip(group, places, strict=True):
            made = dict(place.values)
            for moved in place.moved:
                for parameter in moved:
                    made[parameter] = self._scaled(name, parameter, j, made[parameter], float(steps[at]))
                at += 1
            values.append(made)
        return Found(
            name=name,
            joints=group,
            values=tuple(values),
            tried=tuple(p.values for p in places),
            gain=min(gain, *(own[j][0] for j in group)) if any(own[j][0] < 0.0 for j in group) else gain,
            numbers=len(wanted(name)) * len(group),
        )

    def _scaled(self, name: str, parameter: str, j: int, value: float, by: float) -> float:
        """Return where a linear step ends that scales the way from the model's value to where an effect was tried."""
        p = CATALOGUE[name].parameter(parameter)
        if CATALOGUE[name].structural and p.neutral == MODEL:
            return value
        own = to_fit(p, float(self.model.table[ROW[name, parameter], j]))
        low = 1.0 / REACH if p.starts else -20.0 * REACH
        high = REACH if p.starts else 20.0 * REACH
        return from_fit(p, own + float(np.clip(by, low, high)) * (to_fit(p, value) - own))


def _groups(name: str, own: Mapping[int, tuple[float, Place]], screen: Screen) -> list[tuple[int, ...]]:
    """Return the joints in which an effect is tried: all together, those of one chain, and unless chains share it those
    at one place of their chains, and each alone.
    """
    machine = screen.model.data.machine
    every = tuple(sorted(own))
    if not every:
        return []
    groups = {every}
    if every == (-1,):
        return [every]
    shared = CATALOGUE[name].chain_shared
    for i in every:
        for alike in (machine.chain,) if shared else (machine.chain, machine.place, range(len(machine.joints))):
            groups.add(tuple(j for j in every if alike[j] == alike[i]))
    return sorted(groups)


def with_effect(model: Model, found: Found) -> Model:
    """Return a model with an effect, not yet fitted: where it was tried, at the numbers of a screen or nearer to none,
    whichever is best; derivatives of its own numbers are new.
    """
    starts = [(found.values, share) for share in NEARER] + [(found.tried, 1.0)]
    tried = [_at(model, found, values, share).evaluated() for values, share in starts]
    best = min(tried, key=lambda m: m.cost)
    assert model.columns is not None
    kept = [k for k, f in enumerate(model.free) if f in best.free]
    return best.differentiated([model.columns[k] for k in kept])


def _at(model: Model, found: Found, numbers: Sequence[Mapping[str, float]], share: float) -> Model:
    table = model.table.copy()
    keys = []
    for j, values in zip(found.joints, numbers, strict=True):
        where = slice(None) if j < 0 else j
        _set_fixed(table, found.name, where)
        for parameter, value in values.items():
            p = CATALOGUE[found.name].parameter(parameter)
            row = ROW[found.name, parameter]
            own = to_fit(p, float(model.table[row, j]))
            part = 1.0 if p.shape or p.neutral == MODEL else share
            table[row, where] = from_fit(p, own + part * (to_fit(p, value) - own))
            width, centre = model.setting.width((found.name, parameter), j)
            keys.append(Free((found.name, parameter), j, width, centre))
    new = {(f.key, f.joint) for f in keys}
    effects = dict(model.effects)
    effects[found.name] = tuple(sorted({*effects.get(found.name, ()), *found.joints}))
    kept = tuple(f for f in model.free if (f.key, f.joint) not in new)
    return replace(
        model,
        free=(*kept, *keys),
        table=table,
        effects=tuple(effects.items()),
        columns=None,
        e=np.zeros((0, 0)),
    )
