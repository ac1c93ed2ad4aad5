"""Read results of the suite, judge them against the goals, and draw the detection limit.

    python -m lab.hidden_effects.summary RESULTS.jsonl ... [--markdown FILE] [--plot FILE.png]

How a result is judged:
    right        every hidden effect that the motion shows is among the names, and no name is false or rival     as
    right, where a rival of the accepted name ("cannot be told from") counts as the name first        the first name is
    a hidden effect unexplained  an effect from outside the catalogue: nothing is named, and some affected joint is not
    "explained" not shown    an effect without which no joint's positions change by a tenth of the noise floor in this
    motion: it cannot be named
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy import optimize

from lab.hidden_effects.generator import CLOCKS, DESCRIBED
from lab.hidden_effects.scenarios import FAINT, Scenario, for_choosing
from mimic.config.sysid import CalibrateSettings
from mimic.records import JOINTS, FloatArray

Record = Mapping[str, Any]
STRENGTHS = ("strong", "medium", "weak", *FAINT)

BEGIN, END = "<!-- measured: lab/hidden_effects/summary.py -->", "<!-- end of measured -->"

SHOWN = 0.1
"""Least change of positions, in noise floors, that a motion must show of an effect for the log to tell of it."""

GROUPS: Mapping[str, tuple[str, ...]] = {
    "drive": (
        "armature",
        "gains",
        "torque_speed",
        "supply_sag",
        "kt_gain",
        "kt_drift",
        "kt_heat",
        "torque_lag",
        "velocity_lag",
    ),
    "friction": ("stribeck", "load_friction", "asymmetric_friction", "quadratic_drag", "coupling"),
    "transmission": ("backlash", "compliance"),
    "encoder": ("encoder_offset", "encoder_scale", "encoder_step"),
    "position, time": ("cogging", "spring", "base_tilt", "payload", "com_shift"),
    "commands": ("joint_delay", "delay_jitter", "lost_commands"),
}
"""Effects by where they sit, for the plot."""

BETWEEN_EFFECTS = 0.5
"""Standard deviation of the logarithm of the limit between effects."""

LEAST_BEYOND = 0.1
"""Error beyond the noise, in noise floors, below which logs are taken to show as little."""


def read_results(paths: Iterable[Path]) -> list[Record]:
    """Return the records of all files; of the same scenario the last."""
    records: dict[str, Record] = {}
    for path in paths:
        for line in path.read_text(encoding="utf-8").splitlines():
            if line.strip():
                record = json.loads(line)
                records[record["key"]] = record
    return list(records.values())


def expected(r: Record) -> set[str]:
    """Return the hidden effects that this motion shows."""
    return {n for n in r["names"] if shown(r, n)}


def whole(r: Record) -> bool:
    """The motion shows all that is hidden."""
    return expected(r) == set(r["names"])


def named(r: Record) -> set[str]:
    """Return the reported effects but for the small ones that the machine also has."""
    return set(r["named"]) - set(r.get("small", ()))


def claimed(r: Record) -> list[set[str]]:
    """Return each accepted name with its rivals."""
    return [{name, *r["rivals"].get(name, ())} for name in r["named"] if name in named(r)]


def right(r: Record) -> bool:
    return "error" not in r and r["belongs"] and named(r) == expected(r)


def right_or_rival(r: Record) -> bool:
    """Names and hidden effects can be paired so that each name or one of its rivals is the effect."""
    if "error" in r or not r["belongs"]:
        return False
    sets, names = claimed(r), sorted(expected(r))
    return len(sets) == len(names) and _paired(sets, names)


def _paired(sets: list[set[str]], names: list[str]) -> bool:
    if not names:
        return True
    return any(names[0] in s and _paired(sets[:i] + sets[i + 1 :], names[1:]) for i, s in enumerate(sets))


def all_found(r: Record) -> bool:
    return "error" not in r and expected(r) <= set(r["named"])


def first_right(r: Record) -> bool:
    return "error" not in r and bool(r["named"]) and r["named"][0] in {*r["names"], *r.get("small", ())}


def nothing_false(r: Record) -> bool:
    return "error" not in r and named(r) <= set(r["names"])


def nothing_named(r: Record) -> bool:
    return "error" not in r and not r["named"]


def marked(r: Record) -> bool:
    """Some affected joint is not called explained."""
    if "error" in r:
        return False
    affected = {j for joints in r["where"].values() for j in joints}
    return any(not u["explained"] for u in r["unexplained"] if u["joint"] in affected) or not r["belongs"]


def unexplained(r: Record) -> bool:
    described = {DESCRIBED[n] for n in r["names"] if n in DESCRIBED}
    return (nothing_named(r) and marked(r)) or (bool(described) and "error" not in r and named(r) == described)


def shown(r: Record, name: str = "") -> bool:
    """The effect changes some joint's positions by a tenth of the noise floor, root mean square, in this motion."""
    changes = r.get("changes", {}).get(name or r["names"][0])
    return max(changes or (len(r["names"]) == 1 and r.get("change")) or [SHOWN]) >= SHOWN


def error_after(r: Record) -> float:
    """Held-out error of what was found over the true noise floor."""
    return float(np.sqrt(np.mean(np.square(r["final"])))) / r["floor"]


def declared_error(r: Record) -> float:
    """Held-out error of the baseline model over the true noise floor, over the affected joints."""
    there = list(r.get("joints", JOINTS))
    index = sorted({there.index(j) for joints in r["where"].values() for j in joints if j in there})
    return float(np.sqrt(np.mean(np.square(r["baseline"])[index]))) / r["floor"]


def coverage(records: Iterable[Record], declared: bool) -> list[tuple[str, bool]]:
    """Return (effect.parameter, whether the interval holds the truth) where the right effects were named and the laws
    are those of the catalogue."""
    rows = []
    for r in records:
        if not right(r) or r.get("differs"):
            continue
        truth: dict[tuple[str, str, str], float] = {}
        for name, values in r["truth"]["declared"].items():
            for joint, value in zip(JOINTS if len(values) == 12 else [""], values, strict=True):
                truth[(*name.split("."), joint)] = value
        for e in r["truth"]["hidden"]:
            for parameter, values in e.items():
                if parameter not in ("name", "joints"):
                    for joint, value in zip(e["joints"] or [""], values, strict=True):
                        truth[e["name"], parameter, joint] = value
        for e in r["effects"]:
            is_declared = e["name"] in CalibrateSettings().baseline
            if is_declared is not declared:
                continue
            for parameter, rows_of in e["intervals"].items():
                for joint, (low, high) in zip(e["joints"] or [""], rows_of, strict=True):
                    if (e["name"], parameter, joint) in truth and math.isfinite(low) and high > low:
                        value = truth[e["name"], parameter, joint]
                        rows.append((f"{e['name']}.{parameter}", bool(low <= value <= high)))
    return rows


def wilson(k: int, n: int) -> tuple[float, float]:
    """Return the 95 % interval of a share. Source: Wilson 1927."""
    if n == 0:
        return 0.0, 1.0
    z, p = 1.96, k / n
    centre, half = p + z * z / (2 * n), z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return max(0.0, (centre - half) / (1 + z * z / n)), min(1.0, (centre + half) / (1 + z * z / n))


Row = tuple[str, str, int, int]
"""What, goal, how many, of how many."""


def _row(what: str, goal: str, records: Sequence[Record], judge: Callable[[Record], bool]) -> Row:
    return what, goal, sum(map(judge, records)), len(records)


def share(k: int, n: int) -> str:
    """Return a share with its 95 % interval in words."""
    if n == 0:
        return "not run"
    low, high = wilson(k, n)
    return f"{100 * k / n:.0f} % ({k} of {n}; {100 * low:.0f}-{100 * high:.0f})"


def goals(records: Sequence[Record]) -> list[Row]:
    """Return rows: what, goal, how many of how many."""

    def of(group: str, *strengths: str) -> list[Record]:
        return [r for r in records if r["group"] == group and (not strengths or r["key"].split("/")[2] in strengths)]

    plain, weak = ([r for r in of("single", *s) if shown(r)] for s in (("strong", "medium"), ("weak",)))
    hidden = [r for r in of("single", "strong", "medium", "weak") if not shown(r)]
    pairs, triples = (list(filter(whole, of(group))) for group in ("pair", "triple"))
    partly = [r for r in (*of("pair"), *of("triple")) if not whole(r)]
    clean, aliens = of("clean"), [r for r in of("alien") if shown(r)]
    differ = [r for r in (*plain, *pairs) if r.get("differs")]
    good = [r for r in records if "error" not in r and r["group"] not in ("alien",)]
    explained = [r for r in good if right(r)]
    rows = [
        _row("no effect: nothing named", "99 %", clean, nothing_named),
        _row("the same: held-out error within 1.1 noise floors", "all", clean, lambda r: within(r, 1.1)),
        _row("one effect, strong or medium: named, nothing else", "95 %", plain, right),
        _row("the same, its rivals counted", "", plain, right_or_rival),
        _row("the same, named first", "", plain, first_right),
        _row("the same, among the names", "", plain, all_found),
        _row("two effects: both named, nothing else", "85 %", pairs, right),
        _row("two effects: both named", "", pairs, all_found),
        _row("one or two, by laws other than the catalogue's: named, nothing else", "", differ, right),
        _row("effect outside the catalogue: nothing named, called unexplained", "95 %", aliens, unexplained),
        _row("the same, called unexplained whatever was named", "", aliens, marked),
        _row(
            "one effect, weak: named or among the rivals, nothing else",
            "80 %",
            weak,
            lambda r: right(r) or right_or_rival(r),
        ),
        *(
            _row(f"one effect, {size:g} of weak: named, nothing else", "", of("single", strength), right)
            for strength, size in FAINT.items()
        ),
        _row("the same: nothing false named", "", of("single", *FAINT), nothing_false),
        _row("one effect that this motion does not show: nothing false named", "", hidden, nothing_false),
        _row("three effects: all named", "", triples, all_found),
        _row("two or three, of which the motion does not show all: just those that it shows named", "", partly, right),
        _row("held-out error within 1.15 noise floors, right names", "95 %", explained, lambda r: within(r, 1.15)),
        _row("the same, every scenario but aliens", "", good, lambda r: within(r, 1.15)),
    ]
    covered = {declared: coverage(records, declared) for declared in (False, True)}
    delays = [hit for hit in covered[True] if hit[0] == "delay.time"]
    for title, hits in (
        ("hidden effects", covered[False]),
        ("declared parameters", covered[True]),
        ("the delay", delays),
    ):
        rows.append(
            (f"95 % intervals that hold the truth, {title}", "85-99 %", sum(held for _, held in hits), len(hits))
        )
    rows.append(_row("ended with an exception or out of time", "0", records, lambda r: "error" in r))
    return rows


def within(r: Record, floors: float) -> bool:
    return "error" not in r and error_after(r) <= floors


def clocks_of(records: Sequence[Record]) -> list[str]:
    return sorted({Scenario.of(r["key"]).clock for r in records}, key=list(CLOCKS).index)


def by_clock(records: Sequence[Record]) -> list[str]:
    """Return one table for all clocks: in each cell the half for choosing, then the half for reporting."""
    clocks = clocks_of(records)
    columns = []
    for clock in clocks:
        mine = [r for r in records if Scenario.of(r["key"]).clock == clock]
        columns.append([goals([r for r in mine if for_choosing(r["key"]) == half]) for half in (True, False)])
    lines = [f"| what | goal | {' | '.join(clocks)} | all, half for reporting |", f"|{'---|' * (3 + len(clocks))}"]
    whole_half = goals([r for r in records if not for_choosing(r["key"])])
    for i, (what, goal, k, n) in enumerate(whole_half):
        cells = [[half[i] for half in column] for column in columns]
        if n + sum(half[3] for cell in cells for half in cell) == 0:
            continue
        texts = [" · ".join(f"{half[2]}/{half[3]}" for half in cell) for cell in cells]
        lines.append(f"| {what} | {goal} | {' | '.join(texts)} | {share(k, n)} |")
    return [*lines, ""]


def effect_rows(records: Sequence[Record]) -> list[tuple[str, ...]]:
    """Return a row an effect: right of run at each strength, and what was named instead."""
    rows = []
    for names in dict.fromkeys(
        tuple(r["names"]) for r in records if r["group"] in ("single", "alien", "pair", "triple")
    ):
        mine = [r for r in records if tuple(r.get("names", ())) == names and (len(names) > 1 or shown(r))]
        if not mine:
            continue
        judge = unexplained if mine[0]["group"] == "alien" else right
        cells = []
        for strength in STRENGTHS:
            part = [r for r in mine if r["strength"] == strength]
            cells.append(f"{sum(map(judge, part))} of {len(part)}" if part else "-")
        wrong: dict[str, int] = {}
        for r in mine:
            if not judge(r):
                said = "error" if "error" in r else " + ".join(r["named"]) or "nothing"
                wrong[said] = wrong.get(said, 0) + 1
        said = ", ".join(f"{k} ({v})" if v > 1 else k for k, v in sorted(wrong.items(), key=lambda x: -x[1])[:5])
        rows.append((" + ".join(names), *cells, said))
    return rows


def markdown(records: Sequence[Record]) -> str:
    """Return the tables as Markdown."""
    lines = by_clock(records) if len(clocks_of(records)) > 1 else []
    for clock in clocks_of(records):
        mine = [r for r in records if Scenario.of(r["key"]).clock == clock]
        halves = [[r for r in mine if for_choosing(r["key"]) == choosing] for choosing in (True, False)]
        both = zip(*(goals(half) for half in halves), strict=True)
        lines += [f"Rows written by the clock {clock!r}:", ""] if clock != "grid" else []
        lines += ["| what | goal | half for choosing (95 % interval) | half for reporting |", "|---|---|---|---|"]
        lines += [f"| {a} | {b} | {share(*c)} | {share(*d)} |" for (a, b, *c), (_, _, *d) in both if c[1] + d[1]]
        lines += [""]
    lines += [f"| hidden | {' | '.join(STRENGTHS)} | otherwise named |", f"|{'---|' * (len(STRENGTHS) + 2)}"]
    lines += [f"| {' | '.join(row)} |" for row in effect_rows(records)]
    seconds = [r["cpu_seconds"] for r in records if "cpu_seconds" in r]
    if seconds:
        lines += [
            "",
            f"{len(records)} logs; median {np.median(seconds):.0f} s, longest {max(seconds):.0f} s of processor time.",
        ]
    return "\n".join(lines)


def detection_limits(singles: Sequence[Record], effects: Sequence[str]) -> dict[str, FloatArray]:
    """Return for each effect the errors of the baseline model, in noise floors, at which it is found with 10, 50 and 90
    % (3,).

    A logistic curve of the logarithm of what is beyond the noise, its slope shared and its middles spread by
    :data:`BETWEEN_EFFECTS`: an effect has a handful of logs, few of them near its limit.
    """
    beyond = np.log([np.sqrt(max(declared_error(r) ** 2 - 1.0, LEAST_BEYOND**2)) for r in singles])
    of = np.array([effects.index(r["names"][0]) for r in singles])
    sign = np.where([right(r) for r in singles], 1.0, -1.0)

    def cost(p: FloatArray) -> float:
        middle = p[1] + p[2:]
        misfit = np.logaddexp(0.0, -sign * np.exp(p[0]) * (beyond - middle[of])).sum()
        return float(misfit + 0.5 * np.sum((p[2:] / BETWEEN_EFFECTS) ** 2) + 0.5 * (p[0] - 1.0) ** 2)

    p = optimize.minimize(cost, np.zeros(2 + len(effects)), method="BFGS").x
    odds = np.log([0.1 / 0.9, 1.0, 0.9 / 0.1])
    return {n: np.sqrt(1.0 + np.exp(2 * (p[1] + p[2 + i] + odds / np.exp(p[0])))) for i, n in enumerate(effects)}


def plot(records: Sequence[Record], path: Path) -> None:
    """Draw the share named right against how much the baseline model leaves."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    singles = [r for r in records if r["group"] == "single" and "error" not in r and shown(r)]
    if not singles:
        return
    x = np.array([declared_error(r) for r in singles])
    edges = np.array([0.9, 1.1, 1.4, 1.9, 2.7, 4.0, 6.5, 11.0, 25.0, 400.0])
    there = {r["names"][0] for r in singles}
    effects = [n for names in GROUPS.values() for n in names if n in there]
    figure, (top, low) = plt.subplots(
        2, 1, figsize=(8, 3.5 + 0.25 * len(effects)), height_ratios=(3, 0.25 * len(effects)), constrained_layout=True
    )
    for judge, label, colour in ((right, "named, nothing else", "#1f5fa8"), (all_found, "among the names", "#e07b1f")):
        y = np.array([judge(r) for r in singles])
        at, share, down, up = [], [], [], []
        for a, b in pairwise(edges):
            pick = (x >= a) & (x < b)
            if not pick.sum():
                continue
            k, n = int(y[pick].sum()), int(pick.sum())
            lower, upper = wilson(k, n)
            at.append(float(np.exp(np.log(x[pick]).mean())))
            share.append(k / n)
            down.append(max(0.0, k / n - lower))
            up.append(max(0.0, upper - k / n))
        shift = 1.02 if judge is right else 0.98
        top.errorbar(np.array(at) * shift, share, (down, up), fmt="o-", color=colour, capsize=3, label=label)
    top.set(xscale="log", ylabel="share of logs", ylim=(-0.03, 1.03))
    top.set_title(f"One hidden effect: found or not ({len(singles)} logs, bars 95 %)", loc="left")
    top.legend(frameon=False, loc="lower right")
    limits = detection_limits(singles, effects)
    for row, name in enumerate(effects):
        mine = [r for r in singles if r["names"][0] == name]
        low.plot(limits[name][[0, 2]], [row, row], color="#b9c7da", lw=7, solid_capstyle="butt", zorder=0)
        low.plot(limits[name][[1, 1]], [row - 0.3, row + 0.3], color="#5b7aa5", lw=2, zorder=1)
        for good, marker, colour in ((True, "o", "#1f5fa8"), (False, "x", "#c0392b")):
            at = [declared_error(r) for r in mine if right(r) is good]
            low.scatter(at, np.full(len(at), row), marker=marker, s=18, color=colour, zorder=2)
    first = np.cumsum([sum(n in there for n in names) for names in GROUPS.values()])
    for edge in first[:-1]:
        low.axhline(edge - 0.5, color="0.8", lw=0.8)
    low.set(xscale="log", yticks=range(len(effects)), yticklabels=effects, ylim=(-0.6, len(effects) - 0.4))
    low.set_xlabel("error of the declared model on the affected joints, held out, over the noise floor")
    low.set_title("Each log: dot named right, cross not; bar: found with 10 to 90 %, line: 50 %", loc="left")
    low.invert_yaxis()
    for axis in (top, low):
        axis.set_xlim(0.85, max(30.0, x.max() * 1.1))
        axis.set_xticks([1, 2, 5, 10, 20], ["1", "2", "5", "10", "20"])
        axis.minorticks_off()
        axis.grid(alpha=0.25)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _placed(text: str, path: Path) -> str:
    """Return the file with the text between its marks; the text alone where it has none."""
    old = path.read_text(encoding="utf-8") if path.exists() else ""
    if BEGIN not in old:
        return text + "\n"
    head, rest = old.split(BEGIN)
    return f"{head}{BEGIN}\n{text}\n{END}{rest.split(END)[1]}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path, nargs="+")
    parser.add_argument("--markdown", type=Path, help="write the tables to this file; between the marks if it has them")
    parser.add_argument("--plot", type=Path)
    args = parser.parse_args()
    records = read_results(args.results)
    text = markdown(records)
    print(text)
    if args.markdown:
        args.markdown.write_text(_placed(text, args.markdown), encoding="utf-8")
    if args.plot:
        plot(records, args.plot)


if __name__ == "__main__":
    main()
