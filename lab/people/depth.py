"""How well the depth of the arms is known: clips with exact truth, with the detector's depth and the estimated one.

    python -m lab.people.depth VIDEO [...]

Beside each VIDEO.mp4 lies VIDEO.npz with `t`, `names` and `joints` in camera axes (examples/videos, or what
lab/people/depth_clips.py --video wrote). Wrists are compared from their own shoulder in torso axes, each with its
own heading, and the toe targets that follow from them.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from mimic.config.pose import PoseSettings
from mimic.config.retarget import RetargetSettings
from mimic.flows.motion import track_video
from mimic.records import LANDMARKS, PoseTrack
from mimic.retargeting.targets import target_track
from mimic.retargeting.wrists import torso_heading, wrist_track
from mimic.robot.reach import Reach
from mimic.sources.video.depth import with_depth

STILL = RetargetSettings(keep_peaks=False)
SIDES = {"L": "left", "R": "right"}


def true_track(path: Path, like: PoseTrack) -> PoseTrack:
    """Return the truth as a pose track, at the times of another."""
    stored = np.load(path)
    landmarks = np.full((len(like.t), 33, 3), np.nan)
    valid = np.zeros((len(like.t), 33), dtype=bool)
    for i, name in enumerate(stored["names"]):
        if name[-1] in SIDES:
            column = LANDMARKS.index(f"{SIDES[name[-1]]}_{name[:-1]}")
            valid[:, column] = True
            for axis in range(3):
                landmarks[:, column, axis] = np.interp(like.t, stored["t"], stored["joints"][:, i, axis])
    return replace(like, landmarks=landmarks, valid=valid, score=valid.astype(float), shot=np.zeros(len(like.t)))


def estimated(seen: PoseTrack) -> PoseTrack:
    """Return the track with estimated depth."""
    shots = np.flatnonzero(np.diff(seen.shot) > 0) + 1
    landmarks, spread = with_depth(seen.t, seen.landmarks, seen.image, seen.score, seen.size, shots)
    return replace(seen, landmarks=landmarks, depth_spread=spread)


def forward(seen: PoseTrack, true: PoseTrack) -> tuple[float, float, float]:
    """Return correlation, gain and root mean square error [cm] of the wrists' forward motion, mean of both arms."""
    found, wanted = (wrist_track(track, STILL) for track in (seen, true))
    rows = []
    for side in range(2):
        both = found.valid[:, side] & wanted.valid[:, side]
        a, b = (track.arm_length * track.p_SH[both, side, 0] for track in (found, wanted))
        r = np.corrcoef(a, b)[0, 1]
        rows.append((r, r * a.std() / b.std(), 100 * np.sqrt(np.mean((a - b) ** 2))))
    return tuple(np.mean(rows, axis=0))


def targets_apart(seen: PoseTrack, true: PoseTrack, reach: Reach) -> float:
    """Return how far the toe targets are from those of the truth, mean [cm]."""
    one, other = (target_track(wrist_track(track, STILL), reach, STILL) for track in (seen, true))
    return 100 * float(np.linalg.norm(one.p_BE - other.p_BE, axis=-1)[one.valid & other.valid].mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("videos", nargs="+", type=Path)
    options = parser.parse_args()
    reach = Reach()
    print("| clip | true heading, off | detector alone: r, gain, RMSE, targets apart | with depth |\n|---|---|---|---|")
    means = []
    for path in options.videos:
        cells, figures = [], []
        detected = track_video(path, PoseSettings(depth=False))
        true = true_track(path.with_suffix(".npz"), detected)
        for depth in (False, True):
            seen = estimated(detected) if depth else detected
            figures.append((*forward(seen, true), targets_apart(seen, true, reach)))
            cells.append("{:.2f}, {:.2f}, {:.1f} cm, {:.1f} cm".format(*figures[-1]))
        own, off = (np.degrees(np.median(torso_heading(track))) for track in (true, detected))
        means.append(figures)
        off = (off - own + 180) % 360 - 180
        print(f"| {path.stem} | {own:.0f}°, {off:.0f}° | {cells[0]} | {cells[1]} |", flush=True)
    mean = np.mean(means, axis=0)
    cells = ["{:.2f}, {:.2f}, {:.1f} cm, {:.1f} cm".format(*row) for row in mean]
    print(f"| mean | | {cells[0]} | {cells[1]} |")


if __name__ == "__main__":
    main()
