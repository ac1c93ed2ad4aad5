"""The folder of a run: its name, its files, and how they are written."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mimic.errors import ConfigError
from mimic.flows.reporter import Reporter
from mimic.io import store
from mimic.records import Provenance
from mimic.records.table import ShownAsTable

if TYPE_CHECKING:
    from mimic.flows.motion import Motion
    from mimic.flows.play import Run
    from mimic.view.scene.footage import Footage

POSE, TARGETS, COMMANDS, SCRIPT = "pose.parquet", "targets.parquet", "commands.parquet", "motion.yaml"
LOG, HEALTH, JOINTS, METRICS = "log.parquet", "health.parquet", "joints.parquet", "metrics.json"
SCENE, LIVE, ERROR = "scene.rrd", "live.parquet", "error.txt"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class SavedRun(ShownAsTable):
    """A run and what was written of it."""

    run: Run
    folder: Path
    metrics: Mapping[str, Any]
    """Figures of the run, as in metrics.json."""
    film: Path | None = None


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
    folder, number = Path("runs") / name, 2
    while folder.exists():
        folder, number = Path("runs") / f"{name}-{number}", number + 1
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
    made_by: Provenance,
    reporter: Reporter,
    *,
    more: Mapping[str, Any] | None = None,
    film: Path | None = None,
    footage: Footage | None = None,
) -> SavedRun:
    """Write logs, motion, metrics, Rerun scene and, if asked for, a film.

    Args:
        run: What was played.
        folder: Run folder.
        made_by: Stored with every file.
        reporter: Receives progress.
        more: Further entries of metrics.json.
        film: MP4 file that shows the person and the robot side by side.
        footage: The video of the motion, if its encoding was started before.
    """
    save_logs(run, folder, made_by)
    motion, result = run.motion, run.result
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
            save_video(film, **shown, stamps=None if footage is None else footage.clip().stamps, progress=progress)
    return SavedRun(run=run, folder=folder, metrics=metrics, film=film)
