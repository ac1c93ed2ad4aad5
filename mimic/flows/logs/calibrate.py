"""Logs of machines: which effects a model lacks."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mimic.config.sysid import CalibrateSettings
from mimic.config.text_file import from_json
from mimic.errors import AssetError, CalibrationError, ConfigError
from mimic.flows.play import load_robot
from mimic.flows.provenance import COMMAND, provenance
from mimic.flows.reporter import Activity, Reporter, reporting
from mimic.io import store

if TYPE_CHECKING:
    from mimic.dynamics.machine import MachineModel
    from mimic.io.joint_log import JointLog
    from mimic.sysid.log.checks import LogCheck
    from mimic.sysid.result import Calibration

REPORT = "report.html"
"""Report of a calibration."""
RESULT = "calibration.json"
"""Its figures."""
NEXT = "next_motion.parquet"
"""Targets that tell what was found from the nearest alternative, as a log with what the model predicts."""

EFFECTS = "effects.toml"
"""Its effects, as simulation and training read them."""
MODEL = "model.xml"
"""The MJCF with these effects, where the drives control torque."""
ACTUATORS = "actuators.json"
"""The same as actuator settings of mjlab and Isaac Lab."""


def calibrate(
    log: str | Path | JointLog | Sequence[str | Path | JointLog],
    model: str | Path | MachineModel | None = None,
    settings: CalibrateSettings | None = None,
    *,
    held_out: Sequence[str | Path | JointLog] = (),
    notes: Sequence[str] = (),
    out: Path | None = None,
    reporter: Reporter | None = None,
) -> Calibration:
    """Find what a model of a machine lacks, with evidence, from logs of the machine.

    Args:
        log: Parquet or CSV file with a row for each reading (docs/manual/log-format.md), a log in memory, or several,
            each with its own gains, supply voltage and payload.
        held_out: More logs of the machine, for validation: they are predicted, not fitted.
        notes: Extra metadata: KEY=VALUE for all logs, FILE:KEY=VALUE for one.
        model: MJCF whose base is held, or a machine; by default the CyberDog 2 hung up.
        settings: How the log is explained.
        out: Also write report.html, calibration.json, effects.toml, model.xml and actuators.json into this folder,
            which must not hold an earlier calibration.
        reporter: Receives progress; warnings are in the result.

    Returns:
        Effects with their values and intervals, errors before and after on held-out data, and what stays unexplained.

    Raises:
        CalibrationError: If a log cannot be used, does not fit the model, or contradicts another.
        AssetError: If a file cannot be read.
        ConfigError: If a setting names an effect that does not exist, a note is none, or ``out`` holds a calibration.
    """
    from mimic.io.joint_log import JointLog
    from mimic.sysid.calibrate import calibrate as explain
    from mimic.sysid.calibrate import check_names

    settings = settings or CalibrateSettings()
    reporter = reporting(reporter)
    if out is not None:
        if out.exists() and not out.is_dir():
            raise ConfigError(f"{out} is a file; name a folder with --out")
        if (out / RESULT).exists():
            raise ConfigError(f"{out} holds an earlier calibration; name another folder with --out, or remove it")
        store.check_writable(out)
    check_names(settings)
    logs = [log] if isinstance(log, (str, Path, JointLog)) else list(log)
    if not logs:
        raise ConfigError("no log is given; give one log of the machine or more (.parquet or .csv)")
    given = [*logs, *held_out]
    names = _names(given)
    kind = [] if settings.drive == "log" else [f"drive={settings.drive}"]
    said = _said([*notes, *kind], given)
    with reporter.activity("passes") as show:
        checked = _checked_logs(given, names, said, model, show)
        usable = [check.log for check, _, _ in checked]
        machine = checked[0][1]
        fitted = usable[: len(logs)]
        unseen = usable[len(logs) :]
        result = explain(fitted, machine, settings, show, held_out=unseen, names=names)
    warnings = [line for _, _, lines in checked for line in lines]
    files = {f"log {i + 1}" if i else "log": Path(one) for i, one in enumerate(given) if isinstance(one, (str, Path))}
    if isinstance(model, (str, Path)):
        files["model"] = Path(model)
    name = names[0] if len(logs) == 1 else f"{len(logs)} logs: {', '.join(names[: len(logs)])}"
    result = _signed(result, name, warnings, store.plain(provenance(settings, files)))
    if out is not None:
        source = files.get("model") if machine.drives.volts is None else None
        save_calibration(result, out, source, machine)
    return result


def _write_models(source: Path, machine: MachineModel, result: Calibration, folder: Path) -> None:
    """Write the machine with its effects for other programs; what they cannot hold is named in ACTUATORS."""
    from mimic.dynamics.written_model import actuator_settings, write_mjcf

    settings = actuator_settings(machine, result.effects)
    try:
        write_mjcf(source, machine, result.effects, folder / MODEL)
    except AssetError as reason:
        settings[MODEL] = str(reason)
    store.save_json(settings, folder / ACTUATORS)


def _signed(result: Calibration, name: str, warnings: Sequence[str], made_by: dict[str, Any]) -> Calibration:
    """Return a calibration with what the flow knows: the name of its logs, their warnings, and what made it."""
    from mimic.dynamics.effect_set import EffectSet

    return replace(
        result,
        warnings=tuple(dict.fromkeys((*warnings, *result.warnings))),
        metadata={"name": name, **result.metadata, "provenance": made_by},
        effects=EffectSet(tuple(replace(e, source=f"calibration of {name}") for e in result.effects)),
    )


def _checked_logs(
    given: Sequence[str | Path | JointLog],
    names: Sequence[str],
    said: Sequence[Mapping[str, Any]],
    model: str | Path | MachineModel | None,
    show: Activity,
) -> list[tuple[LogCheck, MachineModel, list[str]]]:
    """Return what `checked_log` does for each log; where there are several, messages begin with the name of one.

    Raises:
        CalibrationError, AssetError: If a log cannot be used or contradicts another.
    """
    from mimic.sysid.log.pool import refuse_contradictions

    prefix = [f"{name}: " if len(given) > 1 else "" for name in names]
    read = []
    for one, name, told, start in zip(given, names, said, prefix, strict=True):
        show(f"reading {name}" if start else "reading the log", 0)
        with _errors_begin_with(start):
            read.append(_read(one, told))
    refuse_contradictions(read, names)  # before a log is held against the model, which names one log only
    checked = []
    for log, start in zip(read, prefix, strict=True):
        with _errors_begin_with(start):
            check, machine, warnings = checked_log(log, model, show)
        checked.append((check, machine, [start + line for line in warnings]))
    return checked


@contextmanager
def _errors_begin_with(start: str) -> Iterator[None]:
    try:
        yield
    except CalibrationError as wrong:
        raise CalibrationError(f"{start}{wrong}") from None


def _names(logs: Sequence[str | Path | JointLog]) -> list[str]:
    """Return a name for each log: that of its file, with its folder where two files have the same.

    Raises:
        ConfigError: If a file is given twice.
    """
    files = [Path(one) if isinstance(one, (str, Path)) else None for one in logs]
    paths = [file.resolve() for file in files if file is not None]
    if len(set(paths)) < len(paths):
        twice = next(file for file in files if file is not None and paths.count(file.resolve()) > 1)
        raise ConfigError(f"{twice} is given twice; a log that is held out must be another than the fitted ones")
    short = [file.name for file in files if file is not None]
    names = []
    for i, file in enumerate(files):
        if file is None:
            names.append("a log in memory" if len(logs) == 1 else f"log {i + 1}")
        else:
            names.append(file.name if short.count(file.name) == 1 else str(file))
    return names


def _said(notes: Sequence[str], logs: Sequence[str | Path | JointLog]) -> list[dict[str, Any]]:
    """Return what notes say of each log.

    Raises:
        ConfigError: If one is not KEY=VALUE, or names no log.
    """
    said: list[dict[str, Any]] = [{} for _ in logs]
    for note in notes:
        head, equals, text = note.partition("=")
        file, colon, key = head.rpartition(":")
        if not equals or not key:
            raise ConfigError(f"--note {note}: expected KEY=VALUE or FILE:KEY=VALUE, such as kp=20 or b.csv:kp=10")
        try:
            value = from_json(text)
        except ValueError:
            value = text
        of = [
            i
            for i, one in enumerate(logs)
            if not colon or (isinstance(one, (str, Path)) and file in (str(one), Path(one).name))
        ]
        if not of:
            known = ", ".join(str(one) for one in logs if isinstance(one, (str, Path)))
            raise ConfigError(f"--note {note}: {file} is none of the logs: {known}")
        for i in of:
            said[i][key] = value
    return said


def _read(log: str | Path | JointLog, notes: Mapping[str, Any]) -> JointLog:
    """Return a log; notes override its metadata."""
    from mimic.io.joint_log import read_log

    if isinstance(log, (str, Path)):
        return read_log(Path(log), notes)
    return replace(log, metadata={**log.metadata, **notes}) if notes else log


def checked_log(
    log: str | Path | JointLog,
    model: str | Path | MachineModel | None,
    show: Activity,
) -> tuple[LogCheck, MachineModel, list[str]]:
    """Return a log that can be used, its machine, and warnings about them.

    Args:
        log: The log.
        model: The machine.
        show: Receives progress.

    Raises:
        CalibrationError, AssetError: If one of them cannot be used.
    """
    import numpy as np

    from mimic.sysid.log.checks import check_log

    log = _read(log, {})
    machine = machine_of(model, log.metadata)
    log = log.of(machine.joints)
    show("checking the log", 0)
    check = check_log(log, np.stack([machine.low, machine.high], -1), unit=machine.unit)
    return check, machine, [*left_out(machine), *_missing_gains(log, machine), *check.warnings]


def machine_of(model: str | Path | MachineModel | None, gains: Mapping[str, Any]) -> MachineModel:
    """Return the machine of an MJCF, or the robot hung up, with these gains (kp, kd).

    Raises:
        AssetError: If there is no such model.
    """
    from mimic.dynamics.machine import MachineModel, hung_robot, read_machine, with_gains

    if isinstance(model, MachineModel):
        return with_gains(model, gains)
    if model is None:
        return with_gains(hung_robot(load_robot()), gains)
    path = Path(model)
    if not path.is_file():
        raise AssetError(f"there is no model {path}; give an MJCF whose base is held")
    return read_machine(path, gains)


def left_out(machine: MachineModel) -> list[str]:
    """Return a warning where the machine lacks parts of its file."""
    return [f"mimic leaves out of the model: {'; '.join(machine.dropped)}"] if machine.dropped else []


def _missing_gains(log: JointLog, machine: MachineModel) -> list[str]:
    """Return a warning where the log lacks gains that its targets need."""
    lacking = [key for key in ("kp", "kd") if key not in log.metadata and machine.drives.volts is None]
    if log.q_des is None or not lacking:
        return []
    own = []
    for key in lacking:
        values = sorted(set(map(float, getattr(machine.drives, key))))
        own.append(f"{key} {', '.join(f'{value:.4g}' for value in values[:3])}{' …' if len(values) > 3 else ''}")
    return [f"the notes of the log lack {' and '.join(lacking)}; the model's values are used: {' and '.join(own)}"]


def save_calibration(result: Calibration, out: Path, source: Path | None, machine: MachineModel) -> None:
    """Write all files of a calibration, or none; effects and models only where log and model fit together.

    Args:
        result: The calibration.
        out: Folder.
        source: An MJCF that is then written with the effects for other programs; None for a machine of no file.
        machine: The machine in it.
    """
    from mimic.dynamics.effect_set import write_effects
    from mimic.io.joint_log import write_log
    from mimic.view.report.html import write_report

    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out, prefix=".part") as folder:
        part = Path(folder)
        write_report(result, part / REPORT)
        store.save_json(result.to_json(), part / RESULT)
        if result.log_matches_model:
            write_effects(result.effects, part / EFFECTS, (result.sentence, f"Made by: {COMMAND.get()}"))
            if source is not None:
                _write_models(source, machine, result, part)
            if result.next_motion is not None and result.next_motion.tells:
                write_log(result.next_motion.log, part / NEXT)
        for name in (REPORT, RESULT, EFFECTS, MODEL, ACTUATORS, NEXT):
            if (part / name).is_file():
                (part / name).replace(out / name)
            else:
                (out / name).unlink(missing_ok=True)  # of an earlier log
