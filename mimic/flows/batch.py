"""Every video and motion file of a folder: retargeted, simulated, and compared in one table."""

from __future__ import annotations

import hashlib
import json
import math
import os
import shutil
import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from mimic.config.play import EffectsSettings, RunSettings
from mimic.config.text_file import from_json
from mimic.errors import ConfigError, MimicError, SourceError
from mimic.flows.motions.motion import InputSettings, load_motion, playable, refuse_second_video
from mimic.flows.play import load_robot, play, shipped_sit_down
from mimic.flows.provenance import COMMAND, provenance
from mimic.flows.reporter import Reporter, SilentReporter, reporting
from mimic.flows.run_folder import METRICS, TARGETS, save_logs
from mimic.frozen import frozen, frozen_arrays
from mimic.io import store
from mimic.jobs.local import Progress
from mimic.version import __version__

ITEMS = "items"
"""Folder, in that of a batch, with a folder for each file."""
SUMMARY = "summary.parquet"
"""Its table as Parquet."""
PAGE = "summary.html"
"""Its table as a page."""

ROW: Mapping[str, type] = {
    "file": str,
    "status": str,
    "error": str,
    "length_s": float,
    "targets": int,
    "clamped_share": float,
    "moved_mean_cm": float,
    "moved_max_cm": float,
    "limited_share": float,
    "filled_share": float,
    "rows_with_person": float,
    "wanted_to_reached_cm": float,
    "toe_error_cm": float,
    "toe_error_p95_cm": float,
    "lag_s": float,
    "toe_error_without_lag_cm": float,
    "stand_up_s": float,
    "standing_share": float,
    "falls": int,
    "knee_torque_rms_nm": float,
    "minutes_to_limit": float,
    "notes": str,
    "seconds": float,
    "folder": str,
    "sha256": str,
    "key": str,
}
"""Columns of the table."""


@frozen
class Job:
    """One file and all that decides what becomes of it."""

    source: Path
    name: str
    """Of the file, from the folder that is played."""
    key: str
    """See `key_of`."""
    items: Path
    """Where the folder of the file goes."""
    settings: InputSettings
    run: RunSettings
    robot: EffectsSettings
    command: str


@frozen_arrays
class Batch:
    """What came of a folder."""

    rows: tuple[dict[str, Any], ...]
    """A row for each file that was played, with the columns of ROW."""
    files: int
    """Files in the folder."""
    interrupted: bool
    page: Path
    """Table as a page."""
    summary: Path
    """Table as Parquet."""

    def with_status(self, status: str) -> list[dict[str, Any]]:
        """Return the rows with a status: done, fell or failed."""
        return [row for row in self.rows if row["status"] == status]


def batch(
    folder: Path,
    out: Path,
    settings: InputSettings | None = None,
    *,
    run: RunSettings | None = None,
    effects: EffectsSettings | None = None,
    workers: int = 0,
    ray: str | None = None,
    reporter: Reporter | None = None,
) -> Batch:
    """Play every video and motion file of a folder in simulation, into one table; go on where it was stopped.

    A file that fails is a row with its error and stops nothing.

    Args:
        folder: Folder to search, with its subfolders.
        out: Folder for summary.html, summary.parquet and a folder for each file.
        settings: How an input becomes commands.
        run: How commands are played.
        effects: What a calibration found.
        workers: Processes; 0 takes one for each core.
        ray: Address of a Ray cluster to play on instead.
        reporter: Receives notes and progress.

    Raises:
        SourceError: If there is nothing to play.
        ConfigError, AssetError, ContractError: If folder, policy or effects cannot be used.
    """
    settings = settings or InputSettings()
    run = run or RunSettings()
    effects = effects or EffectsSettings()
    reporter = reporting(reporter)
    refuse_second_video(settings, "a folder has many: play its pairs one by one")
    sources = _sources(folder, out)
    store.check_writable(out)
    settings_text = settings_key(settings, run, effects)
    items = (out / ITEMS).resolve()
    items.mkdir(parents=True, exist_ok=True)
    _sweep(items)
    jobs = [
        Job(
            source=path.resolve(),
            name=str(path.relative_to(folder)),
            key=key_of(path, folder, settings_text),
            items=items,
            settings=settings,
            run=run,
            robot=effects,
            command=COMMAND.get(),
        )
        for path in sources
    ]
    rows = _finished(jobs)
    if rows:
        reporter.note(f"{len(rows)} of {len(jobs)} files were finished before and are not played again")
    interrupted = False
    try:
        with reporter.progress("files") as progress:
            _play_all(jobs, rows, workers, ray, progress)
    except KeyboardInterrupt:
        interrupted = True
        _sweep(items)
        rows = {**_finished(jobs), **rows}  # a file may be whole although its worker had no time to say so
    ordered = tuple(rows[job.name] for job in jobs if job.name in rows)
    _write_summary(ordered, out, jobs[0], unplayed=len(jobs) - len(rows))
    return Batch(rows=ordered, files=len(jobs), interrupted=interrupted, page=out / PAGE, summary=out / SUMMARY)


def _sources(folder: Path, out: Path) -> list[Path]:
    """Return the videos and motion files of a folder.

    Raises:
        SourceError: If there are none.
        ConfigError: If ``out`` is a file.
    """
    if not folder.is_dir():
        raise SourceError(f"{folder} is not a folder; to play a single file: mimic {folder} --sim")
    if out.exists() and not out.is_dir():
        raise ConfigError(f"{out} is a file; name a folder with --out")
    files = [path for path in sorted(folder.rglob("*")) if path.is_file() and not path.is_relative_to(out)]
    sources = [path for path in files if not path.name.startswith(".") and playable(path)]
    if not sources:
        raise SourceError(f"there is no video and no motion file in {folder}")
    return sources


def _finished(jobs: Sequence[Job]) -> dict[str, dict[str, Any]]:
    """Return the rows of jobs that were finished before, by the name of the job."""
    found = {job.name: finished(job) for job in jobs}
    return {name: row for name, row in found.items() if row is not None}


def _play_all(
    jobs: Sequence[Job], rows: dict[str, dict[str, Any]], workers: int, ray: str | None, progress: Progress
) -> None:
    """Play the jobs that have no row, and add their rows."""
    left = [job for job in jobs if job.name not in rows]
    progress(len(rows), len(jobs))
    with closing(_results(left, workers, ray)) as results:
        for at, result in results:
            row = result if isinstance(result, dict) else _failed(left[at], result.reason)
            rows[row["file"]] = row
            progress(len(rows), len(jobs))


def _results(jobs: list[Job], workers: int, ray: str | None) -> Generator[tuple[int, Any]]:
    if ray is not None:
        from mimic.jobs.ray import results_on_ray

        return results_on_ray(play_job, jobs, address=ray)
    from mimic.jobs.local import results_here

    return results_here(play_job, jobs, workers=workers)


def settings_key(settings: InputSettings, run: RunSettings, robot: EffectsSettings) -> str:
    """Return what decides a result besides the file: all settings, policies, effects and version, as text.

    Raises:
        AssetError, ConfigError, ContractError: If policy or effects cannot be used.
    """
    from mimic.policy.runtime import load_policy
    from mimic.simulation.plant import plant_options

    plant_options(robot)
    description = load_robot(robot.robot_model)
    policies = (load_policy(run.policy, description), shipped_sit_down(description, SilentReporter()))
    files = [policy.path for policy in policies if policy is not None] + (
        [] if robot.effects is None else [Path(robot.effects)]
    )
    parts = [__version__, store.plain(settings), store.plain(run), store.plain(robot), *map(store.sha256_of, files)]
    return json.dumps(parts, sort_keys=True)


def key_of(source: Path, within: Path, settings_text: str) -> str:
    """Return a key (SHA-256) that is the same as long as playing a file of a folder gives the same."""
    parts = [store.sha256_of(source), str(source.relative_to(within)), settings_text]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def _folder(job: Job) -> Path:
    return job.items / f"{Path(job.name).stem}-{job.key[:12]}"


def finished(job: Job) -> dict[str, Any] | None:
    """Return the row of a job that was finished before, None where it must be played."""
    try:
        return from_json((_folder(job) / METRICS).read_text(encoding="utf-8"))["row"]
    except (OSError, ValueError, KeyError):
        return None


def play_job(job: Job) -> dict[str, Any]:
    """Return the row of a job, after its folder was written whole; what fails is a row, too."""
    COMMAND.set(job.command)
    try:
        return _play(job)
    except MimicError as error:
        return _failed(job, str(error))
    except Exception as error:  # a bug, or a file that no library expected: the others go on
        return _failed(job, f"{type(error).__name__}: {error}")


def _play(job: Job) -> dict[str, Any]:
    silent = SilentReporter()
    begin = time.perf_counter()
    description = load_robot(job.robot.robot_model)
    motion = load_motion(job.source, job.settings, description=description, reporter=silent)
    done = play(motion, settings=job.run, effects=job.robot)
    if done.result.error is not None:
        raise done.result.error
    made_by = provenance(
        vars(job.settings) | {"run": job.run, "robot": job.robot}, {"source": job.source, **done.inputs}
    )
    folder = _folder(job)
    part = folder.with_name(f".{folder.name}.{os.getpid()}.part")
    try:
        if motion.targets is not None:
            store.save(motion.targets, part / TARGETS, made_by=made_by)
        save_logs(done, part, made_by)
        metrics = done.metrics
        report = {} if motion.targets is None else dict(motion.targets.report)
        row = _row(job, report, metrics, silent.warnings)
        if done.shortfall is not None:
            row |= {"status": "fell", "notes": "; ".join([done.shortfall, *silent.warnings])}
        row |= {"length_s": float(motion.commands.t[-1]), "seconds": time.perf_counter() - begin}
        store.save_json({**metrics, "retarget": report, "row": row, "provenance": made_by}, part / METRICS)
        if folder.exists():
            shutil.rmtree(folder)
        part.rename(folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return row


def _row(job: Job, report: Mapping[str, Any], metrics: Mapping[str, Any], warnings: list[str]) -> dict[str, Any]:
    person = report.get("pose") or {}
    seen = person["frames_with_person"] / person["frames"] if person else None
    values = {name: report.get(name) for name in ROW if name in report}
    minutes = metrics["minutes_to_limit"]  # JSON has no infinity
    return {
        **dict.fromkeys(ROW),
        **values,
        "file": job.name,
        "status": "done",
        "rows_with_person": seen,
        "wanted_to_reached_cm": (metrics.get("wanted_to_reached_cm") or {}).get("apart"),
        "toe_error_cm": metrics["toe_error_cm"]["mean"],
        "toe_error_p95_cm": metrics["toe_error_cm"]["p95"],
        "lag_s": metrics["lag_s"],
        "toe_error_without_lag_cm": metrics["toe_error_without_lag_cm"],
        "stand_up_s": metrics["stand_up_s"],
        "standing_share": metrics["standing_share"],
        "falls": metrics["falls"],
        "knee_torque_rms_nm": metrics["torque_nm"]["knee_rms"],
        "minutes_to_limit": minutes if math.isfinite(minutes) else None,
        "notes": "; ".join(warnings),
        "folder": f"{ITEMS}/{_folder(job).name}",
        "sha256": store.sha256_of(job.source),
        "key": job.key,
    }


def _failed(job: Job, reason: str) -> dict[str, Any]:
    return {**dict.fromkeys(ROW), "file": job.name, "status": "failed", "error": " ".join(reason.split())}


def _sweep(items: Path) -> None:
    """Remove what a batch that was ended left half-written."""
    for part in items.glob(".*.part"):
        shutil.rmtree(part, ignore_errors=True)


def _write_summary(rows: Sequence[dict[str, Any]], out: Path, job: Job, *, unplayed: int) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    from mimic.view.report.batch import html_batch

    kinds = {str: pa.string(), float: pa.float64(), int: pa.int64()}
    schema = pa.schema([(name, kinds[kind]) for name, kind in ROW.items()])
    with store.written_whole(out / SUMMARY) as part:
        pq.write_table(pa.Table.from_pylist(store.plain(rows), schema=schema), part)
    with store.written_whole(out / PAGE) as part:
        part.write_text(
            html_batch(list(rows), command=job.command, version=__version__, unplayed=unplayed), encoding="utf-8"
        )
