"""Faults of both emulated robots with real processes and sockets, in real time.

python -m lab.faults.faults_in_processes OUT.jsonl {can,stock} [runs] [first seed] [kinds...]

`mimic emulate` is one process, `mimic TARGETS --robot` with its watchdog others, and a proxy stands between them: over
TCP for socketcand, over multicast for LCM. A run in its turn has one of these: what the proxies do, a second program on
the robot, processes killed or stopped, a full disk, signals. What the motors did at the end is what the emulator
says when it ends. Needs root or user namespaces, for a network and a small disk of its own.
"""

from __future__ import annotations

import json
import os
import queue
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from lab.faults.fault_campaign import USER, incomplete, targets
from lab.faults.faults_scene import print_failures
from lab.faults.lcm_proxy import KINDS as LCM_KINDS
from lab.faults.lcm_proxy import LcmProxy, wiring_through
from lab.faults.tcp_proxy import KINDS as TCP_KINDS
from lab.faults.tcp_proxy import TcpProxy
from mimic.hardware.can.python_can import open_link
from mimic.hardware.cybergear.codec import Codec
from mimic.hardware.cybergear.messages import Operation, Stop
from mimic.hardware.stock.messages import MOTOR_CTRL

ROOT = Path(__file__).parents[1]

INSIDE = "MIMIC_OWN_NETWORK"
"""Set inside a network and a /tmp of its own."""

HELPERS = {"can": "mimic.hardware.watchdog", "stock": "mimic.hardware.stock.process"}
"""Module of the second process of a run."""

PROCESSES = (
    "host_killed",
    "helper_killed",
    "both_killed",
    "host_stopped",
    "helper_stopped",
    "both_stopped",
    "emulator_stopped",
    "disk_full",
    "disk_small",
    "ctrl_c",
    "ctrl_c_thrice",
    "terminated",
    "terminal_closed",
    "second_check",
    "second_watch",
    "second_run",
    "second_probe",
    "master_commands",
)
"""What happens to processes, and what others do."""

CAN_ONLY = ("master_stops", "second_damp", "second_zero", "second_scan")

DISKS = ("disk_full", "disk_small")

WITHIN = (0.2, 7.0)
"""When it happens, after the robot was switched on [s]; in the 2.5 s before, a stock robot is limp."""

HANG = 90.0
"""A run that has not ended by then hangs [s]."""

SETTLE = 40.0
"""How long the second process of a run that was killed may take [s]."""

DISK = 3
"""Size of the disk that fills, or on which a scene does not fit [MB]."""

REAL_TIME = ["chrt", "-f", "5"] if os.geteuid() == 0 else []
"""The emulator must not be late on a busy computer."""


class Process:
    """A process of mimic's command line, and what it has said."""

    def __init__(self, *words: str, first: list[str] | None = None) -> None:
        self.began = time.monotonic()
        self.process = subprocess.Popen(
            [*(first or []), sys.executable, "-m", "mimic", *words],
            cwd=ROOT,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=os.environ | {"COLUMNS": "500", "PYTHONPATH": str(ROOT)},
            start_new_session=True,
        )
        self._lines: queue.Queue[str | None] = queue.Queue()
        self.said = ""
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put(line)
            self.said += line
        self._lines.put(None)

    def until(self, wanted: str, seconds: float = 60.0) -> str | None:
        """Return the first line with these words; None where it ends or takes too long."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            try:
                line = self._lines.get(timeout=left)
            except queue.Empty:
                break
            if line is None or wanted in line:
                return line
        return None

    def alive(self) -> bool:
        return self.process.poll() is None

    def signal(self, number: int) -> None:
        with suppress(ProcessLookupError):
            self.process.send_signal(number)

    def end(self, seconds: float) -> bool:
        """Wait for its end, kill it if that takes too long, and return whether it ended by itself."""
        try:
            self.process.wait(seconds)
            ended = True
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            ended = False
        self._thread.join(5.0)
        return ended

    def __enter__(self) -> Process:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: object, trace: TracebackType | None) -> None:
        if self.alive():
            self.signal(signal.SIGCONT)
            self.signal(signal.SIGTERM)
        self.end(20.0)


def helper_of(pid: int, module: str) -> int | None:
    """Return the second process that a process started."""
    for listed in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in listed.read_text().split():
            with suppress(OSError):
                if module.encode() in Path(f"/proc/{child}/cmdline").read_bytes():
                    return int(child)
    return None


def _kill(pid: int | None, number: int) -> None:
    if pid is not None:
        with suppress(ProcessLookupError):
            os.kill(pid, number)


class _Robot:
    """An emulator in a process, a proxy before it, and the words that `mimic` needs to reach it."""

    def __init__(self, robot: str, seed: int, work: Path, stack: ExitStack, *, own_timeout: bool) -> None:
        self.kind = robot
        common = ["emulate", "--every", "0", "--seed", str(seed)]
        self.proxy: TcpProxy | LcmProxy
        if robot == "can":
            timeout = ["--can-timeout"] if own_timeout else []
            words = [*common, "--listen", "127.0.0.1:0", "--zeroed", "--placement", "0.03", *timeout]
            self.emulator = stack.enter_context(Process(*words, first=REAL_TIME))
            line = self.emulator.until("ready") or ""
            found = re.search(r"socketcand://127\.0\.0\.1:(\d+)/can0", line)
            if found is None:
                raise RuntimeError(f"the emulator does not start: {self.emulator.said}")
            self.proxy = stack.enter_context(TcpProxy(int(found[1]), seed))
            self.direct = f"socketcand://127.0.0.1:{found[1]}/can0"
            self.words = [f"socketcand://127.0.0.1:{self.proxy.port}/can0", "--zeroed"]
            self.event = "switched on"
        else:
            self.emulator = stack.enter_context(Process(*common, "--board", "cyberdog2", first=REAL_TIME))
            if self.emulator.until("ready") is None:
                raise RuntimeError(f"the emulator does not start: {self.emulator.said}")
            self.proxy = stack.enter_context(LcmProxy(seed))
            wiring = wiring_through(work / "board.toml")
            self.direct = ""
            self.words = ["cyberdog2", "--interface", "lo", "--wiring", str(wiring)]
            self.event = "motor mode"

    def left(self) -> str:
        """End the emulator, and return what it says of its motors."""
        self.emulator.signal(signal.SIGCONT)
        self.emulator.signal(signal.SIGTERM)
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
            stop, go = Stop(motor=motor, host=0xFD), Operation(motor=motor, q=q, dq=0.0, kp=30.0, kd=1.0, tau=0.0)
            link.send(0, codec.encode(stop if kind == "master_stops" else go))
        time.sleep(0.02)
    link.close()


def _fill(disk: Path) -> None:
    """Fill a disk, and keep it full for a while."""
    with suppress(OSError), (disk / "filler").open("wb", buffering=0) as file:
        while True:
            file.write(bytes(4096))
    with suppress(OSError), (disk / "filler2").open("wb", buffering=0) as file:
        while True:
            file.write(b"0")


def _happen(kind: str, scene: _Robot, host: Process, disk: Path, rng: np.random.Generator) -> dict[str, Any]:
    """Do what the kind says; return what is known of it."""
    lasts = float(rng.choice([0.05, 0.2, 1.0, 1e9]))
    helper = helper_of(host.process.pid, HELPERS[scene.kind])
    known: dict[str, Any] = {"lasts": lasts, "helper": helper, "at": time.monotonic()}
    proxied = TCP_KINDS if scene.kind == "can" else LCM_KINDS
    if kind in proxied:
        share, lag = float(rng.uniform(0.05, 0.6)), float(rng.uniform(0.002, 0.08))
        scene.proxy.disturb(kind, share, lag, lasts)
        return known
    pause = known["lasts"] = float(rng.choice([0.05, 0.3, 2.0]))
    match kind:
        case "host_killed":
            host.signal(signal.SIGKILL)
        case "helper_killed":
            _kill(helper, signal.SIGKILL)
        case "both_killed":
            _kill(helper, signal.SIGKILL)
            host.signal(signal.SIGKILL)
        case "host_stopped" | "helper_stopped" | "both_stopped" | "emulator_stopped":
            own = host.process.pid
            stopped = {"host_stopped": [own], "helper_stopped": [helper], "both_stopped": [helper, own]}
            for number in (signal.SIGSTOP, signal.SIGCONT):
                for pid in stopped.get(kind, [scene.emulator.process.pid]):
                    _kill(pid, number)
                time.sleep(pause if number == signal.SIGSTOP else 0.0)
        case "disk_full":
            _fill(disk)
        case "disk_small":
            pass  # the logs fit on it, and the scene does not
        case "ctrl_c" | "ctrl_c_thrice":
            for _ in range(1 if kind == "ctrl_c" else 3):
                host.signal(signal.SIGINT)
                time.sleep(pause)
        case "terminated":
            host.signal(signal.SIGTERM)
        case "terminal_closed":
            host.signal(signal.SIGHUP)
        case _ if kind.startswith("second_"):
            verb = kind.removeprefix("second_")
            words = ["--robot"] if verb == "run" else ["robot", verb]
            knows_zeros = verb in ("check", "watch", "run", "probe")
            reach = [word for word in scene.words if knows_zeros or word != "--zeroed"]
            more = {
                "run": ["--yes", "-o", str(disk / "second")],
                "probe": ["--yes", "-o", str(disk / "second.parquet")],
                "watch": ["--seconds", "2"],
                "zero": ["--yes"],
            }
            second = Process(*words, *reach, *more.get(verb, []))
            known["second_hung"] = not second.end(60.0)
            known["second"] = second.said.strip().splitlines()[-1:]
            known["second_traceback"] = _traceback(second.said)
        case _:
            _master(scene, kind, rng, min(pause, 1.0))
    return known


def kinds_of(robot: str) -> tuple[str, ...]:
    """Return what can happen."""
    return (*TCP_KINDS, *PROCESSES, *CAN_ONLY) if robot == "can" else (*LCM_KINDS, *PROCESSES)


def play(robot: str, seed: int, motion: Path, work: Path, kinds: Sequence[str]) -> dict[str, Any]:
    """Play a run with the fault of a seed, of these kinds in turn, and return how it ended."""
    rng = np.random.default_rng([seed, 61, len(robot)])
    kind = kinds[seed % len(kinds)]
    start, own_timeout = float(rng.uniform(*WITHIN)), bool(rng.random() < 0.5)
    began = time.monotonic()
    disk = work / "disk"
    disk.mkdir()
    if kind in DISKS:
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK}m", "tmpfs", str(disk)], check=True)
    run = disk / "run"
    known: dict[str, Any] = {}
    with ExitStack() as stack:
        scene = _Robot(robot, seed, work, stack, own_timeout=own_timeout)
        words = [str(motion), "--robot", *scene.words, "--yes", "--no-view", "-o", str(run)]
        host = stack.enter_context(Process(*words))
        moved = scene.emulator.until(scene.event) is not None
        time.sleep(start)
        if host.alive():
            known = _happen(kind, scene, host, disk, rng)
        ended = host.end(HANG)
        helper, settled = known.get("helper"), time.monotonic()
        while helper is not None and Path(f"/proc/{helper}").exists() and time.monotonic() - settled < SETTLE:
            time.sleep(0.1)
        time.sleep(4.0 if robot == "stock" else 0.5)  # a stock board damps by itself, 0.5 s after the last message
        left = scene.left()
    if kind == "disk_full":
        (disk / "filler").unlink(missing_ok=True)
        (disk / "filler2").unlink(missing_ok=True)
    cut_off = kind in ("host_killed", "both_killed", *DISKS)
    stopped = known["lasts"] if kind in ("host_stopped", "both_stopped") and known else 0.0
    lost = incomplete(run, known["at"] if cut_off and known else None, stopped) if run.exists() else ""
    if not run.exists() and host.process.returncode != USER:
        lost = "there is no run folder"  # it was not refused, nor did it end before its first tick
    if kind in DISKS:
        subprocess.run(["umount", "-l", str(disk)], check=False)
    driven = left.startswith("driven") or left == "nothing"
    gone = kind == "both_killed" or (kind in ("refuses", "stalls") and known.get("lasts", 0.0) > SETTLE)
    beyond = robot == "can" and gone and not own_timeout
    lines = [line.strip() for line in host.said.splitlines() if line.strip("─│┌┐└┘├┤┬┴┼ ")]
    told = any("cut the power" in line or "did not confirm" in line for line in lines[-3:])
    return {
        "robot": robot,
        "seed": seed,
        "fault": kind,
        "begin": round(start, 2),
        "lasts": known.get("lasts"),
        "own_timeout": own_timeout,
        "moved": moved,
        "status": host.process.returncode,
        "rule": _rule(run),
        "left": left,
        "driven": driven,
        "undamped": driven and not beyond,
        "hung": not ended or known.get("second_hung", False),
        "traceback": _traceback(host.said) or _traceback(scene.emulator.said) or known.get("second_traceback", ""),
        "lost": lost,
        "silent": driven and beyond and kind != "both_killed" and not told,
        "second": known.get("second"),
        "last": lines[-2:],
        "seconds": round(time.monotonic() - began, 1),
    }


def _traceback(said: str) -> str:
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


def table(rows: list[dict[str, Any]]) -> None:
    """Print how the runs ended."""
    for robot in sorted({row["robot"] for row in rows}):
        mine = [row for row in rows if row["robot"] == robot]
        print(f"{robot}: {len(mine)} runs")
        print_failures(mine)
        print("  driven, beyond reach:", [(r["seed"], r["fault"]) for r in mine if r["driven"] and not r["undamped"]])
        for kind in dict.fromkeys(row["fault"] for row in mine):
            print(f"  {kind:18s}", dict(Counter(row["rule"] or "–" for row in mine if row["fault"] == kind)))


def _own_network() -> int | None:
    """Run this again in a network and with mounts of its own; None where it is there already."""
    if os.environ.get(INSIDE):
        return None
    script = 'ip link set lo up && ip link set lo multicast on && ip route add 224.0.0.0/4 dev lo && exec "$@"'
    user = [] if os.geteuid() == 0 else ["-r"]
    words = ["unshare", *user, "-n", "-m", "sh", "-c", script, "sh", sys.executable, "-m", __spec__.name]
    return subprocess.run([*words, *sys.argv[1:]], env=os.environ | {INSIDE: "1"}, check=False).returncode


def main() -> int:
    status = _own_network()
    if status is not None:
        return status
    out, robot = Path(sys.argv[1]), sys.argv[2]
    runs, first = (int(sys.argv[i]) if len(sys.argv) > i else default for i, default in ((3, 24), (4, 0)))
    kinds = sys.argv[5:] or kinds_of(robot)
    with tempfile.TemporaryDirectory() as name, out.open("a") as file:
        motion = targets(Path(name) / "targets.parquet")
        for seed in range(first, first + runs):
            work = Path(name) / f"run{seed}"
            work.mkdir()
            file.write(json.dumps(play(robot, seed, motion, work, kinds)) + "\n")
            file.flush()
    table([json.loads(line) for line in out.read_text().splitlines()])
    return 0


if __name__ == "__main__":
    sys.exit(main())
