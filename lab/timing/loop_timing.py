"""How well the loop keeps its time with the emulated robot in a process beside it.

python -m lab.timing.loop_timing [seconds] [socketcand|slcan]

`mimic --robot` stands until Ctrl-C; the figures are those of its own health.parquet, from standing up to sitting
down. The machine's load is printed with them: on a shared machine they say how it is when others compute too. A third
process does nothing but sleep and look at the clock; a tick that is late while that one stood still too was held up
by the machine.
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

from mimic.hardware.can.load import expected_load
from mimic.hardware.can.wiring import load_wiring
from mimic.io import store
from mimic.records import PHASES, HealthLog, RunLog

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

WATCH = """
import sys, time
last = time.monotonic()
while True:
    time.sleep(0.002)
    now = time.monotonic()
    if now - last > 0.01:
        print(last, now, flush=True)
    last = now
"""


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 600.0
    transport = sys.argv[2] if len(sys.argv) > 2 else "socketcand"
    options = ["--listen", "127.0.0.1:0", "--slcan", "--zeroed", "--every", "0"]
    emulator = subprocess.Popen([sys.executable, "-c", EMULATE, "emulate", *options], stdout=subprocess.PIPE, text=True)
    assert emulator.stdout is not None
    bus_url = ""
    while not bus_url.startswith(transport):
        bus_url = emulator.stdout.readline().removeprefix("ready").strip()
    with tempfile.TemporaryDirectory() as name:
        run = Path(name) / "run"
        clock = subprocess.Popen([sys.executable, "-c", WATCH], stdout=subprocess.PIPE, text=True)
        command = [sys.executable, "-m", "mimic", "--robot", bus_url, "--zeroed", "--yes", "-o", str(run)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        loads = []
        end = time.monotonic() + seconds
        while time.monotonic() < end and process.poll() is None:
            time.sleep(1.0)
            loads.append(os.getloadavg()[0])
        process.send_signal(signal.SIGINT)
        told, _ = process.communicate()
        for other in (emulator, clock):
            other.terminate()
        emulator.communicate()
        stood_still = [tuple(map(float, line.split())) for line in clock.communicate()[0].splitlines()]
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
    held_up = np.stack([log.t_host[rows], health.late[rows]], -1)[late > 2]
    period = 1e3 * np.diff(log.t[rows])
    print(
        f"{rows.sum()} ticks in {np.ptp(log.t[rows]):.0f} s over {transport}; "
        f"load {np.mean(loads):.1f} on {os.cpu_count()} cores"
    )
    for what, values in (("compute", compute), ("late", late), ("period", period)):
        p50, p99 = np.nanquantile(values, [0.5, 0.99])
        print(f"{what:8s} p50 {p50:6.2f}  p99 {p99:6.2f}  max {np.nanmax(values):6.2f} ms")
    print(
        f"delayed by more than 2 ms: {np.sum(late > 2)}, 10 ms: {np.sum(late > 10)}, "
        f"a whole tick (20 ms): {np.sum(late > 20)}"
    )
    excused = np.array([any(a <= at and at - wait <= b for a, b in stood_still) for at, wait in held_up], dtype=bool)
    longest = max((b - a for a, b in stood_still), default=0.0)
    print(
        f"the machine stood still for more than 10 ms {len(stood_still)} times, {1e3 * longest:.1f} ms at most; "
        f"late by more than 2 ms at other times: {int((~excused).sum())}"
    )
    print(f"answers missing: {int((missed > 0).sum())} of {missed.size}")
    print(f"bus load by the arithmetic {expected_load(load_wiring(), 50.0)[0]:.1%}")


if __name__ == "__main__":
    main()
