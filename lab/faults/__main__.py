"""Play runs with a fault each, and print how they ended.

    python -m lab.faults OUT.jsonl ROBOT SETTING [--runs N] [--first SEED] [--kinds KIND ...]

ROBOT is can or stock. SETTING is own_time (faults drawn by their seeds, faster than real time) or processes (real
processes and sockets in real time, one kind after the other). OUT.jsonl gets a line for each run, and is continued.
Needed of each run: damped or off at the end, no hang, no traceback, a whole log, and a last line that says so where
motors could not be reached.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from lab.faults import own_time, processes
from lab.faults.trouble import CASES, cases, report

INSIDE = "MIMIC_OWN_NETWORK"
"""Set inside a network and mounts of its own."""

NETWORK = 'ip link set lo up && ip link set lo multicast on && ip route add 224.0.0.0/4 dev lo && exec "$@"'


def inside_own_network() -> int:
    """Run this again in a network and with mounts of its own, and return its exit status."""
    user = [] if os.geteuid() == 0 else ["-r"]
    words = ["unshare", *user, "-n", "-m", "sh", "-c", NETWORK, "sh", sys.executable, "-m", "lab.faults", *sys.argv[1:]]
    return subprocess.run(words, env=os.environ | {INSIDE: "1"}, check=False).returncode


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m lab.faults", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("robot", choices=["can", "stock"])
    parser.add_argument("setting", choices=["own_time", "processes"])
    parser.add_argument("--runs", type=int, default=24)
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--kinds", nargs="*", choices=list(CASES), metavar="KIND", help=", ".join(CASES))
    given = parser.parse_args()
    if given.setting == "processes" and not os.environ.get(INSIDE):
        return inside_own_network()
    kinds = given.kinds or cases(given.robot, given.setting)
    with tempfile.TemporaryDirectory() as name, given.out.open("a") as file:
        motion = processes.targets(Path(name) / "targets.parquet")
        for seed in range(given.first, given.first + given.runs):
            work = Path(name) / f"run{seed}"
            work.mkdir()
            if given.setting == "own_time":
                kind = kinds[seed % len(kinds)] if given.kinds else None
                row = own_time.play(given.robot, seed, work, kind)
            else:
                row = processes.play(given.robot, seed, motion, work, kinds)
            file.write(json.dumps(row) + "\n")
            file.flush()
    report([json.loads(line) for line in given.out.read_text().splitlines()])
    return 0


if __name__ == "__main__":
    sys.exit(main())
