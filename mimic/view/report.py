"""A calibration as one page that needs nothing else: what was found, with which evidence, and what is left."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from mimic.calibration import Calibration, Candidate, Errors, Stage
from mimic.robot.effect_set import EffectSet, EffectValues
from mimic.robot.effects import CATALOGUE, unit_of
from mimic.store import written_whole
from mimic.types import FloatArray
from mimic.view.report_plots import Unit, against_state, over_time, spectra, stage_errors, torque_over_time, unit_for
from mimic.view.report_style import STYLE
from mimic.view.svg import figure, number

SHOWN = 6
"""Candidates of a stage that are shown at once; the others unfold."""

LEAST_Z, LEAST_GAIN = 3.0, 0.01
"""Thresholds that the bars of the evidence mark. Source: the rule of :mod:`mimic.calibrate.evidence`."""

_VERDICTS = {
    "explained": "explained down to the noise floor",
    "state-dependent": "depends on the state: an effect that the catalogue lacks",
    "moving base": "shaken in the pattern of a base that moves: hold it more stiffly",
    "periodic": "periodic, whatever the machine does: an external disturbance",
    "broadband": "depends on nothing logged: disturbance or timing",
    "events": "single events: targets that were late or lost, knocks, something that catches",
}


def write_report(calibration: Calibration, path: Path) -> Path:
    """Write the report whole or not at all."""
    page = html_report(calibration)
    with written_whole(path) as part:
        part.write_text(page, encoding="utf-8")
    return path


def html_report(calibration: Calibration) -> str:
    """Return the report as HTML that loads nothing."""
    unit = unit_for(calibration)
    title = f"Calibration of {calibration.metadata.get('name') or 'a machine'}"
    sections = [
        _header(calibration, title),
        _tiles(calibration, unit),
        _effects(calibration),
        _errors(calibration, unit),
        _evidence(calibration),
        _remainder(calibration),
        _declared(calibration),
        _residuals(calibration, unit),
        _footer(calibration),
    ]
    body = "\n".join(s for s in sections if s)
    head = f"<meta charset='utf-8'><meta name='viewport' content='width=device-width,initial-scale=1'><title>{escape(title)}</title>"
    return (
        f"<!doctype html>\n<html lang='en'><head>{head}<style>{STYLE}</style></head>\n<body>\n{body}\n</body></html>\n"
    )


def title_of(name: str) -> str:
    """Return what a sentence calls an effect, or a stage."""
    return {"declared": "declared model", "": "nothing more"}.get(name) or CATALOGUE[name].title


def _section(title: str, lead: str, *parts: str) -> str:
    text = f"<p class='lead'>{lead}</p>" if lead else ""
    return f"<section><h2>{title}</h2>{text}{''.join(parts)}</section>"


def _table(headings: Sequence[str], rows: Iterable[tuple[str, Sequence[str]]], kind: str = "") -> str:
    """Return a table; each row has a class and cells of HTML. All cells but the first are numbers."""
    head = "".join(f"<th{' class=n' if i else ''}>{h}</th>" for i, h in enumerate(headings))
    lines = []
    for row_kind, cells in rows:
        texts = "".join(f"<td class={'n' if i else 'name'}>{c}</td>" for i, c in enumerate(cells))
        lines.append(f"<tr{f' class={row_kind}' if row_kind else ''}>{texts}</tr>")
    opening = f"<table class={kind}>" if kind else "<table>"
    return f"<div class='wide'>{opening}<thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table></div>"


def _header(c: Calibration, title: str) -> str:
    alarm = ""
    if not c.belongs:
        alarm = "<p class='alarm'>Log and model do not belong together. No effect is named; check joints, units and gains.</p>"
    return (
        f"<header><p class='kicker'>mimic calibrate</p><h1>{escape(title)}</h1>{alarm}"
        f"<p class='verdict'>{escape(c.sentence)}</p></header>"
    )


def _tiles(c: Calibration, unit: Unit) -> str:
    last = c.stages[-1].errors if c.stages else c.nominal
    declared = c.stages[0].errors if c.stages else c.nominal
    found = [s.added for s in c.stages if s.added not in ("", "declared")]
    tiles = {
        "held-out error of the model as given": unit.text(Errors.total(c.nominal.held_out)),
        "with the declared numbers fitted": unit.text(Errors.total(declared.held_out)),
        "with what was found": unit.text(Errors.total(last.held_out)),
        "noise floor": unit.text(Errors.total(c.noise)),
        "effects found": str(len(found)),
    }
    return (
        "<div class='tiles'>"
        + "".join(f"<div class='tile'><b>{v}</b><span>{k}</span></div>" for k, v in tiles.items())
        + "</div>"
    )


def _effects(c: Calibration) -> str:
    effects: EffectSet = c.effects
    stages = {s.added: s for s in c.stages}
    found = [e for e in effects if e.name in stages]
    parts = []
    for e in found:
        spec, rivals = CATALOGUE[e.name], ", ".join(title_of(r) for r in stages[e.name].rivals)
        note = f"<p class='lead'>This log cannot tell it from: <b>{escape(rivals)}</b>.</p>" if rivals else ""
        equation = f"<p class='key'><code>{escape(spec.equation)}</code></p>"
        parts.append(f"<h3>{escape(spec.title)}</h3>{equation}{note}{_values([e], e.joints, c.unit)}")
    if not found:
        parts.append("<p class='lead'>No effect earned its place beside the declared model.</p>")
    return _section("What the model lacked", "With 95 % intervals." if found else "", *parts)


def _declared(c: Calibration) -> str:
    added = {s.added for s in c.stages}
    declared = [e for e in c.effects if e.name not in added]
    whole = [e for e in declared if not e.joints]
    by_joint = [e for e in declared if e.joints]
    tables = [_values(by_joint, c.joints, c.unit)] if by_joint else []
    tables += [_values(whole, (), c.unit)] if whole else []
    return _section(
        "Declared model, fitted",
        "The numbers that every model has, with 95 % intervals; ▸| marks one that ran into its bound.",
        *tables,
    )


def _values(effects: Sequence[EffectValues], joints: Sequence[str], positions: str) -> str:
    """Return a table with a row for each joint and a column for each parameter."""
    columns = [(e, n) for e in effects for n in e.values]
    headings = ["joint"]
    for e, n in columns:
        of = f"{escape(CATALOGUE[e.name].title)}<br>" if len(effects) > 1 or not joints else ""
        headings.append(f"{of}<small>{escape(n)}{_in(unit_of(e.name, n, positions))}</small>")
    rows = []
    for joint in joints or ("whole machine",):
        cells = [
            _value(e, n, e.joints.index(joint) if e.joints else 0) if joint in e.joints or not e.joints else ""
            for e, n in columns
        ]
        rows.append(("", [escape(joint), *cells]))
    return _table(headings, rows, kind="narrow" if len(columns) < 4 else "")


def _in(unit: str) -> str:
    return f" [{escape(_pretty(unit))}]" if unit else ""


def _pretty(unit: str) -> str:
    return unit.replace("^2", "²")


def _value(e: EffectValues, parameter: str, i: int) -> str:
    value, spec = float(e.values[parameter][i]), CATALOGUE[e.name].parameter(parameter)
    text = figure(value)
    if value != 0.0 and (value <= spec.low or value >= spec.high) and not spec.fixed:
        text = f"<span class=bad title='on its bound: not to be trusted'>{text} ▸|</span>"
    if parameter not in e.intervals:
        return text
    low, high = (float(v) for v in e.intervals[parameter][i])
    if not (np.isfinite(low) and np.isfinite(high)):
        return text
    return f"{text} <small>{figure(low)} … {figure(high)}</small>"


def _errors(c: Calibration, unit: Unit) -> str:
    columns = [("as given", c.nominal)]
    if c.stages:
        columns.append(("declared fitted", c.stages[0].errors))
    if len(c.stages) > 1:
        columns.append(("final", c.stages[-1].errors))
    last = columns[-1][1]
    floors = {"noise floor": c.noise} | ({} if c.repeatability is None else {"repeats within": c.repeatability})
    shown = (f"{name}<br><small>train / held out</small>" for name, _ in columns)
    headings = ["joint", *shown, *floors, "final / noise"]

    def row(pick: Callable[[FloatArray], float]) -> list[str]:
        cells = [
            f"{figure(pick(e.train) * unit.factor)} / <b>{figure(pick(e.held_out) * unit.factor)}</b>"
            for _, e in columns
        ]
        ratio = pick(last.held_out) / max(pick(c.noise), 1e-300)
        explained = f"<span class=good>{figure(ratio)}</span>" if ratio < 1.2 else figure(ratio)
        return [*cells, *(figure(pick(v) * unit.factor) for v in floors.values()), explained]

    rows = [("", [escape(joint), *row(lambda v, i=i: float(v[i]))]) for i, joint in enumerate(c.joints)]
    if len(c.joints) > 1:
        rows.append(("total", ["all", *row(Errors.total)]))
    names = ["as given", *(title_of(s.added) for s in c.stages)]
    lead = (
        f"Root mean square of measured − predicted [{unit.name}]. Nothing was fitted to the held-out blocks, and nothing"
        " was chosen by them."
    )
    if c.repeatability is not None:
        lead += " The same excitation comes twice in this log; what differs between the two times no model explains."
    return _section("Errors", lead, stage_errors(c, unit, names), _table(headings, rows))


def _evidence(c: Calibration) -> str:
    stages = [s for s in c.stages if s.candidates]
    if not stages:
        return ""
    lead = (
        "Every effect that was tried. The error is that of blocks of the log, each predicted without having been fitted; z is"
        f" the gain over its standard error. An effect must pass both marks, {LEAST_GAIN:.0%} and {LEAST_Z:g}, and more: see"
        " the verdicts."
    )
    return _section("Evidence", lead, *(_stage(s, i + 1, c.unit) for i, s in enumerate(stages)))


def _stage(stage: Stage, index: int, positions: str) -> str:
    chosen = f"{title_of(stage.added)} chosen" if stage.added else "nothing chosen"
    ranked = sorted(stage.candidates, key=lambda x: (not x.accepted, -x.gain if np.isfinite(x.gain) else np.inf))
    top = max([x.gain for x in ranked if np.isfinite(x.gain)] + [0.02])
    rows = [_candidate(x, top, positions, stage) for x in ranked]
    headings = ("effect", "error smaller by", "z", "improvement / noise", "values", "verdict")
    head = "".join(f"<th>{h}</th>" for h in headings)

    def block(lines: list[str]) -> str:
        return f"<div class='wide'><table><thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table></div>"

    rest = rows[SHOWN:]
    more = f"<details><summary>{len(rest)} more that were tried</summary>{block(rest)}</details>" if rest else ""
    return f"<h3>Stage {index}: {escape(chosen)}</h3>{block(rows[:SHOWN])}{more}"


def _candidate(x: Candidate, top: float, positions: str, stage: Stage) -> str:
    if x.accepted:
        verdict = "<span class='good'>chosen</span>"
    elif x.name in stage.rivals:
        verdict = f"cannot be told from the chosen one <small>(apart by {number(x.rival_z)} standard errors)</small>"
    else:
        verdict = escape(x.why) or "another one was better"
    spec = CATALOGUE[x.name]
    values = ", ".join(
        f"{n} {_span(v)} {_pretty(unit_of(x.name, n, positions))}".strip()
        for n, v in x.values.items()
        if not spec.parameter(n).fixed
    )
    return (
        f"<tr{' class=taken' if x.accepted else ''}><td class=name>{escape(spec.title)}</td>"
        f"<td class=n>{_bar(x.gain, top, LEAST_GAIN)}<span class=beside>{_fixed(100 * (1 - np.exp(-x.gain)), 1)} %</span></td>"
        f"<td class=n>{_bar(x.z, 12.0, LEAST_Z)}<span class=beside>{_fixed(x.z, 1)}</span></td>"
        f"<td class=n>{_fixed(x.improvement, 2)}</td><td class=why>{escape(values)}</td><td class=why>{verdict}</td></tr>"
    )


def _fixed(value: float, digits: int) -> str:
    return f"{value:.{digits}f}".replace("-", "−") if np.isfinite(value) else "–"


def _span(values: FloatArray) -> str:
    low, high = float(np.min(values)), float(np.max(values))
    return number(low) if number(low) == number(high) else f"{number(low)} … {number(high)}"


def _bar(value: float, top: float, mark: float) -> str:
    share = min(max(value / top, 0.0), 1.0) if np.isfinite(value) else 0.0
    weak = " weak" if not value >= mark else ""
    return f"<span class='bar{weak}'><i style='width:{100 * share:.0f}%'></i><u style='left:{100 * min(mark / top, 1.0):.0f}%'></u></span>"


def _remainder(c: Calibration) -> str:
    rows = []
    for r in c.unexplained:
        verdict = escape(_VERDICTS.get(r.verdict, r.verdict))
        if r.depends_on:
            verdict += f" <small>(on {escape(' and '.join(r.depends_on))})</small>"
        if r.verdict in ("periodic", "moving base"):
            verdict += f" <small>(near {number(r.peak_hz)} Hz)</small>"
        kind = "good" if r.verdict == "explained" else ""
        rows.append(
            f"<tr><td class=name>{escape(r.joint)}</td><td class=n>{figure(r.ratio)}</td><td class=n>{_fixed(r.state_r2, 2)}</td>"
            f"<td class=n>{figure(r.peak_ratio)} <small>at {number(r.peak_hz)} Hz</small></td>"
            f"<td class='why {kind}'>{verdict}</td></tr>"
        )
    head = "<tr><th>joint</th><th class=n>error / noise</th><th class=n>predicted by the state, R²</th><th class=n>peak / median</th><th>verdict</th></tr>"
    table = (
        f"<div class='wide'><table><thead>{head}</thead><tbody>{''.join(rows)}</tbody></table></div>" if rows else ""
    )
    lists = (
        ("What to log next", c.experiments),
        ("Not determined by this log", c.not_identifiable),
        ("Warnings", c.warnings),
    )
    texts = "".join(
        f"<h3>{title}</h3><ul>{''.join(f'<li>{escape(x)}</li>' for x in lines)}</ul>" for title, lines in lists if lines
    )
    return _section("What is left", "", table, texts)


def _residuals(c: Calibration, unit: Unit) -> str:
    lines = (
        "<span><i class='before' style='--c:var(--before)'></i>declared model</span>"
        "<span><i class='after' style='--c:var(--after)'></i>final model</span>"
    )
    key, timed = f"<p class='key'>{lines}</p>", f"<p class='key'>{lines}<span><i class='held'></i>held out</span></p>"
    noisy = f"<p class='key'>{lines}<span><i class='noise'></i>noise floor</span></p>"
    torques = torque_over_time(c)
    return "".join(
        (
            _section("Residual over time", "Measured − predicted.", timed, *over_time(c, unit)),
            _section("Residual of the measured torque", "", timed, *torques) if torques else "",
            _section(
                "Residual against the state",
                "Median and middle 80 % of the readings. What is explained lies flat on zero.",
                key,
                f"<div class='grid3'>{''.join(against_state(c, unit))}</div>",
            ),
            _section("Residual over frequency", "", noisy, f"<div class='grid3'>{''.join(spectra(c, unit))}</div>"),
        )
    )


def _footer(c: Calibration) -> str:
    rows = [("replays", f"{c.replays:,}".replace(",", " ")), ("time", f"{c.seconds:.0f} s"), *_flat(c.metadata)]
    cells = "".join(f"<tr><th>{escape(str(k))}</th><td>{escape(str(v))}</td></tr>" for k, v in rows)
    return f"<footer><table>{cells}</table></footer>"


def _flat(data: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    rows = []
    for key, value in data.items():
        if isinstance(value, Mapping):
            rows += _flat(value, f"{prefix}{key} ")
        else:
            rows.append((f"{prefix}{key}", number(value) if isinstance(value, float) else str(value)))
    return rows
