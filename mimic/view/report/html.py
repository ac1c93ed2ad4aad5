"""Calibration report as one self-contained page: effects, evidence, and the unexplained residual."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from mimic.dynamics.catalogue import CATALOGUE, unit_of
from mimic.dynamics.effect_set import EffectValues
from mimic.io.store import written_whole
from mimic.records import FloatArray
from mimic.sysid.result import EXPLAINED, Calibration, Errors
from mimic.sysid.sentences import called
from mimic.view.report.correlations import correlations
from mimic.view.report.evidence import evidence
from mimic.view.report.motion import by_phase, other_measures, worst_seconds
from mimic.view.report.plots import Unit, against_state, over_time, spectra, torque_over_time, unit_for
from mimic.view.report.sections import joint_rows, key, page, pretty, section, table, tiles
from mimic.view.report.svg import figure, number


def write_report(calibration: Calibration, path: Path) -> Path:
    """Write the report; the file is complete or not written at all."""
    page = html_report(calibration)
    with written_whole(path) as part:
        part.write_text(page, encoding="utf-8")
    return path


def html_report(calibration: Calibration) -> str:
    """Return the report as self-contained HTML."""
    unit = unit_for(calibration)
    title = f"Calibration of {calibration.metadata.get('name') or 'a machine'}"
    parts = [
        _header(calibration, title),
        _tiles(calibration, unit),
        _effects(calibration),
        _errors(calibration, unit),
        _logs(calibration, unit),
        by_phase(calibration, unit),
        evidence(calibration),
        _unexplained(calibration),
        worst_seconds(calibration),
        _baseline(calibration),
        correlations(calibration),
        _residuals(calibration, unit),
        _footer(calibration),
    ]
    return page(title, parts)


def _header(c: Calibration, title: str) -> str:
    alarm = ""
    if not c.log_matches_model:
        alarm = (
            "<p class='alarm'>The log does not match the model. No effect is reported;"
            " check joints, units and gains.</p>"
        )
    return (
        f"<header><p class='kicker'>mimic calibrate</p><h1>{escape(title)}</h1>{alarm}"
        f"<p class='verdict'>{escape(c.sentence)}</p></header>"
    )


def _tiles(c: Calibration, unit: Unit) -> str:
    return tiles(
        [
            (unit.text(Errors.total(c.nominal.held_out)), "error of the model as given"),
            (unit.text(Errors.total(c.baseline.held_out)), "held out, with the baseline parameters fitted"),
            (unit.text(Errors.total(c.final.held_out)), "held out, with the effects found"),
            (unit.text(Errors.total(c.noise)), "noise floor"),
            (str(len(c.found)), "effects found"),
        ]
    )


def _effects(c: Calibration) -> str:
    parts = []
    for one in c.found:
        spec = CATALOGUE[one.name]
        values = [e for e in c.effects if e.name == one.name]
        evidence = f"{number(one.evidence)} nats of evidence, {100 * one.share:.0f} % of the unexplained error removed"
        note = f"<p class='lead'>{evidence if one.evidence else 'Read off the log.'}</p>"
        equation = f"<p class='key'><code>{escape(spec.equation)}</code></p>"
        parts.append(f"<h3>{escape(spec.title)}</h3>{equation}{note}{_values(values, one.joints, c.unit)}")
    for other in c.alternatives:
        text = f"{escape(called(other.effects, c.joints))} <small>({number(other.behind)} nats behind)</small>"
        parts.append(f"<p class='lead'>Alternative this log cannot rule out: <b>{text}</b>.</p>")
    if not c.found:
        parts.append("<p class='lead'>No effect improved on the baseline model.</p>")
    return section("What the model lacked", "With 95 % intervals." if c.found else "", *parts)


def _baseline(c: Calibration) -> str:
    baseline = [e for e in c.effects if e.name not in c.names]
    whole = [e for e in baseline if not e.joints]
    by_joint = [e for e in baseline if e.joints]
    tables = [_values(by_joint, c.joints, c.unit)] if by_joint else []
    tables += [_values(whole, (), c.unit)] if whole else []
    return section(
        "Baseline model, fitted",
        "The parameters that every model has, with 95 % intervals; ▸| marks one at its bound.",
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
    return table(headings, rows, kind="narrow" if len(columns) < 4 else "")


def _in(unit: str) -> str:
    return f" [{escape(pretty(unit))}]" if unit else ""


def _value(e: EffectValues, parameter: str, i: int) -> str:
    value = float(e.values[parameter][i])
    spec = CATALOGUE[e.name].parameter(parameter)
    text = figure(value)
    if value != 0.0 and (value <= spec.low or value >= spec.high) and not spec.fixed:
        text = f"<span class=bad title='at its bound: do not trust it'>{text} ▸|</span>"
    if parameter not in e.intervals:
        return text
    low, high = (float(v) for v in e.intervals[parameter][i])
    if not (np.isfinite(low) and np.isfinite(high)):
        return text
    return f"{text} <small>{figure(low)} … {figure(high)}</small>"


def _errors(c: Calibration, unit: Unit) -> str:
    columns = [("as given", c.nominal), ("baseline fitted", c.baseline), ("final", c.final)]
    last = columns[-1][1]
    shown = (f"{name}<br><small>train / held out</small>" for name, _ in columns)
    headings = ["joint", *shown, "noise floor", "final / noise"]

    def cells(joints: slice) -> list[str]:
        def size(values: FloatArray) -> str:
            return figure(Errors.total(values[joints]) * unit.factor)

        ratio = Errors.total(last.held_out[joints]) / max(Errors.total(c.noise[joints]), 1e-300)
        explained = f"<span class=good>{figure(ratio)}</span>" if ratio < EXPLAINED else figure(ratio)
        return [*(f"{size(e.train)} / <b>{size(e.held_out)}</b>" for _, e in columns), size(c.noise), explained]

    lead = (
        f"Root mean square of measured − predicted [{unit.name}], to the end of blocks of 1.5 s. Held out: each block"
        " is predicted by a fit without it and every sixth block beside."
    )
    return section("Errors", lead, table(headings, joint_rows(c.joints, cells)), other_measures(c))


def _logs(c: Calibration, unit: Unit) -> str:
    if not c.logs:
        return ""

    def cell(values: FloatArray | None) -> str:
        return "" if values is None else figure(Errors.total(values) * unit.factor)

    rows = []
    for log in c.logs:
        alone = (log.left_out_baseline, log.left_out_final) if log.fitted else (log.baseline, log.final)
        name = escape(log.name) + ("" if log.fitted else " <small>held out</small>")
        rows.append(("", [name, *(cell(v) for v in (log.baseline, log.final, *alone))]))
    headings = ["log", "baseline fitted", "final", "baseline, fitted to the others", "final, fitted to the others"]
    lead = f"Root mean square over all joints [{unit.name}]. A log that is left out has no part in the numbers."
    return section("Each log", lead, table(headings, rows))


def _unexplained(c: Calibration) -> str:
    unit = "N" if c.unit == "m" else "N m"
    rows = []
    for r in c.unexplained:
        on = ", ".join(f"{escape(name)} <small>({100 * share:.0f} %)</small>" for name, share in r.depends_on)
        verdict = (
            "explained down to the noise floor" if r.explained else f"unknown torque, depends on {on or 'nothing'}"
        )
        torque = f"{figure(r.torque)} {unit}"
        rows.append(("", [escape(r.joint), figure(r.ratio), torque, verdict]))
    headings = ["joint", "error / noise", "unknown torque that explains the rest", "verdict"]
    table_of_joints = table(headings, rows) if rows else ""
    lists = (
        ("What to log next", c.experiments),
        ("Warnings", c.warnings),
    )
    texts = ""
    for title, lines in lists:
        if lines:
            texts += f"<h3>{title}</h3><ul>{''.join(f'<li>{escape(x)}</li>' for x in lines)}</ul>"
    return section("Unexplained residual", "", table_of_joints, texts)


def _residuals(c: Calibration, unit: Unit) -> str:
    models = {"before": "baseline model", "after": "final model"}
    timed = key(**models)
    noisy = key(**models, noise="noise floor")
    torques = torque_over_time(c)
    return "".join(
        (
            section("Residual over time", "Measured − predicted.", timed, *over_time(c, unit)),
            section("Residual of the measured torque", "Compared, not fitted.", timed, *torques) if torques else "",
            section(
                "Residual against the state",
                "Median and middle 80 % of the readings. An explained residual is flat at zero.",
                key(**models),
                f"<div class='grid3'>{''.join(against_state(c, unit))}</div>",
            ),
            section("Residual over frequency", "", noisy, f"<div class='grid3'>{''.join(spectra(c, unit))}</div>"),
        )
    )


def _footer(c: Calibration) -> str:
    rows = [("passes", f"{c.passes:,}".replace(",", " ")), ("time", f"{c.seconds:.0f} s"), *_flat(c.metadata)]
    cells = "".join(f"<tr><th>{escape(str(k))}</th><td>{escape(str(v))}</td></tr>" for k, v in rows)
    return f"<footer><table>{cells}</table></footer>"


def _flat(data: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    rows = []
    for name, value in data.items():
        if isinstance(value, Mapping):
            rows += _flat(value, f"{prefix}{name} ")
        else:
            rows.append((f"{prefix}{name}", number(value) if isinstance(value, float) else str(value)))
    return rows
