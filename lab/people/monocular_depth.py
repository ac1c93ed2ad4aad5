"""What one camera costs the robot: clamped toe targets of each single view against those of all four together.

    python -m lab.people.monocular_depth [FOLDER]     # by default ../shared/data/videos/real/multiview

The folder holds the same frames from several cameras (cam*.mp4) and the landmarks triangulated from them (.npz).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from mimic.config.play import RunSettings
from mimic.config.retarget import RetargetSettings
from mimic.control.loop import run_policy
from mimic.flows.motion import InputSettings, Motion, load_motion
from mimic.geometry import R_BT
from mimic.metrics import run_metrics
from mimic.policy.runtime import load_policy
from mimic.records import TargetTrack
from mimic.robot.description import load_description
from mimic.simulation.plant import SimulatedPlant

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "videos" / "real" / "multiview"
STILL = RetargetSettings(keep_peaks=False)
"""Targets of all views at the same times, so that they can be compared one by one."""


def difference(one: TargetTrack, other: TargetTrack) -> np.ndarray:
    """Return how far the targets of two tracks are apart in torso axes (N, 3) [m], where both saw the hand."""
    rows = min(len(one.t), len(other.t))
    both = one.valid[:rows] & other.valid[:rows]
    return ((one.p_BE[:rows] - other.p_BE[:rows]) @ R_BT)[both]


def agreement(one: TargetTrack, other: TargetTrack) -> list[str]:
    """Return correlation and gain of the motion along forward, left and up, over both hands."""
    rows = min(len(one.t), len(other.t))
    cells = []
    for axis in range(3):
        pairs = []
        for side in range(2):
            both = one.valid[:rows, side] & other.valid[:rows, side]
            a, b = ((track.p_BE[:rows, side] @ R_BT)[both, axis] for track in (one, other))
            pairs.append((a - a.mean(), b - b.mean()))
        a, b = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
        cells.append(f"{np.corrcoef(a, b)[0, 1]:.2f}, {a @ b / (b @ b):.2f}")
    return cells


def played(motion: Motion) -> float:
    """Return the mean toe error of the simulated robot [cm]."""
    description = load_description()
    policy = load_policy(None, description)
    log = run_policy(SimulatedPlant(description), policy, motion.commands, RunSettings()).log
    return float(run_metrics(log, description)["toe_error_cm"]["mean"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, default=DATA)
    folder = parser.parse_args().folder
    settings = InputSettings(retarget=STILL)
    truth = load_motion(next(folder.glob("*.npz")), settings)
    assert truth.targets is not None
    print(
        "| view | camera off forward | targets apart, mean / p95 | forward, left, up rms | forward: r, gain "
        "| left: r, gain | up: r, gain | clamped | robot's toe error |\n|---|---|---|---|---|---|---|---|---|"
    )
    for path in [None, *sorted(folder.glob("cam*.mp4"))]:
        motion = truth if path is None else load_motion(path, settings)
        targets = motion.targets
        assert targets is not None
        tail = (
            f"{targets.report['clamped_share']:.0%}, {targets.report['moved_mean_cm']:.1f} cm "
            f"| {played(motion):.1f} cm |"
        )
        if path is None:
            print(f"| all four | – | – | – | – | – | – | {tail}")
            continue
        apart = 100 * difference(targets, truth.targets)
        length = np.linalg.norm(apart, axis=1)
        axis = targets.report["pose"]["camera_axis"]
        off = np.degrees(np.arctan2(abs(axis[1]), -axis[0]))
        rms = ", ".join(f"{v:.1f}" for v in np.sqrt((apart**2).mean(axis=0)))
        cells = " | ".join(agreement(targets, truth.targets))
        print(
            f"| {path.stem} | {off:.0f}° | {length.mean():.1f} / {np.quantile(length, 0.95):.1f} cm | {rms} cm "
            f"| {cells} | {tail}"
        )


if __name__ == "__main__":
    main()
