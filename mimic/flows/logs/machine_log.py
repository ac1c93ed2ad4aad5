"""Logs of machines: predict one, simulate one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mimic.config.sysid import LogMotion, LogSettings
from mimic.errors import ConfigError
from mimic.flows.logs.calibrate import checked_log, left_out, machine_of
from mimic.flows.play import load_robot
from mimic.flows.provenance import provenance
from mimic.flows.reporter import Reporter, reporting
from mimic.frozen import frozen_arrays
from mimic.io import store

if TYPE_CHECKING:
    from mimic.dynamics.machine import MachineModel
    from mimic.io.joint_log import JointLog
    from mimic.records import FloatArray

NO_EFFECTS = "as given"
"""The model without effects."""


@frozen_arrays
class Predictions:
    """How far a log is from what models predict."""

    joints: tuple[str, ...]
    unit: str
    """Unit of positions: rad or m."""
    noise: FloatArray
    """Noise floor of each joint (J,)."""
    errors: Mapping[str, Mapping[str, Any]]
    """For the model as given and for each effects file: rms (J,), all, and relative (J,) to the positions' own size."""
    warnings: Sequence[str]


def predict_log(
    log: str | Path | JointLog,
    effects: Sequence[Path] = (),
    model: str | Path | MachineModel | None = None,
    *,
    whole: bool = False,
    out: Path | None = None,
    reporter: Reporter | None = None,
) -> Predictions:
    """Return how well models predict a log that they were not fitted to; nothing is fitted.

    Args:
        log: Log of the machine.
        effects: effects.toml files of calibrations, to compare them; the model as given always comes first.
        model: MJCF whose base is held; by default the CyberDog 2 hung up.
        whole: Replay the log in one piece; otherwise to the end of blocks of 1.5 s.
        out: Also write the errors into this JSON file.
        reporter: Receives progress.

    Raises:
        ConfigError: If a file is named twice, or an effect names a joint that the machine lacks.
        CalibrationError, AssetError: If the log or a file cannot be used.
    """
    import numpy as np

    from mimic.dynamics.effect_set import EffectSet, read_effects
    from mimic.dynamics.machine import as_logged
    from mimic.sysid.predict import predict
    from mimic.sysid.result import Errors

    if len(set(effects)) < len(effects):
        raise ConfigError(f"--effects names a file twice: {', '.join(map(str, effects))}")
    if out is not None:
        store.check_file(out)
    with (reporting(reporter)).activity("passes") as show:
        show("reading the log", 0)
        sets = {NO_EFFECTS: EffectSet(), **{str(file): read_effects(file) for file in effects}}
        check, machine, warnings = checked_log(log, model, show)
        readings = check.log
        machine = as_logged(machine, readings.metadata, by_force=readings.q_des is None)
        errors: dict[str, Any] = {}
        for name, held in sets.items():
            show("replaying the model as given" if name == NO_EFFECTS else f"replaying it with {name}", 0)
            residual = predict(readings, machine, held, whole=whole)
            known = np.isfinite(residual).all(axis=1)
            squares, size = ((x[known] ** 2).mean(axis=0) for x in (residual, readings.q))
            relative = np.sqrt(squares / np.maximum(size, 1e-300))
            rms = np.sqrt(squares)
            errors[name] = {"rms": rms, "all": Errors.total(rms), "relative": relative}
    found = Predictions(
        joints=machine.joints, unit=machine.unit, noise=check.noise, errors=errors, warnings=tuple(warnings)
    )
    if out is not None:
        files = {"log": log, "model": model, **{f"effects {i}": f for i, f in enumerate(effects)}}
        inputs = {name: Path(f) for name, f in files.items() if isinstance(f, (str, Path))}
        store.save_json({**vars(found), "whole": whole, "provenance": provenance({"whole": whole}, inputs)}, out)
    return found


def simulate_log(
    effects: Path | None = None,
    model: str | Path | None = None,
    motion: LogMotion | None = None,
    settings: LogSettings | None = None,
    *,
    out: Path | None = None,
    reporter: Reporter | None = None,
) -> JointLog:
    """Log a simulated machine with hidden effects, as a real one would be logged.

    Args:
        effects: effects.toml with what the machine has; None leaves it as its model says.
        model: MJCF whose base is held; by default the CyberDog 2 hung up.
        motion: How its joints are moved.
        settings: Rate, noise and losses of the readings.
        out: Also write the log into this file (.parquet or .csv).
        reporter: Receives progress.

    Raises:
        ConfigError: If a number or a file name cannot be used.
        AssetError: If a file cannot be read.
    """
    import numpy as np

    from mimic.dynamics.effect_set import EffectSet, read_effects
    from mimic.dynamics.excitation import hung_ranges, probe_targets
    from mimic.io.joint_log import write_log
    from mimic.sysid.predict import simulate_log as simulate

    motion = motion or LogMotion()
    settings = settings or LogSettings()
    if out is not None:
        if out.suffix.lower() not in (".parquet", ".csv"):
            raise ConfigError(f"{out} is neither .parquet nor .csv; name a log that can be written")
        store.check_file(out)
    hidden = read_effects(effects) if effects else EffectSet()
    given = {"kp": motion.kp, "kd": motion.kd}
    machine = machine_of(model, {name: value for name, value in given.items() if value is not None})
    reporter = reporting(reporter)
    for line in left_out(machine):
        reporter.warn(line)
    if model is None:
        low, high, centre = hung_ranges(load_robot())
    else:
        low = np.asarray(machine.low)
        high = np.asarray(machine.high)
        unlimited = [j for j, a, b in zip(machine.joints, low, high, strict=True) if not np.isfinite(b - a)]
        if unlimited:
            raise ConfigError(
                f"joint {unlimited[0]!r} of {model} has no range; give it one, so that the motion is known"
            )
        centre = (low + high) / 2
    if not np.asarray(machine.drives.kp).all():
        raise ConfigError(f"{model} has no position gain; give --kp and --kd, or position actuators in the model")
    moved = probe_targets(
        low, high, centre, seconds=motion.seconds, seed=settings.seed, kind=motion.motion, size=motion.amplitude
    )
    with reporter.activity("") as show:
        show(f"simulating {motion.seconds:g} s", 0)
        log = simulate(machine, moved.t, moved.q_des, hidden, settings)
    log = replace(log, metadata={**log.metadata, "motion": motion.motion, "seed": settings.seed})
    if out is not None:
        write_log(log, out)
    return log
