"""Correlations of the fitted numbers in a report: the strongest pairs, and all of them as a map."""

from __future__ import annotations

from html import escape

import numpy as np

from mimic.sysid.result import CORRELATED, Calibration, Correlations
from mimic.view.report.sections import fixed, key, section, table

SHOWN = 15
"""Most pairs in the table."""

MOST = 120
"""Most numbers of which a map is drawn."""


def correlations(c: Calibration) -> str:
    """Return the section; empty where nothing or one number was fitted."""
    found = c.correlations
    if found is None or len(found.names) < 2:
        return ""
    pairs = found.pairs(CORRELATED)
    rows = [("", [escape(a), escape(b), fixed(value, 2)]) for a, b, value in pairs[:SHOWN]]
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
    return section("Correlation of the fitted numbers", lead, strongest, more, _map(found))


def _map(found: Correlations) -> str:
    """Return the matrix as squares, coloured by sign and size; each has a text to hover over."""
    n = len(found.names)
    if n > MOST:
        return ""
    side = max(5.0, min(22.0, 760.0 / n))
    groups = [name.partition(".")[0] for name in found.names]
    cells = []
    labels = []
    for i, j in zip(*np.tril_indices(n), strict=True):
        value = float(found.matrix[i, j])
        if abs(value) < 0.05:
            continue
        kind = "after" if value > 0 else "before"
        said = f"{found.names[i]} with {found.names[j]}: {fixed(value, 2)}"
        cells.append(
            f"<rect class='{kind}' x='{j * side:.1f}' y='{i * side:.1f}' width='{side - 0.5:.1f}'"
            f" height='{side - 0.5:.1f}' opacity='{abs(value):.2f}'><title>{escape(said)}</title></rect>"
        )
    first = 0
    for i in range(1, n + 1):
        if i == n or groups[i] != groups[first]:
            middle = (first + i) / 2 * side + 4
            labels.append(f"<text x='{n * side + 6:.1f}' y='{middle:.1f}'>{escape(groups[first])}</text>")
            labels.append(f"<path class='line noise' d='M0,{i * side:.1f}H{n * side:.1f}'/>")
            first = i
    width = n * side + 140
    return (
        f"{key(after='positive', before='negative')}"
        f"<svg class='map' viewBox='0 0 {width:.0f} {n * side:.0f}' style='max-width:{width:.0f}px' role='img'"
        f" aria-label='correlation of the fitted numbers'>{''.join(cells)}{''.join(labels)}</svg>"
    )
