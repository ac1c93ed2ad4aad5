"""Make the pictures of the documentation from the shipped clips and policy.

python docs/make_images.py        # needs an off-screen GL and, for the viewer, Debian's mesa-vulkan-drivers
"""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from pathlib import Path

import cv2
import numpy as np
from viewer_screenshot import screenshot

from mimic.cli import main as mimic
from mimic.config.play import RunSettings
from mimic.config.pose import LiveSettings
from mimic.control.loop import run_policy
from mimic.control.real_time import PacedPlant
from mimic.dynamics.effect_set import EffectSet, read_effects
from mimic.dynamics.machine import hung_robot
from mimic.flows.motions.camera import follow_camera
from mimic.flows.motions.motion import InputSettings
from mimic.io import store
from mimic.io.joint_log import read_log
from mimic.metrics import toe_error
from mimic.policy.runtime import load_policy
from mimic.records import JOINTS, PHASES, PoseTrack, RunLog, TargetTrack
from mimic.robot.description import load_description
from mimic.simulation.plant import SimulatedPlant
from mimic.sysid.predict import predict
from mimic.view.film.footage import read_frames
from mimic.view.film.side_by_side import RobotFilm, save_video
from mimic.view.scene.live import LiveView

HERE = Path(__file__).resolve().parent
CLIPS = HERE.parent / "examples" / "videos"
SIT_DOWN = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.3, 1.8)
"""Times after the beginning of sitting down that its strip shows [s]."""

MOTIONS = {
    "step_and_wave": (0.0, 0.9, 1.8, 2.6, 3.4, 4.15),
    "ballet_in_words": (0.5, 1.3, 3.2, 4.0, 5.4, 6.6, 8.0, 8.9),
    "boxing_in_words": (0.8, 1.15, 1.85, 2.55, 2.9, 3.6, 3.95),
}
"""Times of the motions in words that their strips show [s]."""
WORST = (29.0, 32.0)
"""Part of the log that the figure of the loop shows [s]."""
BOXING = (0.5, 2.3, 4.1, 5.9, 7.7, 9.5, 11.3)
"""Times of the clip that the strip of the loop shows [s]."""
FILM_HZ = 10
"""Pictures a second of the film of two robots."""


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


def loop(folder: Path, images: Path) -> None:
    """Close the loop of docs/manual/calibration.md: figures, and a strip of the corrected run."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    hidden, found = HERE.parent / "examples" / "hidden.toml", folder / "calibration" / "effects.toml"
    probe, clip = folder / "probe.parquet", str(CLIPS / "boxing.mp4")
    models = {"as given": [], "real robot": ["--effects", str(hidden)], "corrected": ["--effects", str(found)]}
    commands = {
        probe: ["log", "simulate", *models["real robot"], "--seconds", "40", "--timestep", "0.0001"],
        folder / "calibration": ["calibrate", str(probe)],
    } | {folder / name: [clip, "--rate", "0.1", "--sim", "--no-view", *more] for name, more in models.items()}
    for out, words in commands.items():
        if not out.exists():
            assert mimic([*words, "-o", str(out)]) == 0, f"{words} failed"
    log = read_log(probe)
    machine = hung_robot(load_description("cyberdog2"))
    left = {
        name: predict(log, machine, effects)[:, JOINTS.index("FL_knee")] * 1e3
        for name, effects in (("as given", EffectSet(())), ("corrected", read_effects(found)))
    }
    runs = {name: store.load(folder / name / "log.parquet", RunLog) for name in models}
    figure, (over_time, toes) = plt.subplots(1, 2, figsize=(11, 3.4), width_ratios=(3, 2), constrained_layout=True)
    rows, colours = (log.t > WORST[0]) & (log.t < WORST[1]), {"as given": "#e07b1f", "real robot": "#888888"}
    for name, residual in left.items():
        over_time.plot(log.t[rows], residual[rows], color=colours.get(name, "#1f5fa8"), label=name)
    over_time.set(xlabel="time [s]", ylabel="measured - predicted [mrad]", title="FL knee in the log")
    for i, (name, run) in enumerate(runs.items()):
        error = 100 * toe_error(run)
        values = [error.mean(), np.quantile(error, 0.95)]
        toes.bar(np.arange(2) + 0.27 * (i - 1), values, 0.25, color=colours.get(name, "#1f5fa8"), label=name)
    toes.set(xticks=range(2), xticklabels=["mean", "95th percentile"], ylabel="[cm]", title="Toe error while boxing")
    for axes in (over_time, toes):
        axes.legend(frameon=False)
    figure.savefig(images / "loop.png", dpi=90)
    corrected = runs["corrected"]
    begin = float(corrected.t[np.argmax(corrected.phase == PHASES.index("track"))])
    strip(corrected, images / "loop_run.png", begin, BOXING)
    small(images / "loop_run.png", width=1600)


def two_robots(folder: Path, images: Path) -> None:
    """Film a person, a CyberDog 2 and a Go2 side by side, as an animated picture."""
    clip, films = CLIPS / "boxing.mp4", []
    for name in ("cyberdog2", "go2"):
        run, film = folder / name, folder / f"{name}.mp4"
        if not film.exists():
            words = [str(clip), "--rate", "0.1", "--sim", "--no-view", "--robot-model", name, "-o", str(run)]
            assert mimic(words) == 0, f"{name} failed"
            pose, targets = (
                store.load(run / f, kind) for f, kind in (("pose.parquet", PoseTrack), ("targets.parquet", TargetTrack))
            )
            log, description = store.load(run / "log.parquet", RunLog), load_description(name)
            save_video(
                film, log=log, description=description, targets=targets, pose=pose, video=clip, fps=FILM_HZ, height=300
            )
        films.append([picture for _, picture in read_frames(film)])
    beside = [np.hstack([one, other[:, -other.shape[0] :]]) for one, other in zip(*films, strict=False)]
    animation = cv2.Animation()
    animation.frames = [cv2.cvtColor(p, cv2.COLOR_RGB2BGR) for p in beside[FILM_HZ // 5 : 10 * FILM_HZ]]
    animation.durations = np.full(len(animation.frames), 1000 // FILM_HZ, np.int32)
    assert cv2.imwriteanimation(str(images / "boxing.webp"), animation, [cv2.IMWRITE_WEBP_QUALITY, 25])


def main() -> None:
    images = HERE / "images"
    images.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        words(Path(folder), images)
        loop(Path(folder), images)
        live(Path(folder), images)
        two_robots(Path(folder) / "two", images)
        log = store.load(Path(folder) / "as given" / "log.parquet", RunLog)
        strip(log, images / "sit_down.png", float(log.t[np.argmax(log.phase == PHASES.index("sit_down"))]), SIT_DOWN)
        small(images / "sit_down.png", width=1600)


if __name__ == "__main__":
    main()
