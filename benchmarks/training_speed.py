"""Where the time of training goes: physics, rewards and observations, inference, learning, and the whole loop.

    CUDA_VISIBLE_DEVICES=7 python3 benchmarks/training_speed.py --out $OUT/speed.json      # everything, below 8 minutes
    python3 benchmarks/training_speed.py --only physics,captured seed=2            # some stages, other settings
    CUDA_VISIBLE_DEVICES=6,7 python3 benchmarks/training_speed.py --only gpus worlds=8192 --out $OUT/gpus.json

Each stage runs in a process of its own, so that one that fails or hangs does not lose the others; its lines are printed
as they come, and the JSON is written anew after each stage. ``name=value`` sets a field as in ``python -m
mimic.train``.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

LIMITS = {
    "captured": 200,
    "kernels": 60,
    "physics": 200,
    "captured_large": 90,
    "physics_large": 90,
    "fused": 150,
    "plain": 90,
    "training_captured": 120,
    "training_plain": 120,
    "launches": 60,
    "gpus": 460,
}
"""Stages in their order, each with the most time it may take [s]."""

HERE = Path(__file__).resolve().parent
START = time.perf_counter()


def say(text: str) -> None:
    print(text, flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=None, help="JSON file to write")
    parser.add_argument("--minutes", type=float, default=7.8, help="no stage goes on after this time")
    parser.add_argument("--only", default=",".join(list(LIMITS)[:-1]), help="stages, with commas between them")
    options, words = parser.parse_known_args()
    found: dict[str, Any] = {"settings": words}
    for name in options.only.split(","):
        left = 60 * options.minutes - (time.perf_counter() - START)
        if left < 20:
            say(f"== {name}: no time left")
            continue
        found[name] = run_stage(name, words, min(left, LIMITS[name]))
        if options.out:
            options.out.parent.mkdir(parents=True, exist_ok=True)
            options.out.write_text(json.dumps(found, indent=1))
    return 0


def run_stage(name: str, words: list[str], limit: float) -> dict[str, Any]:
    """Run a stage in a process of its own; return its figures, or what went wrong."""
    begin = time.perf_counter()
    say(f"== {name} ({begin - START:.0f} s)")
    command = [sys.executable, "-u", str(HERE / "training_stages.py"), name, *words]
    path = os.pathsep.join([str(HERE.parent), *filter(None, [os.environ.get("PYTHONPATH")])])
    figures: dict[str, Any] = {"failed": "no figures"}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env={**os.environ, "PYTHONPATH": path}
    ) as process:
        watch = threading.Timer(limit, process.kill)
        watch.start()
        last = ""
        for line in process.stdout or ():
            if line.startswith("JSON "):
                figures = json.loads(line[5:])
            else:
                last = line.rstrip() or last
                say(line.rstrip())
        watch.cancel()
    if process.returncode:
        figures = {"failed": f"status {process.returncode} after {time.perf_counter() - begin:.0f} s: {last}"}
        say(f"== {name}: {figures['failed']}")
    return figures


if __name__ == "__main__":
    raise SystemExit(main())
