"""A camera drives the robot: capture and pose in a process, filter and clamp in a thread, the loop in the main one."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mimic import store
from mimic.cli import COMMAND
from mimic.cli.app import DONE, STOPPED
from mimic.cli.console import note, progress_bar, table, warn, working
from mimic.cli.inputs import InputSettings
from mimic.cli.judge import tell_of_stand
from mimic.cli.play import COMMANDS, JOINTS, LOG, METRICS, POSE, SCENE, metric_rows, run_folder
from mimic.settings import EffectsSettings, LiveSettings, RunSettings
from mimic.types import PHASES, CommandTrack, FloatArray, LiveTrack, PoseTrack, RunLog

if TYPE_CHECKING:
    from mimic.retarget.live import LiveRetarget, LiveTargets
    from mimic.sources.camera import Seen, Watch
    from mimic.view.live import LiveView

LIVE = "live.parquet"
"""Latency of every frame, beside the files of any run."""
SWITCH = 1e-3
"""A thread that clamps gives way to the loop after this [s]."""
SHOWN = 100
"""Latest frames whose latency is shown."""


@dataclass(slots=True)
class Followed:
    """What came of watching, row by row."""

    seen: list[Seen] = field(default_factory=list)
    latency: list[float] = field(default_factory=list)
    began: float = float("nan")
    """When the first command was asked for, on the clock of the rows [s]."""
    error: Exception | None = None

    def told(self, latest: int | None = None) -> str:
        """Return the latency in words, of all frames or of the latest."""
        rows = 1e3 * np.array(self.latency[-latest:] if latest else self.latency)
        if not len(rows):
            return "no frame yet"
        dropped = sum(row.skipped for row in self.seen)
        return (
            f"{np.median(rows):.0f} ms p50, {np.quantile(rows, 0.95):.0f} ms p95, {rows.max():.0f} ms most; "
            f"{len(self.seen)} frames, {dropped} dropped for newer ones"
        )

    def track(self) -> LiveTrack:
        """Return the rows as a record."""
        rows = self.seen
        wrists = [[bool(row.valid[i]) for i in (15, 16)] for row in rows]
        return LiveTrack(
            t=np.array([row.t for row in rows]) - self.began,
            latency=np.array(self.latency),
            detector=np.array([row.took for row in rows]),
            skipped=np.array([row.skipped for row in rows], dtype=np.int64),
            seen=np.array(wrists, dtype=np.bool_).reshape(-1, 2),
        )

    def pose(self, zero: float) -> PoseTrack | None:
        """Return what was seen from a moment on [s], as a track; None where nothing was."""
        rows = [row for row in self.seen if row.t >= zero]
        if len(rows) < 2:
            return None
        return PoseTrack(
            t=np.array([row.t for row in rows]) - zero,
            landmarks=np.array([row.landmarks for row in rows]),
            image=np.array([row.image for row in rows]),
            score=np.array([row.score for row in rows]),
            valid=np.array([row.valid for row in rows]),
            size=rows[-1].size,
            swapped=np.array([row.swapped for row in rows]),
        )


@contextmanager
def followed(
    camera: str,
    settings: InputSettings,
    live: LiveSettings,
    *,
    view: LiveView | None = None,
    zero: float = 0.0,
    modest: bool = False,
) -> Iterator[tuple[LiveTargets, Followed]]:
    """Yield commands that follow a camera from now on, and what is recorded of it.

    Args:
        camera: Number, device, or a video in its place.
        settings: How landmarks become targets.
        live: How a camera is followed.
        view: Also shows what is seen.
        zero: Time of the robot when the first command is asked for [s]; the clock of ``view``.
        modest: Whether watching gives way to the loop when the computer is busy.

    Raises:
        SourceError: If the camera cannot be opened.
    """
    from mimic.retarget.live import LiveRetarget, LiveTargets
    from mimic.robot.reach import Reach
    from mimic.sources.camera import watched

    record = Followed()
    retarget = LiveRetarget(Reach(), settings.retarget, live)
    with watched(camera, settings.pose, live, pictures=view is not None, modest=modest) as watch:

        def begin() -> None:
            record.began = time.monotonic()
            watch.begin()

        targets = LiveTargets(Reach(), live, begin=begin)
        thread = threading.Thread(
            target=_follow, args=(watch, retarget, targets, record, view, zero), name="follow", daemon=True
        )
        thread.start()
        with working("frames") as tell:
            over = threading.Event()
            shown = threading.Thread(target=_tell, args=(record, tell, over), daemon=True)
            shown.start()
            before = sys.getswitchinterval()
            sys.setswitchinterval(SWITCH)
            try:
                yield targets, record
            finally:
                sys.setswitchinterval(before)
                over.set()
                shown.join()


def _follow(
    watch: Watch,
    retarget: LiveRetarget,
    targets: LiveTargets,
    record: Followed,
    view: LiveView | None,
    zero: float,
) -> None:
    try:
        for seen in watch.rows():
            aspect = seen.size[0] / seen.size[1]
            targets.put(retarget.see(seen.t, seen.landmarks, seen.image, seen.valid, aspect))
            latency = time.monotonic() - seen.t
            record.seen.append(seen)
            record.latency.append(latency)
            if view is not None:
                view.frame(seen.t - record.began + zero, seen.jpeg, seen.image, seen.valid, latency)
    except Exception as error:
        record.error = error
    finally:
        targets.end()


def _tell(record: Followed, tell: Callable[[str, int], None], over: threading.Event) -> None:
    while not over.wait(0.5):
        tell(f"frame to target {record.told(SHOWN)}", 0)


def play_camera(
    camera: str,
    settings: InputSettings,
    live: LiveSettings,
    *,
    out: Path | None,
    view: bool | None,
    run: RunSettings,
    robot: EffectsSettings,
) -> int:
    """Let the simulated robot follow a camera until Ctrl-C, or a file in its place to its end."""
    from mimic.metrics import run_metrics
    from mimic.policy.runtime import load_policy
    from mimic.robot.description import load_description
    from mimic.run.loop import run_policy
    from mimic.run.pacing import PacedPlant
    from mimic.run.pool import simulated
    from mimic.run.simulation import SimulatedPlant
    from mimic.view.viewer import display_available

    folder = run_folder(Path(camera) if not camera.isdigit() else f"camera {camera}", out)
    tell_of_stand(robot)
    description = load_description()
    policy, sit_down = load_policy(run.policy, description), load_policy(None, description, task="sit_down")
    plant = PacedPlant(SimulatedPlant(description, seed=run.seed, **simulated(robot)))
    note("Ctrl-C ends it; the robot then sits down")
    with ExitStack() as stack:
        window = None
        if view or (view is None and display_available()):
            from mimic.view.live import LiveView

            window = stack.enter_context(LiveView(description))
        targets, record = stack.enter_context(followed(camera, settings, live, view=window, zero=run.stand_up))
        sink = None if window is None else window.tick
        result = run_policy(plant, policy, targets, run, sit_down=sit_down, sink=sink)
    inputs = {"policy": policy.path, "sit_down": sit_down.path}
    inputs |= {"camera": Path(camera)} if Path(camera).is_file() else {}
    inputs |= {} if robot.effects is None else {"effects": Path(robot.effects)}
    parts = {"pose": settings.pose, "retarget": settings.retarget, "live": live, "run": run, "robot": robot}
    made_by = store.provenance(command=COMMAND.get(), settings=parts, inputs=inputs)
    store.save(result.log, folder / LOG, made_by=made_by)
    if result.samples is not None:
        store.save(result.samples, folder / JOINTS, made_by=made_by)
    metrics = run_metrics(result.log, description)
    figures = save_followed(record, result.log, folder, made_by, run) | {"late_steps": plant.late}
    store.save_json(
        {**metrics, "interrupted": result.interrupted, "live": figures, "provenance": made_by}, folder / METRICS
    )
    from mimic.view.scene import save_scene

    with progress_bar("scene") as progress:
        pose = record.pose(record.began + run.blend)
        save_scene(
            folder / SCENE, log=result.log, description=description, pose=pose, made_by=made_by, progress=progress
        )
    table(f"camera {camera}", live_rows(record) | metric_rows(metrics) | {"run folder": str(folder)})
    if plant.late:
        warn(f"the simulation was late in {plant.late} of {len(result.log.t)} steps: this computer is too busy")
    for error in (record.error, result.error):
        if error is not None:
            raise error
    if result.fell_at is not None:
        warn(f"the robot was about to fall at {result.fell_at:.1f} s and sat down")
    return STOPPED if result.fell_at is not None else DONE


def live_rows(record: Followed) -> dict[str, str]:
    """Return how a camera was followed, a figure a row."""
    return {"frame to target": record.told()}


def save_followed(record: Followed, log: RunLog, folder: Path, made_by: Any, run: RunSettings) -> dict[str, Any]:
    """Write what was seen, asked and how late; return the figures of it."""
    track = record.track()
    store.save(track, folder / LIVE, made_by=made_by)
    pose = record.pose(record.began + run.blend)
    if pose is not None:
        store.save(pose, folder / POSE, made_by=made_by)
    asked = asked_for(log)
    if asked is not None:
        store.save(asked, folder / COMMANDS, made_by=made_by)
    milliseconds = 1e3 * track.latency

    def quantile(values: FloatArray, q: float) -> float | None:
        return float(np.quantile(values, q)) if len(values) else None

    return {
        "frames": len(track.t),
        "skipped": int(track.skipped.sum()),
        "seen_share": float(track.seen.any(axis=1).mean()) if len(track.t) else None,
        "latency_ms": {f"p{round(100 * q)}": quantile(milliseconds, q) for q in (0.5, 0.95, 1.0)},
        "detector_ms": {f"p{round(100 * q)}": quantile(1e3 * track.detector, q) for q in (0.5, 0.95, 1.0)},
    }


def asked_for(log: RunLog) -> CommandTrack | None:
    """Return what was asked while tracking, so that it can be played again."""
    rows = log.phase == PHASES.index("track")
    if not rows.any():
        return None
    t = log.t[rows]
    heading = log.heading_des[rows] - log.heading_des[0]
    return CommandTrack(t=t - t[0], v=log.v_des[rows], heading=heading, p_BE=log.p_BE_des[rows])
