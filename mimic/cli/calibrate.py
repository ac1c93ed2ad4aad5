"""``mimic calibrate``: what a model lacks, from a log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mimic.cli import options as o
from mimic.cli.terminal.console import ConsoleReporter, console, matrix, note, table, warn
from mimic.cli.terminal.exit_status import DONE, USER_ERROR
from mimic.errors import ConfigError
from mimic.io.store import free_folder

if TYPE_CHECKING:
    from mimic.records import FloatArray
    from mimic.sysid.result import Calibration
    from mimic.view.report.plots import Unit


def calibrate(
    *logs: Path,
    model: Path | None = None,
    held_out: tuple[Path, ...] = (),
    note: tuple[str, ...] = (),
    compare: Path | None = None,
    out: o.Out = None,
    settings: o.Calibrate = None,
) -> int:
    """Find what the model of a machine lacks, with evidence, and write a model that has it.

    Parameters
    ----------
    logs
        Parquet or CSV logs of one machine, one row per reading: t, q.JOINT, q_des.JOINT. More columns: see
        Log format in the manual.
    model
        MJCF of the machine, base fixed; default: the suspended CyberDog 2.
    held_out
        Logs of the same machine that are predicted, not fitted.
    note
        Extra metadata: KEY=VALUE for all logs, FILE:KEY=VALUE for one, such as kp=20 or b.csv:payload=0.5.
    compare
        Log of another unit of the machine: say which effect differs between the two. Nothing is written.
    out
        Folder for report.html, calibration.json, effects.toml, model.xml and actuators.json; default:
        calibration/NAME, with a number appended if it exists.
    """
    from mimic.flows.logs.calibrate import ACTUATORS, EFFECTS, MODEL, REPORT, RESULT
    from mimic.flows.logs.calibrate import calibrate as explain

    if compare is not None:
        if held_out or out is not None:
            raise ConfigError("--compare holds no log out and writes nothing; leave out --held-out and --out")
        return _compare(logs, compare, model, settings, note)
    folder = out or free_folder(Path("calibration") / (logs[0].stem if logs else "log"))
    result = explain(list(logs), model, settings, held_out=held_out, notes=note, out=folder, reporter=ConsoleReporter())
    files = [folder / name for name in (REPORT, RESULT, EFFECTS, MODEL, ACTUATORS)]
    _show(result, [file for file in files if file.exists()])
    return DONE if result.log_matches_model else USER_ERROR


def _compare(
    logs: Sequence[Path], other: Path, model: Path | None, settings: o.Calibrate, notes: tuple[str, ...]
) -> int:
    """Print how two units differ."""
    from mimic.flows.logs.compare_units import compare
    from mimic.view.report.svg import number

    if len(logs) != 1:
        raise ConfigError(f"--compare compares two logs, and {len(logs)} are given beside it; give one")
    if logs[0] == other:
        raise ConfigError(f"--compare {other} is the log itself; give that of another unit")
    first, second = (logs[0].stem, other.stem) if logs[0].stem != other.stem else (str(logs[0]), str(other))
    differences = compare(logs[0], other, model, settings, notes=notes, reporter=ConsoleReporter())
    rows = {
        f"{one.effect}.{one.parameter} {one.joint}".strip(): {
            first: f"{number(one.first)} {one.unit}".strip(),
            second: f"{number(one.second)} {one.unit}".strip(),
            "standard errors": f"{one.z:+.1f}",
        }
        for one in differences
    }
    matrix("Effects of both units", rows, as_is=True)
    sure = [name for name, one in zip(rows, differences, strict=True) if one.sure]
    console.print(f"The units differ in {', '.join(sure)}." if sure else "Nothing differs that noise does not explain.")
    return DONE


def _show(result: Calibration, written: list[Path]) -> None:
    from mimic.view.report.plots import unit_for

    for text in result.warnings:
        warn(text)
    unit = unit_for(result)
    stages = {"as given": result.nominal, "baseline fitted": result.baseline, "final": result.final}
    columns = {name: e.held_out for name, e in stages.items()}
    show_errors("Held-out error", result.joints, {**columns, "noise floor": result.noise}, unit)
    found = _found(result)
    if found:
        table("Found", found)
    console.print()
    console.print(result.sentence, style="bold", markup=False, soft_wrap=True)
    for line in result.experiments:
        note(f"log next: {line}")
    note(f"wrote {', '.join(map(str, written))} ({result.passes} passes, {result.seconds:.0f} s)")


def show_errors(title: str, joints: Sequence[str], columns: Mapping[str, FloatArray], unit: Unit) -> None:
    """Print errors (J,) in columns, a row for each joint and, of several, one for all."""
    from mimic.sysid.result import Errors
    from mimic.view.report.svg import figure

    rows = {}
    for i, joint in enumerate(joints):
        rows[joint] = {name: figure(unit.factor * float(values[i])) for name, values in columns.items()}
    if len(joints) > 1:
        rows["all"] = {name: figure(unit.factor * Errors.total(values)) for name, values in columns.items()}
    matrix(f"{title} [{unit.name}]", rows, as_is=True)


def _found(result: Calibration) -> dict[str, str]:
    """Return the values of what was added to the baseline model, the range over the joints."""
    from mimic.dynamics.catalogue import CATALOGUE, unit_of
    from mimic.view.report.svg import number

    rows = {}
    for e in result.effects:
        if e.name not in {one.name for one in result.found}:
            continue
        parts = []
        for name, values in e.values.items():
            low = number(float(values.min()))
            high = number(float(values.max()))
            span = low if low == high else f"{low} … {high}"
            parts.append(f"{name} {span} {unit_of(e.name, name, result.unit)}".strip())
        where = f" ({len(e.joints)} joints)" if len(e.joints) > 1 else f" ({e.joints[0]})" if e.joints else ""
        rows[CATALOGUE[e.name].title + where] = ", ".join(parts)
    return rows
