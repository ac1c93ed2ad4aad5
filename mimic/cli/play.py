"""``mimic SOURCE``: play a motion in simulation or on a robot; retarget, demo, view."""

from __future__ import annotations

import signal
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from mimic.cli import options as o
from mimic.cli.terminal.console import ConsoleReporter, note, table, warn
from mimic.cli.terminal.exit_status import DONE
from mimic.config.play import DEFAULT_ROBOT
from mimic.errors import AssetError, ConfigError

if TYPE_CHECKING:
    from mimic.flows.motions.motion import InputSettings


def play(
    source: Path | None = None,
    /,
    *,
    sim: Annotated[bool, o.Flag] = False,
    robot: o.BusUrl | None = None,
    text: str | None = None,
    plan: Annotated[bool, o.Flag] = False,
    camera: str | None = None,
    out: o.Out = None,
    video: Annotated[Path | None, Parameter(group=o.OUTPUT)] = None,
    view: o.View = None,
    retarget: Annotated[o.Retarget, o.only("retarget", "rate", "mirror", "slow_down")] = None,
    run: Annotated[o.Run, o.only("run", "policy")] = None,
    model: Annotated[o.Effects, o.only("model", "robot_model", "effects")] = None,
    pose: Annotated[o.Pose, o.only("pose", "person", "also")] = None,
    stored: Annotated[o.Stored, o.only("stored")] = None,
    language: Annotated[o.Language, o.only("language")] = None,
    live: Annotated[o.Live, o.only("live")] = None,
    bus: Annotated[o.Bus, o.only("bus", "wiring", "interface", "zeroed", "yes", "dry_run", "tether", "hold")] = None,
) -> int:
    """Play human motion on the robot.

    Parameters
    ----------
    source
        A video of one person; recorded motion (.npz, .trc, .bvh, .c3d, .pkl, .pt); key frames (.yaml); or a track
        written by mimic (.parquet).
    sim
        Play it on a simulated robot.
    robot
        Play it on a real robot. CAN buses: can0, can0,can1, slcan:/dev/ttyACM0, socketcand://HOST:PORT/can0; or
        cyberdog2 for a stock one, go2 for a Unitree Go2 EDU. Without a source it stands until Ctrl-C.
    text
        Play a sentence, such as "step forward, then wave the left hand".
    plan
        Print how the sentence is understood, and play nothing.
    camera
        Follow a camera live: its number or device, or a video file in its place.
    out
        Run folder; default: runs/NAME, with a number appended if it exists.
    video
        Also write a video of person and robot side by side (.mp4).
    view
        Open the Rerun viewer at the end; default: if there is a display.
    """
    if plan:
        return _show_plan(text, o.input_settings(language=language), model)
    _check_robot(sim, robot, bus, model)
    if sum(given is not None for given in (source, text, camera)) > 1:
        raise ConfigError("a file, --text and --camera are different inputs; give one of them")
    if camera is not None:
        _check_camera_options(retarget, pose)
    live_one = "--robot" if robot is not None else "--camera" if camera is not None else ""
    if video is not None and live_one:
        raise ConfigError(f"--video films a simulated run of a file; leave it out with {live_one}")

    settings = o.input_settings(pose=pose, stored=stored, retarget=retarget, language=language)
    if robot is not None:
        from mimic.cli.robot import play_on_robot

        return play_on_robot(
            robot,
            source if text is None else text,
            settings,
            camera=camera,
            live=live,
            run=run,
            bus=bus,
            out=out,
            view=view,
        )
    if camera is not None:
        return _play_camera(camera, settings, live=live, run=run, model=model, out=out, view=view)
    if source is None and text is None:
        raise ConfigError("say what to play: a file, --text with a sentence, or --camera 0")
    from mimic.cli.terminal.rows import show_simulated
    from mimic.flows.play import play_source

    played: Path | str = source if text is None else text  # type: ignore[assignment]
    saved = play_source(played, settings, run=run, effects=model, out=out, film=video, reporter=ConsoleReporter())
    return show_simulated(saved, played.name if isinstance(played, Path) else played, view)


def _check_robot(sim: bool, robot: str | None, bus: o.Bus, model: o.Effects) -> None:
    """Raise a ConfigError unless one robot is named, with its own options alone."""
    if sim == (robot is not None):
        raise ConfigError(
            "add --sim for the simulated robot, or --robot can0 for a real one on that bus"
            if robot is None
            else "--sim and --robot are two robots; give one of them"
        )
    asked = _options(bus) if sim else ""
    if asked:
        raise ConfigError(f"{asked}: for a real robot only; give --robot instead of --sim, or leave it out")
    asked = _options(model) if robot is not None else ""
    if asked:
        raise ConfigError(f"{asked}: for the simulated robot only; give --sim instead of --robot, or leave it out")


def _show_plan(sentence: str | None, settings: InputSettings, model: o.Effects) -> int:
    """Print how a sentence is understood."""
    from mimic.flows.motions.motion import motion_from_text
    from mimic.flows.play import load_robot

    if sentence is None:
        raise ConfigError('--plan shows how a sentence is understood: give --text "wave the left hand"')
    robot = load_robot(DEFAULT_ROBOT if model is None else model.robot_model)
    motion_from_text(sentence, settings, description=robot, reporter=ConsoleReporter())
    return DONE


def _options(settings: Any) -> str:
    """Return the options, as typed, that a group of settings or None has beside its defaults."""
    if settings is None:
        return ""
    changed = [f for f in fields(settings) if getattr(settings, f.name) != f.default]
    return " and ".join(f"--{'no-' * (f.default is True)}{f.name.replace('_', '-')}" for f in changed)


def _check_camera_options(retarget: o.Retarget, pose: o.Pose) -> None:
    """Raise a ConfigError for what can be asked of a stored motion only."""
    if pose is not None and pose.person is not None:
        raise ConfigError("--person chooses among the people of a video file; before a camera, let one person stand")
    if retarget is not None and retarget.slow_down != 1.0:
        raise ConfigError("--slow-down stretches a stored motion; a camera is followed in real time: leave it out")


def _play_camera(
    camera: str,
    settings: InputSettings,
    *,
    live: o.Live,
    run: o.Run,
    model: o.Effects,
    out: Path | None,
    view: bool | None,
) -> int:
    from mimic.cli.terminal.rows import show_simulated
    from mimic.flows.motions.camera import play_camera
    from mimic.view.scene.viewer import display_available

    window = bool(view or (view is None and display_available()))
    saved, record = play_camera(
        camera, settings, live=live, run=run, effects=model, out=out, window=window, reporter=ConsoleReporter()
    )
    if record.overruns:
        ticks = len(saved.run.log.t)
        warn(f"the simulation was late in {record.overruns} of {ticks} steps: this computer is too busy")
    status = show_simulated(saved, f"camera {camera}", False, {"frame to target": record.summary()})
    if record.error is not None:
        raise record.error
    return DONE if saved.run.shortfall is None else status


def demo(
    *,
    out: o.Out = None,
    video: Annotated[Path | None, Parameter(group=o.OUTPUT)] = None,
    view: o.View = None,
    retarget: o.Retarget = None,
    run: o.Run = None,
) -> int:
    """Play a clip that ships with mimic in simulation.

    Parameters
    ----------
    out
        Run folder; default: runs/NAME, with a number appended if it exists.
    video
        Also write a video of person and robot side by side (.mp4).
    view
        Open the Rerun viewer at the end; default: if there is a display.
    """
    from mimic.io.assets import DEMO_CLIP, shipped

    clip = shipped(*DEMO_CLIP)
    return play(clip, sim=True, out=out, video=video, view=view, retarget=retarget, run=run)


def retarget(
    source: Path,
    /,
    *,
    out: o.RequiredOut,
    robot_model: str = DEFAULT_ROBOT,
    retarget: o.Retarget = None,
    pose: o.Pose = None,
    stored: o.Stored = None,
) -> int:
    """Turn a video or recorded motion into toe targets; mimic TARGETS --sim plays them later.

    Parameters
    ----------
    source
        A video of one person, or recorded motion (.npz, .trc, .bvh).
    out
        Parquet file to write.
    robot_model
        cyberdog2, go2, or the folder of another robot with its robot.toml and MJCF; targets stay in its workspace.
    """
    from mimic.cli.terminal.rows import target_rows
    from mimic.flows.play import load_robot, save_targets

    settings = o.input_settings(pose=pose, stored=stored, retarget=retarget)
    motion = save_targets(source, out, settings, description=load_robot(robot_model), reporter=ConsoleReporter())
    table("Targets", target_rows(motion.targets) | {"written": str(out)})
    return DONE


def view(run: Path, /, *, web: Annotated[bool, o.Flag] = False) -> int:
    """Open the Rerun scene of a run folder; without a display, serve it to a browser on this computer.

    Parameters
    ----------
    run
        Run folder, or its scene.rrd.
    web
        Serve it to a browser also where there is a display.
    """
    from mimic.flows.run_folder import SCENE
    from mimic.view.scene.viewer import display_available, open_viewer, serve_scene

    scene = run / SCENE if run.is_dir() else run
    if not scene.is_file():
        raise AssetError(f"there is no {SCENE} in {run}; expected the folder of a run")
    if not web and display_available():
        open_viewer(scene)
        return DONE

    note("open this in a browser on this computer; Ctrl-C ends the server:")
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # otherwise the server would outlive this command
    with suppress(KeyboardInterrupt):
        serve_scene(scene, note)
    return DONE
