"""Report of a batch as one self-contained page: retargeting and tracking of each run, worst first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from mimic.view.report.sections import page, section, tiles

_WORST_ERROR = 8.0
"""Toe error that fills the bar [cm]."""

_WIDE = (
    "body{max-width:1360px}tr.noted td{border-bottom:0;padding-bottom:0}td{white-space:nowrap}"
    "td[colspan],td+td:last-child,th.n{white-space:normal}th,td{padding:5px 6px}.bar{width:48px}"
)

_COLUMNS = (
    ("length", "length_s", "{:.1f} s"),
    ("person seen", "rows_with_person", "{:.0%}"),
    ("clamped", "clamped_share", "{:.1%}"),
    ("moved mean", "moved_mean_cm", "{:.2f} cm"),
    ("moved max", "moved_max_cm", "{:.1f} cm"),
    ("speed-limited", "limited_share", "{:.1%}"),
    ("wanted → reached", "wanted_to_reached_cm", "{:.1f} cm"),
    ("toe error", "toe_error_cm", "{:.1f} cm"),
    ("p95", "toe_error_p95_cm", "{:.1f} cm"),
    ("lag", "lag_s", "{:.2f} s"),
    ("without lag", "toe_error_without_lag_cm", "{:.1f} cm"),
    ("upright", "standing_share", "{:.1%}"),
    ("knee rms", "knee_torque_rms_nm", "{:.1f} N m"),
)
"""Heading, column name and number format."""


def html_batch(rows: Sequence[Mapping[str, Any]], *, command: str, version: str, unplayed: int = 0) -> str:
    """Return the report of a batch as self-contained HTML.

    Args:
        rows: A row for each file, as `mimic.cli.batch` makes them.
        command: The command line.
        version: Of mimic.
        unplayed: Number of files that were not processed.
    """
    failed = [row for row in rows if row["status"] == "failed"]
    played = sorted((row for row in rows if row["status"] != "failed"), key=_worst_first)
    title = f"{len(rows)} files played on the robot" if not failed else f"{len(played)} of {len(rows)} files played"
    parts = [
        f"<header><p class='kicker'>mimic batch</p><h1>{escape(title)}</h1></header>",
        _tiles(played, failed, unplayed),
        _failures(failed),
        _table(played),
        f"<footer>mimic {escape(version)} · <code>{escape(command)}</code></footer>",
    ]
    return page(title, parts, _WIDE)


def _worst_first(row: Mapping[str, Any]) -> tuple[bool, float]:
    error = row["toe_error_cm"]
    return row["status"] != "fell", -(error if error is not None else 0.0)


def _tiles(played: Sequence[Mapping[str, Any]], failed: Sequence[Mapping[str, Any]], unplayed: int) -> str:
    def mean(name: str) -> float | None:
        values = [row[name] for row in played if row[name] is not None]
        return sum(values) / len(values) if values else None

    shown = [(str(len(played)), "played"), (str(len(failed)), "failed")]
    shown += [(str(unplayed), "not processed")] if unplayed else []
    shown.append((str(sum(row["status"] == "fell" for row in played)), "falls"))
    for name, text, what in (
        ("toe_error_cm", "{:.1f} cm", "toe error, mean of the files"),
        ("clamped_share", "{:.1%}", "of the targets clamped"),
        ("standing_share", "{:.1%}", "upright after standing up"),
    ):
        value = mean(name)
        shown += [] if value is None else [(text.format(value), what)]
    return tiles(shown)


def _failures(failed: Sequence[Mapping[str, Any]]) -> str:
    if not failed:
        return ""
    lines = "".join(
        f"<tr><td class='name'>{escape(row['file'])}</td><td>{escape(row['error'])}</td></tr>" for row in failed
    )
    return section("Failed", "", f"<table><tr><th>file<th>reason</tr>{lines}</table>")


def _table(played: Sequence[Mapping[str, Any]]) -> str:
    if not played:
        return ""
    head = "".join(f"<th class=n>{heading}</th>" for heading, _, _ in _COLUMNS)
    lines = []
    for row in played:
        cells = []
        for _, name, text in _COLUMNS:
            value = row[name]
            cell = "–" if value is None else text.format(value)
            if name == "toe_error_cm" and value is not None:
                share = min(1.0, value / _WORST_ERROR)
                cell = f"<span class='bar'><i style='width:{share:.0%}'></i></span>{cell}"
            cells.append(f"<td class=n>{cell}</td>")
        name = f"<a href='{escape(row['folder'], quote=True)}'>{escape(row['file'])}</a>"
        name += " <b class='bad'>fell</b>" if row["status"] == "fell" else ""
        lines.append(f"<tr{' class=noted' if row['notes'] else ''}><td>{name}</td>{''.join(cells)}</tr>")
        if row["notes"]:
            lines.append(f"<tr><td colspan={1 + len(_COLUMNS)}><small>{escape(row['notes'])}</small></td></tr>")
    lead = "Falls first, then the largest toe error. Retargeting: clamped, moved, speed-limited. Robot: the rest."
    rows = f"<tr><th>file</th>{head}</tr>{''.join(lines)}"
    return section("Played", lead, f"<div class='wide'><table>{rows}</table></div>")
