"""Runs of both emulated robots with real processes and sockets, in real time.

`mimic emulate` is one process, `mimic TARGETS --robot` with its sending process others, and a proxy stands
between them: over TCP for socketcand, over multicast for LCM. What the motors did at the end is what the emulator says
when it ends. Needs root or user namespaces, for a network and a small disk of its own.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from lab.faults.can_scene import CUTS
from lab.faults.drawn import random_fault
from lab.faults.proxies import LcmProxy, TcpProxy, wiring_through
from lab.faults.trouble import CASES, logged, stood
from mimic.control.recorder import ROWS, salvage
from mimic.emulator.faults import EmulatedFault
from mimic.hardware.can.opening import open_link
from mimic.hardware.motors.cybergear.codec import Codec, HostMessage, Kind
from mimic.hardware.motors.interface import MotorCommand
from mimic.hardware.stock.messages import MOTOR_CTRL
from mimic.io import store
from mimic.policy.runtime import load_policy
from mimic.records import RunLog, TargetTrack
from mimic.robot.description import load_description

ROOT = Path(__file__).parents[2]

HELPER = "mimic.hardware.robot.process"
"""Module of the process that sends."""

CUT_OFF = ("host_killed", "both_killed", "disk_full", "disk_small")
"""After these the process could write no more."""

WITHIN = (0.2, 10.9)
"""When it happens, after the robot was switched on [s]; in the 2.5 s before, a stock robot is limp."""

USER = 2
"""Exit status of what is refused."""

HANG = 90.0
"""A run that has not ended by then hangs [s]."""

SETTLE = 40.0
"""How long the second process of a run that was killed may take [s]."""

DISK = 3
"""Size of the disk that fills, or on which a scene does not fit [MB]."""

REAL_TIME = ["chrt", "-f", "5"] if os.geteuid() == 0 else []
"""The emulator must not be late on a busy computer."""

SECOND = {"run": ["--yes"], "probe": ["--yes"], "watch": ["--seconds", "2"], "zero": ["--yes"]}
"""More words of a second command beside the run."""


class Process:
    """A process of mimic's command line; for a with statement."""

    def __init__(self, output: Path, *words: str, first: Sequence[str] = ()) -> None:
        self._output = output
        with output.open("w") as file:
            self.process = subprocess.Popen(
                [*first, sys.executable, "-m", "mimic", *words],
                cwd=ROOT,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                env=os.environ | {"COLUMNS": "500", "PYTHONUNBUFFERED": "1"},
                start_new_session=True,
            )

    @property
    def said(self) -> str:
        """What it has printed."""
        return self._output.read_text(encoding="utf-8", errors="replace")

    def until(self, wanted: str, seconds: float = 60.0) -> str:
        """Return the first line with these words; empty where it ends or takes too long."""
        end, lines, alive = time.monotonic() + seconds, [""], True
        while alive and not any(wanted in line for line in lines) and time.monotonic() < end:
            time.sleep(0.02)
            alive, lines = self.process.poll() is None, self.said.splitlines()
        return next((line for line in lines if wanted in line), "")

    def end(self, seconds: float) -> bool:
        """Wait for its end, kill it if that takes too long, and return whether it ended by itself."""
        try:
            self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            return False
        return True

    def __enter__(self) -> Process:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: object, trace: TracebackType | None) -> None:
        send_signals([self.process.pid] if self.process.poll() is None else [], signal.SIGCONT, signal.SIGTERM)
        self.end(20.0)


def helper_of(pid: int, module: str) -> int | None:
    """Return the second process that a process started."""
    for listed in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in listed.read_text().split():
            with suppress(OSError):
                if module.encode() in Path(f"/proc/{child}/cmdline").read_bytes():
                    return int(child)
    return None


def send_signals(pids: Sequence[int | None], *numbers: int) -> None:
    for number in numbers:
        for pid in pids:
            if pid is not None:
                with suppress(ProcessLookupError):
                    os.kill(pid, number)


class _Robot:
    """An emulator in a process, a proxy before it, and the words that `mimic` needs to reach it."""

    def __init__(self, robot: str, seed: int, work: Path, stack: ExitStack, more: Sequence[str]) -> None:
        own = (
            ["--listen", "127.0.0.1:0", "--zeroed", "--placement", "0.03"]
            if robot == "can"
            else ["--board", "cyberdog2"]
        )
        words = ["emulate", "--every", "0", "--seed", str(seed), *own, *more]
        self.kind = robot
        self.emulator = stack.enter_context(Process(work / "emulator.txt", *words, first=REAL_TIME))
        line = self.emulator.until("ready")
        found = re.search(r"socketcand://127\.0\.0\.1:(\d+)/can0", line)
        if not line or (robot == "can" and found is None):
            raise RuntimeError(f"the emulator does not start: {self.emulator.said}")
        self.proxy: TcpProxy | LcmProxy
        self.direct = "" if found is None else found[0]
        if found is not None:
            self.proxy = stack.enter_context(TcpProxy(int(found[1]), seed))
            self.words = [f"socketcand://127.0.0.1:{self.proxy.port}/can0", "--zeroed"]
            self.event = "switched on"
        else:
            self.proxy = stack.enter_context(LcmProxy(seed))
            wiring = wiring_through(work / "board.toml")
            self.words = ["cyberdog2", "--interface", "lo", "--wiring", str(wiring)]
            self.event = "motor mode"

    def left(self) -> str:
        """End the emulator, and return what it says of its motors."""
        send_signals([self.emulator.process.pid], signal.SIGCONT, signal.SIGTERM)
        self.emulator.end(20.0)
        found = re.search(r"motors at the end\W+(.*?)\s*[│|]?\s*$", self.emulator.said, re.MULTILINE)
        return "nothing" if found is None else found[1].strip()


def _master(scene: _Robot, kind: str, rng: np.random.Generator, seconds: float) -> None:
    """Command the robot as another program would."""
    end = time.monotonic() + seconds
    if scene.kind == "stock":
        assert isinstance(scene.proxy, LcmProxy)
        while time.monotonic() < end:
            ones = np.ones(12)
            q = rng.uniform(-0.5, 0.5, 12)
            scene.proxy.inject(MOTOR_CTRL.encode(q_des=q, kp_des=20.0 * ones, kd_des=ones))
            time.sleep(0.002)
        return
    link, codec = open_link(scene.direct), Codec()
    while time.monotonic() < end:
        for motor in range(1, 13):
            q = float(rng.uniform(-2.0, 2.0))
            stop, go = (
                HostMessage(Kind.STOP, motor),
                HostMessage(Kind.OPERATION, motor, command=MotorCommand(q=q, dq=0.0, kp=30.0, kd=1.0, tau=0.0)),
            )
            link.send(0, codec.encode(stop if kind == "master_stops" else go))
        time.sleep(0.02)
    link.close()


def _fill(disk: Path) -> None:
    """Fill a disk, and keep it full for a while."""
    for name, size in (("filler", 4096), ("filler2", 1)):
        with suppress(OSError), (disk / name).open("wb", buffering=0) as file:
            while True:
                file.write(bytes(size))


def _happen(kind: str, scene: _Robot, host: Process, disk: Path, rng: np.random.Generator) -> dict[str, Any]:
    """Do what the kind says; return what is known of it."""
    own, helper = host.process.pid, helper_of(host.process.pid, HELPER)
    lasts = float(rng.choice([0.05, 0.2, 1.0, 1e9]))
    known: dict[str, Any] = {"lasts": lasts, "helper": helper, "at": time.monotonic()}
    if CASES[kind].place == "messages":
        scene.proxy.disturb(kind, float(rng.uniform(0.05, 0.6)), float(rng.uniform(0.002, 0.08)), lasts)
    if CASES[kind].place in ("messages", "robot"):
        return known
    pause = known["lasts"] = float(rng.choice([0.05, 0.3, 2.0]))
    whose = {"host": [own], "helper": [helper], "both": [helper, own], "emulator": [scene.emulator.process.pid]}
    match kind.split("_"):
        case [who, "killed"]:
            send_signals(whose[who], signal.SIGKILL)
        case [who, "stopped"]:
            send_signals(whose[who], signal.SIGSTOP)
            time.sleep(pause)
            send_signals(whose[who], signal.SIGCONT)
        case ["disk", "full"]:
            _fill(disk)
        case ["ctrl", "c", *more]:
            for _ in range({"": 1, "twice": 2, "thrice": 3}["".join(more)]):
                send_signals([own], signal.SIGINT)
                time.sleep(pause)
        case ["sigterm"]:
            send_signals([own], signal.SIGTERM)
        case ["terminal", "closed"]:
            send_signals([own], signal.SIGHUP)
        case ["second", verb]:
            words = ["--robot"] if verb == "run" else ["robot", verb]
            knows_zeros = verb in ("check", "watch", "run", "probe")
            reach = [word for word in scene.words if knows_zeros or word != "--zeroed"]
            to = {"run": ["-o", str(disk / "second")], "probe": ["-o", str(disk / "second.parquet")]}.get(verb, [])
            second = Process(disk.parent / "second.txt", *words, *reach, *SECOND.get(verb, []), *to)
            known["second_hung"] = not second.end(60.0)
            known["second"] = second.said.strip().splitlines()[-1:]
            known["second_traceback"] = traceback_in(second.said)
        case ["master", *_]:
            _master(scene, kind, rng, min(pause, 1.0))
    return known


def play(robot: str, seed: int, motion: Path, work: Path, kinds: Sequence[str]) -> dict[str, Any]:
    """Play a run with the fault of a seed, of these kinds in turn, and return how it ended."""
    rng = np.random.default_rng([seed, 61, len(robot)])
    kind = kinds[seed % len(kinds)]
    start, own_timeout = float(rng.uniform(*WITHIN)), bool(rng.random() < 0.5)
    of_robot = CASES[kind].place == "robot"
    fault = random_fault(seed, start=(start, start), after_release=True, kinds=(kind,)) if of_robot else None
    began = time.monotonic()
    disk = work / "disk"
    disk.mkdir()
    small = kind in ("disk_full", "disk_small")
    if small:
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK}m", "tmpfs", str(disk)], check=True)
    run = disk / "run"
    known: dict[str, Any] = {}
    with ExitStack() as stack:
        faults = [] if fault is None else ["--fault", str(fault)]
        timeout = ["--can-timeout"] if robot == "can" and own_timeout else []
        scene = _Robot(robot, seed, work, stack, [*faults, *timeout])
        host = stack.enter_context(
            Process(work / "host.txt", str(motion), "--robot", *scene.words, "--yes", "--no-view", "-o", str(run))
        )
        moved = bool(scene.emulator.until(scene.event))
        time.sleep(start)
        if host.process.poll() is None:
            known = _happen(kind, scene, host, disk, rng)
        ended = host.end(HANG)
        _await_end(known.get("helper"))
        time.sleep(4.0 if robot == "stock" else 0.5)  # a stock board damps by itself, 0.5 s after the last message
        left = scene.left()
    for file in disk.glob("filler*"):
        file.unlink()
    log = logged(run) if known and run.exists() else None
    before = 0 if log is None else int(np.searchsorted(log.t_host, known["at"])) - 1
    lost = _lost(kind, run, known, host)
    if small:
        subprocess.run(["umount", "-l", str(disk)], check=False)
    driven = left.startswith("driven") or left == "nothing"
    beyond = robot == "can" and not own_timeout and _unreachable(kind, fault, known)
    lines = lines_in(host.said)
    told = any("cut the power" in line or "did not confirm" in line for line in lines[-3:])
    return {
        "robot": robot,
        "seed": seed,
        "kind": kind,
        "fault": kind if fault is None else str(fault),
        "begin": round(start, 2),
        "lasts": known.get("lasts"),
        "stood": stood(log, before),
        "own_timeout": own_timeout,
        "moved": moved,
        "status": host.process.returncode,
        "rule": _rule(run),
        "left": left,
        "driven": driven,
        "undamped": driven and not beyond,
        "hung": not ended or known.get("second_hung", False),
        "traceback": traceback_in(host.said) or traceback_in(scene.emulator.said) or known.get("second_traceback", ""),
        "lost": lost,
        "silent": driven and beyond and kind != "both_killed" and not told,
        "second": known.get("second"),
        "last": lines[-2:],
        "seconds": round(time.monotonic() - began, 1),
    }


def _await_end(process: int | None) -> None:
    """Return once a process has ended, or nothing ends it."""
    began = time.monotonic()
    while process is not None and Path(f"/proc/{process}").exists() and time.monotonic() - began < SETTLE:
        time.sleep(0.1)


def _lost(kind: str, run: Path, known: dict[str, Any], host: Process) -> str:
    """Return what is missing of a run, or nothing."""
    if run.exists():
        stopped = known["lasts"] if kind in ("host_stopped", "both_stopped") and known else 0.0
        return incomplete(run, known["at"] if kind in CUT_OFF and known else None, stopped)
    refused = host.process.returncode == USER  # or it ended before its first tick
    return "" if refused else "there is no run folder"


def _unreachable(kind: str, fault: EmulatedFault | None, known: dict[str, Any]) -> bool:
    """Return whether nobody can reach the motors to the end."""
    if kind == "both_killed":
        return True
    lasts = np.inf if fault is not None and np.isinf(fault.until) else known.get("lasts") or 0.0
    return kind in ("refuses", "stalls", *CUTS) and lasts > SETTLE


def lines_in(said: str) -> list[str]:
    """Return the lines of what a process said, without the rules of tables."""
    return [line.strip() for line in said.splitlines() if line.strip("─│┌┐└┘├┤┬┴┼ ")]


def traceback_in(said: str) -> str:
    """Return the traceback in what a process said, or nothing."""
    begin = said.find("Traceback")
    return "" if begin < 0 else said[begin : begin + 4000]


def _rule(run: Path) -> str:
    """Return what first ended a run, and what that asked for."""
    path = run / "events.jsonl"
    if not path.is_file():
        return ""
    for line in path.read_text(encoding="utf-8").splitlines():
        with suppress(json.JSONDecodeError):
            event = json.loads(line)
            if event.get("mode") in ("sit_down", "damp"):
                return f"{event['rule']} {event['mode']}"
    return ""


def targets(path: Path, robot: str = "cyberdog2") -> Path:
    """Write three seconds of hands that sway."""
    contract = load_policy(None, load_description(robot)).contract
    t = 0.02 * np.arange(150)
    toes = np.array(contract.neutral_toes).reshape(2, 3) + 0.04 * np.sin(3 * t)[:, None, None]
    yes, no = np.ones((150, 2), dtype=bool), np.zeros((150, 2), dtype=bool)
    nothing = {"valid": yes, "moved": np.zeros((150, 2)), "limited": no, "wanted": toes}
    track = TargetTrack(t=t, p_BE=toes, heading=np.zeros(150), robot=robot, **nothing)
    store.save(track, path, made_by=store.provenance())
    return path


def incomplete(run: Path, killed: float | None, stopped: float = 0.0) -> str:
    """Return what the log of a run lacks, or nothing.

    Args:
        run: Its folder.
        killed: When the process was killed or could write no more; None where it ended by itself.
        stopped: How long the process was stopped; there is no row of that time [s].
    """
    if killed is not None:
        if (run / "log.parquet").exists():
            return ""  # it had ended before
        log, _ = salvage(run)
        if not len(log.t_host):
            return ""  # it had not begun its first tick
        gap = killed - float(log.t_host[-1])
        return f"the last row is {gap:.3f} s older than the kill" if gap > 0.15 else ""
    if not (run / "log.parquet").exists():
        return "there is no log.parquet"
    if (run / ROWS).exists():
        return "rows were left behind"
    log = store.load(run / "log.parquet", RunLog)
    gap = float(np.diff(log.t_host).max())
    return f"rows are {gap:.2f} s apart" if gap > 2.0 + stopped else ""
