"""A short clip in place of a camera, all the way through the command line in real time."""

from __future__ import annotations

import itertools
import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from mimic.cli import main
from mimic.io import store
from mimic.records import PHASES, CommandTrack, LiveTrack, PoseTrack, RunLog
from mimic.view.film.footage import encode_h264, read_frames

pytestmark = pytest.mark.slow

TESTS = Path(__file__).parents[2]
SHORT = ["--config", str(TESTS / "short.toml")]
WAVING = Path(__file__).parents[3] / "examples" / "videos" / "waving.mp4"


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """The run folder of two seconds of waving."""
    folder = tmp_path_factory.mktemp("camera")
    frames = itertools.islice(read_frames(WAVING), 60)
    encode_h264(frames, folder / "short.mp4", fps=Fraction(30))
    quick = ["--config", str(TESTS / "quick.toml")]
    assert main(["--camera", str(folder / "short.mp4"), "--sim", "--no-view", "-o", str(folder / "run"), *quick]) == 0
    return folder / "run"


def test_it_leaves_the_files_of_a_run_and_the_latency_of_every_frame(run):
    names = {
        "log.parquet",
        "health.parquet",
        "joints.parquet",
        "metrics.json",
        "scene.rrd",
        "live.parquet",
        "pose.parquet",
    }
    assert {path.name for path in run.iterdir()} == {*names, "commands.parquet"}
    track = store.load(run / "live.parquet", LiveTrack)
    live = json.loads((run / "metrics.json").read_text())["live"]
    assert live["frames"] == len(track.t)
    assert len(track.t) + track.skipped.sum() <= 60
    assert (track.latency >= track.detector).all()
    assert live["latency_ms"]["p50"] == pytest.approx(1e3 * np.median(track.latency))
    assert np.all(np.diff(track.t) > 0)


def test_the_robot_tracked_for_as_long_as_the_clip_and_sat_down(run):
    log = store.load(run / "log.parquet", RunLog)
    tracked = (log.phase == PHASES.index("track")).sum() * 0.02
    assert 0.2 < tracked < 30.0
    assert log.phase[-1] == PHASES.index("sit_down")
    assert np.isfinite(log.p_BE_des[log.phase != PHASES.index("lie")]).all()


def test_what_was_asked_can_be_played_again(run, tmp_path):
    asked = store.load(run / "commands.parquet", CommandTrack)
    assert len(asked.t) > 5
    assert store.load(run / "pose.parquet", PoseTrack).valid.any()
    command = [str(run / "commands.parquet"), "--sim", "--no-view", *SHORT, "-o", str(tmp_path / "again")]
    assert main(command) == 0


def test_it_says_what_a_run_of_a_file_says(run, capsys):
    from mimic.cli.terminal.console import ConsoleReporter
    from mimic.flows.motions.camera import CameraRecord

    CameraRecord().report(store.load(run / "pose.parquet", PoseTrack), ConsoleReporter())
    said = capsys.readouterr()
    assert "The camera is in front of the person" in said.out + said.err
