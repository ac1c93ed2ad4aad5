"""Explaining logs and simulating them, from the command line."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from mimic import store
from mimic.cli import COMMAND
from mimic.cli.app import DONE, USER
from mimic.cli.console import console, matrix, note, table, warn, working
from mimic.errors import AssetError, ConfigError
from mimic.settings import CalibrateSettings, LogSettings

if TYPE_CHECKING:
    from mimic.calibrate.checks import LogFacts
    from mimic.calibration import Calibration
    from mimic.machine_log import MachineLog
    from mimic.robot.machine import MachineModel
    from mimic.types import FloatArray
    from mimic.view.report_plots import Unit

REPORT, RESULT, EFFECTS = "report.html", "calibration.json", "effects.toml"
"""Files of a calibration."""

AS_GIVEN = "as given"
"""The model without effects."""


@dataclass(frozen=True, kw_only=True)
class MotionOptions:
    """The motion of a simulated log."""

    kind: Literal["probe", "random"]
    seconds: float
    """[s]"""
    size: float
    """Share of the joints' ranges."""
    kp: float | None
    """[N m/rad]; None for the model's."""
    kd: float | None
    """[N m s/rad]; None for the model's."""


def machine_of(model: Path | None, gains: Mapping[str, Any]) -> MachineModel:
    """Return the machine of an MJCF, or the robot hung up, with these gains."""
    from mimic.robot.machine import hung_robot, read_machine, with_gains

    if model is None:
        from mimic.robot.description import load_description

        return with_gains(hung_robot(load_description()), gains)
    if not model.is_file():
        raise AssetError(f"there is no model {model}; give an MJCF whose base is held")
    return read_machine(model, gains)


def calibrate_log(path: Path, model: Path | None, out: Path, settings: CalibrateSettings) -> int:
    """Explain a log, print what was found, and write report, numbers and effects."""
    if out.exists() and not out.is_dir():
        raise ConfigError(f"{out} is a file; name a folder with --out")
    store.check_writable(out)
    with working("replays") as tell:
        tell("reading", 0)
        from mimic.calibrate.flow import calibrate, check_names
        from mimic.robot.effect_set import EffectSet

        check_names(settings)
        facts, machine, told = _checked(path, model, tell)
        result = calibrate(facts.log, machine, settings, tell)
    inputs = {"log": path} | ({"model": model} if model else {})
    made_by = store.provenance(command=COMMAND.get(), settings=settings, inputs=inputs)
    warnings = tuple(dict.fromkeys((*told, *result.warnings)))
    metadata = {"name": path.name, **result.metadata, "provenance": store.plain(made_by)}
    effects = EffectSet(tuple(replace(e, source=f"calibration of {path.name}") for e in result.effects))
    result = replace(result, warnings=warnings, metadata=metadata, repeatability=facts.repeatability, effects=effects)
    written = _write(result, out)
    _tell(result, written)
    return DONE if result.belongs else USER


def _checked(
    path: Path, model: Path | None, tell: Callable[[str, int], None]
) -> tuple[LogFacts, MachineModel, list[str]]:
    """Return a log that can be used, its machine, and what the user should know of them."""
    import numpy as np

    from mimic.calibrate.checks import check_log
    from mimic.machine_log import read_log

    log = read_log(path)
    machine = machine_of(model, log.metadata)
    log = log.of(machine.joints)
    tell("checking the log", 0)
    limits = np.stack([machine.low, machine.high], -1)
    facts = check_log(log, limits, torque=np.asarray(machine.drives.torque), unit=machine.unit)
    return facts, machine, [*_gains_of_the_model(log, machine), *facts.warnings]


def _gains_of_the_model(log: MachineLog, machine: MachineModel) -> list[str]:
    """Return a line where the log does not tell gains that its targets need."""
    lacking = [key for key in ("kp", "kd") if key not in log.metadata]
    if log.q_des is None or not lacking:
        return []
    from mimic.view.svg import number

    own = ((key, sorted(set(map(float, getattr(machine.drives, key))))) for key in lacking)
    values = " and ".join(f"{key} {', '.join(map(number, row[:3]))}{' …' if len(row) > 3 else ''}" for key, row in own)
    return [f"the notes of the log do not tell {' and '.join(lacking)}: those of the model are taken, {values}"]


def _write(result: Calibration, out: Path) -> list[Path]:
    """Write all files of a calibration, or none; effects only where log and model belong together."""
    from mimic.robot.effect_set import write_effects
    from mimic.view.report import write_report

    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out, prefix=".part") as folder:
        part = Path(folder)
        made = [write_report(result, part / REPORT)]
        store.save_json(result.to_json(), part / RESULT)
        made.append(part / RESULT)
        if result.belongs:
            comment = (result.sentence, f"Made by: {COMMAND.get()}")
            made.append(write_effects(result.effects, part / EFFECTS, comment))
        else:
            (out / EFFECTS).unlink(missing_ok=True)  # of an earlier log
        return [file.replace(out / file.name) for file in made]


def _tell(result: Calibration, written: list[Path]) -> None:
    from mimic.view.report_plots import unit_for

    for text in result.warnings:
        warn(text)
    unit = unit_for(result)
    stages = {"as given": result.nominal}
    if result.stages:
        stages["declared fitted"] = result.stages[0].errors
    if len(result.stages) > 1:
        stages["final"] = result.stages[-1].errors
    columns = {name: e.held_out for name, e in stages.items()}
    _show_errors("Held-out error", result.joints, {**columns, "noise floor": result.noise}, unit)
    found = _found(result)
    if found:
        table("Found", found)
    console.print()
    console.print(result.sentence, style="bold", markup=False, soft_wrap=True)
    for line in result.experiments:
        note(f"log next: {line}")
    note(f"wrote {', '.join(map(str, written))} ({result.replays} replays, {result.seconds:.0f} s)")


def _show_errors(title: str, joints: Sequence[str], columns: Mapping[str, FloatArray], unit: Unit) -> None:
    """Print errors (J,) in columns, a row for each joint and, of several, one for all."""
    from mimic.calibration import Errors
    from mimic.view.svg import figure

    rows = {
        joint: {name: figure(unit.factor * float(values[i])) for name, values in columns.items()}
        for i, joint in enumerate(joints)
    }
    if len(joints) > 1:
        rows["all"] = {name: figure(unit.factor * Errors.total(values)) for name, values in columns.items()}
    matrix(f"{title} [{unit.name}]", rows, as_is=True)


def _found(result: Calibration) -> dict[str, str]:
    """Return the values of what was added to the declared model, the range over the joints."""
    from mimic.robot.effects import CATALOGUE, unit_of
    from mimic.view.svg import number

    added = {s.added for s in result.stages}
    rows = {}
    for e in result.effects:
        if e.name not in added:
            continue
        parts = []
        for name, values in e.values.items():
            low, high = number(float(values.min())), number(float(values.max()))
            span = low if low == high else f"{low} … {high}"
            parts.append(f"{name} {span} {unit_of(e.name, name, result.unit)}".strip())
        where = f" ({len(e.joints)} joints)" if len(e.joints) > 1 else f" ({e.joints[0]})" if e.joints else ""
        rows[CATALOGUE[e.name].title + where] = ", ".join(parts)
    return rows


def replay_log(
    path: Path, effects: Sequence[Path], model: Path | None, whole: bool, threads: int, out: Path | None
) -> int:
    """Print how far a log is from what a model foretells, as given and with the effects of each file, and write it."""
    if not 0 <= threads <= 1024:
        raise ConfigError(f"threads is {threads}; it must be from 0 to 1024")
    if len(set(effects)) < len(effects):
        raise ConfigError(f"--effects names a file twice: {', '.join(map(str, effects))}")
    if out is not None:
        store.check_writable(out.parent)
    with working("") as tell:
        tell("reading", 0)
        import numpy as np

        from mimic.calibrate.foretell import foretell
        from mimic.calibration import Errors
        from mimic.robot.effect_set import EffectSet, read_effects
        from mimic.robot.machine import as_logged
        from mimic.view.report_plots import unit_of_size

        sets = {AS_GIVEN: EffectSet(), **{str(file): read_effects(file) for file in effects}}
        facts, machine, told = _checked(path, model, tell)
        log = facts.log
        machine = as_logged(machine, log.metadata, by_force=log.q_des is None)
        errors: dict[str, Any] = {}
        for name, held in sets.items():
            tell(f"replaying the model {name}" if name == AS_GIVEN else f"replaying it with {name}", 0)
            residual = foretell(log, machine, held, whole=whole, threads=threads)
            known = np.isfinite(residual).all(axis=1)
            squares, size = ((x[known] ** 2).mean(axis=0) for x in (residual, log.q))
            relative = np.sqrt(squares / np.maximum(size, 1e-300))
            rms = np.sqrt(squares)
            errors[name] = {"rms": rms, "all": Errors.total(rms), "relative": relative}
    for text in told:
        warn(text)
    unit = unit_of_size(max(e["all"] for e in errors.values()), machine.unit)
    columns = zip([AS_GIVEN, *_short(effects)], (e["rms"] for e in errors.values()), strict=True)
    _show_errors("Error", machine.joints, {**dict(columns), "noise floor": facts.noise}, unit)
    if out is not None:
        inputs = {
            "log": path,
            **({"model": model} if model else {}),
            **{f"effects {i}": f for i, f in enumerate(effects)},
        }
        made_by = store.provenance(command=COMMAND.get(), settings={"whole": whole}, inputs=inputs)
        found = {"joints": machine.joints, "unit": machine.unit, "whole": whole, "noise": facts.noise, "errors": errors}
        store.save_json({**found, "provenance": made_by}, out)
        note(f"wrote {out}")
    return DONE


def _short(files: Sequence[Path]) -> list[str]:
    """Return names of files for headings: as short as they can be told apart."""
    ways = ([f.name for f in files], [f.parent.name for f in files], [str(f) for f in files])
    return next(names for names in ways if len(set(names)) == len(names) or names is ways[-1])


def simulate_to(
    out: Path, effects: Path | None, model: Path | None, motion: MotionOptions, settings: LogSettings
) -> int:
    """Write the log of a simulated machine."""
    import numpy as np

    from mimic.calibrate.simulate import simulate_log
    from mimic.machine_log import write_log
    from mimic.robot.description import load_description
    from mimic.robot.effect_set import EffectSet, read_effects
    from mimic.robot.excitation import hung_ranges, probe_targets

    if out.suffix.lower() not in (".parquet", ".csv"):
        raise ConfigError(f"{out} is neither .parquet nor .csv; name a log that can be written")
    store.check_writable(out.parent)
    hidden = read_effects(effects) if effects else EffectSet()
    given = {"kp": motion.kp, "kd": motion.kd}
    for name, value in given.items():
        if value is not None and not 0.0 <= value < 1e9:
            raise ConfigError(f"{name} is {value:g}; a gain is a number of at least 0")
    machine = machine_of(model, {name: value for name, value in given.items() if value is not None})
    if model is None:
        low, high, centre = hung_ranges(load_description())
    else:
        low, high = np.asarray(machine.low), np.asarray(machine.high)
        open_ended = [j for j, a, b in zip(machine.joints, low, high, strict=True) if not np.isfinite(b - a)]
        if open_ended:
            raise ConfigError(
                f"joint {open_ended[0]!r} of {model} has no range; give it one, so that the motion is known"
            )
        centre = (low + high) / 2
    if not np.asarray(machine.drives.kp).all():
        raise ConfigError(f"{model} has no position gain; give --kp and --kd, or position actuators in the model")
    moved = probe_targets(
        low, high, centre, seconds=motion.seconds, seed=settings.seed, kind=motion.kind, size=motion.size
    )
    with working("") as tell:
        tell(f"simulating {motion.seconds:g} s", 0)
        log = simulate_log(machine, moved.t, moved.q_des, hidden, settings)
    sections = [[name, moved.t[a], moved.t[min(b, len(moved.t) - 1)]] for name, a, b in moved.sections]
    note_ = {"motion": motion.kind, "sections": sections, "seed": settings.seed}
    write_log(replace(log, metadata={**log.metadata, **note_}), out)
    note(f"wrote {out}: {len(log.t)} readings of {len(log.joints)} joints; explain it with: mimic calibrate {out}")
    return DONE
