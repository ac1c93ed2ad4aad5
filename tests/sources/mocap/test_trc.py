"""TRC files in the layouts that OpenCap and Pose2Sim write; the tests make them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mimic.cli import main
from mimic.config.pose import MocapSettings, PoseSettings
from mimic.errors import SourceError
from mimic.records import PoseTrack
from mimic.sources.mocap.load import track_mocap

ROWS = 30
_HALPE = (
    "RHip RKnee RAnkle RBigToe RSmallToe RHeel LHip LKnee LAnkle LBigToe LSmallToe LHeel Neck Head Nose RShoulder "
    "RElbow RWrist LShoulder LElbow LWrist"
)
HALPE = _HALPE.split()
"""Pose2Sim with a body model of 26 points, in its order."""
_OPENPOSE = (
    "Neck RShoulder RElbow RWrist LShoulder LElbow LWrist midHip RHip RKnee RAnkle LHip LKnee LAnkle LBigToe "
    "LSmallToe LHeel RBigToe RSmallToe RHeel"
)
OPENPOSE = _OPENPOSE.split()
"""OpenCap before its markers are added."""
_STUDY = (
    "r.ASIS L.ASIS r.PSIS L.PSIS r_knee r_mknee r_ankle r_mankle r_toe r_5meta r_calc L_knee L_mknee L_ankle "
    "L_mankle L_toe L_calc L_5meta r_shoulder L_shoulder C7 r_thigh1 r_thigh2 r_thigh3 L_thigh1 L_thigh2 L_thigh3 "
    "r_sh1 r_sh2 r_sh3 L_sh1 L_sh2 L_sh3 RHJC LHJC r_lelbow r_melbow r_lwrist r_mwrist L_lelbow L_melbow L_lwrist "
    "L_mwrist"
)
STUDY = _STUDY.split()
"""Markers that OpenCap and Pose2Sim add, each with _study behind it."""
LAYOUTS = {
    "Pose2Sim": (HALPE, "openpose"),
    "Pose2Sim with added markers": ([*HALPE, *(f"{name}_study" for name in STUDY)], "openpose"),
    "OpenCap": ([*OPENPOSE, *(f"{name}_study" for name in STUDY)], "openpose"),
    "OpenCap, added markers only": ([f"{name}_study" for name in STUDY], "opencap"),
}

HEIGHTS = {"shoulder": 1.4, "elbow": 1.1, "wrist": 0.85, "hip": 0.9, "hjc": 0.9, "asis": 0.95, "psis": 0.95}
LOW = {"knee": 0.5, "ankle": 0.1}


def place(name: str) -> tuple[float, float, float]:
    """A person who faces +x, y up, right at +z; the left forearm points forward."""
    left = name.startswith("L")
    side = -1.0 if left else 1.0
    plain = name.removesuffix("_study").lower()
    part = next((part for part in (*HEIGHTS, *LOW) if plain.endswith(part)), "")
    if part == "":
        return (0.1, 0.05 if "toe" in plain or "heel" in plain or "calc" in plain else 1.5, 0.05 * side)
    if part == "wrist" and left:
        return (0.25, 1.1, -0.2)
    return (0.0, (HEIGHTS | LOW)[part], side * (0.2 if part in ("shoulder", "elbow", "wrist") else 0.1))


def write(path: Path, names: list[str], *, unit: str = "m", end: str = "\n") -> Path:
    """Write a file as Pose2Sim does: more facts than the plain format, a tab behind the names, an empty line."""
    facts = ["DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units"]
    facts += ["OrigDataRate", "OrigDataStartFrame", "OrigNumFrames"]
    values = ["60.0", "60.0", str(ROWS), str(len(names)), unit, "60.0", "0", str(ROWS)]
    scale = {"m": 1.0, "mm": 1000.0}[unit]
    rows = [
        "\t".join([str(n + 1), f"{(n + 1) / 60:.7f}", *(f"{scale * v:.7f}" for name in names for v in place(name))])
        for n in range(ROWS)
    ]
    axes = "\t\t" + "".join(f"{axis}{n}\t" for n in range(1, len(names) + 1) for axis in "XYZ")
    head = ["PathFileType  4\t(X/Y/Z) a folder/a.trc", "\t".join(facts), "\t".join(values)]
    head += ["Frame#\tTime\t" + "".join(f"{name}\t\t\t" for name in names), axes, ""]
    path.write_text(end.join([*head, *rows]) + end, newline="")
    return path


def read(path: Path) -> PoseTrack:
    return track_mocap(path, MocapSettings(), PoseSettings())


@pytest.mark.parametrize(("unit", "end"), [("m", "\n"), ("mm", "\r\n")])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_files_of_opencap_and_pose2sim_are_read(layout, unit, end, tmp_path):
    names, scheme = LAYOUTS[layout]
    track = read(write(tmp_path / "a.trc", names, unit=unit, end=end))
    assert any(f"read as {scheme}, y up, in {unit}" in text for text in track.warnings)
    assert track.t[-1] == pytest.approx((ROWS - 1) / 60, abs=1e-6)
    left, right = (
        track.landmarks[5, track.index(f"{side}_wrist")] - track.landmarks[5, track.index(f"{side}_shoulder")]
        for side in ("left", "right")
    )
    assert np.linalg.norm(left) == pytest.approx(np.hypot(0.25, 0.3), abs=1e-6)
    assert left[1] == pytest.approx(0.3, abs=1e-6)  # down
    np.testing.assert_allclose(right, (0, 0.55, 0), atol=1e-6)
    shoulders = track.landmarks[5, track.index("left_shoulder")] - track.landmarks[5, track.index("right_shoulder")]
    forward = np.cross(shoulders, (0.0, -1.0, 0.0))
    assert left @ forward / np.linalg.norm(forward) == pytest.approx(0.25, abs=1e-6)


BAD = {
    "nothing": (lambda text: "", "line 1: not a TRC file"),
    "another file": (lambda text: "time,x\n" * 9, "line 1: not a TRC file"),
    "a unit": (lambda text: text.replace("\tm\t", "\tfurlong\t", 1), "lengths in furlong"),
    "spaces": (lambda text: text.replace("Frame#\tTime\t", "Frame# Time ", 1), "line 4: expected Frame#"),
    "no shoulder": (lambda text: text.replace("LShoulder", "LClavicle"), "no left_shoulder among the names"),
    "a word": (lambda text: text.replace("0.0166667", "soon", 1), "line 7: expected numbers separated by tabs"),
    "no rows": (lambda text: text.split("\n1\t")[0] + "\n", "has 0 rows"),
    "time stands": (lambda text: text.replace("0.0333333", "0.0166667", 1), "do not increase: row 2"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_refused_in_one_line_and_nothing_is_written(name, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    change, message = BAD[name]
    path = write(tmp_path / "a.trc", HALPE)
    path.write_text(change(path.read_text()))
    with pytest.raises(SourceError, match=message) as error:
        read(path)
    assert "\n" not in str(error.value)
    assert main(["retarget", "a.trc", "-o", "out/targets.parquet"]) == 2
    assert [found.name for found in tmp_path.rglob("*")] == ["a.trc"]


def test_joint_angles_of_opencap_are_named_and_refused(tmp_path, capsys):
    text = "Coordinates\nversion=1\nnRows=1\nnColumns=2\nendheader\ntime\tpelvis_tilt\n0\t1\n"
    (tmp_path / "walk.mot").write_text(text)
    assert main(["retarget", str(tmp_path / "walk.mot"), "-o", str(tmp_path / "t.parquet")]) == 2
    assert "export its motion as C3D or TRC" in "".join(capsys.readouterr())
    assert [found.name for found in tmp_path.iterdir()] == ["walk.mot"]
