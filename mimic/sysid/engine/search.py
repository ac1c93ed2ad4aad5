"""Which effects a machine has: fits of the best of a screen, forwards and backwards, by one score.

The score is the log density of predictions to the end of blocks that were left out, less a price for each number that
the logs determine. It is counted in independent readings: errors of a model that lacks something go on through a block,
so that a thousand of them may say no more than ten. Whole logs that are left out must confirm what is named.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from mimic.dynamics.catalogue import CATALOGUE, MODEL
from mimic.records import FloatArray, IntArray
from mimic.sysid.engine.arrivals import arrived, sent_at
from mimic.sysid.engine.data import Data
from mimic.sysid.engine.effects import SURE
from mimic.sysid.engine.laws import ROW
from mimic.sysid.engine.likelihood import FOLLOWING, misfit, scales
from mimic.sysid.engine.model import Free, Model, Setting, to_fit
from mimic.sysid.engine.screen import Found, Screen, wanted, with_effect
from mimic.sysid.result import EXPLAINED, Candidate

FARTHEST = 3.0
"""Standard deviations of what is plausible beyond which a number of the baseline does not go: beyond, something else is
lacking."""

PRICE = 5.0
"""Nats of independent readings left out that a number must gain: BIC's half log of 14,400 readings, 4.8."""

FIRST = 16
WIDTH = 6
LAST = 3
"""Candidates of a screen that are fitted with the derivatives of the model before, with new ones, and to the end."""

SETS = 2
"""Sets of joints of one effect among them."""

AGAIN = 2
"""Effects that are taken out again, each alone, to look for others in their place: the first were found when most else
was lacking.
"""

STAGES = 4
"""Most effects."""

MATERIAL = 0.1
"""Share of the squared error of a joint, a geometric mean over logs, that an effect must remove to be worth a name."""

NOISY = 1.03
"""Plain replay over the noise in all joints below which nothing is looked for."""

MOST = 0.9
"""Or share of the squared error beyond the noise that it must remove."""

TIED = 6.0
"""Nats of independent readings left out up to which two explanations are not told apart, or a 95 % interval of their
difference if that is wider: odds of 400 to one."""

RIVAL = 0.5
"""Share of the gain of the best first effect from which another is followed to its end where a path does not explain a
machine."""

SURELY = 15.0
"""Nats by which other sending times must explain logs better than those before."""

Parts = tuple[tuple[str, tuple[int, ...]], ...]
"""Effects and their joints."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Hunt:
    """What is looked for, and what was tried."""

    effects: Sequence[str]
    most: int = STAGES
    """Most effects that are named."""
    arrivals: Sequence[str] = ()
    """Those on single targets, of `arrivals.ARRIVALS`."""
    say: Callable[[str], None] = print
    tried: dict[Parts, dict[str, Candidate]] = field(default_factory=dict)
    """Beside which effects each was tried in its best joints, fitted where one was."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Scored:
    """A fitted model, judged by what it predicts of blocks that were left out."""

    model: Model
    left_out: FloatArray
    """Errors, each fold under a fit without it (T, J)."""
    density: FloatArray
    """Log density of each block, left out (B,) [nats]."""
    implausible: float
    """Minus the log of how plausible the numbers are [nats]."""
    numbers: float
    """How many numbers the logs determine."""
    repeats: float
    """How often errors repeat themselves within a block: 1 where they are independent."""

    def over(self, other: Scored) -> float:
        """Return by how much this model is better than another [nats of independent readings], numbers paid."""
        return self.apart(other) - PRICE * (self.numbers - other.numbers)

    def apart(self, other: Scored) -> float:
        """Return by how much this model predicts better than another [nats of independent readings]."""
        return float(self._said(other).sum()) + other.implausible - self.implausible

    def unsure(self, other: Scored) -> float:
        """Return how far off that may be, since blocks differ [nats of independent readings]. Source: Vuong 1989."""
        said = self._said(other)
        return SURE * float(np.std(said) * np.sqrt(len(said)))

    def _said(self, other: Scored) -> FloatArray:
        return (self.density - other.density) / np.sqrt(self.repeats * other.repeats)

    @property
    def likely(self) -> float:
        """Log density of all blocks and how plausible the numbers are [nats]."""
        return float(self.density.sum()) - self.implausible

    @cached_property
    def covariance(self) -> FloatArray:
        """How uncertain the numbers are together (P, P)."""
        return self.model.covariance()

    def sure(self, other: Scored) -> float:
        """Return how sure the numbers of what this model has more are not those of none [nats], numbers paid."""
        old = {(f.key, f.joint) for f in other.model.free}
        new = [k for k, f in enumerate(self.model.free) if (f.key, f.joint) not in old]
        return self._told(new) - PRICE * (self.numbers - other.numbers)

    def needs(self, name: str, joints: Sequence[int]) -> float:
        """Return the same of an effect in some joints."""
        own = [k for k, f in enumerate(self.model.free) if f.key[0] == name and f.joint in joints]
        return self._told(own) - PRICE * len(own)

    def _told(self, of: Sequence[int]) -> float:
        """Return how likely some numbers are at their values beside those of none [nats]. Source: Wald 1943."""
        far = _from_none(self.model)
        new = [k for k in of if k in far]
        by = np.array([far[k] for k in new])
        return 0.5 * float(by @ np.linalg.solve(self.covariance[np.ix_(new, new)], by)) if new else np.inf


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """An effect of the best model."""

    name: str
    joints: tuple[int, ...]
    evidence: float
    """By how much the model is better with it, numbers paid [nats of independent readings]."""
    without: Scored
    """The model without it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """What a search found."""

    null: Scored
    """The baseline alone."""
    best: Scored
    parts: tuple[Part, ...]
    """Its effects."""
    ties: tuple[tuple[Model, float], ...]
    """Other explanations that the logs do not tell from it, and by how much they are worse [nats]."""
    noise: FloatArray
    """What is left at readings that follow each other (J,)."""
    explained: bool
    """Whether what was found explains the machine; else its names are of what helps, and the rest is unknown torque."""


def baseline(setting: Setting, names: Sequence[str]) -> Model:
    """Return the baseline: its effects free, and what a drawing leaves open within its tolerance."""
    free = []
    for name in names:
        for p in wanted(name):
            for j in _places(setting.data, name):
                width, centre = setting.width((name, p.name), j)
                free.append(Free((name, p.name), j, width, centre, FARTHEST * width))
    for e in CATALOGUE.values():
        for p in e.parameters:
            if p.tolerance and e.name not in names:
                free += _within(setting, (e.name, p.name), p.tolerance)
    return Model(
        setting=setting,
        free=tuple(free),
        table=setting.blank.copy(),
        unknown=FOLLOWING * setting.gains.torque,
    )


def _places(data: Data, name: str) -> list[int]:
    return [-1] if CATALOGUE[name].scope == "machine" else np.flatnonzero(data.moves).tolist()


def _within(setting: Setting, key: tuple[str, str], tolerance: float) -> list[Free]:
    """Return a number of all joints that may differ from a drawing by its tolerance."""
    if (setting.data.record.volts > 0.0).any():
        return []
    length = np.linalg.norm(setting.data.tree.tip, axis=1)
    own = setting.blank[ROW[key]]
    of = length if CATALOGUE[key[0]].parameter(key[1]).unit == "m" else own
    return [
        Free(key, j, tolerance * float(of[j]), float(own[j]), FARTHEST * tolerance * float(of[j]))
        for j in np.flatnonzero(setting.data.moves).tolist()
        if of[j] > 0.0
    ]


def scored(model: Model) -> Scored:
    """Return a fitted model with its score."""
    model = replace(_pruned(model), columns=None).differentiated()  # those of a fit tell its way, not errors of numbers
    e = model.left_out()
    said = misfit(e, scales(e, model.data), model.data).sum(axis=1)
    return Scored(
        model=model,
        left_out=e,
        density=np.bincount(model.data.block, -said).astype(float),
        implausible=model.implausible(model.values()),
        numbers=model.numbers(),
        repeats=model.repeats(),
    )


def ranked(models: Sequence[Scored]) -> list[Scored]:
    """Return models, best first, numbers paid: of all, readings are counted as the likeliest says that errors repeat
    themselves.
    """
    _, repeats = max(((one.likely, one.repeats) for one in models), default=(0.0, 1.0))
    return sorted(models, key=lambda one: PRICE * one.numbers - one.likely / repeats)


def trimmed(one: Scored) -> Scored:
    """Return a model without numbers of its effects that do not pay, but for the one by which an effect is itself: that
    named first.
    """
    model = one.model.differentiated()
    losses = {k: 0.5 * by**2 / float(one.covariance[k, k]) for k, by in _beside(model).items()}
    idle = min(losses, key=lambda k: losses[k], default=-1)
    if idle < 0 or losses[idle] > PRICE:
        return one
    table = model.table.copy()
    free = list(model.free)
    gone = free.pop(idle)
    where = ROW[gone.key], slice(None) if gone.joint < 0 else gone.joint
    table[where] = model.setting.blank[where]
    columns = None if model.columns is None else (*model.columns[:idle], *model.columns[idle + 1 :])
    less = replace(model, table=table, free=tuple(free), columns=columns).evaluated()
    other = scored(less.fitted(3))
    return trimmed(other) if other.over(one) > 0.0 else one


def _beside(model: Model) -> dict[int, float]:
    """Return how far numbers are from none that an effect can do without, by their places."""
    far = {}
    for k, by in _from_none(model).items():
        f = model.free[k]
        if f.parameter is not wanted(f.key[0])[0] and f.parameter.neutral != MODEL:
            far[k] = by
    return far


def _from_none(model: Model) -> dict[int, float]:
    """Return how far the numbers of effects are from none, in what is fitted, by their places."""
    far = {}
    names = dict(model.effects)
    for k, (f, x) in enumerate(zip(model.free, model.values(), strict=True)):
        if f.key[0] in names and not f.parameter.shape:
            far[k] = float(x) - to_fit(f.parameter, float(model.setting.blank[f.cell]))
    return far


def _pruned(model: Model) -> Model:
    """Return a model without the numbers that ended at a bound that means none."""
    kept = [f for f in model.free if not (f.parameter.inverse and model.table[f.cell] >= f.parameter.high)]
    return model if len(kept) == len(model.free) else replace(model, free=tuple(kept), columns=None)


def spread(model: Model, e: FloatArray | None = None) -> FloatArray:
    """Return the root mean square in each joint (J,) of innovations (T, J), by default the model's."""
    return by_log(model, e, np.zeros(len(model.data.record.t), dtype=int))[0]


def by_log(model: Model, e: FloatArray | None = None, log: IntArray | None = None) -> FloatArray:
    """Return the root mean square in each log and joint (L, J) of errors (T, J), by default the model's."""
    e = np.nan_to_num(model.e if e is None else e)
    log = model.data.record.log if log is None else log
    rows = [model.data.counts & (log == k)[:, None] for k in range(log[-1] + 1)]
    return np.sqrt([(e**2).sum(0, where=own) / np.maximum(own.sum(0), 1) for own in rows]) + 1e-12


def noise_of(model: Model) -> FloatArray:
    """Return what a pass that follows every reading leaves in each joint (J,)."""
    scale = scales(model.setting.passes.run([model.table], model.gains, follow=True)[0], model.data)
    usual = np.sqrt(np.average(scale**2, axis=0, weights=np.bincount(model.data.record.log)))
    return np.minimum(spread(model), usual)


def search(null: Scored, hunt: Hunt) -> Outcome:
    """Find the effects that a machine has beside its baseline."""
    best, others = _paths(null, hunt)
    best, dropped = backwards(best, null, hunt)
    if not _near(best):
        best, others, dropped = _exchanged(best, null, hunt, (others, dropped))
    seen = best
    best = _confirmed(best, null, hunt)
    if best is not seen:
        others = dropped = []
    best, *others = ranked([scored(one.model.settled(4)) for one in (best, *others)])
    best, *others = ranked([best, *(_from_there(one, best) for one in others)])
    ties = {}
    for one in (*others, *dropped):
        by = best.apart(one)
        if by < max(TIED, best.unsure(one)) and one.model.effects != best.model.effects:
            ties[one.model.effects] = one.model, by
    noise = noise_of(best.model)
    left = [spread(one.model, one.left_out) / noise for one in (null, best)]
    beyond = [np.maximum(ratio**2 - 1.0, 0.0).sum() for ratio in left]
    return Outcome(
        null=null,
        best=best,
        parts=(*(_part(best, null, dropped, *one) for one in best.model.effects), *_lost(best)),
        ties=tuple(ties.values()),
        noise=noise,
        explained=bool(left[1].max() < EXPLAINED or beyond[1] < (1.0 - MOST) * beyond[0]),
    )


def _from_there(one: Scored, best: Scored) -> Scored:
    """Return a rival as it is, or as it is found from the numbers of the best model, where these explain more."""
    there = {(f.key, f.joint): x for f, x in zip(best.model.free, best.model.values(), strict=True)}
    x = np.array([there.get((f.key, f.joint), f.centre) for f in one.model.free])
    begun = replace(one.model, table=one.model.at(x), unknown=best.model.unknown, columns=None).evaluated()
    found = begun.settled()
    return scored(found) if found.cost < one.model.cost else one


def _lost(best: Scored) -> tuple[Part, ...]:
    """Return what is said of single targets."""
    times = best.model.data.times
    said = {"lost_commands": times.lost, "delay_jitter": times.spread}
    if not any(said.values()):
        return ()
    other = scored(sent_at(best.model, next(one for one in best.model.data.sending if one.how == times.how)))
    evidence = PRICE * (other.numbers - best.numbers) + (best.likely - other.likely) / best.repeats
    return tuple(Part(name=name, joints=(-1,), evidence=evidence, without=other) for name, told in said.items() if told)


def _part(best: Scored, null: Scored, dropped: Sequence[Scored], name: str, joints: tuple[int, ...]) -> Part:
    """Return an effect of the best model with what speaks for it; models without a part may be known."""
    rest = tuple(one for one in best.model.effects if one[0] != name)
    known = [null, *(one for one in dropped if one.model.effects == rest)]
    if rest and len(known) == 1:
        known.append(less(best, null, name, joints))
    other = known[-1] if rest else null
    return Part(name=name, joints=joints, evidence=best.over(other), without=other)


def _paths(null: Scored, hunt: Hunt) -> tuple[Scored, list[Scored]]:
    """Return where the best first effect leads, or its rival where that explains more, and what else could be last."""
    plain = spread(null.model) / noise_of(null.model)
    wanted = plain.max() >= NOISY and hunt.most > 0
    firsts = [one for one in stage_of(null, hunt) if better(one, null)] if wanted else []
    if not firsts:
        arrived = _arrived(null, hunt) if wanted else null
        return (null, []) if arrived is null else _forwards(arrived, null, hunt)
    best, others = _forwards(firsts[0], null, hunt)
    others = others or firsts[1:]
    if len(firsts) > 1 and not _near(best) and firsts[1].over(null) >= RIVAL * firsts[0].over(null):
        end, beside = _forwards(firsts[1], null, hunt)
        if end.over(best) > 0.0:
            best = end
            others = beside
    return best, others


def _exchanged(
    best: Scored, null: Scored, hunt: Hunt, beside: tuple[list[Scored], list[Scored]]
) -> tuple[Scored, list[Scored], list[Scored]]:
    """Return a model with another effect in the place of one of its first, if that is better, and what is beside it."""
    for part in best.model.effects[:AGAIN] if len(best.model.effects) > 1 else ():
        rivals = stage_of(less(best, null, *part), hunt)
        if rivals and rivals[0].over(best) > TIED:
            other, others = _forwards(rivals[0], null, hunt)
            other, dropped = backwards(other, null, hunt)
            return other, others, dropped
    return best, *beside


def _confirmed(best: Scored, null: Scored, hunt: Hunt) -> Scored:
    """Return a model without the effects of which whole logs that are left out say nothing."""
    while best.model.effects and best.model.data.apart.any() and not _predicts(best.model, null.model):
        parts = [less(best, null, *one) for one in _parts(best.model)]
        best = ranked(parts)[0] if parts else null
        hunt.say(f"whole logs left out do not confirm more than {describe(best.model)}")
    return best


def _near(one: Scored) -> bool:
    """Return whether a model predicts nearly as well as readings allow."""
    return float((spread(one.model) / noise_of(one.model)).max()) < EXPLAINED


def _forwards(best: Scored, null: Scored, hunt: Hunt) -> tuple[Scored, list[Scored]]:
    """Return a model with effects added one after another while they pay, and what else the last could have been."""
    others: list[Scored] = []
    while True:
        sent = _sent(best.model)
        if sent is not best.model:
            best = scored(sent.settled())
        hunt.say(f"so far: {describe(best.model)}")
        plain = spread(best.model) / noise_of(best.model)
        if plain.max() < NOISY:
            break
        stage = stage_of(best, hunt) if len(best.model.effects) < hunt.most else []
        found = [one for one in stage if better(one, best)]
        if found:
            best, *others = found
            continue
        arrived = _arrived(best, hunt)
        if arrived is best:
            break
        best = arrived
    return best, others


def _arrived(best: Scored, hunt: Hunt) -> Scored:
    """Return a model with targets that arrived otherwise, if it is better and worth a name: of each number, its price
    in readings as independent as the better model says.
    """
    made = arrived(best.model, hunt.arrivals, best.repeats, PRICE)
    first, *_ = ranked([best, *(scored(one.settled()) for one in made)])
    return first if first is best or material(first, best) else best


def _predicts(model: Model, null: Model) -> bool:
    """Return whether a model predicts whole logs better than the baseline under fits without them, in a geometric mean
    over logs and joints.
    """
    new, old = (by_log(one, one.left_out(one.data.apart)) for one in (model, null))
    return float(np.log(new / old).mean()) < 0.0


def fitted_baseline(start: Model, given: Sequence[str] = ()) -> Scored:
    """Return a baseline fitted at the sending times that explain the logs best, with given effects that have no
    derivative where they are none.
    """
    near = replace(start.setting, passes=start.setting.passes.of(start.data.near()))
    first = replace(start, setting=near).fitted(4)
    model = _sent(replace(start, table=first.table).fitted(4)).settled(12)
    for name in given:
        every = Screen(model.differentiated()).run((name,))
        if every:
            widest = max(every, key=lambda one: (len(one.joints), one.gain))
            model = replace(with_effect(model.differentiated(), widest).settled(12), effects=())
    return scored(model)


def _sent(model: Model) -> Model:
    """Return a model at the sending times that explain the logs best, of all that these allow."""
    best = model
    for times in model.data.sending if len(model.data.sending) > 1 else ():
        other = sent_at(model, times).fitted(2)
        if other.cost < best.cost - SURELY:
            best = other
    return best


def stage_of(now: Scored, hunt: Hunt) -> list[Scored]:
    """Return models with one effect more, best first."""
    model = now.model
    chosen: list[Found] = []
    for one in sorted(Screen(model).run(hunt.effects), key=lambda f: now.repeats * PRICE * f.numbers - f.gain):
        if sum(other.name == one.name for other in chosen) < SETS and (one.gain > 0.0 or one.rough):
            chosen.append(one)
    tried = hunt.tried.setdefault(model.effects, {})
    for one in chosen[::-1]:
        tried[one.name] = _candidate(model, one.name, one.joints, one.gain / now.repeats - PRICE * one.numbers, False)
    chosen = [f for k, f in enumerate(chosen) if k < FIRST or f.gain <= 0.0]
    enough = max(1.0, 0.1 * now.repeats)
    fits = [with_effect(model, one).fitted(0, enough) for one in chosen]
    for steps, left in ((0, WIDTH), (1, LAST), (2, LAST)):
        refined = [one.fitted(steps, enough) for one in fits]
        fits = sorted(refined, key=lambda m: m.cost + now.repeats * PRICE * len(m.free))[:left]
    made = ranked([scored(one.settled(8, enough)) for one in fits])
    made = ranked([trimmed(one) for one in made[:2]] + made[2:])
    for other in made[::-1]:
        name, joints = other.model.effects[-1]
        tried[name] = _candidate(model, name, joints, other.over(now), True)
    return made


def _candidate(model: Model, name: str, joints: tuple[int, ...], gain: float, fitted: bool) -> Candidate:
    ((_, where),) = named(((name, joints),), model)
    return Candidate(name=name, joints=where, gain=gain, fitted=fitted)


def better(new: Scored, old: Scored) -> bool:
    """Return whether a model is surely better, its numbers are surely not those of none, and it removes a share of the
    error of some joint that is worth a name.
    """
    return new.over(old) >= TIED and material(new, old) and new.sure(old) >= TIED


def material(new: Scored, old: Scored) -> bool:
    """Return whether a model removes a share of the error of some joint that is worth a name."""
    share = np.exp(2.0 * np.mean(np.log(by_log(new.model) / by_log(old.model)), axis=0))
    return bool(share.min() < 1.0 - MATERIAL)


def backwards(best: Scored, null: Scored, hunt: Hunt) -> tuple[Scored, list[Scored]]:
    """Return the model without the effects, or joints of them, that do not pay, and the last models tried."""
    tried: list[Scored] = []
    while best.model.effects:
        parts = sorted(_parts(best.model), key=lambda part: best.needs(*part))[:LAST]
        tried = [less(best, null, *one) for one in parts]
        if not tried:
            break
        first = ranked(tried)[0]
        hunt.say(f"checking {describe(best.model)}")
        if better(best, first):
            break
        best = first
    return best, tried


def _parts(model: Model) -> list[tuple[str, tuple[int, ...]]]:
    """Return the effects of a model, and single joints of those that have several, by which it can be smaller."""
    parts = []
    for name, joints in model.effects:
        if len(model.effects) > 1:
            parts.append((name, joints))
        if len(joints) > 1:
            parts += [(name, (j,)) for j in joints]
    return parts


def less(one: Scored, null: Scored, name: str, joints: tuple[int, ...]) -> Scored:
    """Return a model without an effect in some joints, fitted."""
    return scored(without(one.model, null.model, name, joints).settled())


def without(model: Model, null: Model, name: str, joints: tuple[int, ...]) -> Model:
    """Return a model without an effect in some joints, its numbers as in the baseline."""
    table = model.table.copy()
    for p in CATALOGUE[name].parameters:
        for j in joints:
            where = slice(None) if j < 0 else j
            table[ROW[name, p.name], where] = null.table[ROW[name, p.name], where]
    gone = {((name, p.name), j) for p in CATALOGUE[name].parameters for j in joints}
    kept = [f for f in model.free if (f.key, f.joint) not in gone]
    kept += [f for f in null.free if (f.key, f.joint) in gone]
    effects = []
    for n, own in model.effects:
        left = tuple(j for j in own if n != name or j not in joints)
        if left:
            effects.append((n, left))
    return replace(model, table=table, free=tuple(kept), effects=tuple(effects), columns=None, e=np.zeros((0, 0)))


def describe(model: Model) -> str:
    """Return the effects of a model in words."""
    said = [f"{name} ({', '.join(own)})" if own else name for name, own in named(model.effects, model)]
    return " + ".join(said) or "nothing"


def named(parts: Parts, model: Model) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Return effects with the names of their joints, none for the whole machine."""
    joints = model.data.machine.joints
    made = []
    for name, own in parts:
        made.append((name, tuple(joints[j] for j in own if j >= 0)))
    return tuple(made)
