"""Sections, tables and number formats shared by the parts of a report."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from html import escape

import numpy as np

from mimic.view.report.style import STYLE


def page(title: str, parts: Iterable[str], style: str = "") -> str:
    """Return a self-contained page of parts, of which empty ones are left out."""
    head = (
        "<meta charset='utf-8'><meta name='viewport' content='width=device-width,initial-scale=1'>"
        f"<title>{escape(title)}</title><style>{STYLE}{style}</style>"
    )
    body = "\n".join(part for part in parts if part)
    return f"<!doctype html>\n<html lang='en'><head>{head}</head>\n<body>\n{body}\n</body></html>\n"


def tiles(shown: Iterable[tuple[str, str]]) -> str:
    """Return large figures side by side, each over what it is."""
    each = "".join(f"<div class='tile'><b>{value}</b><span>{what}</span></div>" for value, what in shown)
    return f"<div class='tiles'>{each}</div>"


def key(**marks: str) -> str:
    """Return the key of a plot: the text for each kind of mark."""
    colours = {kind: f" style='--c:var(--{kind})'" for kind in ("before", "after")}
    texts = (f"<span><i class='{kind}'{colours.get(kind, '')}></i>{text}</span>" for kind, text in marks.items())
    return f"<p class='key'>{''.join(texts)}</p>"


def section(title: str, lead: str, *parts: str) -> str:
    """Return a section with a lead paragraph."""
    text = f"<p class='lead'>{lead}</p>" if lead else ""
    return f"<section><h2>{title}</h2>{text}{''.join(parts)}</section>"


def table(headings: Sequence[str], rows: Iterable[tuple[str, Sequence[str]]], kind: str = "") -> str:
    """Return a table; each row has a class and cells of HTML. All cells except the first are numbers."""
    head = "".join(f"<th{' class=n' if i else ''}>{h}</th>" for i, h in enumerate(headings))
    lines = []
    for row_kind, cells in rows:
        texts = "".join(f"<td class={'n' if i else 'name'}>{c}</td>" for i, c in enumerate(cells))
        lines.append(f"<tr{f' class={row_kind}' if row_kind else ''}>{texts}</tr>")
    opening = f"<table class={kind}>" if kind else "<table>"
    return f"<div class='wide'>{opening}<thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table></div>"


def joint_rows(joints: Sequence[str], cells: Callable[[slice], list[str]]) -> list[tuple[str, list[str]]]:
    """Return the rows of a table with the cells of each joint and, of several, of all, given their columns."""
    rows = [("", [escape(joint), *cells(slice(j, j + 1))]) for j, joint in enumerate(joints)]
    return [*rows, ("total", ["all", *cells(slice(None))])] if len(joints) > 1 else rows


def pretty(unit: str) -> str:
    """Return a unit in typographic form."""
    return unit.replace("^2", "²")


def fixed(value: float, digits: int) -> str:
    """Return a number with this many decimals, or a dash if it is not finite."""
    return f"{value:.{digits}f}".replace("-", "−") if np.isfinite(value) else "–"
