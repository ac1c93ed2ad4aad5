"""Make the pictures of the documentation from the shipped clips and policy.

python docs/make_images.py        # needs an off-screen GL and, for the viewer, Debian's mesa-vulkan-drivers
"""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from pathlib import Path

import cv2
import numpy as np

from mimic.cli import main as mimic
from mimic.config.play import RunSettings
from mimic.config.pose import LiveSettings
from mimic.control.loop import run_policy
from mimic.control.real_time import PacedPlant
from mimic.flows.camera import follow_camera
from mimic.flows.motion import InputSettings
from mimic.io import store
from mimic.policy.runtime import load_policy
from mimic.records import PHASES, RunLog
from mimic.robot.description import load_description
from mimic.simulation.plant import SimulatedPlant
from mimic.view.film.side_by_side import RobotFilm
from mimic.view.scene.live import LiveView
from mimic.view.scene.viewer import screenshot

HERE = Path(__file__).resolve().parent
CLIPS = HERE.parent / "examples" / "videos"
MOMENTS = {"boxing": 8.9, "ballet": 8.0, "waving": 4.0}
"""Time in each clip that the picture shows [s]."""
STAND_UP = (0.0, 0.2, 0.35, 0.5, 0.65, 0.8, 1.0, 1.5)
"""Times of the stand-up that its strip shows [s]."""
SIT_DOWN = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.3, 1.8)
"""Times after the beginning of sitting down that its strip shows [s]."""

MOTIONS = {
    "step_and_wave": (0.0, 0.9, 1.8, 2.6, 3.4, 4.15),
    "ballet_in_words": (0.5, 1.3, 3.2, 4.0, 5.4, 6.6, 8.0, 8.9),
}
"""Times of the motions in words that their strips show [s]."""


def strip(log: RunLog, path: Path, begin: float, times: tuple[float, ...]) -> None:
    """Write moments of a run as a row of pictures."""
    ticks = [int(np.argmin(np.abs(log.t - begin - t))) for t in times]
    with RobotFilm(log, load_description("cyberdog2"), width=260, height=320) as film:
        pictures = [film.picture(tick) for tick in ticks]
    cv2.imwrite(str(path), cv2.cvtColor(np.hstack(pictures), cv2.COLOR_RGB2BGR))


def small(path: Path, width: int = 1200) -> None:
    """Shrink a picture and store it as JPEG beside the PNG, which is removed."""
    picture = cv2.imread(str(path))
    assert picture is not None
    scale = width / picture.shape[1]
    picture = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(path.with_suffix(".jpg")), picture, [cv2.IMWRITE_JPEG_QUALITY, 88])
    path.unlink()


def words(folder: Path, images: Path) -> None:
    """Make the strips of the motions that were asked for in words."""
    for name, times in MOTIONS.items():
        motion, run = HERE.parent / "examples" / "motions" / f"{name.removesuffix('_in_words')}.yaml", folder / name
        assert mimic([str(motion), "--sim", "--no-view", "-o", str(run)]) == 0, f"{name} failed"
        log = store.load(run / "log.parquet", RunLog)
        strip(log, images / f"{name}.png", float(log.t[np.argmax(log.phase == PHASES.index("track"))]), times)
        small(images / f"{name}.png", width=1600)


def live(folder: Path, images: Path) -> None:
    """Take a picture of the live window while a clip stands in for the camera."""
    description = load_description("cyberdog2")
    with ExitStack() as stack:
        window = stack.enter_context(LiveView(description, path=folder / "live.rrd"))
        run = RunSettings()
        how = {"view": window, "description": description, "zero": run.stand_up}
        targets, _ = stack.enter_context(
            follow_camera(str(CLIPS / "boxing.mp4"), InputSettings(), LiveSettings(), **how)
        )
        plant = PacedPlant(SimulatedPlant(description))
        run_policy(plant, load_policy(None, description), targets, run, sink=window.tick)
    screenshot(folder / "live.rrd", images / "live.png", time_s=9.0)
    small(images / "live.png")


def main() -> None:
    images = HERE / "images"
    images.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        words(Path(folder), images)
        live(Path(folder), images)
        for name, moment in MOMENTS.items():
            run = Path(folder) / name
            status = mimic([str(CLIPS / f"{name}.mp4"), "--rate", "0.1", "--sim", "--no-view", "-o", str(run)])
            assert status == 0, f"{name} ended with exit status {status}"
            screenshot(run / "scene.rrd", images / f"{name}.png", time_s=moment)
            small(images / f"{name}.png")
        log = store.load(Path(folder) / "boxing" / "log.parquet", RunLog)
        sits = float(log.t[np.argmax(log.phase == PHASES.index("sit_down"))])
        for name, begin, times in (("stand_up", 0.0, STAND_UP), ("sit_down", sits, SIT_DOWN)):
            strip(log, images / f"{name}.png", begin, times)
            small(images / f"{name}.png", width=1600)


if __name__ == "__main__":
    main()
