"""How well the depth of the arms is known: clips with truth, with the detector's depth and the estimated one.

    python -m lab.people.depth VIDEO [...] [VIEWS ...]

Beside each VIDEO.mp4 lies VIDEO.npz with `t`, `names` and `joints` in camera axes (examples/videos, or what
lab/people/depth_clips.py --video wrote). VIEWS is a folder of views of one real person by calibrated cameras: videos,
Calib.qca.txt and triangulated_blazepose.npz, or cam_N.mp4, camera_array.toml of caliscope and ch_truth.npz. Toe targets
are compared with those of the truth, and what is declared of the wrists' depth with its error, in fifths of the frames
from the surest. What was detected is kept: another method of
estimating depth is judged without the detector. Each pair of VIEWS is also judged as two videos of one person
(``mimic VIDEO --also OTHER``).
"""

from __future__ import annotations

import argparse
import tomllib
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from mimic.config.pose import PoseSettings
from mimic.config.retarget import RetargetSettings
from mimic.flows.motions.motion import track_video
from mimic.records import LANDMARKS, SHOULDERS, WRISTS, PoseTrack
from mimic.retargeting.targets import target_track
from mimic.retargeting.wrists import torso_heading, wrist_track
from mimic.robot.description import load_description
from mimic.robot.reach import Reach
from mimic.sources.video.depth import with_depth
from mimic.sources.video.heading import with_heading
from mimic.sources.video.two_views import merge_views

STILL = RetargetSettings()
SIDES = {"L": "left", "R": "right"}


def true_track(path: Path, like: PoseTrack) -> PoseTrack:
    """Return the truth of a clip as a pose track, at the times of another."""
    if is_view(path):
        return _as_track(_seen_by(path), like)
    stored = np.load(path.with_suffix(".npz"))
    landmarks = np.full((len(like.t), 33, 3), np.nan)
    for i, name in enumerate(stored["names"]):
        if name[-1] in SIDES:
            column = LANDMARKS.index(f"{SIDES[name[-1]]}_{name[:-1]}")
            for axis in range(3):
                landmarks[:, column, axis] = np.interp(like.t, stored["t"], stored["joints"][:, i, axis])
    return _as_track(landmarks, like)


def is_view(path: Path) -> bool:
    """Return whether a clip is one of several by calibrated cameras."""
    return any(path.parent.joinpath(name).is_file() for name in ("Calib.qca.txt", "camera_array.toml"))


def _as_track(landmarks: np.ndarray, like: PoseTrack) -> PoseTrack:
    valid = np.isfinite(landmarks).all(axis=-1)
    return replace(
        like, landmarks=landmarks, valid=valid, score=valid.astype(float), shot=np.zeros(len(like.t)), size=(0, 0)
    )


def _seen_by(view: Path) -> np.ndarray:
    """Return the triangulated points (T, 33, 3) in the axes of one of the cameras [m]."""
    if (calibration := view.parent / "camera_array.toml").is_file():
        turn = tomllib.loads(calibration.read_text())["cameras"][view.stem.removeprefix("cam_")]["rotation"]
        return np.load(view.parent / "ch_truth.npz")["xyz"] @ np.array(turn).T
    cameras = ElementTree.parse(view.parent / "Calib.qca.txt").iter("camera")
    turn = next(camera for camera in cameras if camera.get("serial") == view.stem).find("transform")
    assert turn is not None
    axes = np.array([[float(turn.get(f"r{i}{j}", "nan")) for j in (1, 2, 3)] for i in (1, 2, 3)])
    axes = np.diag([1.0, -1.0, -1.0]) @ axes  # the calibration's camera looks along -z with y up
    return np.load(view.parent / "triangulated_blazepose.npz")["xyz"] @ axes.T


def estimated(seen: PoseTrack) -> PoseTrack:
    """Return the track with estimated depth."""
    return with_heading(with_depth(seen))


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


def played_apart(seen: PoseTrack, true: PoseTrack, reach: Reach) -> float:
    """Return the same at all times at which the truth is known: an arm that is not shown counts as it is played."""
    one, other = (target_track(wrist_track(track, STILL), reach, STILL) for track in (seen, true))
    return 100 * float(np.linalg.norm(one.p_BE - other.p_BE, axis=-1)[other.valid].mean())


def depth_errors(seen: PoseTrack, true: PoseTrack) -> tuple[np.ndarray, np.ndarray]:
    """Return what is declared of each wrist's depth from its shoulder and its error (N,) [cm]."""
    declared = seen.depth_spread
    error = np.subtract(*(track.landmarks[:, WRISTS, 2] - track.landmarks[:, SHOULDERS, 2] for track in (seen, true)))
    known = seen.valid[:, WRISTS] & np.isfinite(declared) & np.isfinite(error)
    return 100 * declared[known], 100 * error[known]


def rms_of_fifths(rows: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Return root mean squares (2, 5) of what is declared and of the error, in fifths of the frames."""
    both = np.concatenate(rows, axis=1)
    parts = np.array_split(np.argsort(both[0]), 5)
    return np.sqrt(np.stack([(both[:, part] ** 2).mean(axis=1) for part in parts], axis=1))


def fifths(rows: list[tuple[np.ndarray, np.ndarray]]) -> str:
    """Return the same as cells of a table."""
    return " | ".join(f"{said:.1f}, {true:.1f}" for said, true in rms_of_fifths(rows).T)


def two_views(views: dict[str, tuple[PoseTrack, PoseTrack]], reach: Reach) -> None:
    """Print how far the toe targets of each view are off by itself and with each other view, and what is declared.

    Args:
        views: What was seen and the truth, by name.
        reach: Of the robot.
    """
    print("\n| view | alone |", *(f"and {name} |" for name in views))
    print("|---" * (len(views) + 2) + "|")
    errors = []
    for name, (seen, true) in views.items():
        cells = [f"{played_apart(seen, true, reach):.1f} cm"]
        for other, (second, _) in views.items():
            if other == name:
                cells.append("")
                continue
            merged, fit = merge_views(seen, second, (name, other))
            used = not np.array_equal(merged.landmarks, seen.landmarks, equal_nan=True)
            cells.append(f"{played_apart(merged, true, reach):.1f} cm, {fit.angle_deg:.0f}°" if used else "not used")
            if used:
                errors.append(depth_errors(merged, true))
        print(f"| {name} | {' | '.join(cells)} |", flush=True)
    print(f"\ndeclared, true depth error [cm] | {fifths(errors)} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("clips", nargs="+", type=Path)
    options = parser.parse_args()
    settings = PoseSettings(depth=False)
    reach = Reach(load_description("cyberdog2"))
    print("| clip | true heading, off | detector alone: r, gain, RMSE, targets apart | with depth |\n|---|---|---|---|")
    figures, errors, views = {"people": [], "rendered": []}, {"people": [], "rendered": []}, {}
    for path in [clip for given in options.clips for clip in (sorted(given.glob("*.mp4")) or [given])]:
        kind = "people" if is_view(path) else "rendered"
        detected = track_video(path, settings)
        true = true_track(path, detected)
        seen = estimated(detected)
        figures[kind].append([(*forward(track, true), targets_apart(track, true, reach)) for track in (detected, seen)])
        errors[kind].append(depth_errors(seen, true))
        if kind == "people":
            views[path.stem] = (seen, true)
        own, off = (np.degrees(np.median(torso_heading(track))) for track in (true, seen))
        print(
            f"| {path.stem} | {own:.0f}°, {(off - own + 180) % 360 - 180:.0f}° {_cells(figures[kind][-1])}", flush=True
        )
    for kind, rows in figures.items():
        if rows:
            print(f"| {kind}, mean | {_cells(np.mean(rows, axis=0))}")
    print("\n| declared, true depth error [cm] | surest fifth | | | | least sure |\n|---|---|---|---|---|---|")
    for kind, rows in errors.items():
        if rows:
            print(f"| {kind} | {fifths(rows)} |")
    if len(views) > 1:
        two_views(views, reach)


def _cells(rows: np.ndarray | list[tuple[float, ...]]) -> str:
    return "".join("| {:.2f}, {:.2f}, {:.1f} cm, {:.1f} cm ".format(*row) for row in rows) + "|"


if __name__ == "__main__":
    main()
