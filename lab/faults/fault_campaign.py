"""Many runs with a fault each, random in time and kind: does every one end damped, off, in time, with a whole log.

python -m lab.faults.fault_campaign OUT.json [in-process runs] [runs over TCP]

In process: the emulated robot in its own time, one bus or two. Over TCP: the emulated robot served over socketcand and
slcan in turn, `mimic TARGETS --robot` and its watchdog as processes of their own, which also get signals or are
killed. Motors stop by themselves when they hear nobody in half of the runs (CAN_TIMEOUT honoured).
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from lab.faults.faults_in_process import CUTS, play
from mimic.config.emulator import EmulateSettings
from mimic.control.recorder import ROWS, salvage
from mimic.emulator.faults import CAN_KINDS, random_fault
from mimic.emulator.robot import EmulatedRobot
from mimic.emulator.server import EmulatorServer
from mimic.hardware.cybergear.messages import Mode
from mimic.hardware.wiring import load_wiring
from mimic.io import store
from mimic.policy.runtime import load_policy
from mimic.records import JOINTS, RunLog, TargetTrack
from mimic.robot.description import load_description

SIGNALS = ("ctrl_c", "ctrl_c_twice", "sigterm", "sigkill", "sigstop", "watchdog_killed")

WITHIN = (0.3, 9.0)
"""When a fault begins, after the first motor was switched on [s]."""

USER = 2
"""Exit status of what is refused."""

HANG = 150.0
"""A process that has not ended by then hangs [s]."""

SETTLE = 45.0
"""How long the watchdog of a process that is gone may take [s]; it opens a failed bus again for 30 s."""


def targets(path: Path) -> Path:
    """Write three seconds of hands that sway."""
    contract = load_policy(None, load_description()).contract
    t = 0.02 * np.arange(150)
    toes = np.array(contract.neutral_toes).reshape(2, 3) + 0.04 * np.sin(3 * t)[:, None, None]
    yes, no = np.ones((150, 2), dtype=bool), np.zeros((150, 2), dtype=bool)
    nothing = {"valid": yes, "moved": np.zeros((150, 2)), "limited": no, "wanted": toes}
    store.save(TargetTrack(t=t, p_BE=toes, heading=np.zeros(150), **nothing), path, made_by=store.provenance())
    return path


def watchdog_of(process: subprocess.Popen) -> int | None:
    """Return the watchdog's process."""
    for children in Path(f"/proc/{process.pid}/task").glob("*/children"):
        for child in children.read_text().split():
            if b"mimic.hardware.watchdog" in Path(f"/proc/{child}/cmdline").read_bytes():
                return int(child)
    return None


def disturb(process: subprocess.Popen, kind: str) -> float:
    """Do to a process what the kind says, and return when [s]."""
    at = time.monotonic()
    match kind:
        case "ctrl_c" | "ctrl_c_twice":
            process.send_signal(signal.SIGINT)
            if kind == "ctrl_c_twice":
                time.sleep(0.4)
                process.send_signal(signal.SIGINT)
        case "sigterm":
            process.terminate()
        case "sigkill":
            process.kill()
        case "sigstop":
            process.send_signal(signal.SIGSTOP)
            time.sleep(0.5)
            process.send_signal(signal.SIGCONT)
        case "watchdog_killed":
            pid = watchdog_of(process)
            if pid is not None:
                os.kill(pid, signal.SIGKILL)
    return at


def play_over_tcp(seed: int, folder: Path, motion: Path) -> dict[str, Any]:
    """Play a run across processes with the fault of a seed, and return how it ended."""
    rng = np.random.default_rng([seed, 41])
    kind = str(rng.choice((*CAN_KINDS, *SIGNALS)))
    start, own_timeout = float(rng.uniform(*WITHIN)), bool(rng.random() < 0.5)
    fault = None if kind in SIGNALS else random_fault(seed, start=WITHIN, after_release=True, kinds=(kind,))
    transport = ("socketcand", "slcan")[seed % 2]
    settings = EmulateSettings(zeroed=True, placement=0.03, seed=seed, can_timeout=own_timeout)
    robot = EmulatedRobot(load_description(), load_wiring(), settings, faults=[] if fault is None else [fault])
    server = EmulatorServer(robot, slcan=0)
    over = threading.Event()
    thread = threading.Thread(target=lambda: server.run(over.is_set), daemon=True)
    thread.start()
    bus_url = next(a for a in server.addresses if a.startswith(transport))
    run = folder / f"run{seed}"
    command = [sys.executable, "-m", "mimic", str(motion), "--robot", bus_url, "--zeroed", "--yes", "-o", str(run)]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )
    began = time.monotonic()
    disturbed = float("nan")
    if kind in SIGNALS:
        while robot.body.held and process.poll() is None and time.monotonic() - began < HANG:
            time.sleep(0.02)
        released = robot.now
        while robot.now < released + start and process.poll() is None and time.monotonic() - began < HANG:
            time.sleep(0.01)
        disturbed = disturb(process, kind)
    try:
        told, _ = process.communicate(timeout=HANG)
        hung = False
    except subprocess.TimeoutExpired:
        process.kill()
        told, _ = process.communicate()
        hung = True
    settled = time.monotonic()
    while any(m.mode is Mode.RUN for m in robot.motors) and time.monotonic() - settled < SETTLE:
        time.sleep(0.1)
    running = [name for name, m in zip(JOINTS, robot.motors, strict=True) if m.mode is Mode.RUN]
    driven = [n for n, m in zip(JOINTS, robot.motors, strict=True) if m.mode is Mode.RUN and m.drive.kp > 0.0]
    over.set()
    thread.join(10.0)
    begun = not robot.body.held and not (process.returncode == USER and not run.exists())
    server.close()
    cut = kind in CUTS and fault is not None and np.isinf(fault.until)
    last = "\n".join(told.strip().splitlines()[-2:])
    return {
        "seed": seed,
        "transport": transport,
        "fault": kind if fault is None else str(fault),
        "own_timeout": own_timeout,
        "status": process.returncode,
        "last": last,
        "driven": driven,
        "running": running,
        "undamped": bool(driven) and (own_timeout or not cut),
        "hung": hung,
        "traceback": "Traceback" in told,
        "moved": not robot.body.held,
        "begun": begun,
        "incomplete": incomplete(run, disturbed if kind == "sigkill" else None) if begun else "",
        "seconds": time.monotonic() - began,
    }


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


def main() -> None:
    out = Path(sys.argv[1])
    alone = int(sys.argv[2]) if len(sys.argv) > 2 else 150
    served = int(sys.argv[3]) if len(sys.argv) > 3 else 60
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for seed in range(1, alone + 1):
            one = play(seed, folder / "alone")
            row = asdict(one) | {"transport": "in process", "undamped": one.undamped, "hung": False}
            row |= {"traceback": bool(one.escaped), "incomplete": one.incomplete, "silent": one.silent}
            rows.append(row)
        motion = targets(folder / "targets.parquet")
        for seed in range(1, served + 1):
            rows.append(play_over_tcp(seed, folder, motion))
            store.save_json(rows, out)
    store.save_json(rows, out)
    print(f"{len(rows)} runs:", dict(Counter(r["transport"] for r in rows)))
    for name in ("undamped", "hung", "traceback", "incomplete"):
        bad = [r for r in rows if r[name]]
        print(f"{name:12s} {len(bad)}", [(r["seed"], r["transport"], r["fault"]) for r in bad])
    print(f"{sum(not r.get('moved', True) for r in rows)} were refused before anything moved")
    early = sum(r.get("moved", True) and not r.get("begun", True) for r in rows)
    print(f"{early} ended before their first tick, so that there was nothing to log")
    left = [r for r in rows if r["driven"] and not r["undamped"]]
    print(f"{len(left)} runs whose motors nobody could reach and which have no timeout of their own:")
    print(json.dumps(Counter(r["fault"].split("@")[0].split("=")[0].split(":")[0] for r in left)))


if __name__ == "__main__":
    main()
