"""A camera drives the robot: capture and pose in a process, filter and clamp in a thread, the loop in the main one."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mimic.config.play import EffectsSettings, RunSettings
from mimic.config.pose import LiveSettings
from mimic.errors import SourceError
from mimic.flows.motion import InputSettings, Motion, fetch_pose_model
from mimic.flows.play import play, save_played, warn_of_stand_effects
from mimic.flows.reporter import Activity, Reporter, SilentReporter
from mimic.flows.run_folder import LIVE, SavedRun, new_run_folder
from mimic.io import store
from mimic.records import PHASES, CommandTrack, FloatArray, LiveTrack, PoseTrack, Provenance, RunLog

if TYPE_CHECKING:
    from mimic.retargeting.live import LiveRetarget, LiveTargets
    from mimic.sources.video.camera import CameraFrame, CameraStream
    from mimic.view.scene.live import LiveView

SWITCH_INTERVAL = 1e-3
"""The thread that clamps gives way to the control loop after this [s]."""
SHOWN = 100
"""Number of latest frames whose latency is shown."""


@dataclass(slots=True)
class CameraRecord:
    """What the camera saw and how long each frame took, row by row."""

    settings: InputSettings = field(default_factory=InputSettings)
    seen: list[CameraFrame] = field(default_factory=list)
    latency: list[float] = field(default_factory=list)
    began: float = float("nan")
    """When the first command was asked for, on the clock of the rows [s]."""
    zero: float = 0.0
    """Time from the first command to the first tracked target [s]."""
    overruns: int | None = None
    """Control steps that the simulation could not finish in time; None on a robot."""
    error: Exception | None = None

    def summary(self, latest: int | None = None) -> str:
        """Return the latency as text, of all frames or of the latest."""
        rows = 1e3 * np.array(self.latency[-latest:] if latest else self.latency)
        if not len(rows):
            return "no frame yet"
        dropped = sum(row.skipped for row in self.seen)
        return (
            f"{np.median(rows):.0f} ms p50, {np.quantile(rows, 0.95):.0f} ms p95, {rows.max():.0f} ms max; "
            f"{len(self.seen)} frames, {dropped} dropped in favour of newer ones"
        )

    def track(self) -> LiveTrack:
        """Return the rows as a record."""
        rows = self.seen
        wrists = [[bool(row.valid[i]) for i in (15, 16)] for row in rows]
        return LiveTrack(
            t=np.array([row.t for row in rows]) - self.began,
            latency=np.array(self.latency),
            detector=np.array([row.detector_s for row in rows]),
            skipped=np.array([row.skipped for row in rows], dtype=np.int64),
            seen=np.array(wrists, dtype=np.bool_).reshape(-1, 2),
        )

    def pose(self) -> PoseTrack | None:
        """Return what was seen from the first tracked target on, as a track; None where nothing was."""
        zero = self.began + self.zero
        rows = [row for row in self.seen if row.t >= zero]
        if len(rows) < 2:
            return None
        t = np.array([row.t for row in rows]) - zero
        track = PoseTrack(
            t=t,
            landmarks=np.array([row.landmarks for row in rows]),
            image=np.array([row.image for row in rows]),
            score=np.array([row.score for row in rows]),
            valid=np.array([row.valid for row in rows]),
            size=rows[-1].size,
            depth_spread=np.array([row.depth_spread for row in rows]),
            swapped=np.array([row.swapped for row in rows]),
        )
        return replace(track, warnings=self._warnings(track))

    def _warnings(self, track: PoseTrack) -> tuple[str, ...]:
        """Return what is to be said of a track, as of that of a video."""
        from mimic.sources.video.screening import person_rows
        from mimic.sources.video.shots import describe, find_changes
        from mimic.sources.video.video import doubts

        rows, pose = self.seen[-len(track.t) :], self.settings.pose
        person = person_rows(track.score, pose.min_visibility)
        clothes = np.array([row.clothes for row in rows])
        still, light = np.zeros(len(rows)), np.full((len(rows), 2), 100.0)  # a camera has no cuts and no fades
        changes = find_changes(track.t, still, light, track.image, person, clothes, track.size)
        doubtful = doubts(track.t, track.landmarks, track.image, track.score, track.swapped, track.size, pose)
        return (*rows[-1].people, *describe(changes, track.t), *doubtful)

    def report(self, pose: PoseTrack, reporter: Reporter) -> None:
        """Say what a run of a video says: doubts, an arm that is not seen, where the camera is."""
        from mimic.retargeting.wrists import pose_report, wrist_track

        try:
            wrists = wrist_track(pose, self.settings.retarget)
        except SourceError as nobody:
            reporter.warn(str(nobody))
            return
        for text in wrists.warnings:
            reporter.warn(text)
        reporter.note(pose_report(pose, self.settings.retarget)["unseen"])

    def motion(self, log: RunLog) -> Motion | None:
        """Return what was asked of the robot in the tracking phase, with the person; it can be played again."""
        rows = log.phase == PHASES.index("track")
        if not rows.any():
            return None
        t = log.t[rows]
        heading = log.heading_des[rows] - log.heading_des[0]
        commands = CommandTrack(t=t - t[0], v=log.v_des[rows], heading=heading, p_BE=log.p_BE_des[rows])
        return Motion(commands=commands, pose=self.pose())

    def save(self, folder: Path, made_by: Provenance) -> dict[str, Any]:
        """Write the latency of every frame; return figures of it for metrics.json."""
        track = self.track()
        store.save(track, folder / LIVE, made_by=made_by)

        def quantiles(seconds: FloatArray) -> dict[str, float | None]:
            shares = (0.5, 0.95, 1.0) if len(seconds) else ()
            found = {f"p{round(100 * q)}": float(np.quantile(1e3 * seconds, q)) for q in shares}
            return {name: found.get(name) for name in ("p50", "p95", "p100")}

        return {
            "frames": len(track.t),
            "skipped": int(track.skipped.sum()),
            "seen_share": float(track.seen.any(axis=1).mean()) if len(track.t) else None,
            "latency_ms": quantiles(track.latency),
            "detector_ms": quantiles(track.detector),
            **({} if self.overruns is None else {"late_steps": self.overruns}),
        }


@contextmanager
def follow_camera(
    camera: str,
    settings: InputSettings,
    live: LiveSettings,
    *,
    view: LiveView | None = None,
    zero: float = 0.0,
    low_priority: bool = False,
    reporter: Reporter | None = None,
) -> Iterator[tuple[LiveTargets, CameraRecord]]:
    """Yield commands that follow a camera from now on, and what is recorded of it.

    Args:
        camera: Number, device, or a video in its place.
        settings: How landmarks become targets.
        live: How a camera is followed.
        view: Also shows what is seen.
        zero: Time of the robot when the first command is asked for [s]; the clock of ``view``.
        low_priority: Whether pose estimation gives way to the control loop when the computer is busy.
        reporter: Receives the latency while it runs.

    Raises:
        SourceError: If the camera cannot be opened.
    """
    from mimic.retargeting.live import LiveRetarget, LiveTargets
    from mimic.robot.reach import Reach
    from mimic.sources.video.camera import check_camera, open_camera

    fetch_pose_model(settings.pose, reporter or SilentReporter(), partial(check_camera, camera))
    record = CameraRecord(settings)
    retarget = LiveRetarget(Reach(), settings.retarget, live)
    with open_camera(camera, settings.pose, live, previews=view is not None, low_priority=low_priority) as stream:

        def begin() -> None:
            record.began = time.monotonic()
            stream.begin()

        targets = LiveTargets(Reach(), live, begin=begin)
        thread = threading.Thread(
            target=_follow, args=(stream, retarget, targets, record, view, zero), name="follow", daemon=True
        )
        thread.start()
        with (reporter or SilentReporter()).activity("frames") as show:
            over = threading.Event()
            shown = threading.Thread(target=_show_latency, args=(record, show, over), daemon=True)
            shown.start()
            before = sys.getswitchinterval()
            sys.setswitchinterval(SWITCH_INTERVAL)
            try:
                yield targets, record
            finally:
                sys.setswitchinterval(before)
                over.set()
                shown.join()


def _follow(
    stream: CameraStream,
    retarget: LiveRetarget,
    targets: LiveTargets,
    record: CameraRecord,
    view: LiveView | None,
    zero: float,
) -> None:
    try:
        for seen in stream.rows():
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


def _show_latency(record: CameraRecord, show: Activity, over: threading.Event) -> None:
    while not over.wait(0.5):
        show(f"frame to target {record.summary(SHOWN)}", 0)


def play_camera(
    camera: str,
    settings: InputSettings | None = None,
    *,
    live: LiveSettings | None = None,
    run: RunSettings | None = None,
    effects: EffectsSettings | None = None,
    out: Path | None = None,
    window: bool = False,
    reporter: Reporter | None = None,
) -> tuple[SavedRun, CameraRecord]:
    """Let the simulated robot follow a camera until Ctrl-C, or a video in its place to its end; write the run folder.

    Args:
        camera: Number or device of the camera, or a video that is played in its place.
        settings: How landmarks become targets.
        live: How the camera is followed.
        run: How targets are played.
        effects: What a calibration found.
        out: Run folder; by default runs/NAME.
        window: Open a viewer while it runs.
        reporter: Receives notes, warnings and progress.

    Returns:
        The run, and what was recorded of the camera.

    Raises:
        SourceError: If the camera cannot be opened.
    """
    from mimic.control.real_time import PacedPlant
    from mimic.robot.description import load_description
    from mimic.simulation.plant import SimulatedPlant, plant_options

    settings, live, run = settings or InputSettings(), live or LiveSettings(), run or RunSettings()
    effects, reporter = effects or EffectsSettings(), reporter or SilentReporter()
    folder = new_run_folder(camera_name(camera), out)
    warn_of_stand_effects(effects, reporter)
    description = load_description()
    plant = PacedPlant(SimulatedPlant(description, seed=run.seed, **plant_options(effects)))
    reporter.note("Ctrl-C ends it; the robot then sits down")
    with ExitStack() as stack:
        view = None
        if window:
            from mimic.view.scene.live import LiveView

            view = stack.enter_context(LiveView(description))
        targets, record = stack.enter_context(
            follow_camera(camera, settings, live, view=view, zero=run.stand_up, reporter=reporter)
        )
        sink = None if view is None else view.tick
        done = play(targets, plant=plant, settings=run, effects=effects, sink=sink)
    record.zero, record.overruns = run.blend, plant.overruns
    parts = {"pose": settings.pose, "retarget": settings.retarget, "live": live, "run": run, "robot": effects}
    source = Path(camera) if Path(camera).is_file() else None
    return save_played(done, folder, parts, reporter, source=source, camera=record), record


def camera_name(camera: str) -> Path | str:
    """Return what a run folder is named after."""
    return f"camera {camera}" if camera.isdigit() else Path(camera)
