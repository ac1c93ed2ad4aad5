"""The main flow: source → commands → run → files, and what is told about it."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mimic import store
from mimic.cli import COMMAND
from mimic.cli.app import DONE, STOPPED
from mimic.cli.console import progress_bar, table, warn
from mimic.cli.inputs import Aloud, InputSettings, Motion, load_motion
from mimic.cli.judge import tell_of_stand
from mimic.errors import AssetError, ConfigError, SourceError
from mimic.settings import EffectsSettings, RunSettings
from mimic.types import Provenance, TargetTrack

if TYPE_CHECKING:
    from mimic.robot.description import RobotDescription
    from mimic.run.loop import RunResult

SCENE, LOG, JOINTS, TARGETS, COMMANDS, SCRIPT, POSE, METRICS = (
    "scene.rrd",
    "log.parquet",
    "joints.parquet",
    "targets.parquet",
    "commands.parquet",
    "motion.yaml",
    "pose.parquet",
    "metrics.json",
)
"""Files of a run folder."""


def retarget_only(source: Path, out: Path, settings: InputSettings) -> int:
    """Write the targets of a source, and print what retargeting did."""
    _keep_source(source, out)
    motion = load_motion(source, settings, Aloud())
    if motion.targets is None:
        raise SourceError(
            f"{source} holds commands, which have no targets to make; play them with: mimic {source} --sim"
        )
    store.save(motion.targets, out, made_by=_made_by(settings, {"source": source}))
    table("Targets", target_rows(motion.targets) | {"written": str(out)})
    return DONE


def _made_by(settings: InputSettings, inputs: dict[str, Path], **more: Any) -> Provenance:
    parts = {f.name: getattr(settings, f.name) for f in fields(settings)}
    return store.provenance(command=COMMAND.get(), settings=parts | more, inputs=inputs)


def target_rows(targets: TargetTrack) -> dict[str, str]:
    """Return what retargeting did, a figure a row."""
    report: dict[str, Any] = dict(targets.report)
    if "targets" not in report:  # not made by mimic retarget
        return {"targets": f"{targets.t[-1]:.1f} s in all"}
    rows = {
        "targets": f"{report['targets']} at {report['rate_s']:.3g} s, {targets.t[-1]:.1f} s in all",
        "clamped": f"{report['clamped_share']:.1%}, moved {report['moved_mean_cm']:.2f} cm on average, "
        f"{report['moved_max_cm']:.1f} cm at most",
        "limited by speed": f"{report['limited_share']:.1%}",
    }
    pose = report.get("pose")
    if pose:
        rows |= {
            "frames with a person": f"{pose['frames_with_person']} of {pose['frames']}",
            "left/right exchanged": f"{pose['frames_exchanged']} frames",
        } | ({"camera": str(pose["unseen"])} if "unseen" in pose else {})
    return rows


def run_folder(source: Path | str, out: Path | None) -> Path:
    """Return the folder of a run, which is not there yet or empty."""
    if out is not None:
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise ConfigError(f"{out} exists and is not empty; name another folder with --out, or remove it")
        return out
    if isinstance(source, str):
        name = "-".join(re.findall(r"[a-z0-9]+", source.lower())[:6]) or "text"
    else:
        name = source.parent.name if source.name in (TARGETS, COMMANDS, SCRIPT) else source.stem
    folder, number = Path("runs") / name, 2
    while folder.exists():
        folder, number = Path("runs") / f"{name}-{number}", number + 1
    return folder


def _keep_source(source: Path, written: Path | None) -> None:
    if written is not None and written.exists() and source.exists() and written.samefile(source):
        raise ConfigError(f"{written} is the source itself and would be overwritten; name another file")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Simulated:
    """A motion that was played in simulation."""

    result: RunResult
    description: RobotDescription
    inputs: dict[str, Path]
    """Files that decided it, besides the source."""


def run_simulated(
    motion: Motion,
    run: RunSettings,
    robot: EffectsSettings,
    progress: Callable[[int, int], None] | None = None,
) -> Simulated:
    """Play a motion on the simulated robot.

    Raises:
        AssetError, ConfigError, ContractError: If policy, effects or commands do not fit.
    """
    from mimic.policy.runtime import load_policy
    from mimic.robot.description import load_description
    from mimic.run.loop import run_policy
    from mimic.run.pool import simulated
    from mimic.run.simulation import SimulatedPlant

    options = simulated(robot)
    description = load_description()
    policy = load_policy(run.policy, description)
    sit_down = load_policy(None, description, task="sit_down")
    plant = SimulatedPlant(description, seed=run.seed, **options)
    result = run_policy(plant, policy, motion.commands, run, sit_down=sit_down, progress=progress)
    inputs = {"policy": policy.path, "sit_down": sit_down.path}
    inputs |= {} if robot.effects is None else {"effects": Path(robot.effects)}
    return Simulated(result=result, description=description, inputs=inputs)


def save_motion(motion: Motion, folder: Path, made_by: Provenance) -> None:
    """Write what was played into a run folder."""
    if motion.pose is not None:
        store.save(motion.pose, folder / POSE, made_by=made_by)
    if motion.targets is not None:
        store.save(motion.targets, folder / TARGETS, made_by=made_by)
    if motion.targets is None or motion.commands.v.any():
        store.save(motion.commands, folder / COMMANDS, made_by=made_by)
    if motion.script is not None:
        from mimic.keyframes import save_keyframes

        save_keyframes(motion.script, folder / SCRIPT)


def play_source(
    source: Path | str,
    settings: InputSettings,
    *,
    out: Path | None,
    film: Path | None,
    view: bool | None,
    run: RunSettings,
    robot: EffectsSettings,
) -> int:
    """Play a file, or a sentence, in simulation and write its run folder."""
    from mimic.metrics import run_metrics
    from mimic.policy.runtime import load_policy
    from mimic.robot.description import load_description
    from mimic.run.pool import simulated

    file = source if isinstance(source, Path) else None
    if file is not None and not file.exists():
        raise SourceError(f"there is no file {file}")
    if film is not None and film.suffix != ".mp4":
        raise ConfigError(f"--video is {film}; expected a file name that ends with .mp4")
    if file is not None:
        _keep_source(file, film)
    folder = run_folder(source, out)
    tell_of_stand(robot)
    simulated(robot)  # what cannot be played is told before the long work
    load_policy(run.policy, load_description())
    motion = load_motion(source, settings, Aloud())
    with progress_bar("simulation") as progress:
        done = run_simulated(motion, run, robot, progress)
    result, description = done.result, done.description
    made_by = _made_by(settings, done.inputs | ({} if file is None else {"source": file}), run=run, robot=robot)
    save_motion(motion, folder, made_by)
    store.save(result.log, folder / LOG, made_by=made_by)
    if result.samples is not None:
        store.save(result.samples, folder / JOINTS, made_by=made_by)
    metrics = run_metrics(result.log, description)
    report = {} if motion.targets is None else motion.targets.report
    everything = {**metrics, "interrupted": result.interrupted, "retarget": report, "provenance": made_by}
    store.save_json(everything, folder / METRICS)

    shown: dict[str, Any] = {
        "made_by": made_by,
        "log": result.log,
        "description": description,
        "targets": motion.targets,
        "pose": motion.pose,
        "video": motion.video,
    }
    from mimic.view.scene import save_scene
    from mimic.view.viewer import display_available, open_viewer

    with progress_bar("scene") as progress:
        save_scene(folder / SCENE, **shown, progress=progress)
    if film is not None:
        from mimic.view.side_by_side import save_video

        with progress_bar("film") as progress:
            save_video(film, **shown, progress=progress)
    rows = {} if motion.targets is None else target_rows(motion.targets)
    rows |= metric_rows(metrics) | {"run folder": str(folder)}
    table(source.name if isinstance(source, Path) else source, rows | ({"film": str(film)} if film else {}))
    if result.fell_at is not None:
        warn(f"the robot was about to fall at {result.fell_at:.1f} s and sat down")
    if result.error is not None:
        raise result.error
    if view or (view is None and display_available()):
        open_viewer(folder / SCENE)
    return STOPPED if result.fell_at is not None or result.interrupted else DONE


def metric_rows(m: dict[str, Any]) -> dict[str, str]:
    """Return the figures of a run, a figure a row."""
    error = m["toe_error_cm"]
    return {
        "stood up in": f"{m['stand_up_s']:.2f} s",
        "upright": f"{m['standing_share']:.1%} of the time after standing up",
        "toe error": f"{error['mean']:.1f} cm mean, {error['p95']:.1f} cm at the 95th percentile",
        "of it lag": f"{1e3 * m['lag_s']:.0f} ms; without it {m['toe_error_without_lag_cm']:.1f} cm",
        "knee torque": f"{m['torque_nm']['knee_rms']:.1f} N m rms, {m['torque_nm']['max']:.1f} N m peak of any joint",
        "heat": f"{m['hottest_motor']} reaches its limit after {m['minutes_to_limit']:.0f} min of this"
        if m["minutes_to_limit"] < 1e4
        else "no motor above its continuous rating",
    }


def view_run(run: Path) -> int:
    """Open the scene of a run."""
    from mimic.view.viewer import display_available, open_viewer

    scene = run / SCENE if run.is_dir() else run
    if not scene.is_file():
        raise AssetError(f"there is no {SCENE} in {run}; expected a folder that mimic … --sim wrote")
    if not display_available():
        raise ConfigError(f"there is no display here; copy {scene} to a computer with one and run: rerun {scene.name}")
    open_viewer(scene)
    return DONE
