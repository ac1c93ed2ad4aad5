"""The search for a set of effects: the sets of one size are extended by the effects that the torques ask for, quickly
refitted, and the most likely ones fitted to the end in fine steps. The best of those are the sets of the next size.

A linear step from neutral is blind to effects with a threshold, so those start from a small grid away from neutral.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mimic.config.sysid import CalibrateSettings
from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.law import STIFFEST
from mimic.dynamics.servo import neutral
from mimic.records import BoolArray, FloatArray
from mimic.sysid.baseline import corrected, refine_steps, refined
from mimic.sysid.evidence import (
    TriedEffect,
    cross_validated,
    evaluate,
    fit_delay_per_command,
    late_targets,
    least_order,
    on_harmonic,
    pays,
)
from mimic.sysid.hypotheses import SHARED, Hypothesis, afresh, as_good_without, elsewhere_too, where_it_is
from mimic.sysid.jitter import Timing
from mimic.sysid.least_squares import Fit, fit_all, fitting, left_out_all, linear_step
from mimic.sysid.residuals import Point, Problem
from mimic.sysid.result import RULES
from mimic.sysid.torque_regression import BaseMotion, Torques, asked_for, moving_base

FINEST_ORDER = 0.5
"""Spacing of the orders at which cogging is looked for, over the range of motion: below the width of a peak."""

MOST_PERIODS = 40
"""Most periods of cogging in the range of motion."""

BINS = 20
"""Places that the residual is averaged over, in the shortest period of cogging."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StartingPoint:
    """One place from which an effect may be fitted."""

    name: str
    point: Point
    joints: BoolArray
    """Joints that may have the effect (J,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PredictedMotion:
    """What the model does at a fit; arrays (T, J)."""

    t: FloatArray
    q: FloatArray
    dq: FloatArray
    tau: FloatArray


def starts_of(name: str, incumbent: Fit, problem: Problem, motion: PredictedMotion) -> list[Point]:
    """Return the points from which an effect is tried."""
    spec, machine = CATALOGUE[name], problem.machine
    if name == "torque_speed":
        torque, speed = spec.parameter("torque").starts, spec.parameter("speed").starts
        peak, fast = np.abs(motion.tau).max(0), np.abs(motion.dq).max(0)
        grid = [{"torque": a * peak, "speed": b * fast} for a, b in itertools.product(torque, speed)]
        return [_clipped(incumbent.point.with_effect(name, machine, g)) for g in grid]
    if name == "cogging":
        best = [_best_order(problem, incumbent, motion, j) for j in range(len(machine.joints))]
        return [incumbent.point.with_effect(name, machine, {"order": np.array(best)})]
    if name == "periodic_force":
        best = [_best_frequency(problem, incumbent, motion, j) for j in range(len(machine.joints))]
        return [incumbent.point.with_effect(name, machine, {"frequency": np.array(best)})]
    joints = range(len(machine.joints)) if spec.scope == "joint" else [-1]
    axes = [
        [(p.name, np.array([v * p.step * problem.scale(p.unit, j) for j in joints])) for v in p.starts]
        for p in spec.parameters
        if p.starts and not p.fixed
    ]
    return [_clipped(incumbent.point.with_effect(name, machine, dict(v))) for v in itertools.product(*axes)]


def _clipped(point: Point) -> Point:
    values = {}
    for (name, parameter), row in point.values.items():
        p = CATALOGUE[name].parameter(parameter)
        values[name, parameter] = np.clip(row, p.low, p.high)
    return Point(values)


def _left(incumbent: Fit, joint: int) -> FloatArray:
    residual = incumbent.residual[:, joint].astype(np.float64)
    return np.where(np.isfinite(residual), residual, 0.0)


def _best_order(problem: Problem, incumbent: Fit, motion: PredictedMotion, joint: int) -> float:
    """Order whose sine and cosine over position explain most of the residual."""
    r, q, v = _left(incumbent, joint), motion.q[:, joint], motion.dq[:, joint]
    bounds = CATALOGUE["cogging"].parameter("order")
    span = max(float(np.ptp(q)), 1e-9)
    most = min(2 * np.pi * MOST_PERIODS / span, bounds.high)
    orders = np.arange(max(least_order(q), bounds.low), most, FINEST_ORDER / span)
    if not len(orders):
        return bounds.high
    calm = np.abs(v) < 200.0 / 60.0  # fast motion blurs ripple that the sampling cannot follow
    if not calm.any():
        return float(orders[0])
    r, q = r[calm], q[calm]
    bins = ((q - q.min()) * (BINS * MOST_PERIODS / max(np.ptp(q), 1e-9))).astype(int)
    count = np.bincount(bins)
    there = count > 0
    total = np.bincount(bins, r - r.mean())[there]
    place, count = np.bincount(bins, q)[there] / count[there], count[there]
    a, b = (wave(orders[:, None] * place) for wave in (np.cos, np.sin))
    a, b = (wave - (wave @ count / len(q))[:, None] for wave in (a, b))
    aa, bb, ab, ar, br = (a * a) @ count, (b * b) @ count, (a * b) @ count, a @ total, b @ total
    power = (bb * ar**2 - 2 * ab * ar * br + aa * br**2) / np.maximum(aa * bb - ab**2, 1e-9)
    return float(orders[int(np.argmax(power))])


def _best_frequency(problem: Problem, incumbent: Fit, motion: PredictedMotion, joint: int) -> float:
    """Frequency at which the residual is strongest, of those that the motion itself does not have."""
    r = _left(incumbent, joint)
    dt = float(np.median(np.diff(motion.t)))
    size = 8 * len(r)
    spectrum = np.abs(np.fft.rfft(r - r.mean(), size)) ** 2
    frequency = np.fft.rfftfreq(size, dt)
    inside = (frequency > 0.1) & (frequency < 20.0) & ~on_harmonic(problem, frequency)
    return float(np.clip(frequency[inside][int(np.argmax(spectrum[inside]))], 0.1, 20.0))


def starting_points(
    problem: Problem, incumbent: Fit, names: Sequence[str], motion: PredictedMotion
) -> list[StartingPoint]:
    """Return the best start of each of the named effects: a joint takes the one that suits it best, or none.

    Each start is replayed alone, with the numbers of the incumbent free to make up for it.
    """
    points = [(name, p) for name in names for p in starts_of(name, incumbent, problem, motion)]
    moving = [i for i, (name, p) in enumerate(points) if _acts(name, p, problem)]
    replayed = dict(zip(moving, problem.residuals([points[i][1] for i in moving]), strict=True)) if moving else {}
    left = {
        i: _refitted(problem, incumbent, residual)
        for i, residual in replayed.items()
        if np.isfinite(problem.block_squares(residual)).all()
    }
    own = _channel_squares(problem, incumbent.residual)
    found = []
    for name in names:
        rows = [i for i, (n, _) in enumerate(points) if n == name and (i in left or i not in replayed)]
        if not rows:
            continue
        point, joints = points[rows[0]][1], np.ones(problem.joints, dtype=bool)
        if rows[0] in replayed and CATALOGUE[name].scope == "machine":
            point = points[min(rows, key=lambda i: float(left[i].sum()))][1]
        elif rows[0] in replayed:
            point, joints = _mixed(name, [points[i][1] for i in rows], [left[i] for i in rows], own, problem)
        found.append(StartingPoint(name=name, point=point, joints=joints))
    return found


def _refitted(problem: Problem, incumbent: Fit, residual: FloatArray) -> FloatArray:
    """Return the sum of squares of each channel (C,) after one linear step of the incumbent's numbers."""
    _, left = linear_step(problem, incumbent.point, residual, incumbent.columns, incumbent.free_parameters, 0.0)
    return _channel_squares(problem, left)


def _channel_squares(problem: Problem, residual: FloatArray) -> FloatArray:
    return problem.block_squares(residual)[problem.blocks.train].sum(0)


def _mixed(
    name: str, points: Sequence[Point], squares: Sequence[FloatArray], own: FloatArray, problem: Problem
) -> tuple[Point, BoolArray]:
    """Return the point at which each joint has the start that suits it best, or none, and which joints have one."""
    joints = problem.joints
    by_joint = np.zeros((len(points) + 1, joints))
    for row, square in enumerate((own, *squares)):
        np.add.at(by_joint[row], problem.channel_joint, square)
    choice = np.argmin(by_joint, axis=0)
    mask = choice > 0
    if not CATALOGUE[name].structural:  # a derivative at neutral tells of the joints that no start suits
        mask = np.ones(joints, dtype=bool)
    elif not mask.any():  # the mildest start where it does the least harm
        harm = by_joint[1:] - by_joint[0]
        choice[:] = 0
        j = int(np.argmin(harm.min(0)))
        choice[j] = 1 + int(np.argmin(harm[:, j]))
        mask = choice > 0
    values = dict(points[0].values)
    for p in CATALOGUE[name].parameters:
        rows = np.stack([neutral(name, p.name, problem.machine), *(x.values[name, p.name] for x in points)])
        values[name, p.name] = rows[np.maximum(choice, 1) if p.shape and not p.fixed else choice, np.arange(joints)]
    return Point(values), mask


def _acts(name: str, point: Point, problem: Problem) -> bool:
    """Return whether any number of an effect that is not a shape differs from none."""
    return any(
        not np.array_equal(point.values[name, p.name], neutral(name, p.name, problem.machine))
        for p in CATALOGUE[name].parameters
        if not p.shape and not p.fixed
    )


def predicted(problem: Problem, fitted: Fit) -> PredictedMotion:
    """Return what the model does; velocities from the predicted positions, torques from the servo."""
    machine, log = problem.machine, problem.replay.log
    joints = len(machine.joints)
    left = problem.in_floors(fitted.residual)[:, :joints].astype(np.float64)
    residual = np.nan_to_num(left) * problem.noise[:joints]
    q = log.q - residual
    t = log.t - log.t[0]
    dq = np.gradient(q, t, axis=0)
    target = log.q_des if log.q_des is not None else q
    delay = fitted.point.values.get(("delay", "time"), np.zeros(1))[0]
    delay -= float(np.mean(t[problem.replay.sent] - problem.replay.sending.at))
    late = np.stack([np.interp(t - delay, t, column) for column in target.T], -1)
    kp, kd = problem.replay.row_gains
    tau = kp * (late - q) - kd * dq
    if log.force is not None:
        tau = tau + log.force
    limit = np.asarray(machine.drives.torque)
    return PredictedMotion(t=t, q=q, dq=dq, tau=np.clip(tau, -limit, limit))


SHARED_QUANTILE = 0.25
"""Quantile of such numbers over the joints that goes into the one that all share, and the share of the largest that
then counts.
"""

POORLY_EXPLAINED = 4.0
"""Mean square of what is left, in noise floors, from which on the baseline parameters may be bent out of shape."""

AGAIN = 3
"""Rounds of finding when each target acted, once fine steps correct the coarse ones."""

SOFT = 0.1
"""Greatest compliance that the law gives all transmissions with play, times Kp: with stiffer drives it would be an
elasticity of its own.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Search:
    """What a search for effects needs beside the log."""

    settings: CalibrateSettings
    tick: Callable[[str], None]
    """Called with what is being done."""
    torques: Sequence[Torques]
    """Of the log, see `mimic.sysid.screen.regression.torques_of`."""

    def run(self, baseline: Hypothesis) -> tuple[Hypothesis, tuple[TriedEffect, ...]]:
        """Return the best set, and what was tried last where nothing was added to it."""
        if not self.settings.most_effects or baseline.explained:
            return baseline, ()
        warm = baseline.problem.warmed_up(baseline.fitted.point)
        best, last = replace(baseline, problem=warm), ()
        beam = [best]
        for _ in range(self.settings.most_effects):
            grown, last, base = self.extended(best)
            for other in beam[1:]:
                grown += [h for h in self.extended(other)[0] if pays(h.problem, h.squares, best.squares)]
            if not grown:
                return replace(best, base=base), last
            grown.sort(key=lambda h: -h.likelihood)
            beam = list(_distinct(grown))[: RULES.beam]
            alike = [h for h in beam[1:] if not pays(h.problem, beam[0].squares, h.squares, RULES.apart)]
            others = {n for h in alike for n in h.added} - set(beam[0].added)
            best = beam[0] = replace(beam[0], rivals=tuple(sorted(others)))
            if best.explained:
                break
        return best, ()

    def extended(self, parent: Hypothesis) -> tuple[list[Hypothesis], tuple[TriedEffect, ...], BaseMotion | None]:
        """Return the best sets with one effect more, all that were tried, and a motion of the base if that is it."""
        names = self.candidates(parent)
        late = self._late(parent, [n for n in names if CATALOGUE[n].random])
        if late and not late[0].why:  # first, since the rest is then judged without their noise
            settled = self._settled(parent, late[0], late)
            if settled is not None:
                return [settled], late, None
        names = [n for n in names if not CATALOGUE[n].read_off]
        self.tick("comparing torques")
        wanted, seen = asked_for(self.torques, names, parent.added)
        first = [n for n in names if n in wanted]
        tried: list[TriedEffect] = []
        for some in (first, [n for n in names if n not in first and CATALOGUE[n].structural]):
            tried += self._tried(parent, some) if some else []
            if any(not t.why for t in tried):
                break
        tried.sort(key=lambda t: -t.gain)
        base = self._base(next((t for t in tried if t.name == "periodic_force"), None))
        if base is not None:
            tried = [t if t.why else replace(t, why=base.instead_of(seen.get(t.name))) for t in tried]
        tried += late
        sets: list[Hypothesis] = []
        for t in [t for t in tried if not t.why and t not in late]:
            settled = self._settled(parent, t, tried)
            if settled is None:
                continue
            if settled.names == parent.names:
                return self.extended(settled)
            sets.append(settled)
            if len(sets) == RULES.beam or settled.explained:
                break
        return sets, tuple(tried), base

    def _base(self, shaken: TriedEffect | None) -> BaseMotion | None:
        """Return the motion of the base that explains periodic forces in the joints as well, or None."""
        if shaken is None or not self.torques or shaken.gain < RULES.gain or shaken.z < RULES.z:
            return None
        self.tick("testing for a moving base")
        cosine, sine, frequency = (shaken.fitted.point.values[shaken.name, p] for p in ("cosine", "sine", "frequency"))
        return moving_base(self.torques[0], frequency, np.hypot(cosine, sine), shaken.joints)

    def candidates(self, parent: Hypothesis) -> list[str]:
        """Return the effects that may be added to a set."""
        allowed = self.settings.effects or tuple(CATALOGUE)
        machine, out = parent.problem.machine, set(parent.names)
        if any(CATALOGUE[n].random for n in parent.names):  # one law of late targets is enough
            out |= {n for n in allowed if CATALOGUE[n].random}
        if (np.asarray(machine.drives.neighbour) == np.arange(len(machine.joints))).all():
            out.add("coupling")  # to itself it is viscous friction
        if len(machine.joints) == 1:
            out.add("joint_delay")  # the delay of the machine
        if np.max(machine.drives.kp) * STIFFEST > SOFT:
            out |= {"backlash", "compliance"}
        return [n for n in allowed if n not in out and not CATALOGUE[n].baseline]

    def _late(self, parent: Hypothesis, names: Sequence[str]) -> tuple[TriedEffect, ...]:
        if not names:
            return ()
        self.tick("searching for delayed commands")
        return late_targets(parent.problem, parent.fitted, parent.squares, parent.names, parent.joints, names)

    def _tried(self, parent: Hypothesis, names: Sequence[str]) -> list[TriedEffect]:
        """Return effects beside a set, the strongest of them fitted to the end."""
        problem, fitted = parent.problem, parent.fitted
        self.tick(f"refitting {len(names)} effects")
        starts = starting_points(problem, fitted, names, predicted(problem, fitted))
        places = {s.name: s.joints for s in starts}

        def refitted(of: Sequence[tuple[str, Point]], most: int, frozen: Fit | None = None) -> list[Fit]:
            asked = [
                fitting(
                    problem,
                    point,
                    [*parent.names, name],
                    {**parent.joints, name: places[name]},
                    most=most,
                    frozen=frozen,
                )
                for name, point in of
            ]
            return fit_all(problem, asked)

        def judged(of: Sequence[str], found: Sequence[Fit]) -> list[TriedEffect]:
            made = zip(of, found, left_out_all(found, problem), strict=True)
            return [evaluate(problem, fitted, parent.squares, n, f, places[n], left) for n, f, left in made]

        quick = refitted([(s.name, s.point) for s in starts], 2, fitted)
        for i, (s, f) in enumerate(zip(starts, quick, strict=True)):
            if (apart := _apart_from_shared(f, s)) is not None:
                point, places[s.name] = apart
                quick[i] = refitted([(s.name, point)], 3)[0]
        tried = judged([s.name for s in starts], quick)
        hard = [t for t in tried if _astray(problem, fitted, t, tried)]
        everywhere = np.ones(problem.joints, dtype=bool)
        begins = {s.name: afresh(problem, s.point, everywhere) for s in starts}
        anew = refitted([(t.name, begins[t.name]) for t in hard], 6)
        for t, again in zip(hard, judged([t.name for t in hard], anew), strict=True):
            if again.gain > t.gain:
                tried[tried.index(t)] = again
        strong = sorted((t for t in tried if t.gain >= RULES.gain and t.z >= RULES.apart), key=lambda t: -t.gain)
        strong = [t for t in strong if not pays(problem, strong[0].squares, t.squares, RULES.hopeless)]
        strong = strong[: RULES.finished]
        if strong:
            self.tick(f"comparing {', '.join(CATALOGUE[t.name].title for t in strong)}")
        done = refined(problem, refitted([(t.name, t.fitted.point) for t in strong], 4))
        for t, again in zip(strong, judged([t.name for t in strong], done), strict=True):
            tried[tried.index(t)] = again
        return tried

    def _settled(self, parent: Hypothesis, t: TriedEffect, tried: Sequence[TriedEffect]) -> Hypothesis | None:
        """Return a set with an effect fitted to the end on the joints that have it, or None where it does not last.

        The set without it comes back where trying it has led to numbers that explain more.
        """
        h = replace(parent, parent=parent, found=t, tried=tuple(tried), names=(*parent.names, t.name))
        if t.timing is None:
            problem = corrected(h.problem, t.fitted.point).weighed(t.fitted.residual)
            h = replace(h, problem=problem, fitted=t.fitted, joints={**h.joints, t.name: t.joints})
        else:
            h = self._on_time(h, t.timing)
        h = elsewhere_too(where_it_is(h, t), self.tick)
        if not CATALOGUE[t.name].read_off:
            channels = h.joints[t.name][h.problem.channel_joint]
            left, had = (cross_validated(x.problem, x.fitted)[channels].sum() for x in (h, parent))
            if (bare := as_good_without(h, t.name)) is not None:
                problem, bare = refine_steps(h.problem, bare)
                return replace(parent, problem=problem, fitted=bare) if _explains_more(problem, bare, parent) else None
            if not left < had:
                return None
        return h

    def _on_time(self, h: Hypothesis, timing: Timing) -> Hypothesis:
        """Return the set with the delay of each command fitted in fine steps, and the numbers that go with it."""
        self.tick("fitting the delay of each command")
        problem = corrected(h.problem.changed(replay=h.problem.replay.with_late(timing.late)), timing.point)
        problem, timing, fitted = fit_delay_per_command(problem, timing, h.names, h.joints, AGAIN)
        return replace(
            h,
            problem=problem,
            fitted=fitted,
            intervals={**h.intervals, timing.name: timing.interval},
            unsure={**h.unsure, ("delay", "time"): timing.unsure},
        )


def _explains_more(problem: Problem, fitted: Fit, than: Hypothesis) -> bool:
    """Return whether a fit of the same numbers as a set's leaves less."""
    left, had = (
        np.sqrt(p.mean_squares(f.residual, False).sum()) for p, f in ((problem, fitted), (than.problem, than.fitted))
    )
    return bool(left < (1.0 - RULES.gain) * had)


def _distinct(sets: Sequence[Hypothesis]) -> Iterator[Hypothesis]:
    """Yield the first of several sets with the same effects."""
    seen: set[frozenset[str]] = set()
    for h in sets:
        if frozenset(h.names) not in seen:
            seen.add(frozenset(h.names))
            yield h


def _apart_from_shared(fitted: Fit, start: StartingPoint) -> tuple[Point, BoolArray] | None:
    """Return a new start with the part that most joints share moved to the machine's parameter, or None.

    A delay of all joints and the delay of the machine are the same thing: neither is sure as long as both are fitted.
    """
    values = dict(fitted.point.values)
    for (name, parameter), shared in SHARED.items():
        if name != start.name or shared not in values or not start.joints.all():
            continue
        alike = float(np.quantile(values[name, parameter], SHARED_QUANTILE))
        rest = np.maximum(values[name, parameter] - alike, 0.0)
        there = rest > SHARED_QUANTILE * rest.max()
        if not there.any() or there.all():
            return None
        values[shared] = values[shared] + alike
        values[name, parameter] = np.where(there, rest, 0.0)
        return Point(values), there
    return None


def _astray(problem: Problem, incumbent: Fit, t: TriedEffect, tried: Sequence[TriedEffect]) -> bool:
    """Return whether an effect may have been fitted from a poor start."""
    most = t.gain == max(o.gain for o in tried)
    if most and _bent(incumbent):
        return True
    left = np.mean(problem.mean_squares(t.fitted.residual, False))
    weak = t.gain < RULES.gain or t.z < RULES.z
    return CATALOGUE[t.name].structural and (weak or most) and bool(left > POORLY_EXPLAINED)


def _bent(fitted: Fit) -> bool:
    """Return whether a baseline parameter is at an unphysical bound."""
    for free in fitted.free_parameters:
        value = fitted.point.at(free)
        if CATALOGUE[free.key[0]].baseline and value != 0.0 and min(abs(value - b) for b in free.bounds) < 1e-9:
            return True
    return False
