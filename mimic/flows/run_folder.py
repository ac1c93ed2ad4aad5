"""A run, and its folder: the name, the files, and how they are written."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mimic.errors import ConfigError
from mimic.flows.provenance import provenance
from mimic.flows.reporter import Reporter, reporting
from mimic.frozen import frozen_arrays
from mimic.io import store
from mimic.records import HealthLog, Provenance, RunLog
from mimic.records.table import ShownAsTable

if TYPE_CHECKING:
    from mimic.control.loop import RunResult
    from mimic.control.safety.supervisor import Event
    from mimic.flows.motions.camera_record import CameraRecord
    from mimic.flows.motions.motion import Motion
    from mimic.robot.description import RobotDescription
    from mimic.view.scene.footage import Footage

POSE = "pose.parquet"
TARGETS = "targets.parquet"
COMMANDS = "commands.parquet"
SCRIPT = "motion.yaml"
LOG = "log.parquet"
HEALTH = "health.parquet"
JOINTS = "joints.parquet"
METRICS = "metrics.json"
SCENE = "scene.rrd"
ERROR = "error.txt"


@frozen_arrays
class Run(ShownAsTable):
    """What came of playing a motion."""

    motion: Motion | None
    """What was played; None where commands came live or the robot just stood."""
    result: RunResult
    description: RobotDescription
    inputs: Mapping[str, Path] = field(default_factory=dict)
    """Files that decided it besides the source: policies, effects."""

    @property
    def log(self) -> RunLog:
        """Every control tick."""
        return self.result.log

    @property
    def health(self) -> HealthLog:
        """What the robot reported about itself, a row for each tick."""
        return self.result.health

    @property
    def events(self) -> tuple[Event, ...]:
        """What the supervisor found."""
        return self.result.events

    @cached_property
    def complete_log(self) -> RunLog:
        """The log with sensor dropouts filled in, for metrics and pictures."""
        from mimic.control.dropouts import fill_dropouts

        return fill_dropouts(self.result.log, self.description)

    @cached_property
    def metrics(self) -> dict[str, Any]:
        """Figures of the run: toe error [cm], lag [s], torque [N m], heat, falls; see mimic.metrics.run_metrics."""
        from mimic.metrics import run_metrics, wanted_to_reached

        figures = run_metrics(self.complete_log, self.description)
        targets = None if self.motion is None else self.motion.targets
        if targets is not None:
            figures["wanted_to_reached_cm"] = wanted_to_reached(self.complete_log, targets)
        return figures

    def shown(self) -> dict[str, str]:
        """Return the figures of the run in words, by name."""
        from mimic.metrics import metric_rows

        return metric_rows(self.metrics)

    @property
    def shortfall(self) -> str | None:
        """What the robot did not do, as a sentence without its full stop: it never stood up, or was damped early."""
        from mimic.control.safety.supervisor import SafetyMode

        ends = ("finished", "at_rest")
        damped = next((e for e in self.events if e.mode >= SafetyMode.DAMP and e.rule not in ends), None)
        parts = [] if math.isfinite(self.metrics["stand_up_s"]) else ["the robot never stood up"]
        if damped is not None:
            parts.append(f"the robot was damped at {damped.t:.1f} s: {damped.text}")
        return "; ".join(parts) or None

    def save(self, folder: str | Path, reporter: Reporter | None = None) -> SavedRun:
        """Write the run folder: logs, motion, metrics.json and the Rerun scene.

        Args:
            folder: Run folder; files of an earlier run in it are replaced.
            reporter: Receives progress.

        Raises:
            AssetError: If nothing can be written there.
        """
        store.check_writable(Path(folder))
        return save_run(self, Path(folder), reporting(reporter))


@frozen_arrays
class SavedRun(ShownAsTable):
    """A run and what was written of it."""

    run: Run
    folder: Path
    metrics: Mapping[str, Any]
    """Figures of the run, as in metrics.json."""
    film: Path | None = None

    def shown(self) -> dict[str, str]:
        """Return the figures of the run and its folder in words, by name."""
        return {**self.run.shown(), "run folder": str(self.folder)}


def new_run_folder(source: Path | str, out: Path | None) -> Path:
    """Return the folder of a run that is not there yet, or is empty.

    Args:
        source: File that is played, or a sentence; names the folder runs/NAME.
        out: Folder that the user asked for.

    Raises:
        ConfigError: If ``out`` holds files already.
    """
    if out is not None:
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise ConfigError(f"{out} exists and is not empty; name another folder with --out, or remove it")
        store.check_writable(out.parent if not out.exists() else out)
        return out
    if isinstance(source, str):
        name = "-".join(re.findall(r"[a-z0-9]+", source.lower())[:6]) or "text"
    else:
        name = source.parent.name if source.name in (TARGETS, COMMANDS, SCRIPT) else source.stem
    folder = store.free_folder(Path("runs") / name)
    store.check_writable(folder.parent)
    return folder


def check_not_overwritten(source: Path, written: Path | None) -> None:
    """Raise a ConfigError if a file to be written is the source itself."""
    if written is not None and written.exists() and source.exists() and written.samefile(source):
        raise ConfigError(f"{written} is the source itself and would be overwritten; name another file")


def save_motion(motion: Motion, folder: Path, made_by: Provenance) -> None:
    """Write what was played into a run folder."""
    if motion.pose is not None:
        store.save(motion.pose, folder / POSE, made_by=made_by)
    if motion.targets is not None:
        store.save(motion.targets, folder / TARGETS, made_by=made_by)
    if motion.targets is None or motion.commands.v.any():
        store.save(motion.commands, folder / COMMANDS, made_by=made_by)
    if motion.script is not None:
        from mimic.io.keyframes import save_keyframes

        save_keyframes(motion.script, folder / SCRIPT)


def save_logs(run: Run, folder: Path, made_by: Provenance) -> None:
    """Write the logs of a run into its folder: control ticks, health, and joints where they were sampled."""
    result = run.result
    store.save(result.log, folder / LOG, made_by=made_by)
    store.save(result.health, folder / HEALTH, made_by=made_by)
    if result.samples is not None:
        store.save(result.samples, folder / JOINTS, made_by=made_by)


def save_run(
    run: Run,
    folder: Path,
    reporter: Reporter,
    *,
    settings: Mapping[str, Any] | None = None,
    source: Path | None = None,
    camera: CameraRecord | None = None,
    more: Mapping[str, Any] | None = None,
    film: Path | None = None,
    footage: Footage | None = None,
) -> SavedRun:
    """Write logs, motion, metrics, Rerun scene and, if asked for, a film.

    Args:
        run: What was played.
        folder: Run folder.
        reporter: Receives progress.
        settings: What decided the run, by name; stored with every file.
        source: File that was played, also one in place of a camera.
        camera: What a camera saw that was followed.
        more: Further entries of metrics.json.
        film: MP4 file that shows the person and the robot side by side.
        footage: The video of the motion, if its encoding was started before.
    """
    made_by = provenance(settings, {**run.inputs, **({} if source is None else {"source": source})})
    if camera is not None:
        more = {**(more or {}), "live": camera.save(folder, made_by)}
        motion = camera.motion(run.log)
        run = replace(run, motion=motion or run.motion)
        if motion is not None and motion.pose is not None:
            camera.report(motion.pose, reporter)
    save_logs(run, folder, made_by)
    motion = run.motion
    result = run.result
    if motion is not None:
        save_motion(motion, folder, made_by)
    metrics = run.metrics
    report = {} if motion is None or motion.targets is None else motion.targets.report
    events = [store.plain(event) for event in result.events]
    ending = {"shortfall": run.shortfall, "interrupted": result.interrupted}
    everything = {**metrics, **ending, "retarget": report, "provenance": made_by}
    store.save_json({**everything, **(more or {}), "events": events}, folder / METRICS)
    shown: dict[str, Any] = {"made_by": made_by, "log": run.complete_log, "description": run.description}
    if motion is not None:
        shown |= {"targets": motion.targets, "pose": motion.pose, "video": motion.video}
    from mimic.view.scene.scene import save_scene

    with reporter.progress("scene") as progress:
        save_scene(folder / SCENE, **shown, footage=footage, progress=progress)
    if film is not None:
        from mimic.view.film.side_by_side import save_video

        with reporter.progress("film") as progress:
            save_video(film, **shown, progress=progress)
    return SavedRun(run=run, folder=folder, metrics=metrics, film=film)
