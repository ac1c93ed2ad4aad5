"""Model selection: which effects logs ask for, by one rule.

A model is better than another if it predicts blocks that were left out better: by `Thresholds.z` standard errors over
the blocks, after a price for each number that it has more, by `Thresholds.gain` of the error and `Thresholds.share` of
what noise does not explain. Effects are added while that makes the model better (forward selection with a beam); then
effects, joint by joint, are taken out while the model is not better with them (pruning). Effects of which none makes
the model better than another does are reported as one group. Nothing else decides. Where effects are taken out, each
block may have an offset of its own, of the size that the whole model leaves: beside a torque that wanders slowly,
whatever is slow, too, seems to predict it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from mimic.config.sysid import CalibrateSettings
from mimic.dynamics.catalogue import CATALOGUE
from mimic.dynamics.catalogue.transmission import STIFFEST
from mimic.dynamics.servo import neutral
from mimic.records import BoolArray, FloatArray
from mimic.sysid.fit.baseline import corrected_at, errors_of, moved, settled, with_fine_derivatives
from mimic.sysid.fit.least_squares import (
    LARGEST,
    MOST_STEPS,
    SMALLEST,
    Fit,
    Judged,
    fit,
    fit_all,
    fitting,
    left_out,
    left_out_all,
    stepping,
)
from mimic.sysid.fit.problem import FreeParameter, Key, Point, Problem
from mimic.sysid.log.noise import MEMORY
from mimic.sysid.result import RULES, Candidate, Stage
from mimic.sysid.select.lateness import Lateness, fit_lateness, late_targets
from mimic.sysid.select.starts import StartingPoint, predicted, starting_points

SHARED: dict[Key, Key] = {("joint_delay", "time"): ("delay", "time")}
"""Numbers of joints that are a baseline parameter of the machine where they are alike in all."""

SOFT = 0.1
"""Greatest compliance that the law gives all transmissions with play, times Kp: with stiffer drives it would be an
elasticity of its own."""

# ---------------------------------------------------------------------- the rule


@dataclass(frozen=True, kw_only=True, slots=True)
class Comparison:
    """How much better a model predicts blocks that were left out than another."""

    gain: float
    """log(error of the other / error of the one); 0.01 is 1 %."""
    z: float
    """Standard errors over the blocks, after the price of numbers."""
    share: float
    """Of what noise does not explain under the other, what the one removes."""

    @property
    def better(self) -> bool:
        """Whether the one is better."""
        return not self.why_not

    @property
    def why_not(self) -> str:
        """Return why it is not better, or an empty string."""
        if self.gain < RULES.gain:
            return f"gain {100 * self.gain:.1f} % is below {100 * RULES.gain:g} %"
        if self.z < RULES.z:
            return f"gain is {self.z:.1f} standard errors, below {RULES.z:g}"
        if self.share < RULES.share:
            return f"it removes {100 * self.share:.0f} % of the unexplained error, below {100 * RULES.share:.0f} %"
        return ""


def compare(
    problem: Problem, one: FloatArray, other: FloatArray, numbers: int, channels: BoolArray | None = None
) -> Comparison:
    """Compare two models by blocks that were left out.

    What noise leaves of a block is counted in both: else a joint that rests, of which both leave a small part of the
    noise, says as much by their ratio as one that moves. How sure is the larger of two: the mean over the blocks over
    its standard error, and the normal score of Wilcoxon's signed-rank test over blocks of single channels where the two
    differ by more than a twentieth of the noise: an effect that acts in few blocks is seen by the second. Each number
    costs half the logarithm of the count of independent readings (Schwarz 1978).

    Args:
        problem: Log and model.
        one: Squares of each fitted block judged without itself (B, C).
        other: Those of the other.
        numbers: How many more the one has.
        channels: That can differ (C,); all by default.
    """
    use = np.ones(one.shape[1], dtype=bool) if channels is None else channels
    judging = problem.readings > 0
    if not use.any() or not judging.any():
        return Comparison(gain=0.0, z=0.0, share=0.0)
    good, bad, noise = one[judging][:, use], other[judging][:, use], problem.readings[judging, None]
    price = _price(numbers, _independent(problem) * int(use.sum()))
    each = 0.5 * np.log((bad + noise) / (good + noise)).reshape(-1)
    whole = noise[:, 0] * int(use.sum())
    d = 0.5 * np.log((bad.sum(1) + whole) / (good.sum(1) + whole)) - price
    error = max(d.std(ddof=1) / np.sqrt(len(d)), np.finfo(float).eps) if len(d) > 1 else np.inf
    left = float(bad.sum() - whole.sum())
    return Comparison(
        gain=float(0.5 * np.log(max(bad.sum(), SMALLEST) / max(good.sum(), SMALLEST))),
        z=max(float(d.mean() / error), _rank_score(each[np.abs(each) > RULES.material] - price)),
        share=float(bad.sum() - good.sum()) / left if left > 0.0 else 0.0,  # noise explains all: nothing to remove
    )


def _price(numbers: int, readings: float) -> float:
    """Return what numbers cost of the log of an error, with so many independent readings (Schwarz 1978)."""
    return float(0.5 * numbers * np.log(readings) / readings)


def _score(problem: Problem, squares: FloatArray, numbers: int) -> float:
    """Return the log of the probability of blocks (B_train, C) that were left out, less the price of the numbers."""
    count = _independent(problem)
    size = np.maximum(squares.sum(0) / max(int(problem.blocks.fitted.sum()), 1), SMALLEST)
    return float(-0.5 * count * np.log(size).sum() - 0.5 * numbers * np.log(count * len(size)))


def _independent(problem: Problem) -> float:
    """Return how many readings count in a likelihood: one for each time in which a drive forgets."""
    readings = max(int(problem.blocks.fitted.sum()), 1)
    return max(readings * min(1.0 / (MEMORY * problem.replay.log.rate), 1.0), 2.0)


def _rank_score(d: FloatArray) -> float:
    """Return the normal score of the signed-rank test that d is positive; 0 without values."""
    n = len(d)
    if not n:
        return 0.0
    ranks = np.argsort(np.argsort(np.abs(d))) + 1.0
    return float((ranks[d > 0].sum() - n * (n + 1) / 4) / np.sqrt(n * (n + 1) * (2 * n + 1) / 24))


# ---------------------------------------------------------------------- models


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """An effect that was fitted beside those of a model."""

    name: str
    fitted: Fit
    squares: FloatArray
    """Each fitted block judged without itself; the model's own in chains that do not get the effect (B_train, C)."""
    joints: BoolArray
    """Joints that get it: those of chains where it pays its price (J,)."""
    numbers: int
    """How many it has there."""
    against: Comparison
    """With the model that lacks it."""
    finished: bool = True
    """Whether it was fitted to the end; of others one linear step is all that is known."""
    short: bool = False
    """Whether it was fitted in short segments."""
    late: tuple[Problem, Lateness, Fit] | None = None
    """Of late targets, fitted to the end: with the lateness of each."""
    why: str = ""
    """Why it was not taken though it is better."""

    @property
    def better(self) -> bool:
        """Whether the model is better with it."""
        return self.finished and self.against.better and not self.why

    def score(self, problem: Problem) -> float:
        """Return the log of the probability of left-out blocks, less the price of its numbers."""
        return _score(problem, self.squares, self.numbers)


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedModel:
    """A set of effects, fitted to a log."""

    problem: Problem
    """Its replays are corrected at this fit."""
    fitted: Fit
    names: tuple[str, ...]
    """All effects, those of the baseline first."""
    joints: Mapping[str, BoolArray]
    """Joints that have each (J,); all where it is not there."""
    parent: FittedModel | None = None
    """The model that lacks the last effect; None for the baseline."""
    trial: Trial | None = None
    """The last effect, as it was tried."""
    tried: tuple[Trial, ...] = ()
    """All that were tried beside it, best first."""
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Of the numbers that are read off the lateness of the targets."""
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """For an effect, those that cannot be told from it."""
    notes: tuple[str, ...] = ()
    """What was found and is not in the model any more."""

    @cached_property
    def left_out(self) -> tuple[FloatArray, FloatArray]:
        """Squares of each fitted block judged without itself (B_train, C), and how the numbers move (B_train, P)."""
        return left_out(self.fitted, self.problem)

    @property
    def squares(self) -> FloatArray:
        """Squares of each fitted block, judged without itself (B_train, C)."""
        return self.left_out[0]

    @property
    def path(self) -> tuple[FittedModel, ...]:
        """The baseline, and each model on the way to this one."""
        return (self,) if self.parent is None else (*self.parent.path, self)

    @property
    def added(self) -> tuple[str, ...]:
        """Effects beside the baseline's, in the order in which they were found."""
        return tuple(m.trial.name for m in self.path if m.trial is not None and m.trial.name in self.names)

    @property
    def explained(self) -> bool:
        """Whether no remaining error is large enough to look for more."""
        left = self.problem.mean_squares(self.fitted.residual, False)
        if self.trial is not None and self.trial.late is not None:
            left = self.trial.squares.sum(0) / max(int(self.problem.blocks.fitted.sum()), 1)
        return bool(np.all(left < RULES.enough**2))

    @property
    def score(self) -> float:
        """Log of the probability of blocks that were left out, less the price of each number.

        Of late targets that is what the other chains show of them: each target has a lateness of its own.
        """
        late = self.trial is not None and self.trial.late is not None
        squares = self.trial.squares if self.trial is not None and late else self.squares
        return _score(self.problem, squares, len(self.fitted.free_parameters))

    @cached_property
    def in_short_segments(self) -> FittedModel:
        """The model fitted in short segments."""
        problem = self.problem.in_short_segments()
        fitted = fit(problem, self.fitted.point, self.names, self.joints, most=MOST_STEPS)
        return replace(self, problem=problem, fitted=fitted)

    @property
    def compared(self) -> FittedModel:
        """The model as others are compared with it: in short segments where much is left.

        What a joint that sticks and slips does cannot be told for long: of two models that are both far off after three
        seconds neither is better, but one is in what happens next.
        """
        return self.in_short_segments if self.problem.poorly_explained(self.fitted.residual) else self

    def mask(self, name: str) -> BoolArray:
        """Return the joints (J,) that have an effect."""
        return self.joints.get(name, np.ones(self.problem.joints, dtype=bool))

    def channels(self, joints: BoolArray, name: str) -> BoolArray | None:
        """Return the channels (C,) that an effect of these joints can change; None for all."""
        if CATALOGUE[name].scope == "machine":
            return None
        chain = self.problem.machine.chain
        return np.isin(self.problem.channel_chain, chain[joints])

    def stages(self, last: Sequence[Trial]) -> list[Stage]:
        """Return the models on the way, each with what was tried to get there.

        Args:
            last: What was tried where nothing was added.
        """
        root = self.path[0] if self.added else self  # effects that were taken out again led to a better baseline
        made = [Stage(added="baseline", errors=errors_of(root.problem, root.fitted.residual))]
        kept = [m for m in self.path if m.trial is not None and m.trial.name in self.names]
        for m in kept:
            assert m.trial is not None
            shown = self if m is kept[-1] else m
            found = tuple(_candidate(m.problem, t, m.trial) for t in m.tried)
            errors = errors_of(shown.problem, shown.fitted.residual)
            group = self.groups.get(m.trial.name, ())
            made.append(Stage(added=m.trial.name, errors=errors, candidates=found, alternatives=group))
        if not kept:
            tried = last or (self.path[1].tried if len(self.path) > 1 else ())
            errors = errors_of(self.problem, self.fitted.residual)
            made.append(Stage(added="", errors=errors, candidates=tuple(_candidate(root.problem, t) for t in tried)))
        return made


def _candidate(problem: Problem, t: Trial, best: Trial | None = None) -> Candidate:
    """Return the record of a trial beside the one that was taken."""
    machine, spec = problem.machine, CATALOGUE[t.name]
    why, odds, apart = t.why or t.against.why_not, 0.0, 0.0
    if best is not None:
        why = "" if best is t else why or "another effect explains more"
    if best is not None and t.finished:  # what one linear step promises is no probability
        odds = float(np.exp(min(t.score(problem) - best.score(problem), np.log(LARGEST))))
        apart = 0.0 if best is t else compare(problem, best.squares, t.squares, best.numbers - t.numbers).z
    return Candidate(
        name=t.name,
        gain=t.against.gain,
        z=t.against.z,
        improvement=t.against.share,
        values={p.name: t.fitted.point.values[t.name, p.name] for p in spec.parameters},
        joints=tuple(np.array(machine.joints)[t.joints]) if spec.scope == "joint" else (),
        accepted=best is t,
        why=why,
        odds=odds,
        alternative_z=apart,
    )


def _only_on(model: FittedModel, name: str, joints: BoolArray, point: Point) -> Point:
    """Return a point with an effect on some joints (J,) only."""
    if CATALOGUE[name].scope == "machine":
        return point
    values = dict(point.values)
    for p in CATALOGUE[name].parameters:
        values[name, p.name] = np.where(joints, values[name, p.name], neutral(name, p.name, model.problem.machine))
    return Point(values)


# ---------------------------------------------------------------------- forward


@dataclass(frozen=True, kw_only=True, eq=False)
class Selection:
    """What a selection needs beside the log."""

    settings: CalibrateSettings
    tick: Callable[[str], None]
    """Called with what is being done."""

    def run(self, baseline: FittedModel) -> tuple[FittedModel, tuple[Trial, ...]]:
        """Return the best model, and what was tried last where nothing was added to it."""
        if not self.settings.most_effects or baseline.explained:
            return baseline, ()
        best = replace(baseline, problem=baseline.problem.warmed_up(baseline.fitted.point))
        beam, last = [best], ()
        for _ in range(self.settings.most_effects):
            grown: list[FittedModel] = []
            for i, model in enumerate(beam):
                made, tried = self.extended(model)
                grown += made
                if i == 0:
                    last = tried
            grown = [m for m in grown if m.score > best.score]
            if not grown:
                break
            beam = list(_distinct(sorted(grown, key=lambda m: -m.score)))[: RULES.beam]
            best, last = beam[0], ()
            if best.explained:
                break
        return pruned(best, self.tick), last

    def extended(self, model: FittedModel) -> tuple[list[FittedModel], tuple[Trial, ...]]:
        """Return the best models with one effect more, and all that were tried."""
        names = self.candidates(model)
        random = [n for n in names if CATALOGUE[n].random]
        tried = [self._late(model, x) for x in late_targets(model.problem, model.fitted, random)] if random else []
        if len(tried) == 2:  # whole periods are fewer numbers than a lateness of each target
            lost, jitter = sorted(tried, key=lambda t: t.name != "lost_commands")
            if lost.better and not self._surely(model, jitter, lost):
                tried = [lost, replace(jitter, why="lost commands explain as much with fewer numbers")]
        tried += self._tried(model, [n for n in names if not CATALOGUE[n].read_off])
        tried.sort(key=lambda t: (t.finished, t.score(model.problem)), reverse=True)
        grown: list[FittedModel] = []
        good = [t for t in tried if t.better]
        good = [t for t in good if t is good[0] or not self._surely(model, good[0], t)]  # a beam of what is as good
        for t in good[: RULES.beam]:
            child = self._with(model, t, tried)
            numbers = len(child.fitted.free_parameters) - len(model.fitted.free_parameters)
            channels = child.channels(t.joints, t.name)
            one, other = (child, model) if model.compared is model else (child.in_short_segments, model.compared)
            if compare(one.problem, one.squares, other.squares, numbers, channels).better:
                grown.append(child)
            if grown and grown[0].explained:
                break
        return grown, tuple(tried)

    def _surely(self, model: FittedModel, one: Trial, other: Trial) -> bool:
        """Return whether a model is surely better with one effect than with another."""
        return compare(model.problem, one.squares, other.squares, one.numbers - other.numbers).better

    def candidates(self, model: FittedModel) -> list[str]:
        """Return the effects that may be added to a model."""
        machine, out = model.problem.machine, set(model.names)
        if any(CATALOGUE[n].random for n in model.names):  # one law of late targets is enough
            out |= {n for n in CATALOGUE if CATALOGUE[n].random}
        if (np.asarray(machine.drives.neighbour) == np.arange(len(machine.joints))).all():
            out.add("coupling")  # to itself it is viscous friction
        out |= {"motor"} if machine.drives.volts is None else {"kt_gain", "supply_sag"}
        if len(machine.joints) == 1:
            out.add("joint_delay")  # the delay of the machine
        if np.max(machine.drives.kp) * STIFFEST > SOFT:
            out |= {"backlash", "compliance"}
        allowed = self.settings.effects or tuple(CATALOGUE)
        return [n for n in allowed if n not in out and not CATALOGUE[n].baseline]

    def _late(self, model: FittedModel, lateness: Lateness) -> Trial:
        """Return late targets as a trial, judged by what each chain shows of those of the others."""
        promise = compare(model.problem, lateness.squares, model.squares, 1)
        late = None
        if promise.gain >= RULES.gain:
            names = (*model.names, lateness.name)
            late = fit_lateness(model.problem, lateness, names, model.joints, model.fitted)
            lateness = late[1]
        return Trial(
            name=lateness.name,
            fitted=late[2] if late else replace(model.fitted, point=lateness.point),
            squares=lateness.squares,
            joints=np.ones(model.problem.joints, dtype=bool),
            numbers=1,
            against=compare(model.problem, lateness.squares, model.squares, 1) if late else promise,
            finished=late is not None,
            late=late,
        )

    def _tried(self, model: FittedModel, names: Sequence[str]) -> list[Trial]:
        """Return effects beside a model, those fitted to the end that one linear step says most of."""
        self.tick(f"one step towards each of {len(names)} effects")
        near, problem = model.compared, model.compared.problem
        starts = starting_points(problem, near.fitted, names, predicted(problem, near.fitted))
        asked = [stepping(problem, near.fitted.point, near.names, near.joints, near.fitted)]
        for s in starts:
            where = {**near.joints, s.name: s.joints}
            asked.append(stepping(problem, s.point, [*near.names, s.name], where, near.fitted))
        (_, *steps), ((before, _), *judged) = (made := fit_all(problem, asked)), left_out_all(made, problem, False)
        quick = self._trials(near, starts, steps, judged, before)
        strong = sorted((t for t in quick if t.against.gain >= RULES.gain), key=lambda t: -t.score(problem))
        strong = strong[: RULES.finished]
        self.tick(f"comparing {', '.join(CATALOGUE[t.name].title for t in strong)}")
        first, asked = [next(s for s in starts if s.name == t.name) for t in strong], []
        for s, t in zip(first, strong, strict=True):
            point, where = _apart_from_shared(s.point, s), {**near.joints, s.name: s.joints}
            asked.append(
                fitting(problem, point, [*near.names, s.name], where, most=MOST_STEPS, frozen=t.fitted, every=3)
            )
        done, fits = [], [(problem, f) for f in fit_all(problem, asked)]
        if near is model:  # what coarse steps are wrong by changes with an effect
            new = [([*near.names, s.name], {**near.joints, s.name: s.joints}) for s in first]
            fits = settled(problem, [(f, *n) for (_, f), n in zip(fits, new, strict=True)])
        for s, (own, f) in zip(first, fits, strict=True):
            done += self._trials(near, [s], [f], [left_out(f, own)], near.squares)
        for t in quick:
            if t not in strong:  # its many derivatives are of no more use
                why = "other effects promise more" if t.against.better else ""
                done.append(replace(t, finished=False, why=why, fitted=replace(t.fitted, columns=())))
        if near is model:
            return done
        longer = model.squares / np.maximum(near.squares, SMALLEST)  # what is left in long segments, as those of trials
        return [replace(t, squares=t.squares * longer, short=True) for t in done]

    def _trials(
        self,
        model: FittedModel,
        starts: Sequence[StartingPoint],
        fits: Sequence[Fit],
        judged: Sequence[Judged],
        before: FloatArray,
    ) -> list[Trial]:
        """Return fits as trials: a chain gets an effect where left-out blocks of it pay for its numbers.

        Before are those of the model without it, judged in the same way.
        """
        problem, made = model.problem, []
        chain, of = problem.machine.chain, problem.channel_chain
        noise = np.maximum(problem.readings, 1)[:, None]
        for s, f, (squares, _) in zip(starts, fits, judged, strict=True):
            own = [k for k in f.free_parameters if k.key[0] == s.name]
            if CATALOGUE[s.name].scope == "machine":
                joints, numbers = s.joints, len(own)
            else:
                joints, numbers = np.zeros(problem.joints, dtype=bool), 0
                squares = squares.copy()
                for c in np.unique(chain):
                    mine, count = of == c, sum(chain[k.joint] == c for k in own)
                    price = _price(count, _independent(problem) * int(mine.sum()))
                    good, bad = ((x[:, mine] + noise).sum(0) for x in (squares, before))
                    if count and np.log(bad / good).sum() > 2 * price:
                        joints[[k.joint for k in own if chain[k.joint] == c]] = True
                        numbers += count
                    else:
                        squares[:, mine] = before[:, mine]
            against = compare(problem, squares, before, numbers, model.channels(joints, s.name))
            made.append(Trial(name=s.name, fitted=f, squares=squares, joints=joints, numbers=numbers, against=against))
        return made

    def _with(self, model: FittedModel, t: Trial, tried: Sequence[Trial]) -> FittedModel:
        """Return the model with an effect more, fitted to the end in fine steps."""
        self.tick(f"fitting {CATALOGUE[t.name].title}")
        child = replace(model, parent=model, trial=t, tried=tuple(tried), names=(*model.names, t.name))
        if t.late is not None:
            problem, lateness, fitted = t.late
            child = replace(child, intervals={**model.intervals, t.name: lateness.interval})
        else:
            point = _only_on(model, t.name, t.joints, t.fitted.point)
            child = replace(child, joints={**model.joints, t.name: t.joints})
            problem = model.problem.weighed(t.fitted.residual)
            known = None if t.short else t.fitted
            fitted = fit(problem, point, child.names, child.joints, most=MOST_STEPS, frozen=known)
        problem, fitted = settled(problem, [(fitted, child.names, child.joints)])[0]
        return replace(child, problem=problem, fitted=fitted)


def _distinct(models: Iterable[FittedModel]) -> Iterable[FittedModel]:
    """Yield the first of several models with the same effects."""
    seen: set[frozenset[str]] = set()
    for m in models:
        if frozenset(m.names) not in seen:
            seen.add(frozenset(m.names))
            yield m


def _apart_from_shared(point: Point, start: StartingPoint) -> Point:
    """Return a start with the part that all joints share moved to the machine's parameter.

    A delay of all joints and the delay of the machine are the same thing.
    """
    values = dict(point.values)
    for (name, parameter), shared in SHARED.items():
        if name == start.name and shared in values and start.joints.all():
            alike = float(np.min(values[name, parameter]))
            values[shared], values[name, parameter] = values[shared] + alike, values[name, parameter] - alike
    return Point(values)


# ---------------------------------------------------------------------- backward

Unit = tuple[str, BoolArray]
"""An effect, and the joints (J,) from which it is taken out."""


def pruned(model: FittedModel, tick: Callable[[str], None]) -> FittedModel:
    """Return what of a model is better than without it, fitted to the end, with groups that cannot be told apart."""
    while True:
        tick("checking that each effect is needed")
        fewer = _without_least(model)
        if fewer is None:
            break
        model = fewer
    return _grouped(_polished(model, tick), tick)


def _units(model: FittedModel) -> list[Unit]:
    """Return what can be taken out of a model by itself: an effect at one place of all chains, or as a whole."""
    units: list[Unit] = []
    place = model.problem.machine.place
    for name in [n for n in model.added if not CATALOGUE[n].random]:  # lateness is judged by other chains
        mask, spec = model.mask(name), CATALOGUE[name]
        if spec.scope == "machine" or spec.chain_shared:
            units.append((name, mask))
        else:
            units += [(name, mask & (place == p)) for p in np.unique(place[mask])]
    return units


def _without_least(model: FittedModel) -> FittedModel | None:
    """Return the model without what it needs least, if it is not better with that; None if all stays."""
    units = _units(model)
    if not units:
        return None
    near = model.compared
    problem = near.problem.with_block_offsets(near.fitted.residual)
    if problem is not near.problem:
        again = fit(problem, near.fitted.point, near.names, near.joints, most=3)
        near = replace(near, problem=problem, fitted=again)
    chain, least = problem.machine.chain, None
    bare = [_bare(near, name, joints) for name, joints in units]
    fits = fit_all(problem, [fitting(problem, p, n, w, most=3, frozen=near.fitted, every=0) for n, w, p in bare])
    for (name, joints), (squares, _) in zip(units, left_out_all(fits, problem), strict=True):
        parts = [joints] if CATALOGUE[name].scope == "machine" else [joints & (chain == c) for c in np.unique(chain)]
        for part in (p for p in parts if p.any()):
            own = [k for k in model.fitted.free_parameters if k.key[0] == name and (k.joint < 0 or part[k.joint])]
            channels = model.channels(part, name)
            with_it = compare(problem, near.squares, squares, max(len(own), 1), channels)
            none = all(_is_none(model, k) for k in own if not _is_shape(k)) and bool(own)
            if (none or not with_it.better) and (least is None or with_it.z < least[0]):
                least = (-np.inf if none else with_it.z, name, part, with_it)
    if least is None:
        return None
    _, name, part, with_it = least
    names, where, point = _bare(model, name, part)
    fitted = fit(model.problem, point, names, where, most=3)
    whole = name not in names
    at = "" if whole else f" in {', '.join(np.array(problem.machine.joints)[part])}"
    why = with_it.why_not or "its number is that of none"
    note = f"{CATALOGUE[name].title} was found and taken out again{at}: {why}"
    return replace(
        model,
        fitted=fitted,
        names=tuple(names),
        joints=where,
        notes=(*model.notes, note) if whole else model.notes,
    )


def _bare(model: FittedModel, name: str, joints: BoolArray) -> tuple[list[str], dict[str, BoolArray], Point]:
    """Return names, joints and a start of a model without an effect in some joints (J,)."""
    rest, names, where = model.mask(name) & ~joints, list(model.names), dict(model.joints)
    if rest.any() and CATALOGUE[name].scope != "machine":
        where[name] = rest
        return names, where, _only_on(model, name, rest, model.fitted.point)
    names.remove(name)
    where.pop(name, None)
    return names, where, model.fitted.point.without(name)


def _is_shape(k: FreeParameter) -> bool:
    return CATALOGUE[k.key[0]].parameter(k.key[1]).shape


def _is_none(model: FittedModel, k: FreeParameter) -> bool:
    """Return whether a number is at the bound at which it is none."""
    none = k.parameter.turned(float(neutral(*k.key, model.problem.machine)[max(k.joint, 0)]))
    value = model.fitted.point.at(k)
    return value == none and value in k.bounds


def _polished(model: FittedModel, tick: Callable[[str], None]) -> FittedModel:
    """Return the model fitted again, in fine steps: coarse ones hold back what a log hardly determines."""
    tick("final fit")
    problem = model.problem
    if "kt_heat" in model.names:
        (problem,) = corrected_at(problem.warmed_up(model.fitted.point), [model.fitted.point])
    fitted = fit(problem, model.fitted.point, model.names, model.joints, most=1, frozen=model.fitted, every=0)
    for _ in range(2):
        start = with_fine_derivatives(problem, fitted)
        fine = problem.in_finer_replay(start.point)
        fitted = fit(fine, start.point, model.names, model.joints, most=MOST_STEPS, frozen=start, every=0)
        fitted = replace(fitted, columns=start.columns)  # those that `fit` corrected make more seem determined
        if not moved(start, fitted):
            break
    problem, fitted = settled(problem, [(fitted, model.names, model.joints)])[0]
    return replace(model, problem=problem, fitted=fitted)


def _grouped(model: FittedModel, tick: Callable[[str], None]) -> FittedModel:
    """Return the model with the effects that could stand in place of each: it is not better than with them.

    Those that were tried beside an effect and left-out blocks do not tell from it are put in its place in the final
    model.
    """
    groups: dict[str, tuple[str, ...]] = {}
    near = model.compared
    for m in [m for m in model.path if m.trial is not None and m.trial.name in model.names]:
        best = m.trial
        assert best is not None
        alike = [t for t in m.tried if t is not best and t.better and t.name not in model.names and t.late is None]
        alike = [t for t in alike if not compare(m.problem, best.squares, t.squares, best.numbers - t.numbers).better]
        if not alike or best.late is not None:
            continue
        tick(f"comparing {CATALOGUE[best.name].title} with {', '.join(CATALOGUE[t.name].title for t in alike)}")
        names, where, point = _bare(near, best.name, model.mask(best.name))
        asked = []
        for t in alike:
            row = {k: v for k, v in _only_on(model, t.name, t.joints, t.fitted.point).values.items() if k[0] == t.name}
            start = Point({**point.values, **row})
            asked.append(
                fitting(near.problem, start, [*names, t.name], {**where, t.name: t.joints}, most=MOST_STEPS, every=3)
            )
        fits = fit_all(near.problem, asked)
        same = []
        for t, f, (squares, _) in zip(alike, fits, left_out_all(fits, near.problem), strict=True):
            more = len(model.fitted.free_parameters) - len(f.free_parameters)
            if not compare(near.problem, near.squares, squares, more).better:
                same.append(t.name)
        groups[best.name] = tuple(same)
    return replace(model, groups=groups)
