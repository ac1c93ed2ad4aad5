"""Find how large each effect must be to leave 2, 5 and 15 times the noise floor, and write sizes.json.

A size is judged by what the baseline model could not absorb: the motion with the effect less the motion without it
(same targets, no noise), after the best linear change of friction, damping, mass of every link and delay is taken out,
each inside its bounds in the catalogue; root mean square over the affected joints, without the first half second, over
the noise floor. Each motion carries the effect on the abad of one leg, the hip of another and the knee of a third,
three times with the legs exchanged; the table holds the geometric mean for each of the three joints. Between simulated
sizes (seven, a factor apart) the relation is taken as straight in logarithms.

    python -m lab.hidden_effects.sizes [NAME ...]       # measures these, or all
    python -m lab.hidden_effects.sizes --quick [NAME ...]   # the same with 16 s, 5 points and 1 turn
    python -m lab.hidden_effects.sizes --plot FILE.png  # draws the table
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import lsq_linear

from lab.hidden_effects.families import ALIEN_CAPS, FAMILIES, PARTS, alien, hidden_effect
from lab.hidden_effects.generator import ALIENS, FLOOR, Machine, simulate
from mimic.dynamics.catalogue import effect
from mimic.dynamics.effect_set import EffectSet
from mimic.dynamics.excitation import hung_ranges, probe_targets
from mimic.records import JOINTS, LEGS, FloatArray
from mimic.robot.description import load_description

TABLE = Path(__file__).with_name("sizes.json")
STRENGTHS = {"weak": 2.0, "medium": 5.0, "strong": 15.0}
"""Over the noise floor."""
SEED, SECONDS, POINTS, SPAN, TURNS = 20261121, 60.0, 7, 300.0, 3
"""The aliens of the drive, slip, zero drift and friction over position were measured with 16 s, 5 points and 1 turn."""
BOUNDS = {
    name: (effect(which).parameter(number).low, effect(which).parameter(number).high)
    for name, (which, number) in {
        "friction": ("coulomb", "level"),
        "damping": ("viscous", "coefficient"),
        "mass": ("link_mass", "factor"),
    }.items()
}
"""How far the baseline parameters can go, as in the catalogue."""
SKIP, THIN = 100, 5
"""Readings left out at the start, and one of how many is looked at."""


class Rig:
    """One machine with middling baseline values, one motion, and what its baseline values can absorb."""

    def __init__(self) -> None:
        self.motion = probe_targets(*hung_ranges(load_description("cyberdog2")), seconds=SECONDS, seed=SEED)
        half = np.full(12, 0.5)
        self.machine = Machine(
            friction=0.03 + 0.09 * half, damping=0.02 + 0.08 * half, mass=0.9 + 0.25 * half, delay=0.0125
        )
        self.plain = self._rows(self.machine)
        later = replace(self.machine, delay=self.machine.delay + 0.5e-3)
        columns, room = [self._column(later, np.arange(12))], [(-25.0, 175.0)]
        for name, change in (("friction", 0.01), ("damping", 0.01), ("mass", 0.03)):
            for part in range(3):
                row = np.array(getattr(self.machine, name))
                least, most = ((bound - row[part]) / change for bound in BOUNDS[name])
                row[part::3] += change
                moved = replace(self.machine, **{name: row})
                columns += [self._column(moved, np.arange(3 * leg, 3 * leg + 3)) for leg in range(4)]
                room += [(least, most)] * 4
        self.basis = np.stack([c.ravel() for c in columns], -1)
        self.root = np.linalg.qr(self.basis, mode="r")
        self.room = tuple(np.array(room).T)

    def _rows(self, machine: Machine) -> FloatArray:
        return simulate(machine, self.motion, SEED).q[SKIP::THIN]

    def _column(self, machine: Machine, joints: FloatArray) -> FloatArray:
        moved = getattr(self, "_last", (None, None))
        q = moved[1] if moved[0] == _key(machine) else self._rows(machine)
        self._last = (_key(machine), q)
        out = np.zeros_like(q)
        out[:, joints] = (q - self.plain)[:, joints]
        return out

    def left(self, machine: Machine) -> FloatArray:
        """Return what the baseline model cannot absorb, root mean square (12,) over the noise floor."""
        difference = (self._rows(machine) - self.plain).ravel()
        wanted = np.linalg.solve(self.root.T, self.basis.T @ difference)
        absorbed = lsq_linear(self.root, wanted, self.room).x
        rest = difference - self.basis @ absorbed
        return np.sqrt((rest.reshape(-1, 12) ** 2).mean(0)) / FLOOR


def _key(machine: Machine) -> bytes:
    return b"".join(np.asarray(v).tobytes() for v in (machine.friction, machine.damping, machine.mass, machine.delay))


def measure(rig: Rig, name: str) -> dict[str, object]:
    """Return the sizes of one effect for each part and strength."""
    is_alien = name in ALIENS
    cap = ALIEN_CAPS[name][0] if is_alien else FAMILIES[name].cap
    parts = PARTS if is_alien else FAMILIES[name].parts
    wide = name == "base_swing" or (not is_alien and effect(name).scope == "machine")
    sizes = cap * SPAN ** (np.arange(POINTS) / (POINTS - 1) - 1.0)
    ratios = np.ones((POINTS, len(parts)))
    for i, size in enumerate(sizes):
        turns = []
        for turn in range(1 if wide else TURNS):
            joints = JOINTS if wide else tuple(f"{LEGS[(p + turn) % 4]}_{part}" for p, part in enumerate(parts))
            chosen = dict.fromkeys(joints, float(size))
            if is_alien:
                machine = replace(rig.machine, aliens=alien(name, chosen))
            else:
                rng = np.random.default_rng(0)
                one = hidden_effect(name, chosen, rig.machine, rng, spread=False)
                machine = replace(rig.machine, hidden=EffectSet((one,)))
            left = rig.left(machine)
            index = [JOINTS.index(j) for j in joints]
            turns.append(np.full(len(parts), np.sqrt((left**2).mean())) if wide else left[index])
        ratios[i] = np.exp(np.log(np.maximum(turns, 1e-9)).mean(0))
    row: dict[str, object] = {
        "unit": ALIENS[name] if is_alien else FAMILIES[name].unit,
        "cap": cap,
        "bounded": True,
        "why_no_more": ALIEN_CAPS[name][1] if is_alien else FAMILIES[name].why,
        "ratio_at_cap": dict(zip(parts, ratios[-1].round(2).tolist(), strict=True)),
    }
    for strength, ratio in STRENGTHS.items():
        found = {part: _size_at(sizes, ratios[:, p], ratio) for p, part in enumerate(parts)}
        row[strength] = {part: size for part, size in found.items() if size is not None}
    return row


def _size_at(sizes: FloatArray, ratios: FloatArray, ratio: float) -> float | None:
    """Least size that reaches the ratio; None where even the cap does not (within a tenth)."""
    above = np.flatnonzero(ratios >= ratio)
    if not len(above):
        return float(sizes[-1]) if ratios[-1] >= 0.9 * ratio else None
    k = above[0]
    if k == 0:
        return float(sizes[0] * ratio / ratios[0])
    share = np.log(ratio / ratios[k - 1]) / np.log(ratios[k] / ratios[k - 1])
    return float(np.round(sizes[k - 1] * (sizes[k] / sizes[k - 1]) ** share, 7))


def plot(path: Path) -> None:
    """Draw how far each effect can rise above the noise on this robot."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    table = json.loads(TABLE.read_text(encoding="utf-8"))
    rows = [n for n in table if n in FAMILIES]
    rows.sort(key=lambda n: max(table[n]["ratio_at_cap"].values()))
    figure, axes = plt.subplots(figsize=(8, 7.5), constrained_layout=True)
    markers = dict(zip(PARTS, ("^", "s", "o"), strict=True))
    for row, name in enumerate(rows):
        reach = table[name]["ratio_at_cap"]
        axes.plot([0.05, max(reach.values())], [row, row], color="#c9d3de", lw=5, solid_capstyle="butt", zorder=1)
        shown = {"machine": max(reach.values())} if effect(name).scope == "machine" else reach
        for part, value in shown.items():
            axes.scatter(value, row, marker=markers.get(part, "D"), s=30, color="#1f5fa8", zorder=2)
    for strength, ratio in STRENGTHS.items():
        axes.axvline(ratio, color="#e07b1f", lw=1, zorder=0)
        axes.text(ratio, len(rows) - 0.3, strength, ha="center", va="bottom", color="#b35c0e")
    for part, marker in (*markers.items(), ("whole machine", "D")):
        axes.scatter([], [], marker=marker, color="#1f5fa8", s=30, label=part)
    axes.set(xscale="log", xlim=(0.07, 400), ylim=(-0.6, len(rows) + 0.4))
    axes.set_yticks(range(len(rows)), [n.replace("_", " ") for n in rows])
    axes.set_xticks([0.1, 1, 10, 100], ["0.1", "1", "10", "100"])
    axes.set_xlabel("what the declared model cannot absorb at the greatest plausible size, over the noise floor")
    axes.legend(frameon=False, loc="lower right")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def main(names: list[str]) -> None:
    if names[:1] == ["--plot"]:
        return plot(Path(names[1]))
    if names[:1] == ["--quick"]:
        global SECONDS, POINTS, TURNS
        SECONDS, POINTS, TURNS, names = 16.0, 5, 1, names[1:]
    rig = Rig()
    table = json.loads(TABLE.read_text(encoding="utf-8")) if TABLE.exists() else {}
    for name in names or [*FAMILIES, *ALIENS]:
        table[name] = measure(rig, name)
        print(name, json.dumps({k: table[name][k] for k in ("ratio_at_cap", *STRENGTHS)}), flush=True)
        ordered = {n: table[n] for n in [*FAMILIES, *ALIENS] if n in table}
        TABLE.write_text(json.dumps(ordered, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
