"""How well squats and bows are seen: rendered people with exact truth, two bodies from three sides.

    python -m lab.people.crouches OUT     # renders into the folder OUT what is not there yet, tracks it and compares

A person stands, squats, stands and bows. What the robot's trunk is asked for by the video is compared
with what it would be asked for by the truth.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import mimic
from lab.people.clips import Clip, clip_of, truth
from lab.people.film import Film
from lab.people.make import write_video
from lab.people.motions import DEG, RATE_HZ, curve
from lab.people.skeleton import SIDES, SIGN, TRUTH_NAMES, Motion
from lab.people.surface import Array
from mimic.records import LANDMARKS, PoseTrack
from mimic.retargeting.trunk import trunk_goals
from mimic.retargeting.wrists import wrist_track

BODIES = ("waving", "ballet")
YAWS = (5, -40, 75)
"""Direction of the camera from where the person looks [deg]."""

SECONDS = 8.0

PARTS = {"shoulder": "shoulder", "wrist": "wrist", "elbow": "elbow", "hip": "hip", "knee": "knee", "ankle": "ankle"}
"""Part in LANDMARKS and in TRUTH_NAMES."""


def exercise() -> Motion:
    """Return a squat and a bow, with hands before the body."""
    t = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)

    def made(*keys: tuple[float, float]) -> Array:
        return curve([(at, np.array([value])) for at, value in keys], SECONDS, round_s=0.2)[: len(t), 0]

    squat = made((0, 0), (1, 0), (2, 1), (2.8, 1), (3.9, 0), (8, 0))
    bow = made((0, 0), (4.6, 0), (5.6, 1), (6.4, 1), (7.4, 0), (8, 0))
    zero = np.zeros_like(t)
    lean = 28 * DEG * squat + 38 * DEG * bow
    pelvis = np.stack([-0.17 * squat - 0.12 * bow, zero, -0.42 * squat - 0.01 * bow], axis=-1)
    wrist = {}
    elbow = {}
    for side in SIDES:
        ahead = 0.25 + 0.45 * squat
        wrist[side] = np.stack([ahead, zero + 0.1 * SIGN[side], -np.sqrt(0.85 - ahead**2)], axis=-1)
        elbow[side] = np.tile([-0.6, 0.5 * SIGN[side], -0.6], (len(t), 1))
    palm = {side: np.tile([0.0, -SIGN[side], 0.0], (len(t), 1)) for side in SIDES}
    fingers = {side: np.tile([0.7, 0.0, -0.7], (len(t), 1)) for side in SIDES}
    return Motion(
        t=t,
        pelvis=pelvis,
        pelvis_ypr=np.stack([zero, 0.7 * lean, zero], axis=-1),
        chest_ypr=np.stack([zero, lean, zero], axis=-1),
        head_ypr=np.stack([zero, 0.5 * lean, zero], axis=-1),
        wrist=wrist,
        elbow=elbow,
        palm=palm,
        fingers=fingers,
        foot={"L": (0.0, 0.13, 0.25), "R": (0.0, -0.13, -0.25)},
    )


def true_track(joints: Array, t: Array) -> PoseTrack:
    """Return the truth (n, 13, 3) as a track."""
    landmarks = np.full((len(t), len(LANDMARKS), 3), np.nan)
    middle = joints[:, [TRUTH_NAMES.index(f"hip{side}") for side in SIDES]].mean(axis=1)
    for part, own in PARTS.items():
        for side, letter in (("left", "L"), ("right", "R")):
            column = LANDMARKS.index(f"{side}_{part}")
            landmarks[:, column] = joints[:, TRUTH_NAMES.index(f"{own}{letter}")] - middle
    valid = np.isfinite(landmarks).all(axis=-1)
    return PoseTrack(
        t=t,
        landmarks=landmarks,
        image=np.full((*valid.shape, 2), np.nan),
        score=valid.astype(float),
        valid=valid,
        swapped=np.zeros(len(t), dtype=bool),
    )


def compare(video: Path, motion: Motion, clip: Clip) -> str:
    """Return a row: r and mean error of height [cm] and pitch [deg] of the robot's trunk."""
    description = mimic.load_robot("cyberdog2")
    seen = wrist_track(mimic.track_video(video))
    true = wrist_track(true_track(truth(motion, clip), motion.t))
    asked = trunk_goals(seen.trunk, description)
    at = np.searchsorted(motion.t, seen.t).clip(0, len(motion.t) - 1)
    right = trunk_goals(true.trunk, description)[at]
    cells = []
    for column, unit in enumerate((100.0, 1 / DEG)):
        off = unit * np.abs(asked[:, column] - right[:, column])
        r = np.corrcoef(asked[:, column], right[:, column])[0, 1] if np.ptp(asked[:, column]) > 0 else np.nan
        cells.append(f"{r:.2f} | {off.mean():.1f}, {np.quantile(off, 0.95):.1f}")
    return f"| {video.stem} | " + " | ".join(cells) + " |"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Compare squats and bows in rendered videos with their truth.")
    parser.add_argument("out", type=Path, help="folder for the videos")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    motion = exercise()
    print("| clip | height r | mean, 95 % [cm] | pitch r | mean, 95 % [deg] |\n|---|---|---|---|---|", flush=True)
    for body in BODIES:
        for yaw in YAWS:
            clip = replace(clip_of(body), camera_yaw=np.deg2rad(yaw), aim=0.85, distance=5.2)
            video = args.out / f"{body}{yaw:+d}.mp4"
            if not video.exists():
                film = Film(motion, clip, 1)
                write_video(video, film, len(motion.t), clip.crf, progress=False)
            print(compare(video, motion, clip), flush=True)


if __name__ == "__main__":
    main()
