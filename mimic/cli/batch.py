"""Every video or motion file of a folder: retargeted, simulated, and set side by side in one table."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
from collections.abc import Generator, Mapping
from contextlib import closing
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from mimic import __version__, store
from mimic.cli import COMMAND
from mimic.cli.app import DONE, STOPPED, USER
from mimic.cli.console import note, progress_bar, table, warn
from mimic.cli.inputs import InputSettings, Silent, load_motion, playable
from mimic.cli.play import JOINTS, LOG, METRICS, TARGETS, run_simulated
from mimic.errors import ConfigError, MimicError, SourceError
from mimic.settings import EffectsSettings, RunSettings

ITEMS, SUMMARY, PAGE = "items", "summary.parquet", "summary.html"
"""What is in the folder of a batch: a folder for each file, and the table twice."""

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


@dataclass(frozen=True, kw_only=True, slots=True)
class Job:
    """One file and all that decides what becomes of it."""

    source: Path
    name: str
    """Of the file, from the folder that is played."""
    key: str
    """See :func:`key_of`."""
    items: Path
    """Where the folder of the file goes."""
    settings: InputSettings
    run: RunSettings
    robot: EffectsSettings
    command: str


def batch(
    folder: Path,
    out: Path,
    settings: InputSettings,
    *,
    run: RunSettings,
    robot: EffectsSettings,
    workers: int,
    ray: str | None,
) -> int:
    """Play every file of a folder in simulation; failures are listed and stop nothing."""
    if not folder.is_dir():
        raise SourceError(f"{folder} is not a folder; mimic FILE --sim plays a single file")
    if out.exists() and not out.is_dir():
        raise ConfigError(f"{out} is a file; name a folder with --out")
    sources = [path for path in sorted(folder.rglob("*")) if path.is_file() and not path.is_relative_to(out)]
    sources = [path for path in sources if not path.name.startswith(".") and playable(path)]
    if not sources:
        raise SourceError(f"there is no video and no motion file in {folder}")
    decided = deciding(settings, run, robot)
    items = (out / ITEMS).resolve()
    items.mkdir(parents=True, exist_ok=True)
    _sweep(items)
    command = COMMAND.get()
    jobs = [
        Job(
            source=path.resolve(),
            name=str(path.relative_to(folder)),
            key=key_of(path, decided),
            items=items,
            settings=settings,
            run=run,
            robot=robot,
            command=command,
        )
        for path in sources
    ]
    rows: dict[int, dict[str, Any]] = {i: row for i, job in enumerate(jobs) if (row := finished(job)) is not None}
    if rows:
        note(f"{len(rows)} of {len(jobs)} files were finished before and are not played again")
    same = {job.key: i for i, job in reversed(list(enumerate(jobs)))}  # equal files are played once
    left = [i for i, job in enumerate(jobs) if i not in rows and same[job.key] == i]
    interrupted = False
    try:
        with progress_bar("files") as progress, closing(_results([jobs[i] for i in left], workers, ray)) as results:
            progress(len(rows), len(jobs))
            for at, result in results:
                job = jobs[left[at]]
                rows[left[at]] = result if isinstance(result, dict) else _failed(job, result.reason)
                for i, twin in enumerate(jobs):
                    if twin.key == job.key:
                        rows[i] = {**rows[left[at]], "file": twin.name}
                progress(len(rows), len(jobs))
    except KeyboardInterrupt:
        interrupted = True
        _sweep(items)  # a file may be whole although its worker had no time to say so
        rows |= {i: row for i, job in enumerate(jobs) if i not in rows and (row := finished(job)) is not None}
    _write_summary([rows[i] for i in sorted(rows)], out, jobs[0], unplayed=len(jobs) - len(rows))
    return _told([rows[i] for i in sorted(rows)], len(jobs), out, interrupted)


def _results(jobs: list[Job], workers: int, ray: str | None) -> Generator[tuple[int, Any]]:
    if ray is not None:
        from mimic.run.cluster import results_on_ray

        return results_on_ray(play_job, jobs, address=ray)
    from mimic.run.workers import results_here

    return results_here(play_job, jobs, workers=workers)


def deciding(settings: InputSettings, run: RunSettings, robot: EffectsSettings) -> str:
    """Return what decides a result besides the file: all settings, policies, effects and version, as text.

    Raises:
        AssetError, ConfigError, ContractError: If policy or effects cannot be used.
    """
    from mimic.policy.runtime import load_policy
    from mimic.robot.description import load_description
    from mimic.run.pool import simulated

    simulated(robot)
    description = load_description()
    policies = (load_policy(run.policy, description), load_policy(None, description, task="sit_down"))
    files = [policy.path for policy in policies] + ([] if robot.effects is None else [Path(robot.effects)])
    parts = [__version__, store.plain(settings), store.plain(run), store.plain(robot), *map(store.sha256_of, files)]
    return json.dumps(parts, sort_keys=True)


def key_of(source: Path, decided: str) -> str:
    """Return a key (SHA-256) that is the same as long as playing the file gives the same; its name has no say."""
    parts = [store.sha256_of(source), source.suffix.lower(), decided]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def _folder(job: Job) -> Path:
    return job.items / f"{Path(job.name).stem}-{job.key[:12]}"


def finished(job: Job) -> dict[str, Any] | None:
    """Return the row of a job that was finished before, None where it must be played."""
    for folder in job.items.glob(f"*-{job.key[:12]}"):  # an equal file of another name may have been played
        try:
            row = json.loads((folder / METRICS).read_text(encoding="utf-8"))["row"]
        except (OSError, ValueError, KeyError):
            continue
        return {**row, "file": job.name}
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
    from mimic.metrics import run_metrics

    silent, begin = Silent(), time.perf_counter()
    motion = load_motion(job.source, job.settings, silent)
    done = run_simulated(motion, job.run, job.robot)
    inputs = {"source": job.source, **done.inputs}
    parts = {f.name: getattr(job.settings, f.name) for f in fields(job.settings)}
    made_by = store.provenance(
        command=job.command, settings=parts | {"run": job.run, "robot": job.robot}, inputs=inputs
    )
    folder = _folder(job)
    part = folder.with_name(f".{folder.name}.{os.getpid()}.part")
    try:
        if motion.targets is not None:
            store.save(motion.targets, part / TARGETS, made_by=made_by)
        store.save(done.result.log, part / LOG, made_by=made_by)
        if done.result.samples is not None:
            store.save(done.result.samples, part / JOINTS, made_by=made_by)
        metrics = run_metrics(done.result.log, done.description)
        report = {} if motion.targets is None else dict(motion.targets.report)
        row = _row(job, report, metrics, silent.warnings)
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
    return {
        **dict.fromkeys(ROW),
        **values,
        "file": job.name,
        "status": "fell" if metrics["falls"] else "done",
        "rows_with_person": seen,
        "toe_error_cm": metrics["toe_error_cm"]["mean"],
        "toe_error_p95_cm": metrics["toe_error_cm"]["p95"],
        "lag_s": metrics["lag_s"],
        "toe_error_without_lag_cm": metrics["toe_error_without_lag_cm"],
        "stand_up_s": metrics["stand_up_s"],
        "standing_share": metrics["standing_share"],
        "falls": metrics["falls"],
        "knee_torque_rms_nm": metrics["torque_nm"]["knee_rms"],
        "minutes_to_limit": metrics["minutes_to_limit"],
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


def _write_summary(rows: list[dict[str, Any]], out: Path, job: Job, *, unplayed: int) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    from mimic.view.batch_page import html_batch

    kinds = {str: pa.string(), float: pa.float64(), int: pa.int64()}
    schema = pa.schema([(name, kinds[kind]) for name, kind in ROW.items()])
    with store.written_whole(out / SUMMARY) as part:
        pq.write_table(pa.Table.from_pylist([store.plain(row) for row in rows], schema=schema), part)
    with store.written_whole(out / PAGE) as part:
        part.write_text(html_batch(rows, command=job.command, version=__version__, unplayed=unplayed), encoding="utf-8")


def _told(rows: list[dict[str, Any]], count: int, out: Path, interrupted: bool) -> int:
    failed = [row for row in rows if row["status"] == "failed"]
    fell = [row for row in rows if row["status"] == "fell"]
    for row in failed:
        warn(f"{row['file']}: {row['error']}")
    for row in fell:
        warn(f"{row['file']}: the robot was about to fall and sat down")
    done = [row for row in rows if row["status"] != "failed"]
    figures = {"files": f"{len(done)} played, {len(failed)} failed, {count - len(rows)} not reached"}
    if done:
        errors = [row["toe_error_cm"] for row in done if row["toe_error_cm"] is not None]
        clamped = [row["clamped_share"] for row in done if row["clamped_share"] is not None]
        figures |= {"toe error": f"{sum(errors) / len(errors):.1f} cm mean over the files"} if errors else {}
        figures |= {"clamped": f"{sum(clamped) / len(clamped):.1%} of the targets"} if clamped else {}
        figures |= {"fell": f"{len(fell)}"}
    table("Batch", figures | {"written": f"{out / PAGE}, {out / SUMMARY}"})
    if interrupted:
        return STOPPED
    return USER if failed and not done else DONE
