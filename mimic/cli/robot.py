"""A real robot: ``--robot`` and ``mimic robot``."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np

from mimic.cli import options as o
from mimic.cli.terminal.console import ConsoleReporter, console, matrix, note, table, warn
from mimic.cli.terminal.exit_status import BUG, DONE, STOPPED, USER_ERROR
from mimic.config.hardware import DriveSettings
from mimic.flows.robot.operator import Operator
from mimic.records import JOINTS
from mimic.records.table import number

if TYPE_CHECKING:
    from rich.table import Table

    from mimic.control.safety.supervisor import Event
    from mimic.flows.motions.motion import InputSettings
    from mimic.flows.robot.robot_run import RobotRun
    from mimic.flows.watching import Watched
    from mimic.hardware.robot.checks import Check


def _show_findings(findings: list[Check]) -> None:
    words = {"ok": "ok", "note": "note", "stop": "STOP"}
    table("Pre-flight", {f.name: f"{words[f.verdict]:<5} {f.text}" for f in findings})


def _show_event(event: Event) -> None:
    try:
        note(f"{event.t:7.2f} s    {event.rule}: {event.text}")
    except OSError:  # the terminal was closed: what is printed from now on goes nowhere
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.dup2(nowhere, sys.stderr.fileno())


def _operator(settings: DriveSettings | None) -> Operator:
    """Return the person at this terminal; with --yes everything is confirmed at once."""

    def confirm(what: str) -> None:
        if settings is None or not settings.yes:
            try:
                if sys.stdin is None:  # closed by who started mimic
                    raise EOFError
                console.input(f"{what} Press Enter to begin, Ctrl-C to leave. ")
            except (EOFError, KeyboardInterrupt):
                console.print()  # what is said next has a line of its own
                raise

    return Operator(show_findings=_show_findings, confirm=confirm, say=note, show_event=_show_event)


def play_on_robot(
    bus_url: str,
    source: Path | str | None,
    settings: InputSettings,
    *,
    camera: str | None,
    live: o.Live,
    run: o.Run,
    bus: o.Bus,
    out: Path | None,
    view: bool | None,
) -> int:
    """Play on a real robot, print the figures, and return the exit status."""
    from mimic.cli.terminal.rows import open_scene, show_figures
    from mimic.flows.robot.robot_run import play_on_robot as play

    done = play(
        bus_url,
        source,
        settings,
        camera=camera,
        live=live,
        run=run,
        bus=bus,
        out=out,
        operator=_operator(bus),
        reporter=ConsoleReporter(),
    )
    rows = {} if done.camera is None else {"frame to target": done.camera.summary()}
    name = source.name if isinstance(source, Path) else source or "robot"
    show_figures(done.saved, name if camera is None else f"camera {camera}", rows, _timing_rows(done))
    if done.camera is not None and done.camera.error is not None:
        warn(str(done.camera.error))
    open_scene(done.saved.folder, view)
    return _report_end(done)  # how the robot was left is the last line


def _report_end(done: RobotRun) -> int:
    """Say in one line why and how the run ended, and return the exit status."""
    from mimic.flows.run_folder import ERROR

    if done.bug is not None:
        file = done.saved.folder / ERROR
        warn(f"stopped by a bug: {done.bug}; the traceback is in {file}; {done.ending}")
        return BUG
    if done.finished:
        note(f"done         {done.ending}")
        return DONE
    events = [done.decisive, *(event for event in done.worse if event is not done.decisive)]
    texts = [event.text for event in events if event is not None and event.rule != "finished"]
    stood = [] if done.shortfall is None or math.isfinite(done.saved.metrics["stand_up_s"]) else ["it never stood up"]
    warn("stopped: " + "; ".join(part for part in ("; then ".join(texts), *stood, done.ending) if part))
    return STOPPED


def _timing_rows(done: RobotRun) -> dict[str, str]:
    health = done.saved.run.health
    compute = 1e3 * health.compute[1:]
    late = 1e3 * health.late
    lost = int(np.count_nonzero(health.missed))
    return {
        "robot": done.bus_url,
        **(_load_row(done.load) or _command_row(done)),
        "compute time": f"{np.nanmedian(compute):.1f} ms a tick, {np.nanquantile(compute, 0.99):.1f} ms p99",
        "tick overruns": f"{np.nanquantile(late, 0.99):.1f} ms p99; {(late > 2.0).sum()} by more than 2 ms, "
        f"{(late > 10.0).sum()} by more than 10 ms",
        "lost answers": f"{lost} of {np.count_nonzero(np.isfinite(health.missed))}",
    }


def _command_row(done: RobotRun) -> dict[str, str]:
    health = done.saved.run.health
    late = int(np.count_nonzero(np.nan_to_num(health.err_flag).astype(int) & 1))
    gap = 1e3 * float(np.max(np.nan_to_num(health.command_gap), initial=0.0))
    if not gap:  # a board that says nothing of the commands it gets
        return {}
    return {"late commands": f"{late} ticks with error 0x01; longest time without a command {gap:.0f} ms"}


def _load_row(load: Iterable[float]) -> dict[str, str]:
    """Return the measured load of each bus; none of a robot with a board."""
    shares = [f"{share:.1%}" for share in load]
    return {"bus load": ", ".join(shares)} if shares else {}


def scan(bus_url: o.BusUrl, /, *, bus: o.WiringFile = None) -> int:
    """Find motors and IMU on the buses; nothing moves.

    Parameters
    ----------
    bus_url
        Buses, such as can0; see mimic --help.
    """
    from mimic.flows.robot.commissioning import scan_robot

    seen, wiring, problems = scan_robot(bus_url, bus)
    rows = {}
    for index, one in enumerate(seen):
        for motor, uid in one.motors.items():
            joint = wiring.joint_of(index, motor)
            rows[f"{one.name} motor {motor}"] = {"joint": "–" if joint is None else JOINTS[joint], "uid": f"{uid:016x}"}
        if one.imu:
            rows[f"{one.name} IMU"] = {"joint": f"{one.imu:.0f} Hz", "uid": ""}
        if one.others:
            unknown = ", ".join(f"0x{i:X}" for i in one.others[:6])
            rows[f"{one.name} others"] = {"joint": unknown, "uid": ""}
    if rows:
        matrix("On the buses", rows)
    for problem in problems:
        warn(problem)
    if problems:
        return USER_ERROR
    note("all motors and the IMU answered")
    return DONE


def zero(
    bus_url: o.BusUrl,
    /,
    *,
    again: Annotated[bool, o.Flag] = False,
    yes: Annotated[bool, o.Flag] = False,
    bus: o.WiringFile = None,
) -> int:
    """Set the zeros of a robot that lies; needed after every power-up. Nothing moves.

    Parameters
    ----------
    bus_url
        Buses, such as can0; see mimic --help.
    again
        Forget the stored zeros; the robot now lies exactly in the lying pose.
    yes
        Start without waiting for Enter; for rehearsals.
    """
    from mimic.flows.robot.commissioning import zero_robot

    note(
        "For its first zeros, keep its legs folded under a level belly: upper legs 80 deg back, knees bent by 135 deg,"
    )
    note("hips straight, each within 20 deg. Later it may also lie as it sinks without power. Its motors stay off.")
    done = zero_robot(bus_url, bus, again=again, operator=_operator(DriveSettings(yes=yes)))
    off = np.rad2deg(done.off)
    matrix("Zeros", {name: {"degrees from lying": f"{off[j]:+.1f}"} for j, name in enumerate(JOINTS)})
    for text in done.warnings:
        warn(f"{text}; check both")
    if done.first:
        note(
            "These are the first zeros of this robot. They are as exact as the pose it lies in. Later calls restore the"
        )
        note("same angles from any pose.")
    note(f"done         kept in {done.file} until the power goes")
    return DONE


def wire(bus_url: o.BusUrl, /, *, out: o.RequiredOut = Path("wiring.toml"), bus: o.WiringFile = None) -> int:
    """Find out by hand which motor moves which joint, and how the IMU sits, and write the wiring file.

    Nothing moves by itself: the motors stay off. Hang the robot up so that its legs can be moved, and put it down for
    the IMU.

    Parameters
    ----------
    bus_url
        Buses, such as can0; see mimic --help.
    out
        Wiring file to write; give it to the other commands with --wiring.
    """
    from mimic.flows.robot.wiring import wire_robot

    done = wire_robot(bus_url, out, bus, say=note)
    for text in done.differences:
        warn(text)
    if not done.differences:
        note("It agrees with the wiring that was given.")
    note(f"done         {done.file}; use it with --wiring {done.file}")
    return DONE


def damp(bus_url: o.BusUrl, /, *, bus: Annotated[o.Look, o.only("bus", "wiring", "interface")] = None) -> int:
    """Damp all motors until the robot rests, and switch them off: for motors that a program left on.

    Parameters
    ----------
    bus_url
        Buses, such as can0, or go2; see mimic --help. A stock CyberDog 2 damps itself.
    """
    from mimic.flows.robot.commissioning import damp_robot

    off, ending = damp_robot(bus_url, bus)
    if not off:
        warn(ending)
        return STOPPED
    note(f"done         {ending}")
    return DONE


def check(bus_url: o.BusUrl, /, *, suspended: Annotated[bool, o.Flag] = False, bus: o.Look = None) -> int:
    """Run the pre-flight check alone; nothing moves.

    Parameters
    ----------
    bus_url
        Buses, such as can0, or cyberdog2 or go2 for a stock robot; see mimic --help.
    suspended
        The robot is suspended, not lying.
    """
    from mimic.flows.robot.commissioning import check_robot

    findings = check_robot(bus_url, bus, suspended=suspended)
    _show_findings(findings)
    against = [f.name for f in findings if f.verdict == "stop"]
    if against:
        warn(f"it must not move yet: {', '.join(against)}")
        return USER_ERROR
    note("done         nothing stands against moving it")
    return DONE


def watch(
    bus_url: o.BusUrl,
    /,
    *,
    seconds: float | None = None,
    every: float = 0.5,
    view: Annotated[bool, o.Flag] = False,
    scene: Path | None = None,
    bus: o.Look = None,
) -> int:
    """Show joints, orientation, temperatures and errors of a robot while it is moved by hand; nothing moves.

    Parameters
    ----------
    bus_url
        Buses, such as can0, or cyberdog2 or go2 for a stock robot; see mimic --help.
    seconds
        End after this time [s]; default: at Ctrl-C.
    every
        Time between two tables [s].
    view
        Also open the Rerun viewer and show the robot's pose.
    scene
        Also write the robot's poses to this Rerun scene (.rrd).
    """
    from rich.live import Live

    from mimic.flows.watching import Show, watch_robot

    with ExitStack() as stack:
        stack.enter_context(suppress(KeyboardInterrupt))  # the ordinary end
        show: Show = lambda seen: console.print(_watched(seen))  # noqa: E731
        if console.is_terminal:
            live = stack.enter_context(Live(console=console, auto_refresh=False))
            show = lambda seen: live.update(_watched(seen), refresh=True)  # noqa: E731
        watch_robot(bus_url, bus, seconds=seconds, every=every, show=show, scene=scene or view)
    note("done         nothing was moved")
    return DONE


def _watched(seen: Watched) -> Table:
    """Return a table of what a robot says."""
    from rich.table import Table

    rates = ", ".join(f"{name} {rate:.0f} Hz" for name, rate in seen.rates.items())
    roll, pitch, yaw = (number(float(angle), "{:+.1f}") for angle in np.rad2deg(seen.rpy))
    shown = Table(
        title=f"{seen.t:.1f} s: {rates}",
        caption=f"roll {roll}, pitch {pitch}, yaw {yaw} deg; {'; '.join(seen.notes)}",
        title_justify="left",
        caption_justify="left",
    )
    for name in ("joint", "angle deg", "speed rad/s", "torque N m", "degC", "errors"):
        shown.add_column(name, justify="left" if name == "joint" else "right")
    for j, joint in enumerate(JOINTS):
        values = {
            "{:+.1f}": np.rad2deg(seen.report["q"][j]),
            "{:+.2f}": seen.report["dq"][j],
            "{:+.1f} ": seen.report["tau"][j],
            "{:.0f}": seen.report["temperature"][j],
        }
        faults = int(seen.report["faults"][j])
        errors = f"{faults:#x}" if faults else ""
        shown.add_row(joint, *(number(float(value), form) for form, value in values.items()), errors)
    return shown


def probe(
    bus_url: o.BusUrl,
    /,
    *,
    out: o.RequiredOut = Path("probe.parquet"),
    motion: Path | None = None,
    probe: o.Probe = None,
    bus: o.Drive = None,
) -> int:
    """Move the joints of a robot that hangs with its feet free, and write the log that mimic calibrate reads.

    Parameters
    ----------
    bus_url
        Buses, such as can0; see mimic --help.
    out
        Parquet or CSV file to write.
    motion
        Play the targets of this run folder or log.parquet, scaled into the collision-free joint ranges.
    """
    from mimic.flows.robot.commissioning import probe_robot

    result, path, ending = probe_robot(
        bus_url, out, motion=motion, settings=probe, bus=bus, operator=_operator(bus), reporter=ConsoleReporter()
    )
    rows = {
        "rows": f"{len(result.log.t)} in {result.log.duration:.1f} s, {result.log.rate:.0f} Hz",
        "missing": f"{result.missing:.2%} of the readings asked for",
        **_load_row(result.load),
        "written": str(path),
        "next": f"mimic calibrate {path}",
    }
    table("Probe", rows)
    if result.ended is not None:
        warn(f"stopped: {result.ended.text}; {ending}")
        return STOPPED
    note(f"done         {ending}")
    return DONE


def new(mjcf: Path, /, *, out: o.RequiredOut) -> int:
    """Write the folder of another robot from its MJCF: numbers that it does not tell are guessed, and marked so.

    Parameters
    ----------
    mjcf
        MJCF of a robot with four legs of three joints.
    out
        Folder to write; its name is the robot's.
    """
    from mimic.flows.new_robot import new_robot

    description, guessed = new_robot(mjcf, out)
    rows = {f"base height, {pose}": f"{100 * height:.1f} cm" for pose, height in description.pose_height.items()}
    table(f"Robot {description.name}", rows | {"guessed": f"{guessed} numbers, marked in {out / 'robot.toml'}"})
    note(f"next         mimic retarget VIDEO -o targets.parquet --robot-model {out}")
    return DONE
