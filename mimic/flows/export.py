"""A run, or all runs of a batch, in the formats of other programs."""

from __future__ import annotations

import re
from dataclasses import fields
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from mimic.errors import AssetError, ConfigError
from mimic.flows.play import robot_of
from mimic.flows.reporter import Progress, Reporter, reporting
from mimic.flows.run_folder import LOG, SCRIPT
from mimic.io import store
from mimic.records import JOINTS, SIDES, FloatArray, RunLog

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mimic.io.lerobot import Episode
    from mimic.io.mcap_file import RosRun

Format = Literal["lerobot", "csv", "npz", "mcap"]
ENDINGS = {"csv": ".csv", "npz": ".npz", "mcap": ".mcap"}
"""Ending of the file of each format that is a file."""
FILES = (*ENDINGS.values(), ".parquet", ".zip", ".mp4")
"""Endings that no folder should have."""
STATE = (
    *(f"{name}.pos" for name in JOINTS),
    *(f"{name}.vel" for name in JOINTS),
    *(f"base.quat.{axis}" for axis in "wxyz"),
    *(f"base.gyro.{axis}" for axis in "xyz"),
)
"""Values of observation.state: joint positions [rad] and velocities [rad/s], orientation and angular velocity [rad/s]
of the base."""
ACTION = tuple(f"{name}.pos" for name in JOINTS)
"""Values of action: commanded joint positions [rad]."""
COMMAND = tuple(f"{side}_toe.{axis}" for side in SIDES for axis in "xyz")
"""Values of observation.target: where the front toes should be, base axes [m]."""
SEEN = "observation"
"""What csv and npz leave out: a thousand numbers a tick."""
PICTURE = (240, 320)
"""Height and width of the films of a dataset [px]."""


def export(
    source: Path,
    out: Path,
    form: Format = "lerobot",
    *,
    video: bool = True,
    reporter: Reporter | None = None,
) -> int:
    """Write a run in another format; return the number of runs written.

    Args:
        source: Folder of a run, or of a batch (each of its runs becomes an episode; lerobot only).
        out: Folder of the dataset, or file (.csv, .npz, .mcap).
        form: lerobot (LeRobotDataset v3), csv or npz (every column of the log) or mcap (ROS 2 messages).
        video: Whether a dataset has a film of the robot, one frame for each row.
        reporter: Receives progress.

    Raises:
        AssetError: If there is no run at ``source``.
        ConfigError: If ``out`` exists, or the format holds one run and there are several.
    """
    reporter = reporting(reporter)
    folders = _runs(source)
    if form in ENDINGS and out.suffix.lower() != ENDINGS[form]:
        raise ConfigError(f"--out is {out}; expected a file name that ends with {ENDINGS[form]} for --format {form}")
    if form not in ENDINGS and out.suffix.lower() in FILES:
        raise ConfigError(f"--out is {out}; expected the name of a folder for --format {form}")
    if out.exists():
        raise ConfigError(f"{out} exists; name another place with --out, or remove it")
    store.check_writable(out.parent)
    if form == "lerobot":
        _export_dataset(folders, out, video=video, reporter=reporter)
        return len(folders)
    if len(folders) > 1:
        raise ConfigError(
            f"{source} holds {len(folders)} runs, and a {form} file one; use --format lerobot, or one run"
        )
    log = store.load(folders[0] / LOG, RunLog)
    if form == "mcap":
        from mimic.io.mcap_file import write_mcap

        with store.written_whole(out) as part:
            write_mcap(part, _messages(log))
        return 1
    with store.written_whole(out) as part:
        if form == "csv":
            _save_csv(folders[0] / LOG, part)
        else:
            names = [f.name for f in fields(log) if "axes" in f.metadata and f.name != SEEN]
            arrays = {name: getattr(log, name) for name in names}
            np.savez_compressed(part, joint_names=np.array(JOINTS), **arrays)
    return 1


def _messages(log: RunLog) -> RosRun:
    """Return what of a run becomes ROS messages: joints and links by their roles."""
    from mimic.control.dropouts import fill_dropouts
    from mimic.dynamics.robot_model import load_model
    from mimic.io.mcap_file import RosRun
    from mimic.view.scene.robot_shapes import body_poses, qpos_at_ticks

    description = robot_of(log)
    model = load_model(description)
    filled = fill_dropouts(log, description)
    position, quat = body_poses(model, qpos_at_ticks(filled, model))
    links = [model.body(body).name for body in range(model.nbody)]
    return RosRun(
        t=log.t,
        joints=JOINTS,
        q=log.q,
        dq=log.dq,
        tau=log.tau,
        q_des=log.q_des,
        frames={name: (position[:, body], quat[:, body]) for body, name in enumerate(links) if body},
        points={f"/{side}_toe_target": log.p_BE_des[:, i] for i, side in enumerate(SIDES)},
        base=links[1],
    )


def _rate(log: RunLog, folder: Path) -> int:
    """Return the ticks of a log per second [Hz].

    Raises:
        AssetError: If it has too few of them.
    """
    if len(log.t) < 2:
        raise AssetError(f"{folder / LOG} has {len(log.t)} tick; a motion needs at least two")
    return round(1.0 / float(np.median(np.diff(log.t))))


def _even_ticks(log: RunLog, fps: int) -> np.ndarray:
    """Return the rows of a log at equal time steps; a row that came late is that of the nearest tick."""
    t = log.t
    times = t[0] + np.arange(round(float(t[-1] - t[0]) * fps) + 1) / fps
    right = np.clip(np.searchsorted(t, times), 1, len(t) - 1)
    return right - (times - t[right - 1] < t[right] - times)


def _runs(source: Path) -> list[Path]:
    if (source / LOG).is_file():
        return [source]
    found = sorted(path.parent for path in source.glob(f"items/*/{LOG}"))
    if not found:
        raise AssetError(f"there is no run in {source}; expected a folder with {LOG}, or the folder of a batch")
    return found


def _save_csv(log: Path, out: Path) -> None:
    """Write a row for each tick; a column has the name of its array and, behind points, of joint, side or axis."""
    import pyarrow.parquet as pq
    from pyarrow import csv

    table = pq.read_table(log)
    names = [name for name in table.column_names if not name.startswith(SEEN)]
    csv.write_csv(table.select(names), out, csv.WriteOptions(quoting_style="none"))


def _export_dataset(folders: list[Path], out: Path, *, video: bool, reporter: Reporter) -> None:
    from mimic.io.lerobot import write_dataset

    logs = [store.load(folder / LOG, RunLog) for folder in folders]
    rates = {_rate(log, folder) for log, folder in zip(logs, folders, strict=True)}
    robots = {robot_of(log).name for log in logs}
    if len(rates) > 1 or len(robots) > 1:
        raise ConfigError(f"a dataset has one robot and one rate; these runs have {robots} at {rates} Hz")
    fps = rates.pop()
    robot = robots.pop()
    with reporter.progress("dataset") as progress:
        write_dataset(
            out,
            [_episode(*one, fps, progress if video else None) for one in zip(logs, folders, strict=True)],
            names={"observation.state": STATE, "observation.target": COMMAND, "action": ACTION},
            fps=fps,
            robot=robot,
            picture=PICTURE if video else None,
        )


def _episode(log: RunLog, folder: Path, fps: int, film_progress: Progress | None) -> Episode:
    """Return a run at equal time steps, with a film if its progress is told; a late row is that of the nearest tick."""
    from mimic.io.lerobot import Episode

    ticks = _even_ticks(log, fps)
    target = log.p_BE_des[ticks].reshape(len(ticks), -1)
    columns = {
        "observation.state": np.hstack([log.q[ticks], log.dq[ticks], log.quat_WB[ticks], log.omega_B[ticks]]),
        "observation.target": np.where(np.isfinite(target), target, log.p_BE[ticks].reshape(target.shape)),
        "action": log.q_des[ticks],
    }
    for name, values in columns.items():
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
            raise AssetError(f"{folder / LOG} lacks {name} in tick {row}; a dataset has no gaps")
    film = (lambda path: _film(path, log, ticks, fps, film_progress)) if film_progress else None
    return Episode(task=_task(folder), columns=columns, film=film)


def _film(
    path: Path, log: RunLog, ticks: np.ndarray, fps: int, progress: Progress
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Write a film with a picture for each tick; return minimum, maximum, mean and deviation of its colours (3,)."""
    from mimic.view.film.footage import encode_h264
    from mimic.view.film.side_by_side import RobotFilm

    height, width = PICTURE
    seen: list[np.ndarray] = []

    def pictures() -> Iterator[np.ndarray]:
        robot = robot_of(log)
        with RobotFilm(log, robot, width=width, height=height, shadows=False) as film:
            for tick in ticks:
                picture = film.picture(int(tick))
                flat = picture.reshape(-1, 3) / 255.0
                seen.append(np.stack([flat.min(0), flat.max(0), flat.mean(0), (flat**2).mean(0)]))
                progress(len(seen), len(ticks))
                yield picture

    encode_h264(pictures(), path, fps=Fraction(fps))
    all_of = np.stack(seen)
    mean = all_of[:, 2].mean(0)
    return all_of[:, 0].min(0), all_of[:, 1].max(0), mean, np.sqrt(np.maximum(all_of[:, 3].mean(0) - mean**2, 0.0))


def _task(folder: Path) -> str:
    """Return what a run did: its sentence, or the name of what it followed."""
    if (folder / SCRIPT).is_file():
        from mimic.io.keyframes import read_keyframes

        if sentence := read_keyframes(folder / SCRIPT).sentence:
            return sentence
    return f"follow {re.sub('-[0-9a-f]{8,}$', '', folder.name)}"
