"""Time and memory of what a user runs: start-up, the whole command, and the simulated run alone.

python -m lab.timing.whole_command [VIDEO]        # by default examples/videos/boxing.mp4
"""

from __future__ import annotations

import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "videos" / "boxing.mp4"


def command(*words: str, cache: Path) -> tuple[float, float]:
    """Return wall time [s] and peak memory [MiB] of a mimic command in a process of its own."""
    begin = time.perf_counter()
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    environment = os.environ | {"XDG_CACHE_HOME": str(cache)}
    subprocess.run([sys.executable, "-m", "mimic", *words], check=True, stdout=subprocess.DEVNULL, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    return time.perf_counter() - begin, max(before, after) / 1024


def real_time_factor() -> float:
    """Return simulated seconds per second of the run without pose and rendering, logs included."""
    import numpy as np

    from mimic.config.play import RunSettings
    from mimic.control.loop import run_policy
    from mimic.evaluation.policy import command_script
    from mimic.policy.runtime import load_policy
    from mimic.robot.description import load_description
    from mimic.simulation.plant import SimulatedPlant

    description = load_description("cyberdog2")
    policy = load_policy(None, description)
    track = command_script(description, 20.0, np.random.default_rng(0), speed=0.0, turn=0.0)
    plant = SimulatedPlant(description)
    factors = []
    for _ in range(5):
        begin = time.perf_counter()
        log = run_policy(plant, policy, track, RunSettings()).log
        factors.append((log.t[-1] - log.t[0]) / (time.perf_counter() - begin))
    return statistics.median(factors)


def main() -> None:
    video = Path(sys.argv[1]) if len(sys.argv) > 1 else EXAMPLE
    with tempfile.TemporaryDirectory() as folder:
        cache, out = Path(folder) / "cache", Path(folder)
        helps = [command("--help", cache=cache)[0] for _ in range(7)]
        print(f"mimic --help                 {statistics.median(helps):.2f} s (median of 7)")
        first, memory = command(str(video), "--sim", "--no-view", "-o", str(out / "a"), cache=cache)
        print(f"mimic {video.name} --sim        {first:.1f} s, peak memory {memory:.0f} MiB")
        again, _ = command(str(video), "--sim", "--no-view", "-o", str(out / "b"), cache=cache)
        print(f"the same with stored pose    {again:.1f} s")
    print(f"simulated run alone          {real_time_factor():.0f} times real time (median of 5)")


if __name__ == "__main__":
    main()
