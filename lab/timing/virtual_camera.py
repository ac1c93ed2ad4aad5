"""From a person's hand to the robot's toes through a camera, in virtual or wall time: how late, and how far off.

    python -m lab.timing.virtual_camera [--delay 0.025] [VIDEO ...]     # by default the shipped clips with their truth
    python -m lab.timing.virtual_camera --wall [VIDEO ...]              # the whole of `mimic --camera VIDEO --sim`

Each frame is seen at its time and gives its target a delay later, as on a quiet computer (`--wall` measures it); the
simulated robot follows tick by tick. Its toes are compared with those that the true motion beside the clip asks for, as
a robot without any delay would hold them. In wall time the clip plays in place of a camera, and the robot's clock is
the computer's while no step is late.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from lab.people.depth import true_track
from mimic.config.pose import LiveSettings, PoseSettings
from mimic.config.retarget import RetargetSettings
from mimic.flows.motions.camera import play_camera
from mimic.flows.motions.motion import track_video
from mimic.flows.play import play
from mimic.records import PHASES, Command, RunLog
from mimic.retargeting.live import LiveRetarget, LiveTarget, LiveTargets
from mimic.retargeting.targets import target_track
from mimic.retargeting.wrists import wrist_track
from mimic.robot.description import load_description
from mimic.robot.reach import Reach
from mimic.sources.video.decoding import open_video
from mimic.sources.video.depth import LiveDepth
from mimic.sources.video.left_right import LiveSides, swap_sides
from mimic.sources.video.pose_models.blazepose import BlazePose
from mimic.sources.video.pose_models.pose_model import pose_model
from mimic.sources.video.screening import person_rows

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "videos"
STEPS = RetargetSettings()
LATEST = 0.4
"""Longest delay that is tried [s]."""


def seen_live(path: Path, reach: Reach, live: LiveSettings) -> list[LiveTarget]:
    """Return the target of each frame, from the frames up to it."""
    sides, depth, retarget = LiveSides(), LiveDepth(), LiveRetarget(reach, STEPS, live)
    targets = []
    with open_video(path) as video, BlazePose(pose_model()) as detect:
        for frame in video:
            found = detect(frame.rgb)
            if found is None:
                continue
            t = frame.stamp_ms / 1e3
            swapped = np.array([sides.decide(t, found[0])])
            landmarks, image, score = (swap_sides(values[None], swapped)[0] for values in found)
            if not person_rows(score[None], PoseSettings().min_visibility)[0]:
                continue
            size = frame.rgb.shape[1], frame.rgb.shape[0]
            landmarks, _ = depth.see(t, landmarks, image, score, size)
            valid = score >= PoseSettings().min_visibility
            targets.append(retarget.see(t, landmarks, image, valid, size[0] / size[1]))
    return targets


class VirtualCamera:
    """Live commands on the clock of the control ticks."""

    def __init__(self, targets: list[LiveTarget], delay: float, reach: Reach, live: LiveSettings) -> None:
        self._waiting, self._delay, self._dt = list(targets), delay, reach.description.dt
        self._now = 0.0
        self._live = LiveTargets(reach, live, clock=lambda: self._now)

    def newest(self) -> Command | None:
        while self._waiting and self._waiting[0].t + self._delay <= self._now:
            self._live.put(self._waiting.pop(0))
        if not self._waiting:
            self._live.end()
        command = self._live.newest()
        self._now += self._dt
        return command


def in_virtual_time(path: Path, delay: float, reach: Reach) -> tuple[RunLog, float]:
    """Return the log of a run, and when its first command comes in the time of the clip [s]."""
    live = LiveSettings()
    return play(VirtualCamera(seen_live(path, reach, live), delay, reach, live)).log, 0.0


def in_wall_time(path: Path) -> tuple[RunLog, float]:
    """Return the same of a clip that plays in place of a camera."""
    with tempfile.TemporaryDirectory() as folder:
        saved, record = play_camera(str(path), out=Path(folder) / "run")
    track = record.track()
    print(f"{path.stem}: frame to target {record.summary()}; {record.overruns} steps of the robot late", flush=True)
    with open_video(path) as video:
        stamps = [frame.stamp_ms / 1e3 for frame in video]
    return saved.run.log, stamps[record.seen[0].number] - float(track.t[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("videos", nargs="*", type=Path)
    parser.add_argument("--delay", type=float, default=0.025, help="from a frame to its target [s]")
    parser.add_argument("--wall", action="store_true", help="in real time, on a quiet computer")
    options = parser.parse_args()
    reach = Reach(load_description("cyberdog2"))
    print("| clip | person to toes | toes apart then |\n|---|---|---|")
    for path in options.videos or sorted(EXAMPLES.glob("*.mp4")):
        log, began = in_wall_time(path) if options.wall else in_virtual_time(path, options.delay, reach)
        true = target_track(wrist_track(true_track(path, track_video(path)), STEPS), reach, STEPS)
        rows = (log.phase == PHASES.index("blend")) | (log.phase == PHASES.index("track"))  # it runs from the blend on
        t = log.t[rows] - log.t[rows][0] + began
        toes = log.p_BE[rows]
        apart = {lag: float(np.mean(errors(t, toes, true.t + lag, true.p_BE))) for lag in np.arange(0.0, LATEST, 0.005)}
        best = min(apart, key=lambda lag: apart[lag])
        print(f"| {path.stem} | {1e3 * best:.0f} ms | {100 * apart[best]:.1f} cm |", flush=True)


def errors(t: np.ndarray, toes: np.ndarray, when: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return how far toes (T, 2, 3) are from those wanted at other times (N, 2, 3), but for the mean of it [m].

    The first two seconds, in which the arms come up from hanging, do not count.
    """
    inside = (t > 2.0) & (t < when[-1])
    at = np.stack([np.interp(t[inside], when, column) for column in wanted.reshape(len(when), 6).T], axis=1)
    apart = toes[inside] - at.reshape(-1, 2, 3)
    return np.linalg.norm(apart - apart.mean(axis=0), axis=-1)


if __name__ == "__main__":
    main()
