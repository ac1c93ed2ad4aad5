"""Runs on both emulated robots, in their own time, with a fault that their emulators know nothing of.

python -m lab.faults.faults_outside OUT.json {can,stock} [runs] [first seed]

Between driver and robot stands a proxy that delays, drops, corrupts, repeats or forges what goes through; a second
program commands the robot; processes are killed or stand still; the disk is full. A run in three has a fault of the
emulator's own list instead. Counted is who ends driven, hangs, raises, or loses its log.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from lab.faults import faults_can, faults_stock
from lab.faults.faults_scene import Scene, Trouble, print_failures
from mimic.config.play import RunSettings
from mimic.control.loop import run_policy
from mimic.control.recorder import RunRecorder, salvage
from mimic.control.signals import Signals
from mimic.control.supervisor import Supervisor
from mimic.control.tick import Safety
from mimic.emulator.board import FAULTS as BOARD_FAULTS
from mimic.emulator.faults import CAN_KINDS, random_fault
from mimic.errors import MimicError
from mimic.evaluation.policy import command_script
from mimic.io import store
from mimic.policy.runtime import load_policy
from mimic.robot.description import load_description

PROCESSES = ("host_killed", "host_stopped", "disk_full", "terminal_closed", "many_ctrl_c")
"""What happens to this program."""

TIMING = RunSettings(stand_up=1.0, blend=0.4, hold_last=0.2, sit_down=2.0)

RAMP, TRACK = 0.6, 1.5
"""[s]"""

WITHIN = (0.1, 5.0)
"""When a fault begins, after the robot is ready [s]: from the ramp into the sitting down."""

HANG = 60.0
"""A run that takes longer than this in the robot's time hangs [s]."""


class Killed(BaseException):
    """This program is gone."""


class FullDisk(RunRecorder):
    """A recorder whose disk may be full."""

    full = False

    def row(self, values: Any, health: Any) -> None:
        if self.full:
            raise OSError(28, "No space left on device")
        super().row(values, health)

    def event(self, event: Any) -> None:
        if self.full:
            raise OSError(28, "No space left on device")
        super().event(event)


def kinds_of(robot: str) -> tuple[str, ...]:
    """Return what can go wrong from outside."""
    scenes = faults_can if robot == "can" else faults_stock
    return (*scenes.PROXIES, *scenes.MASTERS, *PROCESSES)


def play(robot: str, seed: int, folder: Path, kind: str | None = None) -> dict[str, Any]:
    """Play a run with the fault of a seed and return how it ended."""
    rng = np.random.default_rng([seed, 47, len(robot)])
    own = kind is None and bool(rng.random() < 1 / 3)
    inner = CAN_KINDS if robot == "can" else BOARD_FAULTS
    if own:
        kind = str(rng.choice(inner))
    kind = str(rng.choice(kinds_of(robot))) if kind is None else kind
    start = float(rng.uniform(*WITHIN))
    lasts = float(rng.choice([0.05, 0.2, 1.0, np.inf]))
    fault = random_fault(seed, start=WITHIN, after_release=True, kinds=(kind,)) if kind in inner else None
    description = load_description()
    between = None if kind in (*inner, *PROCESSES) else kind
    trouble = Trouble(seed=seed, rng=rng, fault=fault, kind=between)
    make = faults_can.CanScene if robot == "can" else faults_stock.StockScene
    scene: Scene = make(description, trouble)
    policy, sitter = load_policy(None, description), load_policy(None, description, task="sit_down")
    recorder = FullDisk(folder, policy.contract.observation_size, {"dt": description.dt})
    signals, supervisor = Signals(), Supervisor(description)
    safety = Safety(supervisor=supervisor, signals=signals, recorder=recorder, ramp=RAMP)
    state = {"begin": np.inf, "stopped": False, "steps": 0}

    def sink(tick: object) -> None:
        now = scene.now()
        if state["begin"] == np.inf:
            state["begin"] = now
            trouble.begin, trouble.end = now + start, now + start + lasts
        if now - state["begin"] > HANG:
            raise TimeoutError
        state["steps"] += 1
        if now < state["begin"] + start:
            return
        if kind == "host_killed":
            raise Killed
        if kind == "host_stopped" and not state["stopped"]:
            state["stopped"] = True
            scene.stands_still(float(rng.choice([0.03, 0.08, 0.3, 2.0])))
        recorder.full |= kind == "disk_full"
        if kind == "terminal_closed":
            signals.interrupts, signals.hung_up = 1, True
        signals.interrupts += kind == "many_ctrl_c"

    track = command_script(description, TRACK, rng)
    pair = [SimpleNamespace(contract=p.contract, path=p.path, act=p.act) for p in (policy, sitter)]
    driver: Any = run_policy
    escaped, hung, killed, rows = "", False, False, 0
    began = time.monotonic()
    scene.plant.close = _closing(scene, scene.plant.close, state)
    try:
        result = driver(scene.plant, pair[0], track, TIMING, sit_down=pair[1], sink=sink, safety=safety)
        rows = len(result.log.t)
        hung = isinstance(result.error, TimeoutError)
        if result.error is not None and not isinstance(result.error, MimicError | TimeoutError):
            escaped = f"{type(result.error).__name__}: {result.error}"
    except MimicError as reason:
        escaped = "" if state["steps"] == 0 else f"{type(reason).__name__}: {reason}"
    except Killed:
        killed = True
        scene.is_alone()
    except Exception as reason:
        escaped = f"{type(reason).__name__}: {reason}"
    recorder.close()
    scene.lets_go(1.0)
    disk = 0
    with suppress(MimicError):
        disk = len(salvage(folder)[0].t)
    kept = disk if kind != "disk_full" else max(rows, disk)
    ended = supervisor.decisive
    return {
        "robot": robot,
        "seed": seed,
        "fault": kind if fault is None else str(fault),
        "outside": not own,
        "begin": start,
        "lasts": lasts,
        "rule": "" if ended is None else ended.rule,
        "mode": "" if ended is None else ended.mode.name.lower(),
        "after": float("nan") if ended is None else ended.t - start,
        "driven": scene.driven(),
        "reachable": scene.reachable(),
        "undamped": bool(scene.driven()) and scene.reachable(),
        "hung": hung,
        "traceback": escaped,
        "lost": kept < state["steps"],
        "silent": bool(scene.on()) and not killed and not scene.told(),
        "steps": state["steps"],
        "rows": kept,
        "ending": scene.plant.ending,
        "seconds": time.monotonic() - began,
    }


def _closing(scene: Any, close: Any, state: dict[str, Any]) -> Any:
    """Return a close that a killed program never reaches."""

    def closing() -> None:
        if not isinstance(sys.exc_info()[1], Killed):
            close()

    return closing


def table(rows: list[dict[str, Any]]) -> None:
    """Print how the runs ended."""
    for robot in sorted({row["robot"] for row in rows}):
        mine = [row for row in rows if row["robot"] == robot]
        print(f"{robot}: {len(mine)} runs, {sum(row['outside'] for row in mine)} with a fault from outside")
        print_failures(mine)
        beyond = [row["fault"].split("=")[0].split(":")[0] for row in mine if row["driven"] and not row["reachable"]]
        print("  driven, and beyond reach:", dict(Counter(beyond)))
        print("  rules:", dict(Counter(row["rule"] for row in mine)))


def main() -> None:
    out, robot = Path(sys.argv[1]), sys.argv[2]
    runs, first = (int(sys.argv[i]) if len(sys.argv) > i else default for i, default in ((3, 100), (4, 1)))
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as name:
        for seed in range(first, first + runs):
            rows.append(play(robot, seed, Path(name) / f"run{seed}"))
            store.save_json(rows, out)
    table(rows)


if __name__ == "__main__":
    main()
