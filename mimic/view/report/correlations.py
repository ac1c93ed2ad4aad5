"""Correlations of the fitted numbers in a report: the strongest pairs."""

from __future__ import annotations

from html import escape

from mimic.sysid.result import CORRELATED, Calibration
from mimic.view.report.sections import section, table

SHOWN = 15
"""Most pairs in the table."""


def correlations(c: Calibration) -> str:
    """Return the section; empty where nothing or one number was fitted."""
    found = c.correlations
    if found is None or len(found.names) < 2:
        return ""
    pairs = found.pairs(CORRELATED)
    rows = [("", [escape(a), escape(b), f"{value:.2f}".replace("-", "−")]) for a, b, value in pairs[:SHOWN]]
    lead = (
        "How the errors of two numbers hang together. Near 1 or −1 the log hardly tells them apart: their sum, or their"
        " difference, is known much better than either."
    )
    strongest = (
        table(["number", "with", "correlation"], rows, kind="narrow")
        if rows
        else f"<p class='lead'>No two numbers are correlated by {CORRELATED:g} or more.</p>"
    )
    more = ""
    if len(pairs) > SHOWN:
        more = f"<p class='lead'>{len(pairs) - SHOWN} further pairs above {CORRELATED:g}.</p>"
    return section("Correlation of the fitted numbers", lead, strongest, more)
