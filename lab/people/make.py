"""Render the example videos and their exact truth.

    python -m lab.people.make boxing            # writes boxing.mp4 and boxing.npz into examples/videos
    python -m lab.people.make boxing --sheet boxing.png
    python -m lab.people.make boxing --check    # tracks the clip and compares it with the truth

MuJoCo renders off-screen: set MUJOCO_GL to egl or osmesa on a machine without a display.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import av
import cv2
import numpy as np

from lab.people.clips import clip_of, truth
from lab.people.motions import MOTIONS, RATE_HZ
from lab.people.skeleton import SIDES, TRUTH_NAMES
from lab.people.surface import Array

if TYPE_CHECKING:
    from lab.people.film import Film

VIDEOS = Path(__file__).parents[2] / "examples" / "videos"


def write_video(path: Path, film: Film, frames: int, crf: int, progress: bool = True) -> None:
    """Write H.264 in yuv420p, indexed at the front, one frame per truth row."""
    start = time.perf_counter()
    with av.open(str(path), "w", options={"movflags": "faststart"}) as out:
        stream = out.add_stream("libx264", rate=int(RATE_HZ))
        stream.width, stream.height, stream.pix_fmt = film.width, film.height, "yuv420p"
        stream.options = {"crf": str(crf), "preset": "veryslow", "tune": "animation"}
        for i in range(frames):
            out.mux(stream.encode(av.VideoFrame.from_ndarray(film.frame(i), format="rgb24")))
            if progress and i % 30 == 29:
                sys.stderr.write(f"\r{path.name}: {i + 1}/{frames} frames, {time.perf_counter() - start:.0f} s ")
                sys.stderr.flush()
        out.mux(stream.encode())
    sys.stderr.write("\n")


def contact_sheet(film: Film, frames: list[int], columns: int) -> np.ndarray:
    """Return several frames side by side."""
    pictures = [film.frame(i) for i in frames]
    pictures += [np.zeros_like(pictures[0])] * (-len(pictures) % columns)
    return np.vstack([np.hstack(pictures[i : i + columns]) for i in range(0, len(pictures), columns)])


def check(video: Path, joints: Array) -> dict[str, float]:
    """Track a clip with BlazePose and compare the wrists, from their own shoulders, with the truth."""
    from mimic.sources.video.pose_models.blazepose import BlazePose
    from mimic.sources.video.pose_models.pose_model import pose_model

    ids = {"shoulderL": 11, "shoulderR": 12, "wristL": 15, "wristR": 16, "hipL": 23, "hipR": 24}
    rows: list[Array] = []
    capture = cv2.VideoCapture(str(video))
    with BlazePose(pose_model()) as detect:
        while True:
            got, picture = capture.read()
            if not got:
                break
            found = detect(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB))
            if found is None:
                rows.append(np.full((6, 4), np.nan))
            else:
                landmarks, _, score = found
                rows.append(np.column_stack([landmarks, score])[list(ids.values())])
    seen = np.array(rows)
    column = dict(zip(ids, range(6), strict=True))
    index = {name: TRUTH_NAMES.index(name) for name in ids}
    true_x = joints[:, index["shoulderL"], 0] - joints[:, index["shoulderR"], 0]
    seen_x = seen[:, column["shoulderL"], 0] - seen[:, column["shoulderR"], 0]
    clear = np.abs(true_x) > 0.08
    visible = np.stack([seen[:, column[f"wrist{s}"], 3] for s in SIDES])
    result = {
        "frames": float(len(seen)),
        "pose share": float(np.isfinite(seen[:, 0, 0]).mean()),
        "wrist visible share": float((visible > 0.5).mean()),
        "swapped frames": float((np.sign(true_x) != np.sign(seen_x))[clear].sum()),
    }
    ok = np.isfinite(seen[:, 0, 0])
    for side in SIDES:
        a = seen[ok][:, column[f"wrist{side}"], :3] - seen[ok][:, column[f"shoulder{side}"], :3]
        b = (joints[:, index[f"wrist{side}"]] - joints[:, index[f"shoulder{side}"]])[: len(seen)][ok]
        for axis, label in enumerate(("left-right", "up", "depth")):
            result[f"{side} {label} r"] = float(np.corrcoef(a[:, axis], b[:, axis])[0, 1])
            result[f"{side} {label} gain"] = float(np.polyfit(b[:, axis], a[:, axis], 1)[0])
            result[f"{side} {label} range of truth [m]"] = float(np.ptp(b[:, axis]))
    return result


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Render the example videos and their truth.")
    parser.add_argument("names", nargs="*", default=list(MOTIONS), metavar="NAME", help=", ".join(MOTIONS))
    parser.add_argument("--sheet", type=Path, help="only write a contact sheet of a few frames to this PNG")
    parser.add_argument("--at", help="times for the sheet [s], separated by commas")
    parser.add_argument("--passes", type=int, default=4, help="pictures averaged to one frame")
    parser.add_argument("--out", type=Path, default=VIDEOS, help="folder to write to")
    parser.add_argument("--truth", action="store_true", help="only write the truth")
    parser.add_argument("--check", action="store_true", help="only compare BlazePose with the truth")
    args = parser.parse_args()
    if sys.platform.startswith("linux") and "DISPLAY" not in os.environ:
        os.environ.setdefault("MUJOCO_GL", "egl")
    for name in args.names:
        if name not in MOTIONS:
            parser.error(f"no clip {name!r}; there are {', '.join(MOTIONS)}")
        motion, clip = MOTIONS[name](), clip_of(name)
        video = args.out / f"{name}.mp4"
        joints = truth(motion, clip)
        if args.check:
            print(name)
            for label, value in check(video, joints).items():
                print(f"  {label:36s} {value:8.3f}")
        elif args.sheet:
            from lab.people.film import Film

            n = len(motion.t)
            times = [float(v) for v in args.at.split(",")] if args.at else list(motion.t[:: max(1, n // 12)][:12])
            sheet = contact_sheet(Film(motion, clip, args.passes), [round(v * RATE_HZ) for v in times], 3)
            cv2.imwrite(str(args.sheet), sheet[:, :, ::-1])
        else:
            np.savez_compressed(video.with_suffix(".npz"), t=motion.t, names=np.array(TRUTH_NAMES), joints=joints)
            if not args.truth:
                from lab.people.film import Film

                write_video(video, Film(motion, clip, args.passes), len(motion.t), clip.crf)
                print(f"{video.name}: {len(motion.t)} frames, {video.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
