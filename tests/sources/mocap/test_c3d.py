"""C3D files as ezc3d itself writes them, and marker names of OpenCap."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from mimic.config.pose import MocapSettings, PoseSettings
from mimic.errors import MissingExtra, SourceError
from mimic.sources.mocap.load import track_mocap

# Vicon's Plug-in Gait: z up, the person looks along +y, millimetres.
MARKERS = {
    "LSHO": (-200, 0, 1400), "RSHO": (200, 0, 1400), "LELB": (-250, 0, 1120), "RELB": (250, 0, 1120),
    "LWRA": (-260, 230, 1100), "LWRB": (-260, 230, 1060), "RWRA": (250, 0, 860), "RWRB": (250, 0, 840),
    "LASI": (-120, 90, 950), "RASI": (120, 90, 950), "LPSI": (-60, -100, 960), "RPSI": (60, -100, 960),
    "LKNE": (-120, 0, 500), "RKNE": (120, 0, 500), "LANK": (-120, -20, 90), "RANK": (120, -20, 90),
    "LTOE": (-120, 150, 40), "RTOE": (120, 150, 40),
}  # fmt: skip
ROWS = 50


def write(path: Path, *, units: str = "mm", names: list[str] | None = None, people: int = 1) -> Path:
    ezc3d = pytest.importorskip("ezc3d", reason="writes the file; needs the extra 'c3d'")
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["UNITS"]["value"] = [units]
    file["parameters"]["POINT"]["RATE"]["value"] = [100]
    people_names = [f"P{n + 1}:{name}" for n in range(people) for name in MARKERS]
    file["parameters"]["POINT"]["LABELS"]["value"] = names or (list(MARKERS) if people == 1 else people_names)
    points = np.ones((4, len(MARKERS), ROWS))
    points[:3] = np.array(list(MARKERS.values()), dtype=float).T[:, :, None]
    points[2, list(MARKERS).index("LWRA"), :] += 100.0 * np.linspace(0, 1, ROWS)
    points[:3, list(MARKERS).index("RELB"), 10:20] = np.nan
    apart = np.array([0.0, 1500.0, 0.0, 0.0])[:, None, None]
    file["data"]["points"] = np.concatenate([points + n * apart for n in range(people)], axis=1)
    file.write(str(path))
    return path


def test_markers_of_a_c3d_file_become_a_person_in_metres(tmp_path):
    track = track_mocap(write(tmp_path / "walk.c3d"), MocapSettings(), PoseSettings())
    assert track.t[-1] == pytest.approx((ROWS - 1) / 100)
    arm = track.landmarks[0, track.index("left_wrist")] - track.landmarks[0, track.index("left_shoulder")]
    assert np.linalg.norm(arm) == pytest.approx(np.hypot(np.hypot(0.06, 0.23), 0.32), abs=0.003)
    assert arm[1] == pytest.approx(0.32, abs=0.003)  # down
    assert not track.valid[10:20, track.index("right_elbow")].any()
    assert any("read as plug-in gait, z up, in mm" in text for text in track.warnings)


def test_several_people_are_said_and_one_can_be_chosen(tmp_path):
    path = write(tmp_path / "pair.c3d", people=2)
    one, two = (track_mocap(path, MocapSettings(), PoseSettings(person=person)) for person in (None, 2))
    assert any("2 people are in the file; number 1" in text for text in one.warnings)
    assert any("number 2" in text for text in two.warnings)
    np.testing.assert_allclose(one.landmarks, two.landmarks, atol=1e-4)


def test_without_ezc3d_the_extra_is_named(tmp_path, monkeypatch):
    path = write(tmp_path / "walk.c3d")
    monkeypatch.setitem(sys.modules, "ezc3d", None)
    with pytest.raises(MissingExtra, match="which is not installed: pip install 'ezc3d"):
        track_mocap(path, MocapSettings(), PoseSettings())


@pytest.mark.parametrize("data", [b"", b"hello" * 200, b"\x02\x50" + bytes(510), b"\x02\x50" + b"\xff" * 2000])
def test_what_is_no_c3d_is_refused_in_one_line(data, tmp_path):
    pytest.importorskip("ezc3d", reason="needs the extra 'c3d'")
    (tmp_path / "a.c3d").write_bytes(data)
    with pytest.raises(SourceError, match=r"C3D|labels|frame rate") as error:
        track_mocap(tmp_path / "a.c3d", MocapSettings(), PoseSettings())
    assert "\n" not in str(error.value)


def test_markers_of_opencap_are_known(tmp_path):
    places = {
        "r_shoulder_study": (0.2, 1.4, 0.0), "L_shoulder_study": (-0.2, 1.4, 0.0),
        "r_lelbow_study": (0.3, 1.1, 0.0), "r_melbow_study": (0.24, 1.1, 0.0),
        "L_lelbow_study": (-0.3, 1.1, 0.0), "L_melbow_study": (-0.24, 1.1, 0.0),
        "r_lwrist_study": (0.3, 0.85, 0.0), "r_mwrist_study": (0.24, 0.85, 0.0),
        "L_lwrist_study": (-0.3, 1.1, 0.25), "L_mwrist_study": (-0.24, 1.1, 0.25),
        "RHJC_study": (0.09, 0.9, 0.0), "LHJC_study": (-0.09, 0.9, 0.0),
    }  # fmt: skip
    head = "\t".join(["Frame#", "Time", *(cell for name in places for cell in (name, "", ""))])
    axes = "\t".join(["", "", *(f"{axis}{n}" for n in range(1, len(places) + 1) for axis in "XYZ")])
    rows = [
        "\t".join([str(n + 1), f"{n / 60:.4f}", *(f"{v:.4f}" for place in places.values() for v in place)])
        for n in range(30)
    ]
    facts = "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n60\t60\t30\t12\tm"
    text = "\n".join(["PathFileType\t4\t(X/Y/Z)\ta.trc", facts, head, axes, "", *rows])
    (tmp_path / "a.trc").write_text(text)
    track = track_mocap(tmp_path / "a.trc", MocapSettings(), PoseSettings())
    assert any("read as opencap, y up, in m" in text for text in track.warnings)
    arm = track.landmarks[5, track.index("left_wrist")] - track.landmarks[5, track.index("left_shoulder")]
    np.testing.assert_allclose(np.abs(arm[1]), 0.3, atol=1e-6)
