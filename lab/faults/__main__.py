"""Play runs with a fault each, and print how they ended.

    python -m lab.faults OUT.jsonl ROBOT SETTING [--runs N] [--first SEED] [--kinds KIND ...]

ROBOT is can, stock, go2, or each: seeds go round the boards of the setting. SETTING is own_time (faults drawn by their
seeds, faster than real time), processes (real processes and sockets in real time, one kind after the other) or kills
(processes and servers end or hang at random moments, in real time). OUT.jsonl gets a line for each run; seeds that it
has are left out, so that a campaign goes on where it was stopped. Needed of each run: motors damped or off at the end,
and within 0.35 s of the decision where somebody could act; no hang, no traceback, a whole log, and a true last line.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from lab.faults import kills, own_time, processes
from lab.faults.trouble import CASES, cases, report

INSIDE = "MIMIC_OWN_NETWORK"
"""Set inside a network and mounts of its own."""

ROBOTS = {"own_time": ("can", "stock", "go2"), "processes": ("can", "stock"), "kills": ("can", "stock", "go2")}

NETWORK = 'ip link set lo up && ip link set lo multicast on && ip route add 224.0.0.0/4 dev lo && exec "$@"'


def inside_own_network() -> int:
    """Run this again in a network and with mounts of its own, and return its exit status."""
    user = [] if os.geteuid() == 0 else ["-r"]
    words = ["unshare", *user, "-n", "-m", "sh", "-c", NETWORK, "sh", sys.executable, "-m", "lab.faults", *sys.argv[1:]]
    return subprocess.run(words, env=os.environ | {INSIDE: "1"}, check=False).returncode


def one(robot: str, seed: int, given: argparse.Namespace, motion: Path, work: Path) -> dict[str, Any]:
    """Play a run of a seed, and return how it ended."""
    if given.setting == "kills":
        return kills.play(robot, seed, motion, work)
    if given.setting == "processes":
        return processes.play(robot, seed, motion, work, given.kinds or cases(robot, given.setting))
    return own_time.play(robot, seed, work, given.kinds[seed % len(given.kinds)] if given.kinds else None)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m lab.faults", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("robot", choices=["can", "stock", "go2", "each"])
    parser.add_argument("setting", choices=list(ROBOTS))
    parser.add_argument("--runs", type=int, default=24)
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--kinds", nargs="*", choices=list(CASES), metavar="KIND", help=", ".join(CASES))
    given = parser.parse_args()
    if given.setting != "own_time" and not os.environ.get(INSIDE):
        return inside_own_network()
    given.out.touch()
    done = {(row["robot"], row["seed"]) for row in map(json.loads, given.out.read_text().splitlines())}
    robots = ROBOTS[given.setting] if given.robot == "each" else (given.robot,)
    with tempfile.TemporaryDirectory() as name, given.out.open("a") as file:
        names = {"go2": "go2"}
        motions = {
            robot: processes.targets(Path(name) / f"{robot}.parquet", names.get(robot, "cyberdog2")) for robot in robots
        }
        for seed in range(given.first, given.first + given.runs):
            robot = robots[seed % len(robots)]
            if (robot, seed) in done:
                continue
            work = Path(name) / f"run{seed}"
            work.mkdir()
            file.write(json.dumps(one(robot, seed, given, motions[robot], work)) + "\n")
            file.flush()
            shutil.rmtree(work, ignore_errors=True)
    (kills.report if given.setting == "kills" else report)(
        [json.loads(line) for line in given.out.read_text().splitlines()]
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
