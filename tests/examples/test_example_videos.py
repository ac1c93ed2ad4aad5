"""The example clips that ship with the project, and the truth beside them."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest

from mimic.config.pose import MocapSettings, PoseSettings
from mimic.sources.mocap.load import track_mocap

FOLDER = Path(__file__).parents[2] / "examples" / "videos"
CLIPS = ("boxing", "ballet", "waving")
NAMES = (
    "nose", "shoulderL", "shoulderR", "elbowL", "elbowR", "wristL", "wristR",
    "hipL", "hipR", "kneeL", "kneeR", "ankleL", "ankleR",
)  # fmt: skip
LIMBS = (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))

clip = pytest.mark.parametrize("name", CLIPS)


def truth_of(name: str) -> dict[str, np.ndarray]:
    with np.load(FOLDER / f"{name}.npz") as stored:
        return dict(stored)


def joint(truth: dict[str, np.ndarray], name: str) -> np.ndarray:
    return truth["joints"][:, list(truth["names"]).index(name)]


@clip
def test_a_clip_is_smaller_than_a_megabyte(name: str) -> None:
    assert (FOLDER / f"{name}.mp4").stat().st_size < 1_000_000


@clip
def test_a_clip_decodes_to_one_frame_per_row_of_truth_at_its_time(name: str) -> None:
    t = truth_of(name)["t"]
    with av.open(str(FOLDER / f"{name}.mp4")) as video:
        stream = video.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        seen = [frame.time for frame in video.decode(stream)]
    assert len(seen) == len(t)
    np.testing.assert_allclose(seen, t, atol=1e-4)


@clip
def test_the_truth_names_the_thirteen_joints_and_has_only_finite_numbers(name: str) -> None:
    truth = truth_of(name)
    assert set(truth) == {"t", "names", "joints"}
    assert tuple(truth["names"]) == NAMES
    assert truth["joints"].shape == (len(truth["t"]), 13, 3)
    assert np.isfinite(truth["joints"]).all()
    assert (np.diff(truth["t"]) > 0).all()


@clip
@pytest.mark.parametrize("side", ["L", "R"])
def test_limbs_keep_their_length(name: str, side: str) -> None:
    truth = truth_of(name)
    for first, second in LIMBS:
        length = np.linalg.norm(joint(truth, first + side) - joint(truth, second + side), axis=1)
        assert np.ptp(length) < 1e-6, f"{first} to {second}"


@clip
def test_the_person_stands_upright_and_faces_the_camera(name: str) -> None:
    truth = truth_of(name)
    nose, ankle = joint(truth, "nose"), joint(truth, "ankleL")
    assert ((nose - ankle)[:, 1] < -1.2).all()
    assert (joint(truth, "shoulderL")[:, 0] > joint(truth, "shoulderR")[:, 0]).all()
    assert (nose[:, 2] < (joint(truth, "shoulderL") + joint(truth, "shoulderR"))[:, 2] / 2).all()


@clip
def test_the_truth_can_be_played_as_a_motion(name: str) -> None:
    track = track_mocap(FOLDER / f"{name}.npz", MocapSettings(), PoseSettings())
    truth = truth_of(name)
    assert track.valid.all()
    assert any("read as mimic, -y up, in m by the length" in text for text in track.warnings)
    arm = track.landmarks[:, track.index("left_wrist")] - track.landmarks[:, track.index("left_shoulder")]
    length = np.linalg.norm(joint(truth, "wristL") - joint(truth, "shoulderL"), axis=1)
    np.testing.assert_allclose(np.linalg.norm(arm, axis=1), length, atol=0.05)


@clip
def test_wrists_move_as_smoothly_as_a_person_does(name: str) -> None:
    truth = truth_of(name)
    fastest = {"boxing": 8.0, "ballet": 1.5, "waving": 3.0}[name]
    for side in "LR":
        speed = np.linalg.norm(np.diff(joint(truth, f"wrist{side}"), axis=0), axis=1) / np.diff(truth["t"])
        assert speed.max() < fastest
        assert speed.max() > 0.5
