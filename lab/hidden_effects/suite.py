"""Calibrate many hidden machines in parallel and write one JSON line for each.

    python -m lab.hidden_effects.suite OUT --processes 8 --limit 560 [--only single/stribeck] [--rounds 6]
    python -m lab.hidden_effects.suite OUT --balanced --seconds 24 --log-limit 480 --limit 1500

OUT/results.jsonl grows as results come; scenarios that are in it are not run again. At the time limit the workers are
ended, what is done stays, and OUT/unfinished.json says what was cut off. Each worker uses one thread. A log that takes
longer than ``--log-limit`` is a result too, an error.
"""

# ruff: noqa: E402
from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"  # before numpy is imported

import argparse
import json
import multiprocessing
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import replace
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

import numpy as np

from lab.hidden_effects.generator import CLOCKS, FINE_RATE, FLOOR, Machine, Truth, measured, read_by, simulate
from lab.hidden_effects.scenarios import Built, Scenario, balanced, build, for_choosing, ordered
from mimic.dynamics.effect_set import EffectSet
from mimic.dynamics.machine import MachineModel, hung_robot, read_machine
from mimic.io.joint_log import JointLog
from mimic.io.store import plain
from mimic.records import JOINTS, LEGS
from mimic.robot.description import load_description
from mimic.robot.model import read_model, remove_free_joint
from mimic.sysid.result import Calibration, Errors

Calibrate = Callable[[JointLog], Calibration]

UNSEEN_BY_ONE_LEG = {"supply_sag", "joint_delay"}
"""Effects of one leg on another: what the others draw, and how much later than the others it gets its targets."""


def calibrate_log(log: JointLog) -> Calibration:
    """Calibrate the hung robot, or the leg of it that the log has, against a log, as ``mimic calibrate`` does."""
    from mimic.config.sysid import CalibrateSettings
    from mimic.sysid.calibrate import calibrate

    return calibrate(log, hung(log.joints), CalibrateSettings(threads=1))


def legs_mjcf(joints: Sequence[str]) -> str:
    """Return the MJCF of the robot hung up, with the legs of these joints only and without motors."""
    spec = read_model(load_description("cyberdog2"))
    remove_free_joint(spec)
    for group in (spec.keys, spec.sensors, spec.pairs, spec.excludes, spec.actuators):
        for item in list(group):
            spec.delete(item)
    for leg in LEGS:
        if not any(j.startswith(leg) for j in joints):
            spec.delete(spec.joint(f"{leg}_abad").parent)
    spec.compile()
    return spec.to_xml()


def hung(joints: Sequence[str]) -> MachineModel:
    """Return the robot hung up, with the legs of these joints only."""
    robot = hung_robot(load_description("cyberdog2"))
    if set(joints) == set(robot.joints):
        return robot
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "leg.xml"
        path.write_text(legs_mjcf(joints), encoding="utf-8")
        leg = read_machine(path)
    index = [robot.joints.index(j) for j in leg.joints]
    rows = {n: getattr(robot.drives, n)[index] for n in ("kp", "kd", "torque", "flat", "speed")}
    return replace(leg, drives=replace(leg.drives, **rows))


def truth_record(machine: Machine) -> dict[str, Any]:
    """Return what is true, as plain numbers."""
    return {
        "declared": {
            "coulomb.level": machine.friction.tolist(),
            "viscous.coefficient": machine.damping.tolist(),
            "link_mass.factor": machine.mass.tolist(),
            "delay.time": [machine.delay],
        },
        "hidden": [
            {"name": e.name, "joints": list(e.joints), **{k: v.tolist() for k, v in e.values.items()}}
            for e in machine.hidden
        ],
        "aliens": [{"name": a.name, "joints": list(a.joints), "size": a.size} for a in machine.aliens],
    }


def result_record(result: Calibration) -> dict[str, Any]:
    """Return what the calibration says, as plain numbers."""
    effects = [
        {
            "name": e.name,
            "joints": list(e.joints),
            "role": e.role,
            "values": {k: v.tolist() for k, v in e.values.items()},
            "intervals": {k: v.tolist() for k, v in e.intervals.items()},
        }
        for e in result.effects
    ]
    return {
        "named": list(result.names),
        "rivals": _rivals(result),
        "explained": result.explained,
        "belongs": result.log_matches_model,
        "noise": result.noise.tolist(),
        "nominal": Errors.total(result.nominal.held_out),
        "baseline": result.baseline.held_out.tolist(),
        "final": result.final.held_out.tolist(),
        "tried": plain(result.tried),
        "effects": effects,
        "unexplained": [{**plain(r), "explained": r.explained} for r in result.unexplained],
        "sentence": result.sentence,
        "warnings": list(result.warnings),
        "passes": result.passes,
    }


def _rivals(result: Calibration) -> dict[str, list[str]]:
    """Return for each name those that stand in its place in alternatives of as many effects."""
    found: dict[str, list[str]] = {name: [] for name in result.names}
    for other in result.alternatives:
        names = {name for name, _ in other.effects}
        gone = set(result.names) - names
        if len(gone) == 1 and len(names) == len(result.names):
            found[gone.pop()] += sorted(names - set(result.names))
    return found


def change(truth: Truth, other: Truth) -> list[float]:
    """Return how far the positions of each joint are apart, root mean square in noise floors (J,)."""
    return (np.sqrt(((truth.q - other.q)[100:] ** 2).mean(0)) / FLOOR).tolist()


def changes(built: Built, truth: Truth) -> dict[str, list[float]]:
    """Return how far the positions are apart without each of the effects that are looked for."""
    found = {}
    for name in built.where.keys() & {e.name for e in built.machine.hidden}:
        rest = EffectSet(tuple(e for e in built.machine.hidden if e.name != name))
        found[name] = change(truth, simulate(replace(built.machine, hidden=rest), built.motion, built.seed))
    return found


def run_scenario(scenario: Scenario, calibrate: Calibrate = calibrate_log) -> dict[str, Any]:
    """Return one line of the results; an exception of the calibration is a result too."""
    record: dict[str, Any] = {
        "key": scenario.key,
        "group": scenario.group,
        "names": scenario.names,
        "strength": scenario.strength,
        "kind": scenario.kind,
        "seed": scenario.seed,
    }
    try:
        built = build(scenario)
        truth = simulate(built.machine, built.motion, built.seed)
        record |= {"where": built.where, "truth": truth_record(built.machine), "floor": FLOOR}
        record |= {"differs": built.differs, "small": built.small}
        if scenario.names:
            bare = replace(built.machine, hidden=type(built.machine.hidden)(), aliens=())
            plain_truth = simulate(bare, built.motion, built.seed)
            record["change"] = change(truth, plain_truth)
            record["changes"] = changes(built, truth) if len(built.machine.hidden) > 1 else {}
        read = truth
        if scenario.clock != "grid":
            fine = simulate(built.machine, built.motion, built.seed, rate_hz=FINE_RATE)
            read = read_by(CLOCKS[scenario.clock], fine, built.motion, built.seed)
        log = measured(read, built.seed)
        if scenario.joints == "leg":
            log = log.of(built.leg)
            keep = [JOINTS.index(j) for j in built.leg]
            record["joints"] = built.leg
            for name in ("change", "changes"):
                if name in record:
                    record[name] = _of(record[name], keep)
        start, used = time.perf_counter(), time.process_time()
        result = calibrate(log)
        record |= {"seconds": time.perf_counter() - start, "cpu_seconds": time.process_time() - used}
        record |= result_record(result)
    except Exception:
        record["error"] = traceback.format_exc(limit=-6)
    return json.loads(json.dumps(plain(record)))


def failed(key: str, why: str) -> dict[str, Any]:
    """Return the line of a log whose calibration did not end."""
    scenario = Scenario.of(key)
    named = {n: getattr(scenario, n) for n in ("group", "names", "strength", "kind", "seed")}
    return {"key": key, **named, "error": why}


def _of(changes: Any, keep: Sequence[int]) -> Any:
    """Return the changes of some joints, of one effect or of several by name."""
    if isinstance(changes, dict):
        return {name: _of(row, keep) for name, row in changes.items()}
    return [changes[j] for j in keep]


def _work(pipe: Any, calibrate: Calibrate) -> None:
    while (key := pipe.recv()) is not None:
        pipe.send(run_scenario(Scenario.of(key), calibrate))


def run_suite(
    scenarios: Sequence[Scenario],
    out: Path,
    processes: int,
    limit: float,
    calibrate: Calibrate = calibrate_log,
    log_limit: float = float("inf"),
) -> int:
    """Run what is not in OUT yet and return how many were done before the time limit [s].

    A log that takes longer than ``log_limit`` [s] is ended and written as an error.
    """
    end = time.monotonic() + limit
    out.mkdir(parents=True, exist_ok=True)
    lines = out / "results.jsonl"
    known = set()
    if lines.exists():
        known = {json.loads(line)["key"] for line in lines.read_text(encoding="utf-8").splitlines() if line.strip()}
    waiting = [s.key for s in scenarios if s.key not in known]
    waiting.reverse()
    context = multiprocessing.get_context("fork")  # what is imported and compiled is shared
    workers: dict[Any, tuple[Any, str, float]] = {}
    done = 0

    def give(pipe: Any, process: Any) -> None:
        key = waiting.pop() if waiting else None
        pipe.send(key)
        if key is not None:
            workers[pipe] = (process, key, time.monotonic())

    def start() -> None:
        ours, theirs = context.Pipe()
        process = context.Process(target=_work, args=(theirs, calibrate), daemon=True)
        process.start()
        theirs.close()
        give(ours, process)

    with open(lines, "a", encoding="utf-8") as file:

        def write(record: dict[str, Any]) -> None:
            nonlocal done
            file.write(json.dumps(record) + "\n")
            file.flush()
            done += 1
            named = "ERROR" if "error" in record else "+".join(record["named"]) or "nothing"
            print(f"{done:5d} {record.get('seconds', 0):6.1f} s  {record['key']} -> {named}", flush=True)

        for _ in range(min(processes, len(waiting))):
            start()
        while workers and (left := end - time.monotonic()) > 0:
            oldest = min(began for *_, began in workers.values())
            patience = max(0.0, oldest + log_limit - time.monotonic())
            for pipe in wait(list(workers), timeout=min(left, patience, 3600.0)):
                process, key, _ = workers.pop(pipe)
                try:
                    record = pipe.recv()
                except EOFError:  # the worker is gone, killed by the system or a crash
                    process.join()
                    record = failed(key, f"worker ended with {process.exitcode}")
                    if waiting:
                        start()
                else:
                    give(pipe, process)
                write(record)
            for pipe, (process, key, began) in list(workers.items()):
                if time.monotonic() - began > log_limit:
                    del workers[pipe]
                    process.kill()
                    write(failed(key, f"not done after {log_limit:g} s"))
                    if waiting:
                        start()
    for process, *_ in workers.values():
        process.kill()
    cut = [{"key": key, "seconds": time.monotonic() - began} for _, key, began in workers.values()]
    (out / "unfinished.json").write_text(json.dumps(cut), encoding="utf-8")
    return done


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--processes", type=int, default=max(1, (os.cpu_count() or 2) - 1))
    parser.add_argument("--limit", type=float, default=float("inf"), help="seconds after which to stop")
    parser.add_argument("--only", action="append", default=[], help="run keys that contain this; may be repeated")
    parser.add_argument("--rounds", type=int, default=6, help="seeds of everything")
    parser.add_argument("--seconds", type=float, default=60.0, help="length of each log")
    parser.add_argument("--clocks", nargs="+", default=["grid"], choices=list(CLOCKS), help="when rows are written")
    parser.add_argument("--balanced", action="store_true", help="all clocks, mixed so that a run may be cut anywhere")
    parser.add_argument(
        "--joints", default="all", choices=("all", "leg"), help="with --balanced: one leg of each robot"
    )
    parser.add_argument("--log-limit", type=float, default=float("inf"), help="seconds after which a log is given up")
    parser.add_argument("--half", choices=("choosing", "reported"), help="only the scenarios of this half")
    parser.add_argument("--list", action="store_true", help="print the keys and stop")
    args = parser.parse_args(argv)
    began = time.monotonic()
    if args.balanced:
        chosen = [replace(s, joints=args.joints) for s in balanced(args.rounds, args.seconds)]
        if args.joints == "leg":
            chosen = [s for s in chosen if not UNSEEN_BY_ONE_LEG & set(s.names)]
    else:
        chosen = [replace(s, clock=c) for s in ordered(args.rounds, args.seconds) for c in args.clocks]
    chosen = [s for s in chosen if not args.only or any(o in s.key for o in args.only)]
    if args.half:
        chosen = [s for s in chosen if for_choosing(s.key) == (args.half == "choosing")]
    if args.list:
        print(*(s.key for s in chosen), sep="\n")
        return 0
    warm = Scenario(group="clean", seed=0, seconds=10.0)
    built = build(warm)
    simulate(built.machine, built.motion, 0)  # compiles the physics once, before the workers fork
    limit = min(args.limit, 1e9) - (time.monotonic() - began)
    done = run_suite(chosen, args.out, args.processes, limit, calibrate_log, args.log_limit)
    print(f"{done} of {len(chosen)} scenarios done now; results in {args.out / 'results.jsonl'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
