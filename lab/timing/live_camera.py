"""A camera followed live: latency of every frame, and how far the live targets are from those of the whole clip.

    python -m lab.timing.live_camera [--beta 4 --min-cutoff 1.5] [VIDEO ...]     # by default the shipped clips

Each clip is played in real time in place of a camera, with the simulated robot in the same process. Run it on a quiet
computer.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from pathlib import Path

import numpy as np

from mimic.config.play import RunSettings
from mimic.config.pose import LiveSettings
from mimic.config.retarget import RetargetSettings
from mimic.flows.motions.camera import play_camera
from mimic.flows.motions.camera_record import LIVE
from mimic.flows.motions.motion import InputSettings, load_motion
from mimic.flows.run_folder import COMMANDS, METRICS
from mimic.io import store
from mimic.records import CommandTrack, LiveTrack

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "videos"


def behind(live: CommandTrack, whole: CommandTrack, blend: float) -> tuple[float, float]:
    """Return how far live targets lag those of the whole clip [s], and how far they are apart with that lag [cm]."""
    dt = 0.02
    best = (np.inf, 0)
    first = round(blend / dt)  # the clip began with the blend, tracking after it
    for lag in range(30):
        rows = np.arange(100, min(len(live.t), len(whole.t) - first))
        apart = np.linalg.norm(live.p_BE[rows] - whole.p_BE[rows + first - lag], axis=-1).mean()
        best = min(best, (float(apart), lag))
    return best[1] * dt, 100 * best[0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("videos", nargs="*", type=Path)
    parser.add_argument("--beta", type=float, default=LiveSettings().beta)
    parser.add_argument("--min-cutoff", type=float, default=LiveSettings().min_cutoff)
    options = parser.parse_args()
    live = LiveSettings(beta=options.beta, min_cutoff=options.min_cutoff)
    lines = [
        "| clip | frames, dropped | latency p50 / p95 / most | detector p50 "
        "| behind the whole clip | apart | toe error | load |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for video in options.videos or sorted(EXAMPLES.glob("*.mp4")):
        load = os.getloadavg()[0]
        whole = load_motion(video, InputSettings(retarget=RetargetSettings(rate=0.05))).commands
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "run"
            play_camera(str(video), live=live, out=out)
            track = store.load(out / LIVE, LiveTrack)
            asked = store.load(out / COMMANDS, CommandTrack)
            metrics = json.loads((out / METRICS).read_text())
        lag, apart = behind(asked, whole, RunSettings().blend)
        p50, p95, most = (1e3 * np.quantile(track.latency, q) for q in (0.5, 0.95, 1.0))
        lines.append(
            f"| {video.stem} | {len(track.t)}, {track.skipped.sum()} | {p50:.0f} / {p95:.0f} / {most:.0f} ms "
            f"| {1e3 * np.median(track.detector):.0f} ms | {1e3 * lag:.0f} ms | {apart:.1f} cm "
            f"| {metrics['toe_error_cm']['mean']:.1f} cm | {load:.1f} |"
        )
    print("\n".join(lines))


if __name__ == "__main__":
    main()
