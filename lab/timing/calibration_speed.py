"""Time of a calibration on a device: replays, baseline fit, the paper's random search, everything.

    python -m lab.timing.calibration_speed pack LOG.parquet LOG.npz                # where pyarrow is not installed
    python -m lab.timing.calibration_speed run LOG.npz --device cuda --out OUT.json [--samples 8192] [--only PART …]

The log is one of the hung CyberDog 2. Each part is timed by itself after the kernels are compiled; the table and
OUT.json grow part by part, so that what was measured stays where a later part is cut off. ``agreement`` holds the
device against the processor.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mimic.config.sysid import CalibrateSettings
from mimic.dynamics.catalogue import BASELINE
from mimic.dynamics.machine import MachineModel, hung_robot, with_gains
from mimic.io.joint_log import CHANNELS, JointLog, read_log
from mimic.robot.description import load_description
from mimic.sysid.baseline import RANGES, fit_baseline, random_search
from mimic.sysid.calibrate import calibrate
from mimic.sysid.logs import make_blocks
from mimic.sysid.noise import noise_floor
from mimic.sysid.replay import Replay, physics_step
from mimic.sysid.residuals import Point, Problem, stack
from mimic.sysid.result import Errors

SIZES = (1, 16, 64, 256)
"""Parameter sets of a timed replay."""


def pack(log: JointLog, path: Path) -> None:
    """Store a log as NPZ, its channels in single precision."""
    channels = {n: getattr(log, n).astype(np.float32) for n in CHANNELS if getattr(log, n) is not None}
    np.savez_compressed(
        path, t=log.t, joints=np.array(log.joints), metadata=np.array(json.dumps(dict(log.metadata))), **channels
    )


def unpack(path: Path) -> JointLog:
    """Return a log that was packed, or any other."""
    if path.suffix != ".npz":
        return read_log(path)
    with np.load(path, allow_pickle=False) as stored:
        channels = {n: stored[n].astype(np.float64) for n in CHANNELS if n in stored}
        joints = tuple(str(j) for j in stored["joints"])
        return JointLog(joints=joints, t=stored["t"], metadata=json.loads(str(stored["metadata"])), **channels)


def replay_on(device: str, machine: MachineModel, log: JointLog, threads: int) -> Replay:
    """Return a replay as a calibration has it."""
    step = physics_step(log.rate)
    if device == "cpu":
        return Replay(machine, log, timestep=step, threads=threads, torque=True)
    from mimic.sysid.gpu_replay import WorldReplay

    device = "cpu" if device == "cpu-worlds" else device
    return WorldReplay(machine, log, device=device, timestep=step, threads=threads, torque=True)


def problem_of(replay: Replay) -> Problem:
    """Return the problem of a calibration."""
    log = replay.log
    noise, torque = (None if x is None else np.maximum(noise_floor(x, log.rate), 1e-9) for x in (log.q, log.tau))
    assert noise is not None
    return Problem(replay, noise, torque, make_blocks(log.t, replay.counts))


def drawn(machine: MachineModel, count: int) -> list[Point]:
    """Return so many random baseline models, from the second on."""
    rng, start = np.random.default_rng(0), Point.of(BASELINE, machine)
    values = [
        {k: rng.uniform(*RANGES[k], row.shape) if k in RANGES else row for k, row in start.values.items()}
        for _ in range(count - 1)
    ]
    return [start, *(Point(v) for v in values)]


class Parts:
    """The timed parts."""

    def __init__(self, log: JointLog, device: str, samples: int, threads: int, effects: int) -> None:
        self.machine = with_gains(hung_robot(load_description()), log.metadata)
        self.log, self.device = log.of(self.machine.joints), device
        self.samples, self.threads, self.effects = samples, threads, effects
        self.replay = replay_on(device, self.machine, self.log, threads)
        self.problem = problem_of(self.replay)

    def first(self) -> dict[str, Any]:
        """Compile whatever must be compiled: the first replays of all sizes that are timed below."""
        began = time.perf_counter()
        for size in SIZES:
            self._replayed(size)
            self._say(f"first replay of {size}", began)
        return {"seconds": time.perf_counter() - began}

    def replays(self) -> dict[str, Any]:
        """Time replays of several sizes."""
        rows = {}
        for size in SIZES:
            began = time.perf_counter()
            self._replayed(size)
            seconds = time.perf_counter() - began
            steps = self.replay.length * self.replay.segments * size
            rows[str(size)] = {"seconds": seconds, "steps_per_s": steps / seconds}
            self._say(f"replay of {size}: {seconds:.2f} s, {steps / seconds / 1e6:.2f} M steps/s", began)
        return {"segments": self.replay.segments, "steps": self.replay.length, "sets": rows}

    def agreement(self) -> dict[str, Any]:
        """Hold the device against the processor, segments alike."""
        points = drawn(self.machine, 4)
        end = int(np.searchsorted(self.log.t, self.log.t[0] + 12.0))
        short = self.log.part(slice(0, end))
        one = replay_on(self.device, self.machine, short, self.threads)
        count = one.segments
        other = Replay(
            self.machine, short, timestep=one.dt, segment=short.duration / count, threads=self.threads, torque=True
        )
        made = [r.run(stack(points, self.machine), len(points)) for r in (one, other)]
        q = made[0].residual - made[1].residual
        worst: dict[str, Any] = {"position_max_rad": float(np.nanmax(np.abs(q)))}
        worst["position_rms_rad"] = float(np.sqrt(np.nanmean(q.astype(np.float64) ** 2)))
        if made[0].torque_residual is not None and made[1].torque_residual is not None:
            tau = made[0].torque_residual - made[1].torque_residual
            worst["torque_max_Nm"] = float(np.nanmax(np.abs(tau)))
        worst["readings_missing_on_one_only"] = int((np.isnan(q) & ~np.isnan(made[1].residual)).sum())
        return worst

    def declared(self) -> dict[str, Any]:
        """Fit the baseline parameters, in coarse steps."""
        before, began = self.replay.replays, time.perf_counter()
        fitted = fit_baseline(self.problem, Point.of(BASELINE, self.machine), BASELINE, {})
        seconds = time.perf_counter() - began
        return {"seconds": seconds, "replays": self.replay.replays - before, **self._error(fitted.residual)}

    def random(self) -> dict[str, Any]:
        """Search as the paper does."""
        before, began = self.replay.replays, time.perf_counter()
        tell = lambda _, replays: self._say(f"random search, {replays - before} samples", began)  # noqa: E731
        fitted = random_search(self.problem, Point.of(BASELINE, self.machine), self.samples, 0, tell)
        seconds = time.perf_counter() - began
        made = {"seconds": seconds, "samples": self.samples, "together": self.replay.sets_per_batch}
        return made | self._error(fitted.residual)

    def everything(self) -> dict[str, Any]:
        """Calibrate: baseline fit, fine steps, diagnosis."""
        began = time.perf_counter()
        stages: list[tuple[float, str]] = []

        def tell(text: str, replays: int) -> None:
            stages.append((round(time.perf_counter() - began, 2), text))
            self._say(f"{text} ({replays} replays)", began)

        settings = CalibrateSettings(device=self.device, threads=self.threads, most_effects=self.effects)
        result = calibrate(self.log, self.machine, settings, tell)
        return {
            "seconds": time.perf_counter() - began,
            "replays": result.replays,
            "held_out_mrad": 1e3 * Errors.total(result.stages[-1].errors.held_out),
            "declared_mrad": 1e3 * Errors.total(result.stages[0].errors.held_out),
            "noise_mrad": 1e3 * Errors.total(result.noise),
            "sentence": result.sentence,
            "stages": stages,
        }

    def _replayed(self, size: int) -> None:
        self.replay.run(stack(drawn(self.machine, size), self.machine), size)

    def _error(self, residual: Any) -> dict[str, float]:
        joints = len(self.machine.joints)
        squares = self.problem.mean_squares(residual, True)[:joints] * self.problem.noise[:joints] ** 2
        return {"held_out_mrad": 1e3 * float(np.sqrt(np.mean(squares)))}

    def _say(self, text: str, began: float) -> None:
        print(f"  {time.perf_counter() - began:7.1f} s  {text}", flush=True)


def _device_name(device: str) -> str:
    if device.startswith("cuda"):
        import torch

        return str(torch.cuda.get_device_name(device))
    return f"{os.cpu_count()} cores"


def _line(name: str, row: dict[str, Any]) -> str:
    figures = [f"{row[k]:.3f} mrad held out" for k in ("held_out_mrad",) if k in row]
    figures += [f"{row[k]} {k}" for k in ("replays", "samples", "segments") if k in row]
    figures += [f"{k} {v:.2g}" for k, v in row.items() if k.endswith(("_rad", "_Nm", "_only"))]
    seconds = f"{row['seconds']:8.2f} s" if "seconds" in row else 10 * " "
    return f"{name:12s} {seconds}  {', '.join(figures)}"


def run(args: argparse.Namespace) -> None:
    """Time the parts and print the table."""
    parts = Parts(unpack(args.log), args.device, args.samples, args.threads, args.effects)
    log = parts.log
    made: dict[str, Any] = {
        "device": _device_name(args.device),
        "log": {"seconds": log.duration, "rate": log.rate, "joints": len(log.joints), "torque": log.tau is not None},
        "parts": {},
    }
    print(f"{made['device']}; {log.duration:.0f} s of {len(log.joints)} joints at {log.rate:.0f} Hz", flush=True)
    todo: dict[str, Callable[[], dict[str, Any]]] = {name: getattr(parts, name) for name in PARTS}
    for name in [n for n in PARTS if n in args.only]:
        print(name, flush=True)
        made["parts"][name] = todo[name]()
        args.out.write_text(json.dumps(made, indent=1), encoding="utf-8")
    print("\n" + "\n".join(_line(name, row) for name, row in made["parts"].items()))
    for size, row in made["parts"].get("replays", {}).get("sets", {}).items():
        print(f"  {size:>4s} sets: {row['seconds']:.3f} s, {row['steps_per_s'] / 1e6:.2f} M steps/s")
    if "everything" in made["parts"]:
        print(made["parts"]["everything"]["sentence"])


PARTS = ("first", "replays", "agreement", "declared", "random", "everything")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    packing = commands.add_parser("pack")
    packing.add_argument("log", type=Path)
    packing.add_argument("out", type=Path)
    packing.set_defaults(do=lambda a: pack(read_log(a.log), a.out))
    timing = commands.add_parser("run")
    timing.add_argument("log", type=Path)
    timing.add_argument("--device", default="cuda", help="cpu, cuda, or cpu-worlds")
    timing.add_argument("--out", type=Path, default=Path("calibration_speed.json"))
    timing.add_argument("--samples", type=int, default=8192)
    timing.add_argument("--threads", type=int, default=0)
    timing.add_argument("--effects", type=int, default=5, help="most effects that are added")
    timing.add_argument("--only", nargs="+", choices=PARTS, default=PARTS)
    timing.set_defaults(do=run)
    args = parser.parse_args()
    args.do(args)


if __name__ == "__main__":
    main()
