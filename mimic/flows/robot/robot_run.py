"""Playing on a real robot: pre-flight check, supervised run, run folder; and salvaging the log of a killed run."""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from mimic.config.hardware import BusSettings
from mimic.config.play import RunSettings
from mimic.config.pose import LiveSettings
from mimic.control.policy_step import observation_width
from mimic.control.recorder import ROWS, RunRecorder
from mimic.control.recorder import salvage as read
from mimic.control.safety.supervisor import Event, Supervisor
from mimic.control.signals import Signals
from mimic.control.start import start_seconds
from mimic.control.tick import Safety
from mimic.errors import AssetError, MimicError, PlantError
from mimic.flows.motions.camera import camera_name, follow_camera
from mimic.flows.motions.camera_record import CameraRecord
from mimic.flows.motions.motion import InputSettings, Motion
from mimic.flows.play import load_source, play, robot_on
from mimic.flows.provenance import provenance
from mimic.flows.reporter import Reporter, reporting
from mimic.flows.robot.operator import Operator, undisturbed
from mimic.flows.run_folder import ERROR, HEALTH, LOG, SavedRun, new_run_folder, save_run
from mimic.frozen import frozen_arrays
from mimic.hardware.can.step_budget import PARTS
from mimic.hardware.hold_to_run import Hold, await_hold, hold_to_run
from mimic.hardware.session import robot_session
from mimic.io import store
from mimic.policy.runtime import Policy, load_policy
from mimic.records import CommandTrack, LiveCommands

HOLD_WITHIN = 20.0
"""What must be held is held within this after the robot may move [s]."""

WARM_UP = 20
"""Inferences of a policy before the robot moves, so that the first ones are not slow."""


@frozen_arrays
class RobotRun:
    """A run on a real robot."""

    saved: SavedRun
    bus_url: str
    ending: str
    """How the robot was left, as a sentence without its full stop."""
    load: Sequence[float]
    """Measured share of each bus's time that was used; empty for a stock robot."""
    camera: CameraRecord | None
    endless: bool
    """Whether it was meant to go on until Ctrl-C."""
    shortfall: str | None
    """What the robot did not do, as a sentence without its full stop; None also for a dry run."""

    @property
    def decisive(self) -> Event | None:
        """The event that first ended the run, if any did."""
        return next((event for event in self.saved.run.events if event.mode > 0), None)

    @property
    def finished(self) -> bool:
        """Whether it stood and ended as it should: by itself, or by Ctrl-C where it was endless."""
        rule = "finished" if self.decisive is None else self.decisive.rule
        asked = rule == "asked_to_end" and self.decisive is not None and self.decisive.mode.name == "SIT_DOWN"
        ended = rule == "finished" or (self.endless and asked and not self.worse)
        return ended and self.shortfall is None

    @property
    def worse(self) -> list[Event]:
        """Events that ended the run and should not have happened."""
        fine = ("asked_to_end", "finished", "at_rest")
        return [event for event in self.saved.run.events if event.mode > 0 and event.rule not in fine]

    @property
    def bug(self) -> Exception | None:
        """The exception that ended the run, where nobody expected it."""
        error = self.saved.run.result.error
        return None if error is None or isinstance(error, MimicError) else error


def play_on_robot(
    bus_url: str,
    source: Path | str | None = None,
    settings: InputSettings | None = None,
    *,
    camera: str | None = None,
    live: LiveSettings | None = None,
    run: RunSettings | None = None,
    bus: BusSettings | None = None,
    out: Path | None = None,
    operator: Operator | None = None,
    reporter: Reporter | None = None,
) -> RobotRun:
    """Let a real robot stand up, play a source, follow a camera or stand until Ctrl-C, sit down; write the run folder.

    Every tick goes to the disk at once, without holding the next one. Whatever fails, the motors end damped.

    Args:
        bus_url: Buses of the robot, such as can0, several with commas, or socketcand://HOST:PORT/can0; or cyberdog2
            for a stock one, or go2 for a Unitree Go2 EDU.
        source: File (Path) or sentence (str) to play; None stands until Ctrl-C.
        settings: How the input becomes commands.
        camera: Follow this camera instead of a source.
        live: How the camera is followed.
        run: How commands are played.
        bus: How the robot is driven.
        out: Run folder; by default runs/NAME.
        operator: Who sees the pre-flight check and confirms that the robot may move.
        reporter: Receives notes, warnings and progress.

    Raises:
        PlantError: If something stands against moving; nothing was moved then.
        BusError: If a bus cannot be opened.
        SourceError, AssetError, ConfigError, ContractError: If something cannot be used, or the run cannot be saved.
    """

    settings = settings or InputSettings()
    live = live or LiveSettings()
    run = run or RunSettings()
    bus = bus or BusSettings()
    if bus.tether:
        run = replace(run, hold_position=False)  # feet that a rope relieves say nothing of the way
    operator = operator or Operator()
    reporter = reporting(reporter)
    description = robot_on(bus_url)
    policy = load_policy(run.policy, description)
    sit_down = load_policy(None, description, task="sit_down")
    motion = _motion(source, settings, policy, reporter)
    played = _played(source, camera)
    standing = played is None
    rate_hz = (PARTS if policy.contract.interpolate else 1) / description.dt
    inference = max(_inference(policy), _inference(sit_down))
    folder = new_run_folder(played or "robot", out)
    moves = not bus.dry_run
    supervisor = Supervisor(description, strict=bus.tether, moves=moves)
    signals = Signals()
    what = _announcement(played, bus)
    commands: CommandTrack | LiveCommands = motion.commands
    record: CameraRecord | None = None
    with ExitStack() as until_saved, ExitStack() as stack:
        if camera is not None:  # opened before anything moves
            zero = start_seconds(bus.start_ramp, description.dt, tested=moves) + run.stand_up
            commands, record = stack.enter_context(
                follow_camera(
                    camera, settings, live, description=description, zero=zero, low_priority=True, reporter=reporter
                )
            )
        hold = None if bus.hold is None else stack.enter_context(hold_to_run(bus.hold))
        recorder = RunRecorder(folder, observation_width(policy, sit_down), {"dt": policy.contract.dt})
        stack.callback(recorder.abandon)
        plant = stack.enter_context(
            robot_session(
                bus_url,
                bus,
                description,
                rate_hz=rate_hz,
                report=operator.show_findings,
                go=lambda: _confirm(operator, what, hold),
                dry_run=bus.dry_run,
                inference=inference,
            )
        )
        safety = Safety(
            supervisor=supervisor,
            signals=signals,
            recorder=recorder,
            ramp=bus.start_ramp,
            tested=moves,
            checked=moves,
            endless=standing,
        )
        signals.hold = None if hold is None else hold.held
        until_saved.enter_context(signals.caught())
        with _shown(supervisor, operator.show_event), undisturbed():
            done = play(commands, plant=plant, policy=policy, sit_down=sit_down, settings=run, safety=safety)
        load = tuple(plant.load())
        stack.close()
        if recorder.restore_events(done.events):
            reporter.warn(f"{folder} was removed while the robot ran; it is written again from memory")
        done = replace(done, motion=None if standing or record else motion)
        if record is not None:
            record.zero = run.blend
        signals.read()
        with _says_how_it_was_left(plant.ending, folder):
            saved = save_run(
                done,
                folder,
                reporter,
                settings={"run": run, "bus": bus, "live": live},
                source=source if isinstance(source, Path) else None,
                camera=record,
                more={"ending": plant.ending},
            )
        recorder.discard()
    ended = RobotRun(
        saved=saved,
        bus_url=bus_url,
        ending=plant.ending,
        load=load,
        camera=record,
        endless=source is None,
        shortfall=None if bus.dry_run else saved.run.shortfall,
    )
    if ended.bug is not None:
        text = "".join(traceback.format_exception(ended.bug))
        (folder / ERROR).write_text(text, encoding="utf-8")
    return ended


def _played(source: Path | str | None, camera: str | None) -> Path | str | None:
    """Return what is played, or followed; None where the robot only stands."""
    return source if camera is None else camera_name(camera)


@contextmanager
def _says_how_it_was_left(ending: str, folder: Path) -> Iterator[None]:
    """Let a run that cannot be saved say how the robot was left, and how to save the run.

    Raises:
        AssetError: If a file cannot be written.
        KeyboardInterrupt: On Ctrl-C.
    """
    try:
        yield
    except OSError as reason:
        raise AssetError(
            f"{ending}; the run could not be saved in {folder}: {reason.strerror or reason}. Make room, then "
            f"run: mimic log salvage {folder}"
        ) from None
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"{ending}; to save the run: mimic log salvage {folder}") from None


def _inference(policy: Policy) -> float:
    """Return the median time that a policy takes [s]; the first calls, which are slow, are over then."""
    observation = np.zeros(policy.contract.observation_size)
    took = []
    for _ in range(WARM_UP):
        begin = time.perf_counter()
        policy.act(observation)
        took.append(time.perf_counter() - begin)
    return float(np.median(took))


def _announcement(played: Path | str | None, bus: BusSettings) -> str:
    """Return what is about to happen."""
    if bus.dry_run:
        return "Dry run: the motors stay off."
    name = played.name if isinstance(played, Path) else played
    what = "It stands up now." if name is None else f"It stands up now and plays {name}."
    return f"{what} On its rope: at most {bus.torque:g} N m." if bus.tether else what


def _confirm(operator: Operator, what: str, hold: Hold | None) -> None:
    """Return once the person wants the robot to move, and holds what must be held.

    Raises:
        PlantError: If nobody holds it.
    """
    operator.confirm(f"{what} Ctrl-C sits down, a second one damps at once.")
    if hold is None:
        return
    operator.say(f"Hold it now, and let go to sit down (within {HOLD_WITHIN:g} s).")

    if not await_hold(hold, HOLD_WITHIN):
        raise PlantError(f"nothing was moved. Nothing was held for {HOLD_WITHIN:g} s (--hold)")


def _motion(source: Path | str | None, settings: InputSettings, policy: Policy, reporter: Reporter) -> Motion:
    """Return what is played; without a source, commands that keep the toes where they are neutral."""
    if source is None:
        toes = np.array(policy.contract.neutral_toes).reshape(1, 2, 3)
        return Motion(commands=CommandTrack(t=np.zeros(1), v=np.zeros((1, 2)), heading=np.zeros(1), p_BE=toes))
    return load_source(source, settings, reporter, policy.description)


@contextmanager
def _shown(supervisor: Supervisor, show: Callable[[Event], None]) -> Iterator[None]:
    """Show what a supervisor finds, from a thread of its own, so that a slow terminal delays nothing."""
    over = threading.Event()
    shown = 0

    def watch() -> None:
        nonlocal shown
        while True:
            last = over.wait(0.1)
            for event in supervisor.events[shown:]:
                show(event)
                shown += 1
            if last:
                return

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(2.0)


def salvage(folder: Path) -> tuple[Path, int]:
    """Turn what a killed run left on disk into its logs.

    Returns:
        The log that was written and its number of ticks.

    Raises:
        AssetError: If the folder holds no rows.
    """

    log, health = read(folder)
    made_by = provenance(inputs={"rows": folder / ROWS})
    store.save(log, folder / LOG, made_by=made_by)
    store.save(health, folder / HEALTH, made_by=made_by)
    (folder / ROWS).unlink()
    return folder / LOG, len(log.t)
