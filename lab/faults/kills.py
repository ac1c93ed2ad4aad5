"""Kill or stop one process of a run at a random moment, and measure when the last motor is damped.

    python -m lab.faults.kills OUT.jsonl ROBOT [--runs N] [--first SEED]

ROBOT is can or stock. The emulated robot runs in this process, `mimic --robot` and the process that sends are others.
Needed: damped within 0.15 s of a process that ends and 0.35 s of one that hangs, and never driven afterwards.
"""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from lab.faults.processes import HELPER, ROOT, helper_of, send_signals, targets
from mimic.config.emulator import EmulateSettings
from mimic.control.priority import EMULATOR, real_time
from mimic.emulator.board import EmulatedBoard
from mimic.emulator.robot import EmulatedRobot
from mimic.emulator.server import EmulatorServer
from mimic.hardware.can.wiring import load_wiring
from mimic.hardware.stock.wiring import load_board
from mimic.robot.description import load_description

WITHIN = {"killed": 0.15, "stopped": 0.35}
"""A robot is damped this long after a process ends or hangs [s]."""

WATCHED = 5.0
"""For how long motors are watched afterwards [s]."""

HANG = 60.0
"""[s]"""


class Scene:
    """An emulated robot in a thread."""

    def __init__(self, robot: str, seed: int) -> None:
        description, settings = load_description("cyberdog2"), EmulateSettings(zeroed=True, placement=0.02, seed=seed)
        self.server: Any
        if robot == "can":
            self.robot: Any = EmulatedRobot(description, load_wiring(), settings)
            self.server = EmulatorServer(self.robot)
            self.words = [self.server.addresses[0], "--zeroed"]
        else:
            from mimic.emulator.board_server import BoardServer
            from mimic.hardware.stock.lcm_bus import LcmBus

            self.robot = EmulatedBoard(description, load_board(), settings)
            self.server = BoardServer(self.robot, LcmBus(load_board(), 0))
            self.words = ["cyberdog2", "--interface", "lo"]
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        with real_time(EMULATOR):
            self.server.run(self._over.is_set)

    def driven(self) -> bool:
        """Return whether a motor has stiffness or torque."""
        return bool(self.robot.driven())

    def close(self) -> None:
        self._over.set()
        self._thread.join(10.0)


def play(robot: str, seed: int, motion: Path, work: Path) -> dict[str, Any]:
    """Play a run, and return what was done to which process, and when the motors were damped."""
    rng = np.random.default_rng([seed, 83, len(robot)])
    who, how = str(rng.choice(["loop", "sender"])), str(rng.choice(["killed", "stopped"]))
    scene, after = Scene(robot, seed), float(rng.uniform(0.1, 8.0))
    words = [sys.executable, "-m", "mimic", str(motion), "--robot", *scene.words, "--yes", "--no-view"]
    with (work / "said.txt").open("w") as said:
        host = subprocess.Popen([*words, "-o", str(work / "run")], cwd=ROOT, stdout=said, stderr=said)
    row: dict[str, Any] = {"robot": robot, "seed": seed, "who": who, "how": how, "at": round(after, 2)}
    end = time.monotonic() + HANG
    while not scene.driven() and host.poll() is None and time.monotonic() < end:
        time.sleep(0.01)
    time.sleep(after)
    pid = host.pid if who == "loop" else helper_of(host.pid, HELPER)
    begin = last = time.monotonic()
    row["driven_before"] = scene.driven()
    send_signals([pid], signal.SIGKILL if how == "killed" else signal.SIGSTOP)
    while time.monotonic() - begin < WATCHED:
        last = time.monotonic() if scene.driven() else last
        time.sleep(0.001)
    send_signals([host.pid, pid], signal.SIGCONT)
    try:
        row["status"] = host.wait(HANG)
    except subprocess.TimeoutExpired:
        host.kill()
        row["status"] = "hung"
    row["damped_after"] = round(last - begin, 3)
    row["fine"] = row["damped_after"] <= WITHIN[how] and not scene.driven()
    row["last"] = (work / "said.txt").read_text(errors="replace").strip().splitlines()[-1:]
    scene.close()
    return row


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m lab.faults.kills", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("robot", choices=["can", "stock"])
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--first", type=int, default=1, help="first seed")
    given = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as name, given.out.open("a") as file:
        motion = targets(Path(name) / "targets.parquet")
        for seed in range(given.first, given.first + given.runs):
            work = Path(name) / f"run{seed}"
            work.mkdir()
            rows.append(play(given.robot, seed, motion, work))
            file.write(json.dumps(rows[-1]) + "\n")
            file.flush()
    for who in ("loop", "sender"):
        for how, within in WITHIN.items():
            some = [r for r in rows if (r["who"], r["how"]) == (who, how) and r["driven_before"]]
            if some:
                longest = max(r["damped_after"] for r in some)
                fine = sum(r["fine"] for r in some)
                print(f"{who} {how}: {fine} of {len(some)} damped within {within} s, {longest:.3f} s at most")


if __name__ == "__main__":
    main()
