"""The robot on its bus, from the command line: play, scan, zero, check."""

from __future__ import annotations

import gc
import threading
import traceback
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mimic import store
from mimic.cli import COMMAND
from mimic.cli.app import BUG, DONE, STOPPED, USER
from mimic.cli.console import console, matrix, note, progress_bar, table, warn
from mimic.cli.inputs import Aloud, InputSettings, Motion, load_motion
from mimic.cli.play import LOG, METRICS, SCENE, metric_rows, run_folder, save_motion, target_rows
from mimic.errors import ConfigError, MimicError
from mimic.settings import BusSettings, LiveSettings, ProbeSettings, RunSettings
from mimic.types import CommandTrack, LiveCommands, RunLog

if TYPE_CHECKING:
    from mimic.cli.live import Followed
    from mimic.policy.contract import PolicyContract
    from mimic.run.loop import RunResult
    from mimic.run.preflight import Finding
    from mimic.run.safety import Event, Supervisor

HEALTH, ERROR = "health.parquet", "error.txt"
"""Files of a run on the robot, beside those of any run."""

WARM_UP = 20
"""Answers that a policy gives before it counts, so that its first ones are not late."""


def tell_findings(findings: list[Finding]) -> None:
    """Print what pre-flight found."""
    words = {"ok": "ok", "note": "note", "stop": "STOP"}
    table("Pre-flight", {f.name: f"{words[f.verdict]:<5} {f.text}" for f in findings})


def wait_for_enter(settings: BusSettings, what: str) -> None:
    """Return when a person has pressed Enter, or at once in a rehearsal."""
    if settings.yes:
        return
    console.input(f"{what} Enter begins, Ctrl-C leaves. ")


def _standing(contract: PolicyContract) -> CommandTrack:
    """Return commands that ask for neutral hands."""
    toes = np.array(contract.neutral_toes).reshape(1, 2, 3)
    return CommandTrack(t=np.zeros(1), v=np.zeros((1, 2)), heading=np.zeros(1), p_BE=toes)


@contextmanager
def _told_live(supervisor: Supervisor) -> Iterator[None]:
    """Print what a supervisor finds, from a thread of its own, so that a slow terminal holds up nothing."""
    over, told = threading.Event(), 0

    def tell() -> None:
        nonlocal told
        while True:
            last = over.wait(0.1)
            for event in supervisor.events[told:]:
                note(f"{event.t:7.2f} s    {event.rule}: {event.text}")
                told += 1
            if last:
                return

    thread = threading.Thread(target=tell, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(2.0)


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Keep other work out of the loop: this thread goes first where it may, and the garbage collector waits."""
    from mimic.run.priority import LOOP, real_time

    gc.collect()
    gc.freeze()
    try:
        with real_time(LOOP):
            yield
    finally:
        gc.unfreeze()


def play_on_robot(
    source: Path | str | None,
    words: str,
    settings: InputSettings,
    *,
    out: Path | None,
    view: bool | None,
    run: RunSettings,
    bus: BusSettings,
    camera: str | None = None,
    live: LiveSettings | None = None,
) -> int:
    """Let the robot stand up, play a source, follow a camera or stand until Ctrl-C, sit down, and write the run folder."""
    from mimic.policy.runtime import load_policy
    from mimic.robot.description import load_description
    from mimic.run.bus_load import expected_load
    from mimic.run.loop import run_policy
    from mimic.run.on_robot import ready
    from mimic.run.recorder import RunRecorder
    from mimic.run.safety import Supervisor
    from mimic.run.signals import Signals
    from mimic.run.ticking import Safety, observation_width

    description = load_description()
    policy = load_policy(run.policy, description)
    sit_down = load_policy(None, description, task="sit_down")
    motion = Motion(commands=_standing(policy.contract)) if source is None else load_motion(source, settings, Aloud())
    standing = source is None and camera is None
    file, name = (source, source.name) if isinstance(source, Path) else (None, source or "robot")
    name = name if camera is None else f"camera {camera}"
    for one in (policy, sit_down):
        for _ in range(WARM_UP):
            one.act(np.zeros(one.contract.observation_size))
    folder = run_folder(source if source is not None else name if camera else Path("robot"), out)
    supervisor, signals = Supervisor(description), Signals()
    what = "It stands up now." if standing else f"It stands up now and plays {name}."
    commands: CommandTrack | LiveCommands = motion.commands
    record: Followed | None = None
    with ExitStack() as stack:
        if camera is not None:  # opened before anything moves
            from mimic.cli.live import followed

            zero = bus.ramp + run.stand_up
            commands, record = stack.enter_context(
                followed(camera, settings, live or LiveSettings(), zero=zero, modest=True)
            )
        plant = stack.enter_context(
            ready(
                words,
                bus,
                description,
                rate_hz=1.0 / description.dt,
                told=tell_findings,
                go=lambda: wait_for_enter(bus, f"{what} Ctrl-C sits down, a second one damps at once."),
            )
        )
        recorder = RunRecorder(folder, observation_width(policy, sit_down), {"dt": policy.contract.dt})
        safety = Safety(supervisor=supervisor, signals=signals, recorder=recorder, ramp=bus.ramp, endless=standing)
        try:
            with signals.caught(), _told_live(supervisor), _undisturbed():
                result = run_policy(plant, policy, commands, run, sit_down=sit_down, safety=safety)
        finally:
            recorder.abandon()
        load = plant.load(), expected_load(plant.exchange.wiring, 1.0 / description.dt)
    inputs = {"policy": policy.path, "sit_down": sit_down.path} | ({} if file is None else {"source": file})
    made_by = store.provenance(command=COMMAND.get(), settings={"run": run, "bus": bus, "live": live}, inputs=inputs)
    figures: dict[str, str] = {}
    measured: dict[str, Any] = {}
    if record is not None:
        from mimic.cli.live import live_rows, save_followed

        measured = {"live": save_followed(record, result.log, folder, made_by, run)}
        figures, motion = live_rows(record), replace(motion, pose=record.pose(record.began + run.blend))
    _save(folder, result, motion, made_by, standing=source is None)
    recorder.discard()
    metrics = _finish(folder, result, motion, made_by, description, measured)
    rows = figures if motion.targets is None else target_rows(motion.targets)
    rows |= metric_rows(metrics) | _timing_rows(result, words, *load) | {"run folder": str(folder)}
    table(name, rows)
    if record is not None and record.error is not None:
        warn(str(record.error))
    status = _last_line(folder, result, plant.ending, endless=source is None)
    from mimic.view.viewer import display_available, open_viewer

    if view or (view is None and display_available()):
        open_viewer(folder / SCENE)
    return status


def _save(folder: Path, result: RunResult, motion: Motion, made_by: Any, *, standing: bool) -> None:
    store.save(result.log, folder / LOG, made_by=made_by)
    assert result.health is not None
    store.save(result.health, folder / HEALTH, made_by=made_by)
    if not standing:
        save_motion(motion, folder, made_by)


def _finish(
    folder: Path, result: RunResult, motion: Motion, made_by: Any, description: Any, more: dict[str, Any]
) -> dict[str, Any]:
    """Write figures and scene of what was measured, with gaps filled in and the feet on the ground."""
    from mimic.metrics import run_metrics
    from mimic.run.gaps import without_gaps
    from mimic.view.scene import save_scene

    log: RunLog = without_gaps(result.log, description)
    metrics = run_metrics(log, description)
    report = {} if motion.targets is None else motion.targets.report
    everything = {**metrics, "interrupted": result.interrupted, "retarget": report, "provenance": made_by}
    store.save_json(everything | more | {"events": [store.plain(e) for e in result.events]}, folder / METRICS)
    shown: dict[str, Any] = {"targets": motion.targets, "pose": motion.pose, "video": motion.video}
    with progress_bar("scene") as progress:
        save_scene(folder / SCENE, made_by=made_by, log=log, description=description, **shown, progress=progress)
    return metrics


def _timing_rows(result: RunResult, words: str, load: Any, expected: Any) -> dict[str, str]:
    health = result.health
    assert health is not None
    compute, late = 1e3 * health.compute[1:], 1e3 * health.late
    lost = int(np.count_nonzero(health.missed))
    return {
        "buses": words,
        "bus load": _load_row(load, expected),
        "computing": f"{np.nanmedian(compute):.1f} ms a tick, {np.nanquantile(compute, 0.99):.1f} ms at the 99th percentile",
        "late ticks": f"{np.count_nonzero(late > 2.0)} by more than 2 ms, {np.count_nonzero(late > 10.0)} by more than 10 ms",
        "answers lost": f"{lost} of {np.count_nonzero(np.isfinite(health.missed))}",
    }


def _load_row(load: Any, expected: Any) -> str:
    return ", ".join(f"{a:.1%} (by the arithmetic {b:.1%})" for a, b in zip(load, expected, strict=True))


def _last_line(folder: Path, result: RunResult, ending: str, *, endless: bool) -> int:
    """Say in one line why and how it ended, and return the exit status."""
    decisive: Event | None = next((e for e in result.events if e.mode > 0), None)
    rule = "finished" if decisive is None else decisive.rule
    worse = [e for e in result.events if e.mode > 0 and e.rule not in ("interrupt", "finished", "at_rest")]
    if result.error is not None and not isinstance(result.error, MimicError):
        text = "".join(traceback.format_exception(result.error))
        (folder / ERROR).write_text(text, encoding="utf-8")
        warn(f"a bug ended it: {result.error}; the traceback is in {folder / ERROR}; {ending}")
        return BUG
    if rule == "finished" or (endless and rule == "interrupt" and not worse):
        note(f"done         {ending}")
        return DONE
    assert decisive is not None
    told = [decisive, *(e for e in worse if e is not decisive)]
    warn(f"stopped: {'; then '.join(e.text for e in told)}; {ending}")
    return STOPPED


def scan_buses(words: str, bus: BusSettings) -> int:
    """Print who is on the buses, and what the wiring misses."""
    from mimic.run.on_robot import reached
    from mimic.run.scan import lacking, scan
    from mimic.types import JOINTS

    with reached(words, bus) as robot:
        seen = scan(robot.link, robot.wiring)
    rows = {}
    for index, one in enumerate(seen):
        for motor, uid in one.motors.items():
            joint = robot.wiring.joint_of(index, motor)
            rows[f"{one.name} motor {motor}"] = {"joint": "–" if joint is None else JOINTS[joint], "uid": f"{uid:016x}"}
        if one.imu:
            rows[f"{one.name} IMU"] = {"joint": f"{one.imu:.0f} Hz", "uid": ""}
        if one.others:
            unknown = ", ".join(f"0x{i:X}" for i in one.others[:6])
            rows[f"{one.name} others"] = {"joint": unknown, "uid": ""}
    if rows:
        matrix("On the buses", rows)
    problems = lacking(seen, robot.wiring)
    for problem in problems:
        warn(problem)
    if problems:
        return USER
    note("all motors and the IMU are there")
    return DONE


def zero_joints(words: str, bus: BusSettings, *, again: bool) -> int:
    """Guide a person through setting the zeros of a robot that lies, and keep them."""
    from mimic.robot.description import load_description
    from mimic.run.homing import home, uneven
    from mimic.run.on_robot import homing_file, reached
    from mimic.types import JOINTS

    description = load_description()
    note(
        "Lay the robot on its four feet with its legs folded, belly level: upper legs 80 deg back, knees bent by 135 deg,"
    )
    note("hips straight. Each joint must be within 20 deg of that; left and right alike. Its motors stay off.")
    wait_for_enter(bus, "Keep your hands off it from here on.")
    with reached(words, bus) as robot:
        known = None if again else robot.homing
        homing, q = home(robot.exchange(), description, known)
    path = homing_file(robot.wiring)
    homing.save(path)
    off = np.rad2deg(q - description.poses["lie"])
    matrix("Zeros", {name: {"degrees from lying": f"{off[j]:+.1f}"} for j, name in enumerate(JOINTS)})
    for text in uneven(q):
        warn(f"{text}; look at both")
    if known is None:
        note(
            "This was the first time: joints are taken to have been exactly in the lying pose, so how well you laid it is"
        )
        note("how well its angles are known. Later calls bring the same angles back, whatever the pose.")
    note(f"done         kept in {path} until the power goes")
    return DONE


def check_robot(words: str, bus: BusSettings, *, hung: bool) -> int:
    """Print what pre-flight finds; nothing moves."""
    from mimic.robot.description import load_description
    from mimic.run.on_robot import guarded, reached
    from mimic.run.preflight import preflight

    description = load_description()
    with reached(words, bus) as robot:
        exchange = robot.exchange()
        rate = 1.0 / description.dt
        options = {"homing": robot.homing, "trust_zeros": bus.homed, "hung": hung}
        findings = preflight(exchange, description, rate_hz=rate, **options)
    findings.append(guarded(findings, words, bus))
    tell_findings(findings)
    return USER if any(f.verdict == "stop" for f in findings) else DONE


def probe_robot(words: str, out: Path, motion: Path | None, settings: ProbeSettings, bus: BusSettings) -> int:
    """Move a robot that hangs, and write the log that calibration reads."""
    from mimic.machine_log import write_log
    from mimic.robot.description import load_description
    from mimic.run.on_robot import ready
    from mimic.run.probe import probe
    from mimic.run.probe_motion import asked_rates, probe_motion, recorded_motion
    from mimic.run.signals import Signals

    if out.suffix.lower() not in (".parquet", ".csv"):
        raise ConfigError(f"--out is {out}; expected a file name that ends with .parquet or .csv")
    description, signals = load_description(), Signals()
    if motion is None:
        targets = probe_motion(description, settings)
    else:
        log = store.load(motion / LOG if motion.is_dir() else motion, RunLog)
        targets = recorded_motion(log.t, log.q_des, description, settings)
    what = (
        f"It moves {settings.joints} joints for {len(targets) / settings.rate:.0f} s; feet free, nobody within reach."
    )
    with ready(
        words,
        bus,
        description,
        rate_hz=asked_rates(targets, settings, description),
        told=tell_findings,
        go=lambda: wait_for_enter(bus, what),
        hung=True,
    ) as plant:
        note(f"It comes to the centre within {2 * settings.approach:g} s. Ctrl-C damps and keeps what was measured.")
        with signals.caught(), _undisturbed():
            result = probe(plant, targets, settings, signals)
    path = write_log(result.log, out)
    rows = {
        "rows": f"{len(result.log.t)} in {result.log.duration:.1f} s, {result.log.rate:.0f} Hz",
        "missing": f"{result.missing:.2%} of the readings asked for",
        "bus load": _load_row(result.load, result.expected),
        "written": str(path),
        "next": f"mimic calibrate {path}",
    }
    table("Probe", rows)
    if result.ended is not None:
        warn(f"stopped: {result.ended.text}; {plant.ending}")
        return STOPPED
    note(f"done         {plant.ending}")
    return DONE


def salvage_run(folder: Path) -> int:
    """Turn the rows of a run whose process was killed into its logs."""
    from mimic.run.recorder import ROWS, salvage

    log, health = salvage(folder)
    made_by = store.provenance(command=COMMAND.get(), inputs={"rows": folder / ROWS})
    store.save(log, folder / LOG, made_by=made_by)
    store.save(health, folder / HEALTH, made_by=made_by)
    (folder / ROWS).unlink()
    note(f"salvaged     {len(log.t)} ticks into {folder / LOG}")
    return DONE
