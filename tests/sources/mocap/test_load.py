from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mimic.config.pose import MocapSettings, PoseSettings
from mimic.errors import ConfigError, SourceError
from mimic.records import PoseTrack
from mimic.retargeting.wrists import wrist_track
from mimic.sources.mocap.body import MIRRORED
from mimic.sources.mocap.load import track_mocap
from mimic.sources.mocap.skeletons import LAYOUTS, SCHEMES

FOUR_CAMERAS = Path(__file__).parents[3] / ".." / "shared" / "data" / "videos" / "real" / "multiview"
ROWS = 90
T = np.arange(ROWS) / 60


def person() -> dict[str, np.ndarray]:
    """Someone in metres, x forward, y left, z up, whose forearms of 26 cm swing slowly."""
    still = np.zeros((ROWS, 1))
    swing = 0.3 * np.sin(2 * np.pi * 0.7 * T)[:, None]
    points = {}
    for side, y in (("left", 1.0), ("right", -1.0)):
        shoulder = still + [0.0, 0.2 * y, 1.45]
        elbow = shoulder + [0.05, 0.05 * y, -0.25]
        forearm = swing * [0.8, 0.2 * y, 0.5] + [0.3, 0.0, 0.1]
        points |= {
            f"{side}_shoulder": shoulder,
            f"{side}_elbow": elbow,
            f"{side}_wrist": elbow + 0.26 * forearm / np.linalg.norm(forearm, axis=1, keepdims=True),
            f"{side}_hip": still + [0.0, 0.1 * y, 0.95],
            f"{side}_knee": still + [0.02, 0.1 * y, 0.5],
            f"{side}_ankle": still + [0.0, 0.1 * y, 0.08],
            f"{side}_foot_index": still + [0.15, 0.1 * y, 0.03],
        }
    return points


PERSON = person()
UPS = {
    "z": np.eye(3),
    "y": np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    "-y": np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]]),
    "x": np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]),
}
"""Rotations from forward, left, up to the axes of a file whose up is the key."""


def stacked(up: str = "z", scale: float = 1.0, names: list[str] | None = None) -> np.ndarray:
    return scale * np.stack([PERSON[name] for name in names or PERSON], axis=1) @ UPS[up].T


def save(path: Path, **arrays: object) -> Path:
    np.savez(path, **{"t": T, "points": stacked(), "names": list(PERSON), **arrays})
    return path


def read(path: Path, **options: object) -> PoseTrack:
    return track_mocap(path, MocapSettings(**options), PoseSettings())


def arms(path: Path, **options: object) -> np.ndarray:
    return wrist_track(read(path, **options)).p_SH


def expected_arms() -> np.ndarray:
    """Shoulder to wrist in forward, left, up, by the reach of the clip."""
    p = np.stack([PERSON[f"{side}_wrist"] - PERSON[f"{side}_shoulder"] for side in ("left", "right")], axis=1)
    return p / np.quantile(np.linalg.norm(p, axis=-1), 0.98)


def write_trc(path: Path, names: dict[str, str], *, up: str = "y", unit: str = "mm", scale: float = 1000.0) -> Path:
    """Write a TRC file with our landmarks under other names."""
    xyz = stacked(up, scale, list(names))
    head = "\t".join(["Frame#", "Time", *(f"{name}\t\t" for name in names.values())])
    axes = "\t\t" + "\t".join(f"{a}{i}" for i in range(1, len(names) + 1) for a in "XYZ")
    rows = [
        "\t".join([str(i + 1), f"{t:.5f}", *(f"{v:.3f}" for v in row.ravel())])
        for i, (t, row) in enumerate(zip(T, xyz, strict=True))
    ]
    facts = "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames"
    values = f"60\t60\t{ROWS}\t{len(names)}\t{unit}\t60\t1\t{ROWS}"
    path.write_text("\n".join([f"PathFileType\t4\t(X/Y/Z)\t{path.name}", facts, values, head, axes, "", *rows]))
    return path


# ---------------------------------------------------------------------- all formats


@pytest.mark.parametrize("up", UPS)
@pytest.mark.parametrize("scale", [1.0, 1000.0], ids=["m", "mm"])
def test_axes_and_units_of_a_file_make_no_difference(up, scale, tmp_path):
    path = save(tmp_path / "a.npz", points=stacked(up, scale))
    np.testing.assert_allclose(arms(path), expected_arms(), atol=0.03)
    track = read(path)
    assert track.landmarks[0, track.index("left_shoulder")] == pytest.approx([0, -0.5, 0], abs=0.21)


def test_a_marker_file_and_a_point_file_of_the_same_person_agree(tmp_path):
    names = {ours: theirs[0] for ours, theirs in SCHEMES["openpose"].items() if ours in PERSON}
    one = arms(write_trc(tmp_path / "a.trc", names))
    np.testing.assert_allclose(one, arms(save(tmp_path / "a.npz", points=stacked("y"))), atol=2e-3)


def test_the_person_stands_on_its_feet_in_camera_axes(tmp_path):
    track = read(save(tmp_path / "a.npz"))
    height = track.landmarks[0, :, 1]
    assert height[track.index("left_ankle")] > 0.8
    assert height[track.index("left_shoulder")] < -0.4
    assert track.t[0] == 0.0
    assert np.isnan(track.image).all()


def test_what_was_not_seen_is_a_gap(tmp_path):
    points, score = stacked(), np.ones((ROWS, len(PERSON)))
    wrist = list(PERSON).index("left_wrist")
    points[10:20, wrist] = np.nan
    score[40:45, wrist] = 0.2
    track = read(save(tmp_path / "a.npz", points=points, visibility=score))
    missing = np.flatnonzero(~track.valid[:, track.index("left_wrist")])
    assert missing.tolist() == [*range(10, 20), *range(40, 45)]
    assert track.valid[:, track.index("right_wrist")].all()


def test_a_person_without_hips_says_where_up_is(tmp_path):
    upper = [name for name in PERSON if name.split("_")[1] in ("shoulder", "elbow", "wrist")]
    path = save(tmp_path / "a.npz", points=stacked("y", 1.0, upper), names=upper)
    with pytest.raises(SourceError, match=r"\[mocap\] up"):
        read(path)
    np.testing.assert_allclose(arms(path, up="y"), expected_arms(), atol=0.03)


def test_a_trunk_between_two_axes_is_asked_about(tmp_path):
    lean = Rotation.from_euler("y", 45, degrees=True).as_matrix()
    with pytest.raises(SourceError, match="along no single axis"):
        read(save(tmp_path / "a.npz", points=stacked() @ lean.T))


def test_an_upside_down_person_is_reported(tmp_path):
    warnings = read(save(tmp_path / "a.npz"), up="-z").warnings
    assert any("upside down" in text for text in warnings)


def test_left_handed_axes_are_reported_and_turned_over(tmp_path):
    path = save(tmp_path / "a.npz", points=stacked() * [1, -1, 1])
    assert MIRRORED in read(path).warnings
    np.testing.assert_allclose(arms(path), expected_arms(), atol=0.03)
    assert MIRRORED not in read(save(tmp_path / "b.npz")).warnings


def test_names_can_be_mapped_by_hand(tmp_path):
    odd = {name: f"marker {i}" for i, name in enumerate(PERSON)}
    path = write_trc(tmp_path / "a.trc", odd, unit="m", scale=1.0)
    with pytest.raises(SourceError, match="no left_shoulder, right_shoulder, left_wrist, right_wrist"):
        read(path)
    words = tuple(f"{ours}={theirs}" for ours, theirs in odd.items())
    np.testing.assert_allclose(arms(path, names=words), expected_arms(), atol=0.03)


def test_a_wrist_between_two_markers_is_their_mean(tmp_path):
    names = [name for name in PERSON if "wrist" not in name]
    wrists = [PERSON[f"{side}_wrist"] + [0, sign, 0] for side in ("left", "right") for sign in (-0.03, 0.03)]
    points = np.concatenate([stacked("z", 1.0, names), np.stack(wrists, axis=1)], axis=1)
    path = save(tmp_path / "a.npz", points=points, names=[*names, "LWRA", "LWRB", "RWRA", "RWRB"])
    words = ("left_wrist=LWRA+LWRB", "right_wrist=RWRA+RWRB")
    np.testing.assert_allclose(arms(path, names=words), expected_arms(), atol=0.03)


@pytest.mark.parametrize("words", [("left_wrist",), ("elbow=LELB",), ("left_wrist=",)])
def test_a_mapping_that_cannot_be_read_is_refused(words, tmp_path):
    with pytest.raises(ConfigError, match="OURS=THEIRS"):
        read(save(tmp_path / "a.npz"), names=words)


def test_a_mapping_to_a_name_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(SourceError, match="asks for LWRX"):
        read(save(tmp_path / "a.npz"), names=("left_wrist=LWRX",))


@pytest.mark.parametrize("name", [name for name in SCHEMES if name != "qualisys"])
def test_each_naming_scheme_is_recognised(name, tmp_path):
    theirs = {ours: names for ours, names in SCHEMES[name].items() if ours in PERSON}
    columns = [(column, PERSON[ours]) for ours, names in theirs.items() for column in names]
    points = np.stack([values for _, values in columns], axis=1)
    path = save(tmp_path / "a.npz", points=points, names=[f"someone:{column}" for column, _ in columns])
    np.testing.assert_allclose(arms(path), expected_arms(), atol=0.03)


# ---------------------------------------------------------------------- NPZ

BAD_NPZ = {
    "expected an array 'points'": {"points": None},
    "expected numbers (T, N, 3)": {"points": np.zeros((ROWS, 14))},
    "names for": {"names": ["left_wrist"]},
    "visibilities": {"visibility": np.ones(ROWS)},
    "a time for each row": {"t": np.zeros(3)},
    "has no times (t) and no frame rate (fps); store one": {"t": None},
    "do not increase": {"t": np.r_[T[:5], T[:-5]]},
    "needs at least two": {"t": T * 1e-3},
    "shows both shoulders": {"visibility": np.zeros((ROWS, len(PERSON)))},
}


@pytest.mark.parametrize("message", BAD_NPZ)
def test_a_point_file_that_lacks_something_is_refused(message, tmp_path):
    arrays = {"t": T, "points": stacked(), "names": list(PERSON), **BAD_NPZ[message]}
    np.savez(tmp_path / "a.npz", **{name: value for name, value in arrays.items() if value is not None})
    with pytest.raises(SourceError) as error:
        read(tmp_path / "a.npz")
    assert message in str(error.value)


@pytest.mark.parametrize("unknown", [np.nan, np.inf])
def test_a_row_without_a_time_is_refused(unknown, tmp_path):
    with pytest.raises(SourceError, match=r"row 90 of a\.npz has no time"):
        read(save(tmp_path / "a.npz", t=np.append(T[:-1], unknown)))


def test_an_infinite_position_was_not_seen(tmp_path):
    points = stacked()
    points[10, list(PERSON).index("left_wrist")] = np.inf
    track = read(save(tmp_path / "a.npz", points=points))
    wrist = track.index("left_wrist")
    assert not track.valid[10, wrist]
    assert track.valid[11, wrist]
    assert np.isfinite(track.landmarks[11, wrist]).all()


def test_pickled_objects_are_refused(tmp_path):
    np.savez(tmp_path / "a.npz", points=np.array([{"a": 1}], dtype=object))
    with pytest.raises(SourceError, match="without Python objects"):
        read(tmp_path / "a.npz")


def test_a_file_that_is_no_npz_is_refused(tmp_path):
    (tmp_path / "a.npz").write_text("PK not really")
    with pytest.raises(SourceError, match="cannot be read as NPZ"):
        read(tmp_path / "a.npz")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_points_without_names_are_named_by_their_layout(layout, tmp_path):
    names = LAYOUTS[layout]
    points = np.stack([PERSON.get(name, PERSON["left_hip"]) for name in names], axis=1)
    path = tmp_path / "a.npz"
    np.savez(path, fps=60, points=points, layout=layout)
    np.testing.assert_allclose(arms(path), expected_arms(), atol=0.03)
    np.savez(path, fps=60, points=points)
    if len(names) == 17:
        with pytest.raises(SourceError, match="could be coco17 or h36m17"):
            read(path)
    np.testing.assert_allclose(arms(path, layout=layout), expected_arms(), atol=0.03)


@pytest.mark.parametrize(("layout", "message"), [("coco18", "there is no layout"), ("coco17", "has 17 points")])
def test_a_layout_that_does_not_fit_is_refused(layout, message, tmp_path):
    with pytest.raises((ConfigError, SourceError), match=message):
        read(save(tmp_path / "a.npz"), layout=layout)


@pytest.mark.skipif(
    not FOUR_CAMERAS.is_dir(), reason="the shared test data is not beside the repository (../shared/data)"
)
def test_a_person_triangulated_from_four_cameras_can_be_followed():
    track = read(FOUR_CAMERAS / "triangulated_blazepose.npz")
    assert len(track.t) == 100
    assert track.t[-1] == pytest.approx(99 / 60)
    upper_arm = np.linalg.norm(
        track.landmarks[:, track.index("left_elbow")] - track.landmarks[:, track.index("left_shoulder")], axis=-1
    )
    assert 0.22 < np.nanmedian(upper_arm) < 0.36
    assert MIRRORED not in track.warnings


# ---------------------------------------------------------------------- TRC

NAMES = {ours: theirs[0] for ours, theirs in SCHEMES["openpose"].items() if ours in PERSON}


def test_empty_cells_and_zeros_of_a_marker_file_are_gaps(tmp_path):
    path = write_trc(tmp_path / "a.trc", NAMES)
    lines = path.read_text().split("\n")
    for row, value in ((9, ""), (20, "0.000")):
        cells = lines[row].split("\t")
        at = 2 + 3 * list(NAMES).index("right_wrist")
        cells[at : at + 3] = [value] * 3
        lines[row] = "\t".join(cells)
    path.write_text("\n".join(lines))
    track = read(path)
    assert np.flatnonzero(~track.valid[:, track.index("right_wrist")]).tolist() == [3, 14]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: "no such thing\n" * 10, "not a TRC file"),
        (lambda text: text.replace("\tmm\t", "\tfurlong\t"), "furlong"),
        (lambda text: text.replace("Frame#", "Number"), "line 4"),
        (lambda text: text.replace("0.01667", "soon"), "line 8"),
    ],
)
def test_a_marker_file_that_is_none_is_refused(change, message, tmp_path):
    path = write_trc(tmp_path / "a.trc", NAMES)
    path.write_text(change(path.read_text()))
    with pytest.raises(SourceError, match=message):
        read(path)


# ---------------------------------------------------------------------- BVH

BONES = {
    "Hips": ("", (0, 0, 0)),
    "Spine": ("Hips", (0, 20, 1)),
    "LeftShoulder": ("Spine", (4, 30, 0)),
    "LeftArm": ("LeftShoulder", (14, 0, 0)),
    "LeftForeArm": ("LeftArm", (28, 0, 0)),
    "LeftHand": ("LeftForeArm", (25, 0, 0)),
    "RightShoulder": ("Spine", (-4, 30, 0)),
    "RightArm": ("RightShoulder", (-14, 0, 0)),
    "RightForeArm": ("RightArm", (-28, 0, 0)),
    "RightHand": ("RightForeArm", (-25, 0, 0)),
    "LeftUpLeg": ("Hips", (9, -4, 0)),
    "RightUpLeg": ("Hips", (-9, -4, 0)),
}
ORDERS = {name: order for name, order in zip(BONES, ["ZXY", "ZYX", "XYZ", "YXZ"] * 3, strict=True)}


def write_bvh(path: Path, angles: np.ndarray, *, announced: int = ROWS, place: tuple[float, ...] = (1, 90, 2)) -> Path:
    """Write a skeleton whose joints turn by angles (T, joints, 3) [deg] in the order of each joint's channels."""

    def joint(name: str, indent: str) -> list[str]:
        parent, offset = BONES[name]
        order = " ".join(f"{a}rotation" for a in ORDERS[name])
        channels = f"6 Xposition Yposition Zposition {order}" if not parent else f"3 {order}"
        lines = [f"{indent}{'JOINT' if parent else 'ROOT'} {name}", f"{indent}{{"]
        lines += [f"{indent}\tOFFSET {' '.join(map(str, offset))}", f"{indent}\tCHANNELS {channels}"]
        children = [line for child, (own, _) in BONES.items() if own == name for line in joint(child, indent + "\t")]
        end = [f"{indent}\tEnd Site", f"{indent}\t{{", f"{indent}\t\tOFFSET 0 1 0", f"{indent}\t}}"]
        return [*lines, *(children or end), f"{indent}}}"]

    depth_first: list[str] = []

    def visit(name: str) -> None:
        depth_first.append(name)
        for child, (own, _) in BONES.items():
            if own == name:
                visit(child)

    visit("Hips")
    columns = [list(BONES).index(name) for name in depth_first]
    rows = [" ".join(f"{v:.6f}" for v in (*place, *row[columns].ravel())) for row in angles]
    text = ["HIERARCHY", *joint("Hips", ""), "MOTION", f"Frames: {announced}", f"Frame Time: {1 / 60:.6f}", *rows]
    path.write_text("\n".join(text) + "\n")
    return path


def by_hand(angles: np.ndarray, place: tuple[float, ...] = (1, 90, 2)) -> dict[str, np.ndarray]:
    """Positions of the joints, by SciPy's rotations."""
    turns: dict[str, Rotation] = {}
    places: dict[str, np.ndarray] = {}
    for i, (name, (parent, offset)) in enumerate(BONES.items()):
        own = Rotation.from_euler(ORDERS[name], angles[:, i], degrees=True)
        turns[name] = turns[parent] * own if parent else own
        places[name] = places[parent] + turns[parent].apply(offset) if parent else np.tile(place, (len(angles), 1))
    return places


@pytest.fixture
def angles() -> np.ndarray:
    """Joint angles that change slowly."""
    rng = np.random.default_rng(3)
    phase, size = rng.uniform(0, 6, (len(BONES), 3)), rng.uniform(5, 40, (len(BONES), 3))
    size[:2] = 8.0
    return size * np.sin(2 * np.pi * 0.5 * T[:, None, None] + phase)


def test_joints_of_a_skeleton_are_where_its_angles_put_them(angles, tmp_path):
    track = read(write_bvh(tmp_path / "a.bvh", angles))
    places = by_hand(angles)
    for side in ("left", "right"):
        cap = side.title()
        for ours, (one, other) in {"wrist": ("Arm", "Hand"), "elbow": ("Arm", "ForeArm")}.items():
            ours_length = np.linalg.norm(
                track.landmarks[:, track.index(f"{side}_{ours}")] - track.landmarks[:, track.index(f"{side}_shoulder")],
                axis=-1,
            )
            theirs = 0.01 * np.linalg.norm(places[cap + other] - places[cap + one], axis=-1)
            np.testing.assert_allclose(ours_length, theirs, atol=2e-3)
    up = 0.01 * (places["LeftArm"] + places["RightArm"] - places["LeftUpLeg"] - places["RightUpLeg"])[:, 1] / 2
    ours_up = -track.landmarks[:, [track.index("left_shoulder"), track.index("right_shoulder")], 1].mean(axis=1)
    np.testing.assert_allclose(ours_up, up, atol=2e-3)


def test_a_skeleton_that_stands_still_has_its_left_arm_at_its_left(tmp_path):
    still = np.zeros((ROWS, len(BONES), 3))
    p_SH = arms(write_bvh(tmp_path / "a.bvh", still))
    np.testing.assert_allclose(p_SH[:, 0], np.tile([0, 1, 0], (ROWS, 1)), atol=1e-6)
    np.testing.assert_allclose(p_SH[:, 1], np.tile([0, -1, 0], (ROWS, 1)), atol=1e-6)


def test_a_skeleton_file_that_was_cut_off_is_read_as_far_as_it_goes(angles, tmp_path):
    path = write_bvh(tmp_path / "a.bvh", angles, announced=200)
    track = read(path)
    assert len(track.t) == ROWS
    assert any("announces 200 frames and holds 90" in text for text in track.warnings)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: "skeleton\n", r"line 1: not a BVH file \(it must start with HIERARCHY\)"),
        (lambda text: text.split("MOTION")[0], "expected MOTION, got the end of the file"),
        (lambda text: text.replace("Zrotation", "Wrotation", 1), "'Wrotation'"),
        (lambda text: text.replace("OFFSET 0 20 1", "OFFSET 0 up 1"), "expected a number, got 'up'"),
        (lambda text: text.replace("Frames:", "Pictures:"), "Frames:"),
        (lambda text: text.split("Frame Time")[0] + "Frame Time: 0.0166\n", "less than the"),
        (lambda text: text + "nan\n", "expected a number, got 'nan'"),
        (lambda text: text.replace("Frame Time: 0.016667", "Frame Time: inf"), "got 'inf'"),
        (lambda text: text + "the end\n", "expected a number, got 'the'"),
        (lambda text: text.replace("Frame Time: 0.016667", "Frame Time: 0"), r"give the frame rate as \[mocap\] fps"),
    ],
)
def test_a_skeleton_file_that_is_none_is_refused(change, message, angles, tmp_path):
    path = write_bvh(tmp_path / "a.bvh", angles)
    path.write_text(change(path.read_text()))
    with pytest.raises(SourceError, match=message):
        read(path)
