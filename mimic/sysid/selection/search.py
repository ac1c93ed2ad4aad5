"""The search for a set of effects: the sets of one size are extended by the effects that the torques ask for, quickly
refitted, and the most likely ones fitted to the end in fine steps. The best of those are the sets of the next size.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mimic.config.sysid import CalibrateSettings
from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.law import STIFFEST
from mimic.records import BoolArray
from mimic.sysid.baseline import FINE, FINE_SEGMENT, corrected, refine_steps, refined
from mimic.sysid.evidence import (
    TriedEffect,
    cross_validated,
    evaluate,
    fit_delay_per_command,
    late_targets,
    pays,
)
from mimic.sysid.hypotheses import SHARED, Hypothesis, afresh, as_good_without, elsewhere_too, where_it_is
from mimic.sysid.jitter import Timing
from mimic.sysid.least_squares import Fit, fit_all, fitting, left_out_all
from mimic.sysid.residuals import Point, Problem
from mimic.sysid.selection.starts import StartingPoint, predicted, starting_points
from mimic.sysid.thresholds import RULES
from mimic.sysid.torque_regression import BaseMotion, Torques, asked_for, moving_base

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
        warm = baseline.problem.warmed_up(baseline.fitted.point, FINE, FINE_SEGMENT)
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
        allowed = self.settings.effects or tuple(n for n, e in CATALOGUE.items() if not e.by_request)
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
        everywhere = np.ones(len(problem.machine.joints), dtype=bool)
        begins = {s.name: afresh(problem, s.point, everywhere) for s in starts}
        anew = refitted([(t.name, begins[t.name]) for t in hard], 6)
        for t, again in zip(hard, judged([t.name for t in hard], anew), strict=True):
            if again.gain > t.gain:
                tried[tried.index(t)] = again
        strong = sorted((t for t in tried if t.gain >= RULES.gain and t.z >= RULES.promising), key=lambda t: -t.gain)
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
        value = fitted.point.values[free.key][max(free.joint, 0)]
        if CATALOGUE[free.key[0]].baseline and value != 0.0 and min(abs(value - b) for b in free.bounds) < 1e-9:
            return True
    return False
