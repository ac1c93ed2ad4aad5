"""Turn a video of a person into toe targets, and store them as a table.

    python examples/video_to_targets.py [VIDEO] [targets.parquet]

Play the table later with `mimic targets.parquet --sim`.
"""

import sys
from pathlib import Path

import numpy as np

import mimic
from mimic.config.retarget import RetargetSettings
from mimic.io import store

CLIP = Path(__file__).parent / "videos" / "waving.mp4"


def main(video: str | Path = CLIP, out: str | Path = "targets.parquet") -> None:
    pose = mimic.track_video(video)
    targets = mimic.retarget(pose, RetargetSettings(rate=0.2, mirror=True))

    clamped = targets.moved[targets.valid] > 0.0
    print(f"{len(pose.t)} frames, {len(targets.t)} targets, {clamped.mean():.1%} of them clamped")
    print(f"left toe, mean position from the base: {np.round(targets.p_BE[:, 0].mean(axis=0), 3)} m")
    for warning in targets.warnings:
        print("warning:", warning)
    store.save(targets, Path(out), made_by=store.provenance(command="examples/video_to_targets.py"))


if __name__ == "__main__":
    main(*sys.argv[1:])
