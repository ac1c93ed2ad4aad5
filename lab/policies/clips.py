"""How well the simulated robot follows each clip: a table with toe error, lag, clamping and standing.

    python -m lab.policies.clips [--rate 0.1] [VIDEO ...]      # without videos: the shipped examples

Pose tracks are cached by content, as the mimic command does.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mimic.cli.terminal.console import ConsoleReporter
from mimic.config.play import RunSettings
from mimic.config.retarget import RetargetSettings
from mimic.control.loop import run_policy
from mimic.flows.motions.motion import InputSettings, load_motion
from mimic.metrics import run_metrics
from mimic.policy.runtime import load_policy
from mimic.retargeting.commands import command_track
from mimic.robot.description import load_description
from mimic.simulation.plant import SimulatedPlant

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "videos"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("videos", nargs="*", type=Path)
    parser.add_argument("--rate", type=float, default=0.1)
    parser.add_argument("--policy", default=None)
    parser.add_argument("--arms", choices=("network", "inverse_kinematics"), help="see RunSettings.arms")
    parser.add_argument("--robot-model", default="cyberdog2")
    options = parser.parse_args()
    description = load_description(options.robot_model)
    policy = load_policy(options.policy, description)
    lines = [
        "| clip | length | toe error mean / p95 | lag | without lag "
        "| clamped | speed-limited | stood up in | upright |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for video in options.videos or sorted(EXAMPLES.glob("*.mp4")):
        settings = InputSettings(retarget=RetargetSettings(rate=options.rate))
        targets = load_motion(video, settings, description=description, reporter=ConsoleReporter()).targets
        assert targets is not None
        plant = SimulatedPlant(description)
        m = run_metrics(
            run_policy(plant, policy, command_track(targets), RunSettings(arms=options.arms)).log, description
        )
        e, r = m["toe_error_cm"], targets.report
        lines.append(
            f"| {video.stem} | {targets.t[-1]:.1f} s | {e['mean']:.1f} / {e['p95']:.1f} cm | {1e3 * m['lag_s']:.0f} ms "
            f"| {m['toe_error_without_lag_cm']:.1f} cm | {r['clamped_share']:.1%}, {r['moved_mean_cm']:.2f} cm "
            f"| {r['limited_share']:.1%} | {m['stand_up_s']:.2f} s | {m['standing_share']:.1%} |"
        )
    print("\n".join(lines))


if __name__ == "__main__":
    main()
