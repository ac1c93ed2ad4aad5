"""What each effect adds to the torque that a motor must give: columns of a regression, thresholds on a grid.

tau_motor - need(q, dq, ddq) = sum over columns of coefficient times column. A column is (T, J, K): T times, J joints
whose torque it enters, K coefficients. Most coefficients belong to one joint and enter only its torque.

A log is first put on an even clock. Everything that is compared passes the same low-pass filter, so that what the
filter takes away is missing on both sides of the equation (Janot, Gautier, Brunot 2019; Khalil and Dombre 2002, section
12).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from copy import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, lfilter, sosfiltfilt

from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.machine import GRAVITY, MachineModel, as_logged, inertias, tilted_gravity
from mimic.io.joint_log import JointLog
from mimic.records import BoolArray, FloatArray, IntArray
from mimic.sysid.log.noise import noise_floor
from mimic.sysid.log.pool import VOLTAGE, enabled
from mimic.sysid.log.timing import SendingTimes, at_rows

BANDWIDTH = 1.2
"""Bandwidth of a comparison over the frequency of the fastest drive: beyond, an acceleration has more noise than the
torque, and a soft joint swings on its own.
"""

LEAST, WITHOUT_GAINS = 3.0, 25.0
"""Least bandwidth of a comparison, and that without gains or with measured torque [Hz]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """One log at even times; arrays (T, J) but for t."""

    t: FloatArray
    """(T,) [s]"""
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    target: FloatArray
    """Target in effect: that of the log, `delay` later."""
    tau: FloatArray
    """Torque of the motor: measured, or what the declared gains ask for [N m]."""
    later: FloatArray
    """What it would be with 1 ms more delay, less what it is [N m]; zeros where it was measured."""
    on: FloatArray
    """1 where a drive is switched on, else 0 (the column ``enabled`` of the log)."""
    need: FloatArray
    """Torque that the declared links need, without friction [N m]."""
    bias: FloatArray
    """Part of it that is there without acceleration: gravity, Coriolis, springs [N m]."""
    moving: BoolArray
    """Where friction is not that of a joint at rest, in rows that may be looked at."""
    slow: FloatArray
    """Speed below which a sign cannot be told (J,)."""
    cut_off: float
    """Of the filter that all passes [Hz]."""
    every: int
    """Rows of this motion for one that is compared."""
    machine: MachineModel
    """With the gains of this log."""

    def through_gear(self) -> FloatArray:
        """Return what the motor gives beyond its own rotor, without noise, at all times (T, J) [N m]."""
        given = self.tau - self.machine.model.dof_armature * self.ddq
        return _low_pass(given, self.cut_off, 1.0 / (self.t[1] - self.t[0]))

    def filtered(self, x: FloatArray) -> FloatArray:
        """Return columns (T, …) as they are compared: filtered and thinned out."""
        return _low_pass(x, self.cut_off, 1.0 / (self.t[1] - self.t[0]))[:: self.every]


def cut_off_of(log: JointLog, machine: MachineModel) -> float:
    """Return the bandwidth in which a log is compared [Hz].

    An eighth of the rate of the log at most, and 25 Hz where torque was measured or the drives have no gains.
    """
    kp = np.asarray(machine.drives.kp)
    most = min(log.rate / 8.0, WITHOUT_GAINS)
    if log.tau is not None or not kp.any():
        return most
    fastest = np.sqrt(np.max(kp * machine.model.dof_invweight0)) / (2 * np.pi)
    return float(np.clip(BANDWIDTH * fastest, min(LEAST, most), log.rate / 8.0))


def motion_of(
    log: JointLog,
    model: MachineModel,
    delay: float,
    rows: BoolArray | None = None,
    sending: SendingTimes | None = None,
) -> Motion:
    """Return a log at even times.

    Args:
        log: Of the joints of the model.
        model: What it should have done.
        delay: Of the targets [s].
        rows: Rows of the log that may be looked at (T,), all by default.
        sending: When targets were sent; with the rows that first show them by default.
    """
    machine = as_logged(model, log.metadata, by_force=log.q_des is None)
    rate, t0 = log.rate, log.t[0]
    t = np.arange(0.0, log.duration, 1.0 / rate)
    q_read = _at(t, log.t - t0, log.q)
    cut_off = cut_off_of(log, machine)
    q = _low_pass(q_read, min(2.0 * cut_off, 0.45 * rate), rate)
    dq = slope(q, t)
    ddq = slope(dq, t)
    sending = sending or at_rows(log)
    targets = np.zeros_like(log.q[sending.rows]) if log.q_des is None else log.q_des[sending.rows]
    target = q_read if log.q_des is None else _held(t - delay, sending.at, targets)
    kp, kd = np.asarray(machine.drives.kp), np.asarray(machine.drives.kd)
    force = 0.0 if log.force is None else _held(t, log.t - t0, log.force)
    most, flat, speed = (np.asarray(getattr(machine.drives, name)) for name in ("torque", "flat", "speed"))
    slope_down = most / (speed - flat)
    low, high = (-np.clip((speed + dq) * slope_down, 0.0, most), np.clip((speed - dq) * slope_down, 0.0, most))
    drives = machine.drives
    stall = np.inf if drives.volts is None else np.asarray(drives.volts * drives.kt / drives.resistance)  # at full duty
    on = (_held(t, log.t - t0, enabled(log).astype(float)) > 0.5).astype(float)
    seen = np.ones((len(t), 1), dtype=bool)
    if rows is not None:
        seen = np.interp(t, log.t - t0, rows.astype(float))[:, None] > 0.99

    full = _full_duty(log, machine, t)

    def asked(u: FloatArray) -> FloatArray:
        pull = kp * (u - q_read)
        if full is not None:
            pull = np.clip(pull * full[:, None], -stall * full[:, None], stall * full[:, None])
        return on * np.clip(pull - kd * dq + force, low, high)

    if log.tau is not None:
        tau, later = on * _at(t, log.t - t0, log.tau), np.zeros_like(q)
    else:
        tau = asked(target)
        further = tau if log.q_des is None else asked(_held(t - delay - 1e-3, sending.at, targets))
        later = _low_pass(further - tau, cut_off, rate)
    noise = noise_floor(log.q, rate)
    slow = 2.0 * noise * 2 * np.pi * cut_off * np.sqrt(2 * cut_off / rate)
    slow = np.maximum(slow, 0.01 * np.sqrt(np.mean(dq**2, axis=0)) + 1e-9)
    links = Links(machine)
    return Motion(
        t=t,
        q=q,
        dq=dq,
        ddq=ddq,
        target=target,
        tau=tau,
        later=later,
        on=on,
        need=links.torque(q, dq, ddq),
        bias=links.torque(q, dq, np.zeros_like(q)),
        moving=(_low_pass((np.abs(dq) > slow).astype(float), cut_off, rate) > 0.9) & seen,
        slow=slow,
        cut_off=cut_off,
        every=max(1, round(rate / (2.5 * cut_off))),
        machine=machine,
    )


def _full_duty(log: JointLog, machine: MachineModel, t: FloatArray) -> FloatArray | None:
    """Return the supply of voltage drives over what the notes say (T,); None for other drives."""
    if machine.drives.volts is None:
        return None
    volts = log.extra.get(VOLTAGE)
    if volts is None or not np.isfinite(volts).any():
        return np.ones(len(t))
    known = np.isfinite(volts)
    return np.interp(t, (log.t - log.t[0])[known], volts[known] / float(np.mean(machine.drives.volts)))


class Links:
    """Inverse dynamics of a machine without friction."""

    def __init__(self, machine: MachineModel) -> None:
        """Take a copy of its model, without friction, contacts and limits."""
        self.model = copy(machine.model)
        self.model.dof_damping[:] = 0.0
        self.model.dof_frictionloss[:] = 0.0
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        self._data = mujoco.MjData(self.model)

    def torque(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """Return the torque (T, J) [N m] that this motion needs."""
        mujoco.mj_setConst(self.model, self._data)
        out, data, model = np.empty_like(q), self._data, self.model
        for i in range(len(q)):
            data.qpos[:], data.qvel[:], data.qacc[:] = q[i], dq[i], ddq[i]
            mujoco.mj_inverse(model, data)
            out[i] = data.qfrc_inverse
        return out


def slope(x: FloatArray, t: FloatArray) -> FloatArray:
    """Return the derivative of columns (T, …), of fourth order in the time between rows."""
    return CubicSpline(t, x, axis=0)(t, 1)


def _at(t: FloatArray, rows: FloatArray, x: FloatArray) -> FloatArray:
    return np.stack([np.interp(t, rows, column) for column in x.T], -1)


def _held(t: FloatArray, rows: FloatArray, x: FloatArray) -> FloatArray:
    """Return the mean over an interval around each time of what is held from each row to the next."""
    whole = np.concatenate([np.zeros_like(x[:1]), np.cumsum(x[:-1] * np.diff(rows)[:, None], axis=0)])
    half = (t[1] - t[0]) / 2
    ends = [_at(np.clip(t + h, rows[0], rows[-1]), rows, whole) + _beyond(t + h, rows, x) for h in (half, -half)]
    return (ends[0] - ends[1]) / (2 * half)


def _beyond(t: FloatArray, rows: FloatArray, x: FloatArray) -> FloatArray:
    return np.minimum(t - rows[0], 0.0)[:, None] * x[:1] + np.maximum(t - rows[-1], 0.0)[:, None] * x[-1:]


def _low_pass(x: FloatArray, cut_off: float, rate: float) -> FloatArray:
    """Return columns (T, …) without what is faster, and without a lag."""
    return sosfiltfilt(butter(4, cut_off, fs=rate, output="sos"), x, axis=0)


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
        if self.motions[0].machine.drives.volts is not None:
            made.append(self._own("armature", lambda m: m.ddq))
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
        q = np.concatenate([m.q[:: m.every] for m in self.motions])
        use, rest = np.concatenate([m.moving[:: m.every] for m in self.motions]), np.concatenate(left)
        order = np.array([best_order(q[use[:, j], j], rest[use[:, j], j]) for j in self._each])
        yield self._own("cogging", lambda m: np.cos(order * m.q), lambda m: np.sin(order * m.q))

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

    def _by_place(
        self,
        name: str,
        f: Callable[[int, Links, FloatArray], FloatArray],
        at: tuple[float, ...] = (),
        spread: float = np.inf,
    ) -> Column:
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


LEAST_PERIODS, MOST_PERIODS = 1.5, 40
"""Fewest and most periods of cogging in the range of motion; a longer wave is a spring, or whatever else depends on
position."""

FINEST_ORDER = 0.5
"""Spacing of the orders at which cogging is looked for, over the range of motion: below the width of a peak."""

BINS = 20
"""Places that a residual is averaged over, in the shortest period of cogging."""


def best_order(q: FloatArray, r: FloatArray) -> float:
    """Return the order whose sine and cosine over positions (T,) explain most of a residual (T,)."""
    bounds = CATALOGUE["cogging"].parameter("order")
    span = max(float(np.ptp(q)), 1e-9) if len(q) else 1e-9
    orders = np.arange(
        max(2 * np.pi * LEAST_PERIODS / span, bounds.low),
        min(2 * np.pi * MOST_PERIODS / span, bounds.high),
        FINEST_ORDER / span,
    )
    if not len(q) or not len(orders):
        return bounds.high
    bins = ((q - q.min()) * (BINS * MOST_PERIODS / span)).astype(int)
    count = np.bincount(bins)
    there = count > 0
    total = np.bincount(bins, r - r.mean())[there]
    place, count = np.bincount(bins, q)[there] / count[there], count[there]
    a, b = (wave(orders[:, None] * place) for wave in (np.cos, np.sin))
    a, b = (wave - (wave @ count / len(q))[:, None] for wave in (a, b))
    aa, bb, ab, ar, br = (a * a) @ count, (b * b) @ count, (a * b) @ count, a @ total, b @ total
    power = (bb * ar**2 - 2 * ab * ar * br + aa * br**2) / np.maximum(aa * bb - ab**2, 1e-9)
    return float(orders[int(np.argmax(power))])


def _write(links: Links, made: Sequence[FloatArray]) -> None:
    for name, value in zip(("body_mass", "body_ipos", "body_inertia", "body_iquat"), made, strict=True):
        getattr(links.model, name)[:] = value


def _lag(x: FloatArray, time: float, t: FloatArray, start: float | None = None) -> FloatArray:
    """Return columns (T, J) behind a first-order lag; it begins at the first row, or at ``start``."""
    left = np.exp(-(t[1] - t[0]) / time)
    begin = x[:1] * left if start is None else np.full_like(x[:1], start)
    return lfilter([1.0 - left], [1.0, -left], x, axis=0, zi=begin)[0]
