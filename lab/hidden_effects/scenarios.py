"""Which hidden machines the suite calibrates, most informative first, and how each is built from its name alone."""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import zip_longest
from pathlib import Path

import numpy as np

from lab.hidden_effects.families import ALIEN_CAPS, FAMILIES, alien, hidden_effect
from lab.hidden_effects.generator import ALIENS, CLOCKS, OTHER_LAWS, Machine
from mimic.dynamics.catalogue import effect
from mimic.dynamics.effect_set import EffectSet
from mimic.dynamics.excitation import Excitation, Kind, hung_ranges, probe_targets
from mimic.records import JOINTS, LEGS
from mimic.robot.description import load_description

STRENGTHS = ("strong", "medium", "weak")
FAINT = {"faint": 0.5, "trace": 0.25}
"""Shares of weak: what they leave is as large as the noise and half as large, about where effects stop being found."""
KINDS: tuple[Kind, ...] = ("probe", "random")
WHERE = ("all", "knees", "leg", "joint")

PAIRS = (
    ("torque_speed", "stribeck"),
    ("stribeck", "backlash"),
    ("load_friction", "cogging"),
    ("velocity_lag", "spring"),
    ("coupling", "spring"),
    ("cogging", "quadratic_drag"),
    ("armature", "encoder_step"),
    ("torque_speed", "joint_delay"),
    ("payload", "coupling"),
    ("gains", "lost_commands"),
)
TRIPLES = (
    ("torque_speed", "stribeck", "backlash"),
    ("cogging", "velocity_lag", "spring"),
    ("load_friction", "cogging", "joint_delay"),
)
"""Medium; weak where an effect cannot be more (backlash)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Scenario:
    """One hidden machine and one motion."""

    group: str
    """single, pair, triple, clean or alien."""
    names: tuple[str, ...] = ()
    strength: str = "none"
    kind: Kind = "probe"
    seed: int = 0
    seconds: float = 60.0
    clock: str = "grid"
    """When the rows are written, of `generator.CLOCKS`: the same machine and motion with each."""
    joints: str = "all"
    """all, or leg: all that is hidden is in one leg, and the log has only its joints, for little time."""

    @property
    def machine_key(self) -> str:
        """Name of its machine and motion."""
        what = "+".join(self.names) or "nothing"
        return f"{self.group}/{what}/{self.strength}/{self.kind}/{self.seed}/{self.seconds:g}s"

    @property
    def key(self) -> str:
        """Its name: the same name is the same log."""
        if self.joints != "all":
            return f"{self.machine_key}/{self.clock}/{self.joints}"
        return self.machine_key if self.clock == "grid" else f"{self.machine_key}/{self.clock}"

    @staticmethod
    def of(key: str) -> Scenario:
        """Return the scenario of a name."""
        group, what, strength, kind, seed, seconds, *rest = key.split("/")
        names = () if what == "nothing" else tuple(what.split("+"))
        return Scenario(
            group=group, names=names, strength=strength, kind=kind, seed=int(seed), seconds=float(seconds[:-1]),
            clock=rest[0] if rest else "grid", joints=rest[1] if len(rest) > 1 else "all",
        )  # fmt: skip


def for_choosing(key: str) -> bool:
    """Return whether thresholds may be chosen by a scenario; the other half is run and reported, never looked at for
    that.

    Drawn once and for all from the name of its machine and motion, so that all clocks of one are in the same half.
    """
    return bool(zlib.crc32(f"half/{Scenario.of(key).machine_key}".encode()) & 1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Built:
    """A scenario made real."""

    machine: Machine
    motion: Excitation
    seed: int
    where: dict[str, tuple[str, ...]]
    """Affected joints of each name; all for the whole machine."""
    differs: str = ""
    """How the machine differs from the catalogue beside what is hidden; empty where it does not."""
    small: tuple[str, ...] = ()
    """Small effects beside those that are hidden: they may be named and need not be."""

    @property
    def leg(self) -> tuple[str, ...]:
        """Joints of the leg with something hidden; of a leg drawn by the seed where all or none have it."""
        joint = next((joints[0] for joints in self.where.values() if len(joints) < len(JOINTS)), JOINTS[self.seed % 12])
        return tuple(j for j in JOINTS if j.startswith(joint.split("_")[0]))


def differs(key: str) -> bool:
    """Return whether the laws of a scenario's machine differ from the catalogue's: a third of those with effects."""
    s = Scenario.of(key)
    return s.group in ("single", "pair", "triple") and _draw(f"differs/{s.machine_key}") % 3 == 0


def _draw(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big")


SMALL = ("stribeck", "spring", "quadratic_drag", "cogging", "load_friction")
"""What a machine may have a little of, beside effects that have no other law."""


@cache
def table() -> dict[str, dict]:
    """Return sizes.json."""
    return json.loads(Path(__file__).with_name("sizes.json").read_text(encoding="utf-8"))


def reachable(name: str, strength: str) -> tuple[str, ...]:
    """Return the parts (abad, hip, knee) where the effect can be this strong."""
    return tuple(sizes(name, strength))


def sizes(name: str, strength: str) -> dict[str, float]:
    """Return the size of an effect for each part of a leg where it can be this strong."""
    if strength in FAINT:
        return {part: FAINT[strength] * size for part, size in table()[name]["weak"].items()}
    return table()[name][strength]


def build(scenario: Scenario) -> Built:
    """Return machine and motion; everything is drawn from the name of the scenario.

    Raises:
        ValueError: If an effect cannot be this strong on any joint.
    """
    seed = zlib.crc32(scenario.machine_key.encode())
    rng = np.random.default_rng(seed)
    machine = Machine.drawn(rng)
    effects, aliens, where, leg = [], [], {}, ""
    for place, name in enumerate(scenario.names):
        is_alien = name in ALIENS
        wide = name == "base_swing" or (not is_alien and effect(name).scope == "machine")
        strength = scenario.strength
        if not reachable(name, strength) and len(scenario.names) > 1:
            strength = "weak"
        parts = reachable(name, strength)
        if not parts:
            raise ValueError(f"{name} cannot be {scenario.strength}: {table()[name]['why_no_more']}")
        cap = ALIEN_CAPS[name][0] if is_alien else FAMILIES[name].cap
        joints = JOINTS if wide else _some_joints(scenario, place, parts, rng)
        if scenario.joints == "leg" and not wide:
            leg = leg or joints[0].split("_")[0]
            joints = tuple(dict.fromkeys(f"{leg}_{j.split('_')[1]}" for j in joints))
        usual = sizes(name, strength)
        own = {
            j: min(cap, usual[j.split("_")[1] if not wide else parts[0]] * factor)
            for j, factor in zip(joints, rng.uniform(0.85, 1.2, len(joints)), strict=True)
        }
        where[name] = joints
        if is_alien:
            aliens += alien(name, own)
        else:
            effects.append(hidden_effect(name, own, machine, rng))
    other, small, text = (), (), ""
    if differs(scenario.key):
        other = tuple(n for n in scenario.names if n in OTHER_LAWS)
        if other:
            text = "; ".join(f"{n}: {OTHER_LAWS[n][0]}" for n in other)
        else:
            small = (SMALL[_draw(scenario.machine_key) % len(SMALL)],)
            joint = where[scenario.names[0]][0]
            one = {joint: sizes(small[0], "faint")[joint.split("_")[1]]}
            effects.append(hidden_effect(small[0], one, machine, rng))
            text = f"a little {small[0]} beside it"
    machine = replace(machine, hidden=EffectSet(tuple(effects)), aliens=tuple(aliens), other_laws=other)
    ranges = hung_ranges(load_description("cyberdog2"))
    motion = probe_targets(*ranges, seconds=scenario.seconds, seed=seed % 100_000, kind=scenario.kind)
    return Built(machine=machine, motion=motion, seed=seed, where=where, differs=text, small=small)


def _some_joints(scenario: Scenario, place: int, parts: tuple[str, ...], rng: np.random.Generator) -> tuple[str, ...]:
    """All joints, the knees, one leg or one joint, in turn over names and seeds; only where the effect can be so
    strong.
    """
    turn = zlib.crc32(f"{scenario.names[place]}/{scenario.strength}".encode()) + scenario.seed + place
    where = WHERE[(turn + (scenario.kind == "random")) % len(WHERE)]
    if scenario.names[place] == "joint_delay" and where == "all":
        where = "leg"  # on all joints it is the machine's delay
    can = [j for j in JOINTS if j.split("_")[1] in parts]
    leg = LEGS[int(rng.integers(4))]
    chosen = {
        "all": can,
        "knees": [j for j in can if j.endswith("knee")],
        "leg": [j for j in can if j.startswith(leg)],
        "joint": [can[int(rng.integers(len(can)))]],
    }[where]
    return tuple(chosen or can)


def ordered(rounds: int = 6, seconds: float = 60.0) -> Iterator[Scenario]:
    """Yield scenarios, one of everything in each round, each round with another seed and the other motion."""
    clean = 0
    for number in range(rounds):
        kind = KINDS[number % 2]

        def one(group: str, names: tuple[str, ...] = (), strength: str = "none", **more: int) -> Scenario:
            options = {"kind": kind, "seed": number, **more}  # noqa: B023
            return Scenario(group=group, names=names, strength=strength, seconds=seconds, **options)

        for strength in ("strong", "medium"):
            yield from (one("single", (n,), strength) for n in FAMILIES if reachable(n, strength))
        yield from (one("pair", names, "medium") for names in PAIRS)
        yield from (one("triple", names, "medium") for names in TRIPLES)
        yield from (one("single", (n,), "weak") for n in FAMILIES if reachable(n, "weak"))
        for strength in ("strong", "medium"):
            yield from (one("alien", (n,), strength) for n in ALIENS if reachable(n, strength))
        for _ in range(25):
            yield one("clean", seed=clean, kind=KINDS[clean % 2])
            clean += 1
        for strength in FAINT:
            yield from (one("single", (n,), strength) for n in FAMILIES if reachable(n, strength))


MIX = ("clean", "single", "clean", "pair", "clean", "single", "alien", "single")
"""Groups in turn, of a run that may be cut anywhere."""


def balanced(rounds: int = 6, seconds: float = 24.0) -> Iterator[Scenario]:
    """Yield clean logs, strong and medium effects, pairs and aliens on all clocks, so mixed that any beginning has the
    same shares of groups, clocks and halves.

    Each clock has an order of its own, drawn by names, and clean logs of its own.
    """
    queues = {clock: {group: iter(()) for group in MIX} for clock in CLOCKS}
    everything = [s for s in ordered(rounds, seconds) if s.strength in ("strong", "medium", "none")]
    for number, clock in enumerate(CLOCKS):
        for group in set(MIX):
            mine = [replace(s, clock=clock) for s in everything if s.group == group]
            if group == "clean":
                mine = [s for s in mine if s.seed // 2 % len(CLOCKS) == number]
            else:
                mine.sort(key=lambda s: (s.seed // len(KINDS), zlib.crc32(s.key.encode())))
            first = number % 2 == 0
            halves = ([s for s in mine if for_choosing(s.key) is half] for half in (first, not first))
            queues[clock][group] = (s for both in zip_longest(*halves) for s in both if s is not None)
    while queues:
        for group in MIX:
            for clock in list(queues):
                if (s := next(queues[clock][group], None)) is not None:
                    yield s
                elif group == "single":
                    del queues[clock]
