"""The renderer of the example clips."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

VIDEOS = Path(__file__).parents[2] / "examples" / "videos"


def test_what_goes_before_the_landmark_model_is_made_again() -> None:
    pytest.importorskip("mediapipe")
    from lab.people.pose_head import MEAN, STD, with_normalisation
    from mimic.sources.video.pose_models.pose_model import LANDMARKS, pose_model

    head = (VIDEOS.parents[1] / "assets" / "pose" / "landmarks.head").read_bytes()
    with zipfile.ZipFile(pose_model()) as archive:
        whole = archive.read(LANDMARKS)
    assert with_normalisation(whole[len(head) :], MEAN, STD) == whole


@pytest.mark.parametrize("name", ["boxing", "ballet", "waving"])
def test_the_script_makes_the_same_truth_again(name: str, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "lab.people.make", name, "--truth", "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    if "mujoco" in done.stderr and ("GL" in done.stderr or "No module" in done.stderr):
        pytest.skip(f"MuJoCo does not load here: {done.stderr.strip().splitlines()[-1]}")
    assert done.returncode == 0, done.stderr
    with np.load(tmp_path / f"{name}.npz") as again, np.load(VIDEOS / f"{name}.npz") as truth:
        np.testing.assert_allclose(again["joints"], truth["joints"], atol=1e-9)
        np.testing.assert_array_equal(again["t"], truth["t"])


def test_one_frame_renders_with_a_person_in_it(tmp_path: Path) -> None:
    sheet = tmp_path / "one.png"
    command = [sys.executable, "-m", "lab.people.make", "waving", "--sheet", str(sheet), "--at", "0", "--passes", "1"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    if done.returncode != 0:
        pytest.skip(f"no off-screen rendering here: {(done.stderr.strip().splitlines() or ['no message'])[-1]}")
    cv2 = pytest.importorskip("cv2")
    picture = cv2.imread(str(sheet)).astype(float)
    shirt = picture[150:220, 300:340].mean(axis=(0, 1))
    assert shirt[1] > 1.3 * shirt[2], "the green shirt is in the middle of the picture"
