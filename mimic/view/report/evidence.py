"""Evidence section of a report: each effect that was tried, and by how much it would predict better."""

from __future__ import annotations

from html import escape

from mimic.dynamics.catalogue import CATALOGUE
from mimic.sysid.result import Calibration, Stage
from mimic.view.report.sections import section, table
from mimic.view.report.svg import number

SHOWN = 6
"""Number of candidates per stage that are shown; the others are folded."""


def evidence(c: Calibration) -> str:
    """Return the section with all effects that were tried, stage by stage; empty if there were none."""
    lead = (
        "All effects that were tried: by how much blocks left out are likelier with them, a price for each number paid"
        " [nats of independent readings], for those that a linear step said most of; of others what that step said."
    )
    return section("Evidence", lead, *(_stage(stage) for stage in c.tried)) if c.tried else ""


def _stage(stage: Stage) -> str:
    beside = " and ".join(CATALOGUE[name].title for name in stage.beside)
    rows = []
    for one in stage.candidates:
        kind = "fitted" if one.fitted else "linear step"
        rows.append(("", [escape(CATALOGUE[one.name].title), number(one.gain), kind, escape(", ".join(one.joints))]))
    headings = ("effect", "gain [nats]", "by", "joints")
    rest = rows[SHOWN:]
    summary = f"<summary>{len(rest)} more candidates</summary>"
    more = f"<details>{summary}{table(headings, rest)}</details>" if rest else ""
    return f"<h3>Beside {escape(beside or 'the baseline')}</h3>{table(headings, rows[:SHOWN])}{more}"
