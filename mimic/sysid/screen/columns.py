"""What each effect adds to the torque that a motor must give: columns of the regression, thresholds on a grid.

tau_motor - need(q, dq, ddq) = sum over columns of coefficient times column. A column is (T, J, K): T times, J joints
whose torque it enters, K coefficients. Most coefficients belong to one joint and enter only its torque.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from mimic.dynamics.machine import GRAVITY, inertias, tilted_gravity
from mimic.records import FloatArray, IntArray
from mimic.sysid.screen.motion import Links, Motion, slope

BASELINE = ("coulomb", "viscous", "link_mass", "delay")
"""Columns of every model."""

SMALL = 1e-4
"""Change of a number by which inverse dynamics is differentiated."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Column:
    """One effect at one set of thresholds."""

    name: str
    """In the catalogue, or a plain name for what it does not have."""
    at: tuple[float, ...]
    """The thresholds."""
    parts: tuple[FloatArray, ...]
    """For each log (T, J, K), filtered and thinned out."""
    joint: IntArray
    """Joint that a coefficient belongs to, -1 for the whole machine (K,)."""
    spread: float = np.inf
    """Standard deviation of the coefficient before the log is seen."""
    scales: FloatArray | None = None
    """By how much a coefficient changes the torque that all is compared with (K,): a smaller one makes every error
    small and no model better, so that errors are told over 1 + scales coefficient.
    """


class Columns:
    """Makes the columns of some logs of one machine."""

    def __init__(self, motions: Sequence[Motion]) -> None:
        """Take the motions."""
        self.motions = tuple(motions)
        self._links = [Links(m.machine) for m in motions]
        self.joints = self.motions[0].q.shape[1]
        self._each = np.arange(self.joints)
        machine = self.motions[0].machine
        self._place, self._chain = np.asarray(machine.place), np.asarray(machine.chain)
        self._fast = np.concatenate([np.abs(m.dq) for m in motions]).max(0)
        self._hard = np.quantile(np.concatenate([np.abs(m.tau) for m in motions]), 0.999, axis=0)
        self._error = np.quantile(np.concatenate([np.abs(m.target - m.q) for m in motions]), 0.99, axis=0)
        self._slow = np.max([m.slow for m in motions], axis=0)
        self._span = np.ptp(np.concatenate([m.q for m in motions]), axis=0)
        self._by_model = motions[0].machine.drives.kp.max() > 0 and not np.any([m.later.any() for m in motions])

    # ------------------------------------------------------------------ the two lists

    def baseline(self) -> list[Column]:
        """Return the columns of every model."""
        made = [
            self._own("coulomb", self._sign),
            self._own("viscous", lambda m: m.dq),
            self._links_column("link_mass", 0, 0.15),
        ]
        if any(m.later.any() for m in self.motions):
            made.append(self._shared("delay", lambda m: -m.later[..., None]))
        return made

    def candidates(self, left: Sequence[FloatArray]) -> list[Column]:
        """Return all others; what baseline columns leave (T, J) of each log says where to look for waves."""
        return [*self._friction(), *self._mechanics(), *self._drive(), *self._waves(left)]

    def _friction(self) -> Iterable[Column]:
        sign, own = self._sign, self._own
        yield own("asymmetric_friction", lambda m: np.ones_like(m.q), lambda m: np.abs(m.dq))
        yield own("quadratic_drag", lambda m: m.dq * np.abs(m.dq))
        yield own("load_friction", lambda m: np.abs(m.tau) * sign(m))
        yield own("gear_load_friction", lambda m: np.abs(m.tau + m.bias) * sign(m))
        for share in (0.01, 0.02, 0.05, 0.1, 0.2):
            v0 = np.maximum(share * self._fast, 1.5 * self._slow)
            yield own("stribeck", lambda m, v0=v0: np.exp(-((m.dq / v0) ** 2)) * sign(m), at=(share,))
        yield own("position_friction", lambda m: m.q * sign(m), lambda m: m.q**2 * sign(m))
        for share in (0.005, 0.02, 0.06):
            yield own("presliding", lambda m, s=share * self._span: _dahl(m.q, s) - sign(m), at=(share,))

    def _mechanics(self) -> Iterable[Column]:
        own = self._own
        yield own("armature", lambda m: m.ddq)
        yield own("spring", lambda m: m.q, lambda m: np.ones_like(m.q))
        neighbour = np.asarray(self.motions[0].machine.drives.neighbour)
        if (neighbour != self._each).any():
            yield own("coupling", lambda m: m.dq[:, neighbour])
        yield self._shared("base_tilt", self._tilted)
        yield self._links_column("com_shift", 1, 0.05)
        yield self._links_column("payload", 2, 0.5)
        yield self._read("encoder_offset", lambda m: (-np.ones_like(m.q),))
        yield self._read("encoder_scale", lambda m: (-m.q,))
        yield self._read("encoder_eccentricity", lambda m: (-np.cos(m.q), -np.sin(m.q)))
        if any(m.on.any() and m.tau.any() for m in self.motions):
            for share in (0.03, 0.07, 0.15, 0.3, 0.5, 0.8):
                soft = share * self._error / self._hard
                yield self._read("compliance", lambda m, s=soft: (-s * m.through_gear(),), (share,), True, 1.0)
            for share in (0.02, 0.1):
                hard = share * self._hard + 1e-12
                yield self._read("backlash", lambda m, h=hard: (-0.5 * np.tanh(m.through_gear() / h),), (share,), True)

    def _drive(self) -> Iterable[Column]:
        if self._by_model or not any(m.tau.any() for m in self.motions):
            return  # the torque was measured: the drive is not in it
        own = self._own
        kp = [np.asarray(m.machine.drives.kp) for m in self.motions]
        gains = {id(m): k for m, k in zip(self.motions, kp, strict=True)}

        def asked(m: Motion) -> FloatArray:
            return m.on * gains[id(m)] * (m.target - m.q)

        yield own("kt_gain", lambda m: -m.tau, spread=0.2, scales=True)
        yield own("gains", lambda m: -asked(m), spread=0.3, scales=True)
        yield own("kt_drift", lambda m: -m.tau * m.t[:, None] / 100.0, scales=True)
        for time in (15.0, 40.0, 100.0):
            yield own("kt_heat", lambda m, s=time: m.tau * _lag(m.tau**2, s, m.t, 0.0), at=(time,), scales=True)
        for time in (0.002, 0.004, 0.008, 0.016):
            yield own("torque_lag", lambda m, s=time: m.tau - _lag(m.tau, s, m.t), at=(time,))
            yield own(
                "velocity_lag",
                lambda m, s=time: -np.asarray(m.machine.drives.kd) * m.on * (m.dq - _lag(m.dq, s, m.t)),
                at=(time,),
            )
        for time in (0.01, 0.03, 0.08):
            yield own(
                "target_filter",
                lambda m, s=time: gains[id(m)] * m.on * (m.target - _lag(m.target, s, m.t)),
                at=(time,),
            )
        if any(m.later.any() for m in self.motions) and self.joints > 1:
            yield own("joint_delay", lambda m: -m.later)
        yield own("drive_integral", lambda m: -np.cumsum(asked(m), axis=0) * (m.t[1] - m.t[0]))
        for share in (0.05, 0.15, 0.4):
            width = share * self._error
            yield own(
                "deadband",
                lambda m, w=width: m.on * gains[id(m)] * np.clip(m.target - m.q, -w, w),
                at=(share,),
            )
        for share in (0.3, 0.45, 0.6, 0.75, 0.9):
            for turns in (np.inf, 2.0, 1.2, 0.8):
                yield own("torque_speed", lambda m, a=share, b=turns: self._cut(m, a, b)[0], at=(share, turns))
            yield own(
                "supply_sag",
                lambda m, a=share: self._cut(m, a, np.inf)[0],
                lambda m, a=share: self._cut(m, a, np.inf)[1],
                at=(share,),
            )

    def _waves(self, left: Sequence[FloatArray]) -> Iterable[Column]:
        order = np.array([self._strongest([m.q[:, j] for m in self.motions], left, j) for j in self._each])
        yield self._own("cogging", lambda m: np.cos(order * m.q), lambda m: np.sin(order * m.q))
        when = [m.t for m in self.motions]
        hertz = np.array([self._strongest(when, left, j) for j in self._each])
        yield self._own(
            "periodic_force", lambda m: np.cos(hertz * m.t[:, None]), lambda m: np.sin(hertz * m.t[:, None])
        )

    # ------------------------------------------------------------------ how they are made

    def _sign(self, m: Motion) -> FloatArray:
        return np.tanh(m.dq / self._slow)

    def _own(
        self,
        name: str,
        *of: Callable[[Motion], FloatArray],
        at: tuple[float, ...] = (),
        spread: float = np.inf,
        scales: bool = False,
    ) -> Column:
        parts, same = [], np.zeros(self.joints * len(of))
        for m in self.motions:
            block = np.zeros((len(m.t[:: m.every]), self.joints, self.joints * len(of)))
            for k, f in enumerate(of):
                column, each = f(m), self.joints * k + self._each
                block[:, self._each, each] = m.filtered(column)
                same[each] -= np.sum(column * m.tau, axis=0)
            parts.append(block)
        total = np.tile(sum(np.sum(m.tau**2, axis=0) for m in self.motions), len(of))
        return Column(
            name=name,
            at=at,
            parts=tuple(parts),
            joint=np.tile(self._each, len(of)),
            spread=spread,
            scales=same / np.maximum(total, 1e-12) if scales else None,
        )

    def _shared(self, name: str, f: Callable[[Motion], FloatArray]) -> Column:
        parts = tuple(m.filtered(f(m)) for m in self.motions)
        return Column(name=name, at=(), parts=parts, joint=np.full(parts[0].shape[-1], -1))

    def _by_place(self, name: str, f: Callable[[int, Links, FloatArray], FloatArray], at=(), spread=np.inf) -> Column:
        """Return a column of which a joint's coefficient enters the torque of its whole chain.

        Chains do not influence each other, so all joints with the same place are changed at once.
        """
        parts = []
        for i, m in enumerate(self.motions):
            block = np.zeros((len(m.t[:: m.every]), self.joints, self.joints))
            for place in np.unique(self._place):
                changed = m.filtered(f(i, self._links[i], self._place == place))
                for j in np.flatnonzero(self._place == place):
                    mates = np.flatnonzero(self._chain == self._chain[j])
                    block[:, mates, j] = changed[:, mates]
            parts.append(block)
        return Column(name=name, at=at, parts=tuple(parts), joint=self._each, spread=spread)

    def _links_column(self, name: str, which: int, spread: float) -> Column:
        """Return mass (0), centre of mass (1) or payload (2) of each link."""

        def changed(i: int, links: Links, has: FloatArray) -> FloatArray:
            m = self.motions[i]
            given: list[FloatArray | None] = [None, None, None]
            given[which] = np.where(has, SMALL, 0.0)[None] + (1.0 if which == 0 else 0.0)
            made = inertias(m.machine, *given)
            own = [getattr(links.model, n).copy() for n in ("body_mass", "body_ipos", "body_inertia", "body_iquat")]
            _write(links, (made.mass[0], made.ipos[0], made.inertia[0], made.iquat[0]))
            need = links.torque(m.q, m.dq, m.ddq)
            _write(links, own)
            return (need - m.need) / SMALL

        return self._by_place(name, changed, spread=spread)

    def _read(
        self,
        name: str,
        of: Callable[[Motion], tuple[FloatArray, ...]],
        at: tuple[float, ...] = (),
        rotor: bool = False,
        size: float = SMALL,
    ) -> Column:
        """Return what it needs if the links are elsewhere than the encoders say, for each of some ways.

        With ``rotor`` the encoder is on the motor, whose inertia moves as it says.
        """
        ways = []
        for k in range(len(of(self.motions[0]))):

            def changed(i: int, links: Links, has: FloatArray, k: int = k) -> FloatArray:
                m = self.motions[i]
                off = np.where(has, of(m)[k], 0.0)
                speed = slope(off, m.t)
                more = slope(speed, m.t)
                need = links.torque(m.q + size * off, m.dq + size * speed, m.ddq + size * more)
                return (need - m.need) / size - (links.model.dof_armature * more if rotor else 0.0)

            ways.append(self._by_place(name, changed, at))
        parts = tuple(np.concatenate(rows, -1) for rows in zip(*(w.parts for w in ways), strict=True))
        return Column(name=name, at=at, parts=parts, joint=np.tile(self._each, len(ways)))

    def _tilted(self, m: Motion) -> FloatArray:
        links = Links(m.machine)
        own, made = links.model.opt.gravity.copy(), []
        if not own.any():
            own = np.array([0.0, 0.0, -GRAVITY])
        for roll, pitch in ((SMALL, 0.0), (0.0, SMALL)):
            links.model.opt.gravity[:] = tilted_gravity(np.array([roll]), np.array([pitch]), own.tolist())[0]
            made.append((links.torque(m.q, m.dq, m.ddq) - m.need) / SMALL)
        links.model.opt.gravity[:] = own
        return np.stack(made, -1)

    def _cut(self, m: Motion, share: float, turns: float) -> tuple[FloatArray, FloatArray]:
        """Return what limits take of the torque asked for, and what a sagging supply takes of the limit, per watt."""
        most = share * self._hard
        line = 1.0 if np.isinf(turns) else np.clip(1.0 - np.abs(m.dq) / (turns * self._fast), 0.0, 1.0)
        limit = most * np.where(m.tau * m.dq > 0, line, 1.0)
        given = np.clip(m.tau, -limit, limit)
        power = np.clip(given * m.dq, 0.0, None).sum(-1, keepdims=True)
        return m.tau - given, np.where(given == m.tau, 0.0, given * power)

    def _strongest(self, places: Sequence[FloatArray], left: Sequence[FloatArray], j: int) -> float:
        """Return the angular frequency of the wave over places that explains most of what is left in a joint."""
        x = np.concatenate([p[:: m.every] for p, m in zip(places, self.motions, strict=True)])
        y = np.concatenate([rows[:, j] for rows in left])
        use = np.concatenate([m.moving[:: m.every, j] for m in self.motions])
        x, y = x[use], y[use] - y[use].mean() if use.any() else y[use]
        if len(x) < 20:
            return 1.0
        span = max(float(np.ptp(x)), 1e-9)
        most = min(np.pi * 60 / span, 400.0) if places[0] is not self.motions[0].t else 2 * np.pi * 15.0
        found = np.arange(2 * np.pi * 1.5 / span, max(most, 2 * np.pi * 3 / span), 0.7 / span)
        power = [abs(np.exp(-1j * w * x) @ y) for w in found]
        return float(found[int(np.argmax(power))])


def _write(links: Links, made: Sequence[FloatArray]) -> None:
    for name, value in zip(("body_mass", "body_ipos", "body_inertia", "body_iquat"), made, strict=True):
        getattr(links.model, name)[:] = value


def _lag(x: FloatArray, time: float, t: FloatArray, start: float | None = None) -> FloatArray:
    """Return columns (T, J) behind a first-order lag; it begins at the first row, or at ``start``."""
    left = np.exp(-(t[1] - t[0]) / time)
    begin = x[:1] * left if start is None else np.full_like(x[:1], start)
    return lfilter([1.0 - left], [1.0, -left], x, axis=0, zi=begin)[0]


def _dahl(q: FloatArray, width: FloatArray) -> FloatArray:
    """Return friction, of 1, that builds up over a way after each reversal (Dahl 1968)."""
    z, out, step = np.zeros(q.shape[1]), np.zeros_like(q), np.diff(q, axis=0)
    for i, d in enumerate(step):
        z = np.clip(z + (d - np.abs(d) * z) / np.maximum(width, 1e-9), -1.0, 1.0)
        out[i + 1] = z
    return out
