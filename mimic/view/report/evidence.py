"""Evidence section of a report: each tested effect with its gain, significance and verdict."""

from __future__ import annotations

from html import escape

import numpy as np

from mimic.dynamics.catalogue import CATALOGUE, unit_of
from mimic.records import FloatArray
from mimic.sysid.result import RULES, Calibration, Candidate, Stage
from mimic.view.report.sections import fixed, pretty, section, title_of
from mimic.view.report.svg import number

SHOWN = 6
"""Number of candidates per stage that are shown; the others are folded."""


def evidence(c: Calibration) -> str:
    """Return the section with all tested effects, stage by stage; empty if there were none."""
    stages = [s for s in c.stages if s.candidates]
    if not stages:
        return ""
    lead = (
        "All tested effects. The error is that of blocks of the log, each predicted by a fit without this block. z"
        f" is the gain over its standard error, after a price for each number. An accepted effect exceeds both marks,"
        f" {RULES.gain:.0%} and {RULES.z:g}, and removes {RULES.share:.0%} of the unexplained error where it acts."
    )
    return section("Evidence", lead, *(_stage(s, i + 1, c.unit) for i, s in enumerate(stages)))


def _stage(stage: Stage, index: int, positions: str) -> str:
    chosen = f"{title_of(stage.added)} accepted" if stage.added else "no effect accepted"
    ranked = sorted(stage.candidates, key=lambda x: (not x.accepted, -x.gain if np.isfinite(x.gain) else np.inf))
    top = max([x.gain for x in ranked if np.isfinite(x.gain)] + [0.02])
    rows = [_candidate(x, top, positions, stage) for x in ranked]
    headings = ("effect", "error reduced by", "z", "unexplained error removed", "values", "verdict")
    head = "".join(f"<th>{h}</th>" for h in headings)

    def block(lines: list[str]) -> str:
        return f"<div class='wide'><table><thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table></div>"

    rest = rows[SHOWN:]
    more = f"<details><summary>{len(rest)} more candidates</summary>{block(rest)}</details>" if rest else ""
    return f"<h3>Stage {index}: {escape(chosen)}</h3>{block(rows[:SHOWN])}{more}"


def _candidate(x: Candidate, top: float, positions: str, stage: Stage) -> str:
    if x.accepted:
        verdict = "<span class='good'>accepted</span>"
    elif x.name in stage.alternatives:
        apart = f"{number(x.alternative_z)} standard errors behind, odds {number(x.odds)} : 1"
        verdict = f"cannot be ruled out <small>({apart})</small>"
    else:
        verdict = escape(x.why) or "another effect was better"
    spec = CATALOGUE[x.name]
    values = ", ".join(
        f"{n} {_span(v)} {pretty(unit_of(x.name, n, positions))}".strip()
        for n, v in x.values.items()
        if not spec.parameter(n).fixed
    )
    return (
        f"<tr{' class=taken' if x.accepted else ''}><td class=name>{escape(spec.title)}</td>"
        f"<td class=n>{_bar(x.gain, top, RULES.gain)}"
        f"<span class=beside>{fixed(100 * (1 - np.exp(-x.gain)), 1)} %</span></td>"
        f"<td class=n>{_bar(x.z, 12.0, RULES.z)}<span class=beside>{fixed(x.z, 1)}</span></td>"
        f"<td class=n>{fixed(100 * x.improvement, 0)} %</td><td class=why>{escape(values)}</td>"
        f"<td class=why>{verdict}</td></tr>"
    )


def _span(values: FloatArray) -> str:
    low = float(np.min(values))
    high = float(np.max(values))
    return number(low) if number(low) == number(high) else f"{number(low)} … {number(high)}"


def _bar(value: float, top: float, mark: float) -> str:
    share = min(max(value / top, 0.0), 1.0) if np.isfinite(value) else 0.0
    weak = " weak" if not value >= mark else ""
    left = 100 * min(mark / top, 1.0)
    return f"<span class='bar{weak}'><i style='width:{100 * share:.0f}%'></i><u style='left:{left:.0f}%'></u></span>"
