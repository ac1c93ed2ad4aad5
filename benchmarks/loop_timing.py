"""How well the loop keeps its time with the emulated robot in a process beside it.

python benchmarks/loop_timing.py [seconds] [socketcand|slcan]

`mimic --robot` stands until Ctrl-C; the figures are those of its own health.parquet, from standing up to sitting down. The
machine's load is printed with them: on a shared machine they say how it is when others compute too.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from mimic import store
from mimic.robot.wiring import load_wiring
from mimic.run.bus_load import expected_load
from mimic.types import PHASES, HealthLog, RunLog

EMULATE = """
import os, sys
from mimic.cli import main
try:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(5))
except OSError:
    pass
sys.exit(main(sys.argv[1:]))
"""
"""The emulated robot keeps its time before other work where the system allows it: a real one does too."""


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 600.0
    transport = sys.argv[2] if len(sys.argv) > 2 else "socketcand"
    options = ["--listen", "127.0.0.1:0", "--slcan", "0", "--homed", "--every", "0"]
    emulator = subprocess.Popen([sys.executable, "-c", EMULATE, "emulate", *options], stdout=subprocess.PIPE, text=True)
    assert emulator.stdout is not None
    words = ""
    while not words.startswith(transport):
        words = emulator.stdout.readline().removeprefix("ready").strip()
    with tempfile.TemporaryDirectory() as name:
        run = Path(name) / "run"
        command = [sys.executable, "-m", "mimic", "--robot", words, "--homed", "--yes", "-o", str(run)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        loads = []
        end = time.monotonic() + seconds
        while time.monotonic() < end and process.poll() is None:
            time.sleep(1.0)
            loads.append(os.getloadavg()[0])
        process.send_signal(signal.SIGINT)
        told, _ = process.communicate()
        emulator.terminate()
        emulator.communicate()
        print(told.strip().splitlines()[-1])
        print(
            next(
                (line for line in told.splitlines() if "bus load" in line and "arithmetic" in line and "%" in line), ""
            )
        )
        if not (run / "health.parquet").exists():
            print(told)
            raise SystemExit(1)
        log, health = store.load(run / "log.parquet", RunLog), store.load(run / "health.parquet", HealthLog)
    rows = (log.phase >= PHASES.index("stand_up")) & (log.phase <= PHASES.index("sit_down"))
    rows[0] = False
    compute, late, missed = 1e3 * health.compute[rows], 1e3 * health.late[rows], health.missed[rows]
    period = 1e3 * np.diff(log.t[rows])
    print(
        f"{rows.sum()} ticks in {np.ptp(log.t[rows]):.0f} s over {transport}; load {np.mean(loads):.1f} on {os.cpu_count()} cores"
    )
    for what, values in (("compute", compute), ("late", late), ("period", period)):
        p50, p99 = np.nanquantile(values, [0.5, 0.99])
        print(f"{what:8s} p50 {p50:6.2f}  p99 {p99:6.2f}  max {np.nanmax(values):6.2f} ms")
    print(
        f"late by more than 2 ms: {np.sum(late > 2)}, 10 ms: {np.sum(late > 10)}, a whole tick (20 ms): {np.sum(late > 20)}"
    )
    print(f"answers missing: {int((missed > 0).sum())} of {missed.size}")
    print(f"bus load by the arithmetic {expected_load(load_wiring(), 50.0)[0]:.1%}")


if __name__ == "__main__":
    main()
