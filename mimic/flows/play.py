"""Commands -> a plant -> a log: one flow for simulation, camera and robot."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mimic.config.play import DEFAULT_ROBOT, EffectsSettings, RunSettings
from mimic.errors import AssetError, ConfigError, SourceError
from mimic.flows.motions.motion import Arrays, InputSettings, Motion, as_motion, is_video, load_motion, motion_from_text
from mimic.flows.provenance import provenance
from mimic.flows.reporter import Reporter, reporting
from mimic.flows.run_folder import (
    COMMANDS,
    HEALTH,
    JOINTS,
    LOG,
    METRICS,
    POSE,
    TARGETS,
    Run,
    SavedRun,
    check_not_overwritten,
    new_run_folder,
    save_run,
)
from mimic.io import store
from mimic.io.reading import existing
from mimic.records import (
    CommandTrack,
    HealthLog,
    JointSamples,
    LiveCommands,
    PoseTrack,
    RunLog,
    TargetTrack,
    WristTrack,
)

if TYPE_CHECKING:
    from mimic.control.plant import Plant
    from mimic.control.tick import Safety, Sink
    from mimic.policy.runtime import Policy
    from mimic.robot.description import RobotDescription


def load_robot(name: str | Path = DEFAULT_ROBOT) -> RobotDescription:
    """Return the description of a robot: joints, limits, poses, motors, each number with its source.

    Args:
        name: A shipped robot, or the folder of another one, or its robot.toml (docs/manual/add-a-robot.md).

    Raises:
        AssetError: If there is no such robot, or its file lacks a number.
    """
    from mimic.robot.description import load_description

    return load_description(name)


def robot_on(bus_url: str) -> RobotDescription:
    """Return the robot behind some buses: a board's own robot, or the default one's motors on CAN."""
    from mimic.hardware.robot.board_wiring import BOARDS

    return load_robot(bus_url if bus_url in BOARDS else DEFAULT_ROBOT)


def robot_of(log: RunLog) -> RobotDescription:
    """Return the robot of a run."""
    return load_robot(str(log.metadata.get("robot", DEFAULT_ROBOT)))


def load_policy(policy: str | Path | None = None, robot: RobotDescription | None = None) -> Policy:
    """Return a low-level policy, ready to run.

    Args:
        policy: ONNX file with its contract inside, or the name of a shipped policy; by default stand_track.
        robot: Robot that it must fit; by default the CyberDog 2.

    Raises:
        AssetError: If there is no such policy, or it is no ONNX model.
        ContractError: If it declares no contract, or one that does not fit the robot.
    """
    from mimic.policy.runtime import Policy, find_policy

    robot = robot or load_robot()
    return Policy(find_policy("stand_track" if policy is None else policy, robot.name), robot)


def play(
    commands: str | Path | Arrays | Motion | CommandTrack | TargetTrack | WristTrack | PoseTrack | LiveCommands,
    *,
    robot: str | Path | None = None,
    plant: Plant | None = None,
    policy: Policy | str | Path | None = None,
    sit_down: Policy | None = None,
    settings: RunSettings | None = None,
    effects: EffectsSettings | None = None,
    safety: Safety | None = None,
    sink: Sink | None = None,
    reporter: Reporter | None = None,
) -> Run:
    """Stand up, play commands through a policy, sit down. Writes no files.

    Args:
        commands: A file, arrays (see `load_motion`), a motion, a track at any stage (it is retargeted as needed), or
            live commands.
        robot: Which robot is simulated, such as "go2" (see `load_robot`); by default that of the effects.
        plant: Robot that plays them instead; it is closed at the end.
        policy: Low-level policy or its ONNX file; by default the shipped one.
        sit_down: Policy that brings the robot down at the end; by default the shipped one.
        settings: Times of the phases, seed of the simulated start; its ``policy`` counts where none is given. Those of
            retargeting are for `load_motion`.
        effects: What a calibration found, for the simulated robot.
        safety: Supervision of the run; by default every rule at its usual limit, without a recorder.
        sink: Called after each control tick; must not block.
        reporter: Receives progress.

    Returns:
        The run, with its log and what the supervisor found. A fall ends it early (``result.fell_at``); so does a
        failure after the first tick (``result.error``), after which the robot is damped.

    Raises:
        AssetError, ConfigError, ContractError: If policy, effects or commands do not fit.
        SourceError: If there is no such file, or it holds no motion that can be played.
        PlantError: If the plant fails before the first tick.
    """
    from mimic.control.loop import run_policy
    from mimic.policy.runtime import Policy
    from mimic.policy.runtime import load_policy as policy_for

    settings = settings or RunSettings()
    effects = effects or EffectsSettings()
    reporter = reporting(reporter)
    if robot is not None:
        effects = replace(effects, robot_model=str(robot))
    description = load_robot(effects.robot_model) if plant is None else plant.description
    if isinstance(commands, str | Path) and not os.path.exists(commands):
        raise SourceError(f"there is no file {commands}; to play a sentence: play(motion_from_text(sentence))")
    if isinstance(commands, (str, Path, Mapping, np.ndarray)):
        commands = load_motion(commands, description=description, reporter=reporter)
    motion: Motion | None = None
    asked: CommandTrack | LiveCommands
    if isinstance(commands, LiveCommands):
        asked = commands
    else:
        motion = as_motion(commands, description=description, reporter=reporter)
        asked = motion.commands
    if not isinstance(policy, Policy):
        policy = policy_for(settings.policy if policy is None else policy, description)
    sit_down = sit_down or shipped_sit_down(description, reporter)
    inputs = {"policy": policy.path} | ({} if sit_down is None else {"sit_down": sit_down.path})
    if plant is None:
        from mimic.simulation.plant import SimulatedPlant, plant_options

        plant = SimulatedPlant(description, seed=settings.seed, **plant_options(effects))
    if effects.effects is not None:
        inputs["effects"] = Path(effects.effects)
    with reporter.progress("run") as progress:
        result = run_policy(
            plant,
            policy,
            asked,
            settings,
            sit_down=sit_down,
            sink=sink,
            progress=progress,
            safety=safety,
        )
    return Run(motion=motion, result=result, description=description, inputs=inputs)


def shipped_sit_down(description: RobotDescription, reporter: Reporter) -> Policy | None:
    """Return the shipped policy that brings a robot down; None, with a warning, for a robot that has none."""
    from mimic.policy.runtime import load_policy as policy_for

    try:
        return policy_for(None, description, task="sit_down")
    except AssetError:
        reporter.warn(f"there is no shipped sit_down policy for {description.name}; it stands at the end of the run")
        return None


def play_source(
    source: Path | str,
    settings: InputSettings | None = None,
    *,
    run: RunSettings | None = None,
    effects: EffectsSettings | None = None,
    out: Path | None = None,
    film: Path | None = None,
    reporter: Reporter | None = None,
) -> SavedRun:
    """Play a file (Path) or a sentence (str) on the simulated robot and write its run folder.

    Args:
        source: File, or a sentence.
        settings: How the input becomes commands.
        run: How they are played.
        effects: What a calibration found.
        out: Run folder; by default runs/NAME.
        film: Also write a film (.mp4) of person and robot side by side.
        reporter: Receives notes, warnings and progress.

    Raises:
        SourceError, AssetError, ConfigError, ContractError: If something cannot be used; nothing is written then.
    """
    from mimic.policy.runtime import load_policy as policy_for
    from mimic.simulation.plant import plant_options

    settings = settings or InputSettings()
    run = run or RunSettings()
    effects = effects or EffectsSettings()
    reporter = reporting(reporter)
    file = existing(source) if isinstance(source, Path) else None
    if film is not None and film.suffix != ".mp4":
        raise ConfigError(f"--video is {film}; expected a file name that ends with .mp4")
    if film is not None:
        store.check_file(film)
    if file is not None:
        check_not_overwritten(file, film)
    folder = new_run_folder(source, out)
    warn_of_stand_effects(effects, reporter)
    with ExitStack() as stack:
        footage = None
        if file is not None and is_video(file):
            from mimic.view.scene.footage import Footage

            footage = stack.enter_context(Footage(file))
        plant_options(effects)  # refused before long work, as a policy
        policy_for(run.policy, load_robot(effects.robot_model))
        motion = load_source(source, settings, reporter, load_robot(effects.robot_model))
        done = play(motion, settings=run, effects=effects, reporter=reporter)
        parts = vars(settings) | {"run": run, "robot": effects}
        return save_run(done, folder, reporter, settings=parts, source=file, film=film, footage=footage)


def load_run(folder: str | Path) -> SavedRun:
    """Read the folder of a run: logs, motion, events and figures.

    Args:
        folder: Run folder that a command or `Run.save` wrote.

    Returns:
        The run as it was saved. Its video and key frames are not read again.

    Raises:
        AssetError: If it is no run folder, or a file in it is broken.
    """
    from mimic.control.loop import RunResult
    from mimic.control.safety.supervisor import Event, SafetyMode

    folder = Path(folder)
    if not (folder / LOG).is_file():
        raise AssetError(f"there is no {LOG} in {folder}; expected the folder of a run")
    metrics = store.load_json(folder / METRICS)
    if missing := {"events", "interrupted"} - set(metrics):
        raise AssetError(f"{folder / METRICS} has no {', '.join(sorted(missing))}; it is not as mimic wrote it")
    log = store.load(folder / LOG, RunLog)

    def stored(name: str, kind: type[store.R]) -> store.R | None:
        return store.load(folder / name, kind) if (folder / name).is_file() else None

    description = robot_of(log)
    motion = None
    targets = stored(TARGETS, TargetTrack)
    commands = stored(COMMANDS, CommandTrack)
    if commands is not None:
        motion = Motion(commands=commands, targets=targets, pose=stored(POSE, PoseTrack))
    elif targets is not None:
        motion = replace(as_motion(targets, description=description), pose=stored(POSE, PoseTrack))
    result = RunResult(
        log=log,
        health=store.load(folder / HEALTH, HealthLog),
        events=tuple(Event(**event | {"mode": SafetyMode(event["mode"])}) for event in metrics["events"]),
        samples=stored(JOINTS, JointSamples),
        fell_at=log.metadata.get("fell_at"),
        interrupted=metrics["interrupted"],
    )
    run = Run(motion=motion, result=result, description=description)
    return SavedRun(run=run, folder=folder, metrics=metrics)


def save_targets(
    source: Path,
    out: Path,
    settings: InputSettings | None = None,
    *,
    description: RobotDescription | None = None,
    reporter: Reporter | None = None,
) -> Motion:
    """Retarget a source and write its toe targets, without playing them.

    Args:
        source: A video, recorded motion, or a record of mimic.
        out: Parquet file to write.
        settings: How the input becomes targets.
        description: Robot whose workspace they are clamped to; by default the shipped CyberDog 2.
        reporter: Receives notes, warnings and progress.

    Raises:
        SourceError: If the source has no targets.
        ConfigError: If ``out`` is the source, or no Parquet file.
    """
    settings = settings or InputSettings()
    check_not_overwritten(source, out)
    if out.suffix.lower() != ".parquet":
        raise ConfigError(f"--out is {out}; expected a file name that ends with .parquet")
    store.check_file(out)
    motion = load_motion(source, settings, description=description, reporter=reporter)
    if motion.targets is None:
        raise SourceError(f"{source} holds commands without targets; to play them: mimic {source} --sim")
    store.save(motion.targets, out, made_by=provenance(settings, {"source": source}))
    return motion


def load_source(source: Path | str, settings: InputSettings, reporter: Reporter, robot: RobotDescription) -> Motion:
    """Return the motion of a file (Path) or a sentence (str)."""
    if isinstance(source, Path):
        return load_motion(source, settings, description=robot, reporter=reporter)
    return motion_from_text(source, settings, description=robot, reporter=reporter)


def warn_of_stand_effects(effects: EffectsSettings, reporter: Reporter) -> None:
    """Warn of effects that belong to the stand in which the robot hung; a robot on its feet does without them."""
    if effects.effects is None:
        return
    from mimic.dynamics.effect_set import read_effects
    from mimic.dynamics.servo import of_stand

    for name in of_stand(read_effects(Path(effects.effects))):
        reporter.warn(f"effect {name!r} belongs to the stand of the calibration; the robot on its feet does without it")
