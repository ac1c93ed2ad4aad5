"""What no body does: files with marks, first poses, mirrored axes, matrices that turn nothing, and other units."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from mimic.config.pose import MocapSettings, PoseSettings
from mimic.errors import SourceError
from mimic.flows.motions.motion import load_motion
from mimic.records import PoseTrack
from mimic.retargeting.wrists import wrist_track
from mimic.sources.mocap.body import MIRRORED, UNTOLD
from mimic.sources.mocap.load import track_mocap
from mimic.sources.mocap.skeletons import LAYOUTS

OUTSIDE = Path(__file__).parents[3] / ".." / "shared" / "data" / "outside_2"
ROWS = 90
JOINTS = list(LAYOUTS["smpl24"][:22])


def body() -> dict[str, np.ndarray]:
    """Somebody in metres who raises bent arms; x left, y up, z forward."""
    angle = 0.8 + 0.5 * np.sin(np.linspace(0.0, 6.0, ROWS))
    still = np.zeros((ROWS, 1))
    points = {"nose": still + [0.0, 1.6, 0.1]}
    for side, x in (("left", 1.0), ("right", -1.0)):
        shoulder = still + [0.2 * x, 1.4, 0.0]
        elbow = shoulder + 0.3 * np.stack([x * np.sin(angle), -np.cos(angle), 0.0 * angle], axis=1)
        points |= {
            f"{side}_shoulder": shoulder,
            f"{side}_elbow": elbow,
            f"{side}_wrist": elbow + 0.25 * np.stack([0.0 * angle, np.sin(angle), np.cos(angle)], axis=1),
            f"{side}_hip": still + [0.1 * x, 0.9, 0.0],
            f"{side}_knee": still + [0.1 * x, 0.5, 0.03],
            f"{side}_ankle": still + [0.1 * x, 0.1, 0.0],
        }
    return points


def read(path: Path, points: dict[str, np.ndarray], *, unlike: np.ndarray | float = 1.0) -> PoseTrack:
    np.savez(path, points=unlike * np.stack(list(points.values()), axis=1), names=list(points), fps=30)
    return track_mocap(path, MocapSettings(), PoseSettings())


def outside(name: str) -> Path:
    if not OUTSIDE.is_dir():
        pytest.skip("the shared test data is not beside the repository (../shared/data)")
    return OUTSIDE / name


def apart(one: PoseTrack, other: PoseTrack, rows: slice | np.ndarray = slice(None)) -> float:
    """Largest distance of the wrists in the axes of the torso [m]."""
    wrists = [track.arm_length * track.p_SH[rows] for track in map(wrist_track, (one, other))]
    return float(np.nanmax(np.abs(wrists[0] - wrists[1])))


# ---------------------------------------------------------------------- marks


@pytest.mark.parametrize(
    ("part", "mark"),
    [
        ("left_wrist", [0.0, 0.0, 0.0]),
        ("right_wrist", [-1.0, -1.0, -1.0]),
        ("left_elbow", [9999.0, 9999.0, 9999.0]),
        ("right_shoulder", [5.0, 0.0, -3.0]),
    ],
)
def test_a_mark_is_a_gap_and_said_and_leaves_all_other_rows_as_they_are(part, mark, tmp_path):
    points = body()
    points[part][40:65] = mark
    track, whole = read(tmp_path / "a.npz", points), read(tmp_path / "b.npz", body())
    assert np.flatnonzero(~track.valid[:, track.index(part)]).tolist() == list(range(40, 65))
    assert track.valid.sum() == whole.valid.sum() - 25
    assert any("taken as not seen" in text and f"{part} in 25 rows (1.33 to 2.13 s)" in text for text in track.warnings)
    assert apart(track, whole, np.r_[:35, 70:ROWS]) < 0.005


def test_a_steady_body_has_no_marks(tmp_path):
    assert not any("not seen" in text for text in read(tmp_path / "a.npz", body()).warnings)


def test_a_wrist_stored_as_zero_is_hidden_in_a_file_of_a_user():
    track, whole = (
        track_mocap(outside(name), MocapSettings(), PoseSettings())
        for name in ("wrist_missing_zero.npz", "points_ok.npz")
    )
    assert apart(track, whole, np.r_[:38, 67:90]) < 0.005


@pytest.mark.parametrize("scale", [0.0, 1e-6, 10.0, 1e6])
def test_a_body_of_a_length_that_nobody_has_is_refused(scale, tmp_path):
    with pytest.raises(SourceError, match=r"the arms in a\.npz are .* long; expected 0.25 to 1 m"):
        read(tmp_path / "a.npz", {name: scale * xyz + [0.5, 1.0, 2.0] for name, xyz in body().items()})


# ---------------------------------------------------------------------- a pose before the motion


@pytest.mark.parametrize("rows", [1, 2])
def test_a_rest_pose_in_the_first_rows_is_left_out_and_said(rows, tmp_path):
    points = body()
    for side, x in (("left", 1.0), ("right", -1.0)):
        points[f"{side}_elbow"][:rows] = points[f"{side}_shoulder"][:rows] + [0.3 * x, 0.0, 0.0]
        points[f"{side}_wrist"][:rows] = points[f"{side}_shoulder"][:rows] + [0.55 * x, 0.0, 0.0]
    track = read(tmp_path / "a.npz", points)
    assert len(track.t) == ROWS - rows
    assert any(text.startswith(("row 1 is left out", "rows 1 to 2 are left out")) for text in track.warnings)


def test_a_motion_that_begins_at_once_keeps_its_first_row(tmp_path):
    assert len(read(tmp_path / "a.npz", body()).t) == ROWS


def test_the_rest_pose_of_a_skeleton_file_is_left_out():
    track = track_mocap(outside("rest_pose_first.bvh"), MocapSettings(), PoseSettings())
    assert any("row 1 is left out" in text for text in track.warnings)


# ---------------------------------------------------------------------- left and right


@pytest.mark.parametrize("lacking", [(), ("nose",), ("nose", "left_knee", "right_knee"), ("left_knee", "left_elbow")])
def test_left_handed_axes_are_turned_over_whatever_the_file_has_to_tell(lacking, tmp_path):
    points = {name: xyz for name, xyz in body().items() if name not in lacking}
    mirrored = read(tmp_path / "a.npz", points, unlike=np.array([-1.0, 1.0, 1.0]))
    true = read(tmp_path / "b.npz", points)
    assert MIRRORED in mirrored.warnings
    assert MIRRORED not in true.warnings
    assert apart(mirrored, true) < 0.005


def test_a_straight_body_without_a_face_does_not_tell_left_from_right(tmp_path):
    points = {name: xyz for name, xyz in body().items() if name not in ("nose", "left_knee", "right_knee")}
    for side in ("left", "right"):
        middle = points[f"{side}_shoulder"] + points[f"{side}_wrist"]
        points[f"{side}_elbow"] = middle / 2
    assert UNTOLD in read(tmp_path / "a.npz", points).warnings


def test_a_file_of_a_user_with_negated_x_is_turned_over():
    mirrored, true = (
        track_mocap(outside(name), MocapSettings(), PoseSettings())
        for name in ("left_handed_nose.npz", "points_ok.npz")
    )
    assert apart(mirrored, true) < 0.005


# ---------------------------------------------------------------------- rotations


def rotations() -> np.ndarray:
    """A T-pose whose arms hang, as axis angles (T, 22, 3)."""
    turns = np.zeros((ROWS, len(JOINTS), 3))
    turns[:, JOINTS.index("left_shoulder"), 2] = -1.2
    turns[:, JOINTS.index("right_shoulder"), 2] = 1.2 + 0.2 * np.sin(np.linspace(0, 6, ROWS))
    return turns


@pytest.mark.parametrize("wrong", [np.diag([-1.0, 1.0, 1.0]), 1.1 * np.eye(3), np.zeros((3, 3))])
def test_matrices_that_turn_nothing_are_refused_with_their_row(wrong, tmp_path):
    poses = np.tile(np.eye(3), (ROWS, len(JOINTS), 1, 1))
    poses[6, 3] = wrong
    np.savez(tmp_path / "a.npz", poses=poses, fps=30)
    with pytest.raises(SourceError, match="no rotations in row 7"):
        track_mocap(tmp_path / "a.npz", MocapSettings(), PoseSettings())


def test_mirrored_matrices_of_a_user_are_refused():
    with pytest.raises(SourceError, match="no rotations in row 1"):
        load_motion(outside("matrices_mirrored.npz"))


def test_axis_angles_in_degrees_are_refused(tmp_path):
    np.savez(tmp_path / "a.npz", poses=np.degrees(rotations()).reshape(ROWS, -1), fps=30)
    with pytest.raises(SourceError, match="expected axis angles in radians"):
        track_mocap(tmp_path / "a.npz", MocapSettings(), PoseSettings())


def soma() -> np.ndarray:
    """The same as the 77 joints of SOMA, whose documentation has LeftArm as number 12 and RightArm as number 40."""
    turns = np.zeros((ROWS, 77, 3))
    turns[:, 12] = rotations()[:, JOINTS.index("left_shoulder")]
    turns[:, 40] = rotations()[:, JOINTS.index("right_shoulder")]
    return turns


@pytest.mark.parametrize("form", ["pt", "npz"])
def test_what_gem_x_and_soma_write_moves_as_smpl_does(form, tmp_path):
    """Made from the documentation of GEM-X and SOMA; no file of theirs was tried."""
    np.savez(tmp_path / "smpl.npz", poses=rotations(), fps=30)
    true = track_mocap(tmp_path / "smpl.npz", MocapSettings(), PoseSettings())
    path = tmp_path / f"a.{form}"
    if form == "pt":
        own = {"global_orient": soma()[:, 0], "body_pose": soma()[:, 1:].reshape(ROWS, 228)}
        path = path.with_suffix(".pkl")
        path.write_bytes(pickle.dumps({"body_params_global": {**own, "transl": np.zeros((ROWS, 3))}}))
    else:
        np.savez(path, poses=soma(), joint_names=["Hips"], root_translation=np.zeros((ROWS, 3)))
    assert apart(track_mocap(path, MocapSettings(fps=30.0), PoseSettings()), true) < 1e-6


def test_what_sam_3d_body_finds_is_named_by_its_seventy_points(tmp_path):
    """Made from sam_3d_body/metadata/mhr70.py, where the wrists are 41 and 62; no file of theirs was tried."""
    points = body()
    order = [
        "nose",
        *("left_hip",) * 4,
        *(f"{s}_{p}" for p in ("shoulder", "elbow", "hip", "knee", "ankle") for s in ("left", "right")),
    ]
    seventy = np.stack([points[name] for name in order] + [points["left_hip"]] * 55, axis=1)
    seventy[:, 41], seventy[:, 62] = points["right_wrist"], points["left_wrist"]
    seventy[:, [1, 2, 3, 4]] -= [0.0, -0.7, 0.05]
    seventy[:, [15, 16, 17]] = (points["left_ankle"] + [0.0, 0.0, 0.15])[:, None]
    seventy[:, [18, 19, 20]] = (points["right_ankle"] + [0.0, 0.0, 0.15])[:, None]
    np.savez(tmp_path / "a.npz", pred_keypoints_3d=seventy * [1.0, -1.0, -1.0], fps=30)
    track = track_mocap(tmp_path / "a.npz", MocapSettings(), PoseSettings())
    assert apart(track, read(tmp_path / "b.npz", points)) < 1e-6


# ---------------------------------------------------------------------- tables and skeletons


def markers(path: Path, *, unit: str = "m", scale: float = 1.0, separator: str = "\t", point: str = ".") -> PoseTrack:
    """The same body as a marker file."""
    xyz = scale * np.stack(list(body().values()), axis=1)
    head = separator.join(["Frame#", "Time", *(f"{name}{2 * separator}" for name in body())])
    rows = [
        separator.join([str(i + 1), *(f"{v:.5f}".replace(".", point) for v in (i / 30, *row.ravel()))])
        for i, row in enumerate(xyz)
    ]
    facts = [separator.join(["DataRate", "Units"]), separator.join(["30", unit])]
    path.write_text("\n".join([f"PathFileType{separator}4", *facts, head, "", "", *rows]))
    return track_mocap(path, MocapSettings(), PoseSettings())


@pytest.mark.parametrize(("separator", "point"), [(",", "."), (";", "."), (";", ","), ("\t", ",")])
def test_markers_are_read_whatever_separates_them(separator, point, tmp_path):
    track = markers(tmp_path / "a.trc", separator=separator, point=point)
    assert apart(track, read(tmp_path / "b.npz", body())) < 1e-3


@pytest.mark.parametrize(("unit", "scale"), [("m", 30.0), ("cm", 0.1), ("mm", 30.0)])
def test_arms_that_are_long_in_no_unit_are_refused(unit, scale, tmp_path):
    with pytest.raises(SourceError, match=rf"the arms in a\.trc are .* {unit} long; expected 0.25 to 1 m, in m or cm"):
        markers(tmp_path / "a.trc", unit=unit, scale=scale)


@pytest.mark.parametrize(("unit", "scale"), [("m", 100.0), ("m", 1000.0), ("mm", 1.0)])
def test_a_unit_that_is_off_by_what_units_differ_by_is_said(unit, scale, tmp_path):
    assert any(
        f"the file says {unit}, but" in text for text in markers(tmp_path / "a.trc", unit=unit, scale=scale).warnings
    )


def test_a_file_of_marks_only_shows_nobody(tmp_path):
    with pytest.raises(SourceError, match=r"a\.trc shows nobody"):
        markers(tmp_path / "a.trc", scale=0.0)


def test_markers_separated_by_commas_of_a_user_are_read():
    assert len(track_mocap(outside("commas.trc"), MocapSettings(), PoseSettings()).t) == 60


BONES = {
    "Hips": (None, (0, 0, 0)),
    "Chest": ("Hips", (0, 50, 0)),
    "LeftArm": ("Chest", (18, 0, 0)),
    "LeftForeArm": ("LeftArm", (28, 0, 0)),
    "LeftHand": ("LeftForeArm", (25, 0, 0)),
    "RightArm": ("Chest", (-18, 0, 0)),
    "RightForeArm": ("RightArm", (-28, 0, 0)),
    "RightHand": ("RightForeArm", (-25, 0, 0)),
    "LeftUpLeg": ("Hips", (9, -5, 0)),
    "RightUpLeg": ("Hips", (-9, -5, 0)),
}


def skeleton(path: Path, *, moved: bool | None, angle: float, scale: float = 1.0) -> PoseTrack:
    """A skeleton whose left arm turns; positions below the root take the place of offsets, are added (True) or lack."""

    def joint(name: str) -> str:
        offset = " ".join(str(scale * x) for x in BONES[name][1])
        places = "Xposition Yposition Zposition " if moved is not None or name == "Hips" else ""
        children = "".join(joint(child) for child, (parent, _) in BONES.items() if parent == name)
        kind = "ROOT" if BONES[name][0] is None else "JOINT"
        channels = f"CHANNELS {6 if places else 3} {places}Zrotation Xrotation Yrotation"
        return f"{kind} {name}\n{{\nOFFSET {offset}\n{channels}\n{children or 'End Site { OFFSET 1 0 0 }'}\n}}\n"

    rows = []
    for phase in np.linspace(0.0, 6.0, ROWS):
        values = []
        for name, (parent, offset) in BONES.items():
            if parent is None:
                values += [0, 95, 0]
            elif moved is not None:
                values += [0.2, 0, 0] if moved else list(offset)
            values += [angle * np.sin(phase) if name == "LeftArm" else 0, 0, 0]
        rows.append(" ".join(f"{value:.5f}" for value in values))
    head = ["HIERARCHY", joint("Hips"), "MOTION", f"Frames: {ROWS}", "Frame Time: 0.0333333"]
    path.write_text("\n".join([*head, *rows]))
    return track_mocap(path, MocapSettings(), PoseSettings())


def test_positions_that_only_move_a_joint_are_added_to_its_offset(tmp_path):
    plain, taken, added = (skeleton(tmp_path / "a.bvh", moved=moved, angle=30.0) for moved in (None, False, True))
    assert apart(plain, taken) < 1e-6
    assert apart(plain, added) < 0.02
    assert [any("added to the offsets" in text for text in track.warnings) for track in (plain, taken, added)] == [
        False,
        False,
        True,
    ]


def test_a_skeleton_whose_positions_are_displacements_is_a_body():
    with np.errstate(all="raise"):
        track = track_mocap(outside("positions_are_displacements.bvh"), MocapSettings(), PoseSettings())
    assert any("added to the offsets" in text for text in track.warnings)


@pytest.mark.parametrize(("angle", "said"), [(30.0, False), (0.5, True), (3.0, True)])
def test_angles_that_are_radians_are_told(angle, said, tmp_path):
    track = skeleton(tmp_path / "a.bvh", moved=None, angle=angle)
    assert any("if these are radians" in text for text in track.warnings) == said


@pytest.mark.parametrize(
    ("unit", "metres"), [("m", 1.0), ("cm", 0.01), ("mm", 0.001), ("inches", 0.0254), ("CMU's unit", 0.05644)]
)
def test_a_skeleton_is_in_a_unit_that_such_files_have(unit, metres, tmp_path):
    track = skeleton(tmp_path / "a.bvh", moved=None, angle=30.0, scale=0.01 / metres)
    assert any(f"in {unit} by the length of the arms" in text for text in track.warnings)


@pytest.mark.parametrize("scale", [0.003, 0.04, 3.0, 30.0])
def test_a_skeleton_in_no_unit_that_such_files_have_is_refused(scale, tmp_path):
    with pytest.raises(SourceError, match=r"expected 0\.25 to 1 m, in m or cm or mm or inches or CMU's unit"):
        skeleton(tmp_path / "a.bvh", moved=None, angle=30.0, scale=scale)
