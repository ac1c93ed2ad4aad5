"""mimic --robot cyberdog2 on the maker's firmware.

python -m benchmarks.stock_firmware build                  copy and build the firmware, 7 minutes
python -m benchmarks.stock_firmware play [N] [FIRST]       N robots of Table II lie, stand up, box, sit down
python -m benchmarks.stock_firmware cut [ROUNDS]           processes killed, cable cut: what drives the robot afterwards
python -m benchmarks.stock_firmware compare                the emulated board given the same commands

Needs real time: two cores that do little else.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.stock_firmware.compare import compare
from benchmarks.stock_firmware.firmware import ROOT, Bench, NotHere, build, inside_network, require_built, save_model
from benchmarks.stock_firmware.firmware import upright as uprightness
from mimic.config.play import Randomisation
from mimic.dynamics.robot_model import draw_variation, load_model, vary_model
from mimic.flows.play import play
from mimic.io import store
from mimic.io.assets import shipped
from mimic.records import JOINTS, HealthLog, RunLog, TargetTrack
from mimic.robot.description import load_description
from mimic.simulation.plant import SimulatedPlant

CLIP = ROOT / "examples" / "videos" / "boxing.mp4"

WIRE = tuple(f"{leg}_{part}" for leg in ("FR", "FL", "RR", "RL") for part in ("abad", "hip", "knee"))

MODEL = shipped("assets", "cyberdog2", "scene.xml")

STANDING, TIMEOUT = 0.35, 120.0
"""Height of the trunk above which the robot stands [m]; longest run [s]."""


def targets(work: Path) -> Path:
    """Return the targets of the boxing clip, retargeted once."""
    path = work / "boxing.parquet"
    if not path.is_file():
        subprocess.run([sys.executable, "-m", "mimic", "retarget", CLIP, "-o", path], check=True, capture_output=True)
    return path


def command(source: Path, out: Path) -> list[str]:
    words = ["nice", "-n", "5", sys.executable, "-m", "mimic", str(source), "--robot", "cyberdog2"]
    return [*words, "--interface", "lo", "--yes", "-o", str(out), "--no-view"]


# ---------------------------------------------------------------------- randomised robots


def robot(seed: int, work: Path) -> tuple[Path, list[str]]:
    """Write the model of a robot of Table II, and return it with the options of the bench that belong to it."""
    description = load_description()
    variation = draw_variation(Randomisation(), description.timestep, np.random.default_rng(seed))
    nominal, model = load_model(description, visuals=False), load_model(description, visuals=False)
    vary_model(model, nominal, variation)
    key = model.key("lie").id
    q = np.clip(description.poses["lie"] + variation.start_q, description.q_min + 0.01, description.q_max - 0.01)
    model.key_qpos[key, -12:] = q
    model.key_qpos[key, 2] += variation.start_height
    order = [JOINTS.index(name) for name in WIRE]
    gains = [*np.broadcast_to(variation.kp, 12)[order], *np.broadcast_to(variation.kd, 12)[order]]
    options = ["--gains", ",".join(f"{gain:.4f}" for gain in gains), "--yaw", f"{np.rad2deg(variation.heading):.2f}"]
    return save_model(model, work / "robot.mjb"), options


def play_one(folder: Path, work: Path, source: Path, seed: int) -> dict[str, object]:
    """Play the clip on a robot through the firmware, and return what came of it."""
    model, options = (MODEL, []) if seed < 0 else robot(seed, work)
    out = work / "run"
    with Bench(folder, work, model, *options) as bench:
        done = subprocess.run(command(source, out), capture_output=True, text=True, timeout=TIMEOUT, check=False)
        time.sleep(0.5)
    rows = bench.rows()
    up = uprightness(rows)
    log, health = store.load(out / "log.parquet", RunLog), store.load(out / "health.parquet", HealthLog)
    metrics = store.load_json(out / "metrics.json")
    tracked = np.isin(log.phase, (2, 3, 4))
    simulated = play(
        store.load(source, TargetTrack),
        plant=SimulatedPlant(
            load_description(), **({} if seed < 0 else {"ranges": Randomisation(push=(0.0, 0.0)), "seed": seed})
        ),
    )
    w, x, y, z = log.quat_WB[tracked].T
    seen = 2.0 * (x * z - w * y)
    return {
        "seed": seed,
        "status": done.returncode,
        "stood": bool(tracked.sum() > 500 and np.nanmin(seen) > 0.85),
        "lies": bool(abs(up[-1]) < 0.2 and rows["z"][-1] < 0.12),
        "toe_error_cm": metrics_toe(metrics),
        "toe_error_simulated_cm": metrics_toe(simulated.metrics),
        "ticks_with_0x01": int(np.count_nonzero(health.err_flag.astype(int) & 1)),
        "longest_gap_ms": round(1e3 * float(np.nanmax(health.command_gap)), 1),
        "ticks": len(log.t),
        "slowness": round(float(rows["wall"][-1] / rows["t"][-1]), 3),
        "line": _last_line(done),
    }


def metrics_toe(metrics: Mapping[str, Any]) -> float | None:
    """Return the mean toe error [cm] of a run's figures; None where it never tracked."""
    mean = (metrics["toe_error_cm"] or {}).get("mean")
    return None if mean is None else round(float(mean), 2)


def _last_line(done: subprocess.CompletedProcess[str]) -> str:
    lines = [line.strip() for line in (done.stdout + done.stderr).splitlines() if line.strip()]
    return lines[-1] if lines else ""


# ---------------------------------------------------------------------- cuts


def children(pid: int) -> list[int]:
    """Return the processes that a process started."""
    listed = subprocess.run(["ps", "-o", "pid=,args=", "--ppid", str(pid)], capture_output=True, text=True, check=False)
    return [int(line.split()[0]) for line in listed.stdout.splitlines() if "stock.process" in line]


def cut_one(folder: Path, work: Path, source: Path, what: str, after: float) -> dict[str, object]:
    """Cut something while the robot boxes, and return what still drove it, from the bench's own record."""
    out = work / "run"
    words = command(source, out)[3:]  # without nice: its pid is mimic's
    with Bench(folder, work, MODEL) as bench:
        process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        end = time.monotonic() + 40.0
        while bench.height() < STANDING and time.monotonic() < end:
            time.sleep(0.1)
        time.sleep(after)
        sender = children(process.pid)
        before = len(bench.rows()["t"])
        began = time.time()
        if what in ("host", "both"):
            os.kill(process.pid, signal.SIGKILL)
        if what in ("sender", "both"):
            for pid in sender:
                os.kill(pid, signal.SIGKILL)
        if what == "host stopped":
            os.kill(process.pid, signal.SIGSTOP)
        if what == "cable":
            subprocess.run(["ip", "link", "set", "lo", "down"], check=True)
        time.sleep(12.0)
        if what == "host stopped":
            os.kill(process.pid, signal.SIGCONT)
        try:
            text, _ = process.communicate(timeout=25.0)
            hung = False
        except subprocess.TimeoutExpired:
            process.kill()
            text, _ = process.communicate()
            hung = True
        if what == "cable":
            subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
            subprocess.run(["ip", "route", "add", "224.0.0.0/4", "dev", "lo"], check=False)
    rows = bench.rows()
    t, kp = rows["t"][before:] - rows["t"][before - 1], rows["kp_max"][before:]
    driven = t[kp > 0.0]
    lines = [line for line in text.splitlines() if line.strip()]
    return {
        "what": what,
        "senders": len(sender),
        "driven_for_s": round(float(driven[-1]), 2) if len(driven) else 0.0,
        "lies": bool(abs(uprightness(rows)[-1]) < 0.3 and rows["z"][-1] < 0.12),
        "z": round(float(rows["z"][-1]), 3),
        "status": process.returncode,
        "hung": hung,
        "traceback": "Traceback" in text,
        "line": re.sub(r"\s+", " ", lines[-1]) if lines else "",
        "seconds": round(time.time() - began, 1),
    }


CUT = ("host", "sender", "both", "host stopped", "cable")


def main(arguments: list[str]) -> int:
    what, *more = arguments or [""]
    try:
        if what == "build":
            print(build())
            return 0
        if what not in ("play", "cut", "compare"):
            print(__doc__)
            return 2
        status = inside_network(arguments)
        if status is not None:
            return status
        folder = require_built()
    except NotHere as reason:
        print(reason)
        return 2
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        if what == "compare":
            print(json.dumps(compare(folder, work), indent=1))
            return 0
        source = targets(work)
        if what == "cut":
            for number in range(int(more[0]) if more else 1):
                for cut in CUT:
                    found = cut_one(folder, work / f"{number}-{cut}", source, cut, 2.0 + 1.7 * number)
                    print(json.dumps(found), flush=True)
            return 0
        count, first = int(more[0]) if more else 1, int(more[1]) if len(more) > 1 else 0
        for seed in range(first, first + count):
            (work / str(seed)).mkdir()
            print(json.dumps(play_one(folder, work / str(seed), source, seed)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
