"""Which effects a machine has: fits of the best of a screen, forwards and backwards, by one score.

The score is the log density of blocks that were left out, less a price for each number that the logs determine. An
effect is named if it beats what an unknown torque says without it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import wilcoxon

from lab.innovations.data import Data
from lab.innovations.laws import ROW
from lab.innovations.likelihood import FOLLOWING, scales
from lab.innovations.model import Free, Model, Setting, setting_of, to_fit
from lab.innovations.screen import Found, Screen, applicable, wanted, with_effect
from mimic.dynamics.catalogue import CATALOGUE, MODEL
from mimic.records import FloatArray

FARTHEST = 3.0
"""Standard deviations of what is plausible beyond which a number of the baseline does not go: beyond, something else is
lacking."""

PRICE = 8.0
"""Nats of held-out log density that a number must gain: more than BIC's half log of 14,400 readings, 4.8."""

LEAST = 15.0
"""Nats by which a model must be better than the one before: odds of three million to one, over hundreds that are
tried."""

SURE = 0.01
"""Probability by Wilcoxon's test over blocks that a better model is none."""

WIDTH = 12
"""Candidates of a screen that are fitted by a step; the better half by another, and so on to `LAST`."""

LAST = 3
"""Candidates that are fitted to the end."""

SETS = 2
"""Sets of joints of one effect among them."""

STAGES = 4
"""Most effects."""

MATERIAL = 0.02
"""Share of the whole gain below which an effect is not worth a name."""

NOISY = 1.03
"""Plain replay over the noise in all joints below which nothing is looked for."""

EXPLAINED = 1.5
"""The same up to which what was found explains a machine."""

MOST = 0.9
"""Or share of the squared error beyond the noise that it must remove."""

TIED = 6.0
"""Nats of held-out log density up to which two explanations are not told apart: odds of 400 to one."""

Report = Callable[[str], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Scored:
    """A model and its score."""

    model: Model
    blocks: FloatArray
    """Held-out log density of each block (B,)."""
    score: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """What a search found."""

    null: Scored
    """The baseline alone."""
    best: Scored
    ties: tuple[tuple[str, float], ...]
    """Other explanations that the logs do not tell from it, and by how much they are worse [nats]."""
    before: FloatArray
    """Plain replay of the baseline, each fold fitted without it: root mean square of each joint (J,)."""
    after: FloatArray
    """Of what was found (J,)."""
    noise: FloatArray
    """What is left at readings that follow each other (J,)."""
    explained: bool
    """Whether what was found explains the machine; else its names are of what helps, and the rest is unknown torque."""
    seconds: float
    """Of the processor."""
    passes: int


def baseline(setting: Setting, names: Sequence[str], threads: int = 1) -> Model:
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
    return [-1] if CATALOGUE[name].scope == "machine" else list(range(data.joints))


def _within(setting: Setting, key: tuple[str, str], tolerance: float) -> list[Free]:
    """Return a number of all joints that may differ from a drawing by its tolerance."""
    if (setting.data.record.volts > 0.0).any():
        return []
    length = np.linalg.norm(setting.data.tree.tip, axis=1)
    own = setting.blank[ROW[key]]
    of = length if CATALOGUE[key[0]].parameter(key[1]).unit == "m" else own
    return [
        Free(key, j, tolerance * float(of[j]), float(own[j]), FARTHEST * tolerance * float(of[j]))
        for j in range(len(own))
        if of[j] > 0.0
    ]


def scored(model: Model) -> Scored:
    """Return a fitted model with its score."""
    model = _pruned(model).differentiated()
    blocks = model.held_out()
    x = model.values()
    return Scored(
        model=model, blocks=blocks, score=float(blocks.sum()) - model.implausible(x) - PRICE * model.numbers()
    )


def trimmed(one: Scored) -> Scored:
    """Return a model without numbers of its effects that do not pay, but for the one by which an effect is itself: that
    named first.
    """
    model = one.model.differentiated()
    x = model.values()
    spread = np.diag(np.linalg.pinv(model.normal()[0] + model.plausibility(x)[0]))
    losses = {k: float(0.5 * by**2 / spread[k]) for k, by in _beside(model, x).items()}
    idle = min(losses, key=lambda k: losses[k], default=-1)
    if idle < 0 or losses[idle] > PRICE:
        return one
    table, free = model.table.copy(), list(model.free)
    gone = free.pop(idle)
    where = ROW[gone.key], slice(None) if gone.joint < 0 else gone.joint
    table[where] = model.setting.blank[where]
    columns = None if model.columns is None else np.delete(model.columns, idle, axis=0)
    less = replace(model, table=table, free=tuple(free), columns=columns).evaluated()
    other = scored(less.fitted(3))
    return trimmed(other) if other.score > one.score else one


def _beside(model: Model, x: FloatArray) -> dict[int, float]:
    """Return how far numbers are from none that an effect can do without, by their places."""
    far = {}
    for k, f in enumerate(model.free):
        p = CATALOGUE[f.key[0]].parameter(f.key[1])
        first = wanted(f.key[0])[0].name
        if f.key[0] in dict(model.effects) and p.name != first and not p.shape and p.neutral != MODEL:
            far[k] = float(x[k]) - to_fit(p, float(model.setting.blank[ROW[f.key], max(f.joint, 0)]))
    return far


def _pruned(model: Model) -> Model:
    """Return a model without the numbers that ended at a bound that means none."""
    kept = []
    for f in model.free:
        p = CATALOGUE[f.key[0]].parameter(f.key[1])
        value = model.table[ROW[f.key], max(f.joint, 0)]
        if not (p.inverse and value >= p.high):
            kept.append(f)
    return model if len(kept) == len(model.free) else replace(model, free=tuple(kept), columns=None)


def spread(model: Model, e: FloatArray | None = None) -> FloatArray:
    """Return the root mean square in each joint (J,) of innovations (T, J), by default the model's."""
    e = np.where(model.data.counts, np.nan_to_num(model.e if e is None else e), 0.0)
    return np.sqrt((e**2).sum(0) / np.maximum(model.data.counts.sum(0), 1))


def noise_of(model: Model) -> FloatArray:
    """Return what a pass that follows every reading leaves in each joint (J,)."""
    scale = scales(model.setting.passes.run([model.table], model.gains, follow=True)[0], model.data)
    usual = np.sqrt(np.average(scale**2, axis=0, weights=np.bincount(model.data.record.log)))
    return np.minimum(spread(model), usual)


def search(
    data: Data,
    names: Sequence[str],
    effects: Sequence[str] = (),
    threads: int = 1,
    report: Report | None = None,
) -> Outcome:
    """Find the effects that a machine has beside its baseline.

    Args:
        data: Logs.
        names: Effects of the baseline.
        effects: Those to look for; all that the machine may have by default.
        threads: Passes at the same time.
        report: Told what is being done.
    """
    began, say = time.process_time(), report or (lambda text: None)
    say("fitting the baseline")
    null = _baseline(data, names, threads)
    effects = tuple(effects) or applicable(null.model.setting, names)
    best, others = _forwards(null, null, effects, say)
    best, dropped = backwards(best, null, say)
    for part in best.model.effects if len(best.model.effects) > 1 else ():
        reduced = scored(without(best.model, null.model, *part).settled())
        other, beside = _forwards(reduced, null, effects, say)
        other, left = backwards(other, null, say)
        if other.score > best.score + TIED * repeated(best):
            best, others, dropped = other, beside, left
            break
    apart = {describe(o.model): float((best.blocks - o.blocks).sum()) for o in [*others, *dropped]}
    ties = [(name, by) for name, by in apart.items() if by < TIED * repeated(best)]
    before, after = (spread(one.model, one.model.left_out()) for one in (null, best))
    noise = noise_of(best.model)
    left = float((np.maximum(after**2 - noise**2, 0.0) / noise**2).sum())
    first = float((np.maximum(before**2 - noise**2, 0.0) / noise**2).sum())
    return Outcome(
        null=null,
        best=best,
        ties=tuple(ties),
        before=before,
        after=after,
        noise=noise,
        explained=bool((after / noise).max() < EXPLAINED or left < (1.0 - MOST) * first),
        seconds=time.process_time() - began,
        passes=null.model.setting.passes.count,
    )


def _forwards(best: Scored, null: Scored, effects: Sequence[str], say: Report) -> tuple[Scored, list[Scored]]:
    """Return a model with effects added one after another while they pay, and what else the last could have been."""
    others: list[Scored] = []
    while len(best.model.effects) < STAGES:
        plain = spread(best.model) / noise_of(best.model)
        say(_line(best, null, plain))
        if plain.max() < NOISY:
            break
        found = [one for one in stage_of(best, effects, say) if better(one, best)]
        if not found:
            break
        best, others = found[0], found[1:]
        sent = _sent(best.model)
        if sent is not best.model:
            best = scored(sent.settled())
    return best, others


def _baseline(data: Data, names: Sequence[str], threads: int) -> Scored:
    """Return the baseline at the sending times that explain the logs best."""
    model = baseline(setting_of(data, threads), names).fitted(4)
    return scored(_sent(model).settled(12))


def _sent(model: Model) -> Model:
    """Return a model at the sending times that explain the logs best, of all that these allow."""
    best = model
    for times in model.data.sending if len(model.data.sending) > 1 else ():
        setting = replace(model.setting, passes=model.setting.passes.of(model.data.sent_at(times)))
        other = replace(model, setting=setting, columns=None).evaluated().fitted(2)
        if other.cost < best.cost - LEAST:
            best = other
    return best


def stage_of(now: Scored, effects: Sequence[str], say: Report) -> list[Scored]:
    """Return models with one effect more, best first."""
    model, price = now.model, PRICE * repeated(now)
    unknown = model.setting.passes.whole([model.table], model.gains, follow=True)[0][1]
    chosen: list[Found] = []
    for one in sorted(Screen(model, unknown).run(effects), key=lambda f: PRICE * f.numbers - f.gain):
        if sum(other.name == one.name for other in chosen) < SETS:
            chosen.append(one)
    fits = [with_effect(model, one) for one in chosen[:WIDTH]]
    steps = 1
    while fits:
        fits = sorted((one.fitted(steps) for one in fits), key=lambda m: m.cost + price * len(m.free))
        say("    " + ", ".join(f"{describe(m)} {model.cost - m.cost:.0f}" for m in fits))
        if len(fits) <= LAST:
            break
        fits, steps = fits[: max(len(fits) // 2, LAST)], 2 * steps
    made = sorted((scored(one.settled()) for one in fits), key=lambda s: -s.score)
    return sorted([trimmed(one) for one in made[:2]] + made[2:], key=lambda s: -s.score)


def repeated(one: Scored) -> float:
    """Return how often errors repeat themselves within a block: 1 where they are independent."""
    return max(one.model.numbers() / len(one.model.free), 1.0)


def better(new: Scored, old: Scored) -> bool:
    """Return whether a model is better for sure."""
    if new.score - old.score < LEAST * repeated(new):
        return False
    return float(wilcoxon(new.blocks - old.blocks, alternative="greater").pvalue) < SURE


def backwards(best: Scored, null: Scored, say: Report) -> tuple[Scored, list[Scored]]:
    """Return the model without the effects, or joints of them, that do not pay, and the last models tried."""
    tried: list[Scored] = []
    while best.model.effects:
        tried = [scored(without(best.model, null.model, *one).settled()) for one in _parts(best.model)]
        if not tried:
            break
        first = max(tried, key=lambda s: s.score)
        paid = best.score - first.score
        say(f"  without a part: {describe(first.model)} {-paid:+.1f}")
        if paid >= max(LEAST * repeated(best), MATERIAL * (best.score - null.score)):
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
    joints = model.data.machine.joints
    said = [name + ("" if own == (-1,) else f" ({', '.join(joints[j] for j in own)})") for name, own in model.effects]
    return " + ".join(said) or "nothing"


def _line(best: Scored, null: Scored, plain: FloatArray) -> str:
    return (
        f"  {describe(best.model)}: {best.score - null.score:+.1f}, replay over noise {plain.round(2).tolist()}, "
        f"repeated {repeated(best):.1f}, unknown {best.model.unknown.round(4).tolist()}, {time.process_time():.0f} s"
    )
