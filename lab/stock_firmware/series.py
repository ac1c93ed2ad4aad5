"""Randomised robots on the maker's firmware: undisturbed, and in series with pushes, noise, IMU lag and jitter."""

from __future__ import annotations

import fcntl
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from lab.faults.processes import HELPER
from lab.faults.proxies import LcmProxy, wiring_through
from lab.stock_firmware.firmware import ROOT, Bench, save_model, through_network
from lab.stock_firmware.firmware import upright as uprightness
from mimic.config.play import Randomisation
from mimic.dynamics.lying import sink
from mimic.dynamics.robot_model import draw_variation, load_model, vary_model
from mimic.flows.play import play
from mimic.io import store
from mimic.records import JOINTS, FloatArray, HealthLog, RunLog, TargetTrack
from mimic.robot.description import load_description
from mimic.simulation.plant import SimulatedPlant

CLIP = ROOT / "examples" / "videos" / "boxing.mp4"

WIRE = tuple(f"{leg}_{part}" for leg in ("FR", "FL", "RR", "RL") for part in ("abad", "hip", "knee"))

TIMEOUT = 120.0
"""Longest run [s]."""

CASES: dict[str, tuple[str, ...]] = {
    "plain": (),
    "pushes": ("--push", "0.2"),
    "noise": ("--noise", "0.01,0.2,0.015,0.05"),
    "imu_lag": ("--imu-lag", "10"),
    "jitter": (),
}
"""Options of the bench for each series: pushes of the trunk up to 0.2 m/s every 5 s; noise of joint positions
+-0.01 rad, velocities +-0.2 rad/s, orientation +-0.015 rad and rate of turn +-0.05 rad/s; an IMU 20 ms late. See
JITTER."""

JITTER = 0.008
"""In the series jitter a proxy lets each message wait up to this long, both ways, in order [s]."""

SLOTS = "MIMIC_FIRMWARE_SLOTS"
"""Environment variable: folder of the files that are locked by the robots that run."""

PLAN = {"plain": 100, "pushes": 20, "noise": 20, "imu_lag": 20, "jitter": 20}
"""Robots of each series."""


def targets(work: Path) -> Path:
    """Return the targets of the boxing clip, retargeted once."""
    path = work / "boxing.parquet"
    if not path.is_file():
        words = [sys.executable, "-m", "mimic", "retarget", str(CLIP), "-o", str(path)]
        subprocess.run(words, cwd=ROOT, check=True, capture_output=True)
    return path


def command(source: Path, out: Path, *more: str) -> list[str]:
    """Return the command that plays targets on the robot."""
    words = [sys.executable, "-m", "mimic", str(source), "--robot", "cyberdog2"]
    return [*words, "--interface", "lo", "--yes", "-o", str(out), "--no-view", *more]


def robot(seed: int, work: Path) -> tuple[Path, list[str]]:
    """Write the model of a robot of Table II, and return it with the options of the bench that belong to it."""
    description = load_description("cyberdog2")
    variation = draw_variation(Randomisation(), description.timestep, np.random.default_rng(seed))
    nominal, model = load_model(description, visuals=False), load_model(description, visuals=False)
    vary_model(model, nominal, variation)
    let_sink(model, description.poses["lie"] + variation.start_q, variation.start_height)
    order = [JOINTS.index(name) for name in WIRE]
    gains = [*np.broadcast_to(variation.kp, 12)[order], *np.broadcast_to(variation.kd, 12)[order]]
    options = ["--gains", ",".join(f"{gain:.4f}" for gain in gains), "--yaw", f"{np.rad2deg(variation.heading):.2f}"]
    return save_model(model, work / "robot.mjb"), options


def let_sink(model: mujoco.MjModel, q: FloatArray, height: float = 0.0) -> None:
    """Let the robot of the keyframe `lie` be one without power, that sank from joints q (12,) [rad]."""
    key, data = model.key("lie").id, mujoco.MjData(model)
    data.qpos[:] = model.key_qpos[key]
    data.qpos[2] += height
    data.qpos[-12:] = np.clip(q, model.jnt_range[-12:, 0] + 0.01, model.jnt_range[-12:, 1] - 0.01)
    mujoco.mj_forward(model, data)
    sink(model, data)
    model.key_qpos[key] = data.qpos


def nominal(work: Path) -> Path:
    """Write the model of a robot as described, and return it."""
    description = load_description("cyberdog2")
    model = load_model(description, visuals=False)
    let_sink(model, description.poses["lie"])
    return save_model(model, work / "robot.mjb")


def play_one(folder: Path, work: Path, source: Path, seed: int, case: str = "plain") -> dict[str, object]:
    """Play the clip on a robot through the firmware, and return what came of it."""
    model, options = (nominal(work), []) if seed < 0 else robot(seed, work)
    out, more = work / "run", list[str]()
    began = time.monotonic()
    with ExitStack() as stack:
        stack.enter_context(_slot())
        bench = stack.enter_context(Bench(folder, work, model, *options, *CASES[case], "--seed", str(seed)))
        if case == "jitter":
            stack.enter_context(LcmProxy(seed)).disturb("jitter", lag=JITTER)
            more = ["--wiring", str(wiring_through(work / "board.toml"))]
        words = command(source, out, *more)
        process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        _await_end(process)
        time.sleep(0.5)
    said, _ = process.communicate(timeout=TIMEOUT)
    rows = bench.rows()
    up = uprightness(rows)
    if not (out / "log.parquet").is_file():  # it was refused before it began
        refused = {"status": process.returncode or 2, "stood": False, "lies": bool(abs(up[-1]) < 0.2)}
        return {"case": case, "seed": seed, **refused, "line": _last_line(said)}
    log, health = store.load(out / "log.parquet", RunLog), store.load(out / "health.parquet", HealthLog)
    metrics = store.load_json(out / "metrics.json")
    tracked = np.isin(log.phase, (2, 3, 4))
    w, x, y, z = log.quat_WB[tracked].T
    seen = 2.0 * (x * z - w * y)
    return {
        "case": case,
        "seed": seed,
        "status": process.returncode,
        "stood": bool(tracked.sum() > 500 and np.nanmin(seen) > 0.85),
        "lies": bool(abs(up[-1]) < 0.2 and rows["z"][-1] < 0.12),
        "toe_error_cm": metrics_toe(metrics),
        "ticks_with_0x01": int(np.count_nonzero(health.err_flag.astype(int) & 1)),
        "longest_gap_ms": round(1e3 * float(np.nanmax(health.command_gap)), 1),
        "ticks": len(log.t),
        "slowness": round(float(rows["wall"][-1] / rows["t"][-1]), 3),
        "seconds": round(time.monotonic() - began, 1),
        "rule": next((event["rule"] for event in _events(out) if event["rule"] != "finished"), ""),
        "line": _last_line(said),
    }


def simulated_toe(source: Path, seed: int) -> float | None:
    """Return the mean toe error [cm] of the same robot in simulation, undisturbed."""
    ranges = Randomisation(push=(0.0, 0.0))
    plant = SimulatedPlant(load_description("cyberdog2"), ranges=ranges, seed=seed)
    return metrics_toe(play(store.load(source, TargetTrack), plant=plant).metrics)


def metrics_toe(metrics: Mapping[str, Any]) -> float | None:
    """Return the mean toe error [cm] of a run's figures; None where it never tracked."""
    mean = (metrics["toe_error_cm"] or {}).get("mean")
    return None if mean is None else round(float(mean), 2)


def _last_line(said: str) -> str:
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    return lines[-1] if lines else ""


def _await_end(process: subprocess.Popen[str]) -> None:
    """Wait until a robot needs its firmware no more: its sender has ended, or mimic itself."""
    end, seen = time.monotonic() + TIMEOUT, False
    while process.poll() is None and time.monotonic() < end:
        there = bool(children(process.pid))
        if seen and not there:
            return
        seen = seen or there
        time.sleep(0.2)


def children(pid: int) -> list[int]:
    """Return the processes that send to the robot for a process of mimic."""
    listed = subprocess.run(
        ["ps", "-o", "pid=,stat=,args=", "--ppid", str(pid)], capture_output=True, text=True, check=False
    )
    rows = [line.split(maxsplit=2) for line in listed.stdout.splitlines()]
    return [int(row[0]) for row in rows if HELPER in row[2] and not row[1].startswith("Z")]


@contextmanager
def _slot() -> Iterator[None]:
    """Wait for one of the places in which a robot may run; those that start or save need none."""
    folder, files = os.environ.get(SLOTS), list[Any]()
    if folder is None:
        yield
        return
    try:
        files = [path.open("w") for path in sorted(Path(folder).glob("slot*"))]
        while True:
            for file in files:
                with suppress(BlockingIOError):
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    yield
                    return
            time.sleep(0.2)
    finally:
        for file in files:
            file.close()


def _events(run: Path) -> list[dict[str, Any]]:
    """Return what the supervisor decided beyond the ordinary end."""
    lines = (run / "events.jsonl").read_text(encoding="utf-8").splitlines()
    events = [json.loads(line) for line in lines]
    return [event for event in events if event.get("mode") in ("sit_down", "damp")]


def ended(row: Mapping[str, Any]) -> str:
    """Return how a robot ended: passed, refused, fell or failed.

    It passed if it lay, stood up, boxed, sat down and ended damped; it was refused if a check before or after Enter
    kept it from being moved; and it fell if it did not stand, or did not lie at the end.
    """
    if row.get("status") == 0 and row["stood"] and row["lies"]:
        return "passed"
    if "ticks" in row:
        return "failed" if row["stood"] and row["lies"] else "fell"
    return "refused" if any(words in row["line"] for words in ("nothing was moved", "was not moved")) else "failed"


def series(out: Path, jobs: int, plan: Mapping[str, int]) -> list[dict[str, Any]]:
    """Play what is not in a file of results yet, several robots side by side, and return all rows.

    Args:
        out: One line of JSON for each robot; rows of an earlier call are kept.
        jobs: Robots at a time, each in a network of its own; as many again may start or save.
        plan: Robots of each series.
    """
    rows = [json.loads(line) for line in out.read_text().splitlines()] if out.is_file() else []
    have = {(row["case"], row["seed"]) for row in rows}
    todo = [(case, seed) for case, count in plan.items() for seed in range(count) if (case, seed) not in have]
    source = targets(out.parent)

    def one(case: str, seed: int) -> dict[str, Any]:
        words, environment = through_network(["one", case, str(seed), str(source)]), os.environ | {SLOTS: places}
        done = subprocess.run(words, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
        lines = done.stdout.strip().splitlines()
        if done.returncode or not lines:
            problem = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
            nothing = {"status": done.returncode, "stood": False, "lies": False}
            return {"case": case, "seed": seed, **nothing, "line": problem}
        return json.loads(lines[-1])

    with tempfile.TemporaryDirectory() as places, ThreadPoolExecutor(2 * jobs) as pool, out.open("a") as file:
        for number in range(jobs):
            (Path(places) / f"slot{number}").touch()
        for row in pool.map(lambda job: one(*job), todo):
            rows.append(row)
            file.write(json.dumps(row) + "\n")
            file.flush()
    beside = out.with_suffix(".simulated.json")
    simulated = json.loads(beside.read_text()) if beside.is_file() else {}
    for row in rows:
        seed = str(row["seed"])
        if seed not in simulated:
            simulated[seed] = simulated_toe(source, int(seed))
            beside.write_text(json.dumps(simulated))
        row["toe_error_simulated_cm"] = simulated[seed]
    return rows


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the series as a table in Markdown; a robot that was refused is one of its series."""
    headings = ("series", "robots", "passed", "refused before moving", "fell", "other ends")
    headings += ("toe error", "… in simulation", "most apart", "0x01 ticks a run")
    lines = [f"| {' | '.join(headings)} |", "|---" * len(headings) + "|"]
    for case in dict.fromkeys(str(row["case"]) for row in rows):
        mine = [row for row in rows if row["case"] == case]
        good = [row for row in mine if ended(row) == "passed"]
        here, there = ([float(row[name]) for row in good] for name in ("toe_error_cm", "toe_error_simulated_cm"))
        apart = max((abs(a - b) for a, b in zip(here, there, strict=True)), default=float("nan"))
        late = np.mean([row["ticks_with_0x01"] for row in good]) if good else float("nan")
        cells = [case, str(len(mine)), str(len(good)), *(_count(mine, kind) for kind in ("refused", "fell", "failed"))]
        cells += [f"{np.mean(values or [np.nan]):.1f} ({_range(values)}) cm" for values in (here, there)]
        lines.append(f"| {' | '.join([*cells, f'{apart:.1f} cm', f'{late:.1f}'])} |")
    return "\n".join(lines)


def _count(rows: Sequence[Mapping[str, Any]], kind: str) -> str:
    """Return how many ended like that, and why."""
    mine = [row for row in rows if ended(row) == kind]
    reasons = Counter(str(row.get("rule") or row["line"])[:60] for row in mine)
    return f"{len(mine)}: {', '.join(f'{n} {text}' for text, n in reasons.items())}" if mine else "0"


def _range(values: Sequence[float]) -> str:
    return f"{min(values):.1f} to {max(values):.1f}" if values else "–"
