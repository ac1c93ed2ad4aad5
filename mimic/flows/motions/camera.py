"""A camera drives the robot: capture and pose in a process, filter and clamp in a thread, the loop in the main one."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from mimic.config.play import RAMP, TRIM, EffectsSettings, RunSettings
from mimic.config.pose import LiveSettings
from mimic.flows.motions.camera_record import CameraRecord
from mimic.flows.motions.motion import InputSettings, fetch_pose_model, refuse_second_video
from mimic.flows.play import load_robot, play, warn_of_stand_effects
from mimic.flows.reporter import Reporter, reporting
from mimic.flows.run_folder import SavedRun, new_run_folder, save_run

if TYPE_CHECKING:
    from mimic.retargeting.live import LiveTargets
    from mimic.robot.description import RobotDescription
    from mimic.view.scene.live import LiveView

SWITCH_INTERVAL = 1e-3
"""The thread that clamps gives way to the control loop after this [s]."""
SHOWN = 100
"""Number of latest frames whose latency is shown."""
SHOW_EVERY = 0.5
"""Time between two showings [s]."""


@contextmanager
def follow_camera(
    camera: str,
    settings: InputSettings,
    live: LiveSettings,
    *,
    view: LiveView | None = None,
    description: RobotDescription,
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
        description: The robot.
        zero: Time of the robot when the first command is asked for [s]; the clock of ``view``.
        low_priority: Whether pose estimation gives way to the control loop when the computer is busy.
        reporter: Receives the latency while it runs.

    Raises:
        SourceError: If the camera cannot be opened.
    """
    from mimic.retargeting.live import LiveRetarget, LiveTargets
    from mimic.robot.reach import Reach
    from mimic.sources.video.camera import check_camera, open_camera

    reporter = reporting(reporter)
    refuse_second_video(settings, "a camera is followed by itself")
    fetch_pose_model(reporter, partial(check_camera, camera))
    record = CameraRecord(settings)
    retarget = LiveRetarget(Reach(description), settings.retarget, live)
    with open_camera(camera, settings.pose, live, previews=view is not None, low_priority=low_priority) as stream:

        def begin() -> None:
            record.began = time.monotonic()
            stream.begin()

        targets = LiveTargets(Reach(description), live, begin=begin)
        with reporter.activity("frames") as show:

            def follow() -> None:
                shown = 0.0
                try:
                    for seen in stream.rows():
                        aspect = seen.size[0] / seen.size[1]
                        targets.put(retarget.see(seen.t, seen.landmarks, seen.image, seen.valid, aspect))
                        latency = time.monotonic() - seen.t
                        record.seen.append(seen)
                        record.latency.append(latency)
                        for text in seen.people if not record.people else ():
                            reporter.warn(text)
                        record.people = seen.people or record.people
                        if seen.t > shown + SHOW_EVERY:
                            nobody = "" if seen.valid.any() else "nobody seen; "
                            show(f"{nobody}frame to target {record.summary(SHOWN)}", 0)
                            shown = seen.t
                        if view is not None:
                            view.frame(seen.t - record.began + zero, seen.jpeg, seen.image, seen.valid, latency)
                except Exception as error:
                    record.error = error
                finally:
                    targets.end()

            threading.Thread(target=follow, name="follow", daemon=True).start()
            before = sys.getswitchinterval()
            sys.setswitchinterval(SWITCH_INTERVAL)
            try:
                yield targets, record
            finally:
                sys.setswitchinterval(before)


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
    from mimic.simulation.plant import SimulatedPlant, plant_options

    settings = settings or InputSettings()
    live = live or LiveSettings()
    run = run or RunSettings()
    effects = effects or EffectsSettings()
    reporter = reporting(reporter)
    folder = new_run_folder(camera_name(camera), out)
    warn_of_stand_effects(effects, reporter)
    description = load_robot(effects.robot_model)
    plant = PacedPlant(SimulatedPlant(description, seed=run.seed, **plant_options(effects)))
    reporter.note("Ctrl-C ends it; the robot then sits down")
    with ExitStack() as stack:
        view = None
        if window:
            from mimic.view.scene.live import LiveView

            view = stack.enter_context(LiveView(description))
        targets, record = stack.enter_context(
            follow_camera(
                camera,
                settings,
                live,
                view=view,
                description=description,
                zero=RAMP + TRIM + run.stand_up,
                reporter=reporter,
            )
        )
        sink = None if view is None else view.tick
        done = play(targets, plant=plant, settings=run, effects=effects, sink=sink)
    record.zero = run.blend
    record.overruns = plant.overruns
    parts = {"pose": settings.pose, "retarget": settings.retarget, "live": live, "run": run, "robot": effects}
    source = Path(camera) if Path(camera).is_file() else None
    return save_run(done, folder, reporter, settings=parts, source=source, camera=record), record


def camera_name(camera: str) -> Path | str:
    """Return what a run folder is named after."""
    return f"camera {camera}" if camera.isdigit() else Path(camera)
