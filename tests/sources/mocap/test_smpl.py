"""Files in the layouts of AMASS, SMPL-X, GVHMR, WHAM and 4D-Humans; joblib and PyTorch wrote the pickles."""

from __future__ import annotations

import base64
import os
import pickle
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mimic.config.pose import MocapSettings, PoseSettings
from mimic.errors import SourceError
from mimic.records import PoseTrack
from mimic.sources.mocap.load import track_mocap
from mimic.sources.mocap.skeletons import LAYOUTS

JOINTS = list(LAYOUTS["smpl24"][:22])
UP, FORWARD = np.array([0.0, -1.0, 0.0]), np.pi / 2
ROWS = 40

# joblib 1.6 wrote these two; base 85 of zlib. WHAM: two people, the second in frames 3, 4, 6, 7 with the left arm up.
WHAM = (
    "c-rk&OH0E*5N_JUKCx9%e1Hc*e1Jv7g9kyxOEFMT5RYNgq;51X@}Tq}=)qcHZ*G5-zrmY-ByQTI?@F~|LH0XrW|P^OVe-w#KCq3C"
    "NDKFPoA(#QnuaZ7v~X*Psv_ofS2L@Esg&+i@^-H1Z%-`?RIe>ynzDso@y;Xm4<>9^EUCb@G2)u1FpBFE@O_CB;%o>^8S_!TP$N6T"
    "lE`7ioDo}cs^kkyh8FRTmJjhu{TW}9vSNri#>Has+#_f%e8j;bN&!_hDuSi~6W7sNtI}pZ0jSE2uF1M1h*d|nF`skAsOLrg3Es1B"
    "ClQK2?@wbdFc9ZhK({gETI7cbn1&g`?N|-NS(t@6xCoc)aK$HH(hD&%?m-wg<xihbF)URY3|<%#JmYnN{y)m^iTHgL@-W@x_b4KE"
    "SUyjb`lzGSaA{Dd+f-$~&CkX~SWmKS0ZkSZX>jJAx@u9zt%d8E7p8x{U7qnXMEi2FLq{-4=a0@G1?|uD^?NHY;Oc;K4ZE3Sy<Yr0"
    "-}+ceIcYx1ciJD?AKIVa*UODB^m2P@`qkJB>)Y+GuYK#?@48>d0(Ule&IHeRc&&BwpM?Kyng"
)
# As PHALP stores them, packed by joblib: two people in four pictures, person 1 in each with the left arm up.
HUMANS4D = (
    "c-jHU0yh14UhP>+Z__{!w&R30ttga&3PP&HOSD2wXhUyE6)Ie?2oe`g$XdrH>(q`dKU8u+3I}MAmJ{pW!%r)_euUHs&PGb4CfPki"
    "-gwr#GtM{PH<NBLJQ0Oxe8szH#}0fa@V%<?`pvud)h|`UYF3{|qtbGknA#M5!_u)VAjvm0{0Z;ME3&Agb>9VzQ(aRG%_HB+B0xpY"
    "a!hJLmtAj~whBzeb`8DlW3<(>Rnt%_?Z9$6ieofRO&z1nI-S09UC{aH0>{x^{2T9mi#A^M0<~cR&%>w`t-@%ftpRFFj8Msgz##_{"
    "Wl5IK$=r4|vK)yg<XZDP<Q}}0UJ?7k=NI^A?;L+19!N-hiR<<H+Y2(H4_WZBiq?Q>+GmPo0SEWc{rIfWjtVf1X4@jJC~C*oJuKf0"
    "RPjO(y2o)i(=j{`Yso!SR&9;=ZhPct8?l#g6W)e*<n7oAxDD^ZdvFIn=)s3{ha2>41A}EhZj=8$7Cb)Pyx-!2`<{=(XDJR#s_p|X"
    "i@~+;Ecm;O_W#Yo{p3zSF}|Kbdy=w-(9W1o_L67AM~qpd+|MA({QkM``FZj1;MZdkqd&1#_c)$s*No@8MU8X#B*op+4DLo{j#7j<"
    "wrn8?;Zd3|bX2ZsO3OCdKGjv3o%Utv$8eS!#5e1X+-}(-5Sod{AjlE^2dVIfk}Sevs`ufwNaMrRSl%;J+Q#JiHRSv@qNZ5hygOw+"
    ";rck?_bj*1l;5}>CYa_Jo~PQB>*4%*VW#;at<?h^9x<w5X#%~yY}$|eOKL30qJIwu^lyRcU#fcliQh@IZ-Lf-<8waOyQ5+>K5i_r"
    "U1l53Usr*@0Ov1GK2wPRTmPmuz+V#Y-}EETIp%WhHMjiA`!~FQ!~f5W>WaC=@BkmqE-!QadlmFA@83*C{PBkfVX@!82`Ya9t7a`#"
    "KmT?m"
)


def read(path: Path, **settings: Any) -> PoseTrack:
    return track_mocap(path, MocapSettings(**settings), PoseSettings())


def arm(track: PoseTrack, side: str, row: int = -1) -> np.ndarray:
    """Shoulder to wrist, of length one, in camera axes (y down)."""
    line = track.landmarks[row, track.index(f"{side}_wrist")] - track.landmarks[row, track.index(f"{side}_shoulder")]
    return line / np.linalg.norm(line)


def left_arm_up(width: int) -> np.ndarray:
    """A T-pose whose left shoulder turns by 90 degrees about z, which lifts the arm from +x to +y (T, width)."""
    pose = np.zeros((ROWS, width))
    pose[:, 3 * JOINTS.index("left_shoulder") + 2] = np.pi / 2
    return pose


def amass(path: Path, **change: Any) -> Path:
    """A file as AMASS stores SMPL-H: z is up, so that the pelvis is turned by 90 degrees about x."""
    poses = left_arm_up(156)
    poses[:, 0] = np.pi / 2
    arrays = {
        "trans": np.zeros((ROWS, 3)),
        "gender": np.array("male"),
        "mocap_framerate": np.array(120.0),
        "betas": np.zeros(16),
        "dmpls": np.zeros((ROWS, 8)),
        "poses": poses,
        **change,
    }
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    return path


def test_amass_is_read_with_its_frame_rate_and_its_upward_axis(tmp_path):
    track = read(amass(tmp_path / "walk_poses.npz"))
    assert track.t[1] == pytest.approx(1 / 120)
    np.testing.assert_allclose(arm(track, "left"), UP, atol=1e-6)
    assert abs(arm(track, "right")[1]) < 1e-6
    assert any("z up" in text for text in track.warnings)
    assert any("generic skeleton" in text for text in track.warnings)


@pytest.mark.parametrize("width", [66, 72, 156, 165])
def test_each_model_of_the_family_is_read(width, tmp_path):
    np.savez(tmp_path / "a.npz", poses=left_arm_up(width), trans=np.zeros((ROWS, 3)), fps=30)
    np.testing.assert_allclose(arm(read(tmp_path / "a.npz"), "left"), UP, atol=1e-6)


def test_smpl_x_in_parts_is_read(tmp_path):
    pose = left_arm_up(66)
    np.savez(
        tmp_path / "x.npz", root_orient=pose[:, :3], pose_body=pose[:, 3:], mocap_frame_rate=60.0,
        surface_model_type="smplx", trans=np.zeros((ROWS, 3)), pose_hand=np.zeros((ROWS, 90)),
    )  # fmt: skip
    track = read(tmp_path / "x.npz")
    np.testing.assert_allclose(arm(track, "left"), UP, atol=1e-6)
    assert track.t[-1] == pytest.approx((ROWS - 1) / 60)


def test_matrices_are_read(tmp_path):
    turns = np.tile(np.eye(3), (ROWS, 22, 1, 1))
    turns[:, JOINTS.index("left_shoulder")] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    np.savez(tmp_path / "m.npz", poses=turns, fps=30)
    np.testing.assert_allclose(arm(read(tmp_path / "m.npz"), "left"), UP, atol=1e-6)


def test_rotations_add_up_along_the_arm(tmp_path):
    """A forearm at a right angle to an arm that hangs: shoulder -90 degrees about z, elbow then forward (+z)."""
    pose = np.zeros((ROWS, 72))
    pose[:, 3 * JOINTS.index("left_shoulder") + 2] = -np.pi / 2
    pose[:, 3 * JOINTS.index("left_elbow") + 1] = -np.pi / 2
    np.savez(tmp_path / "e.npz", poses=pose, fps=30)
    track = read(tmp_path / "e.npz")
    part = {name: track.landmarks[5, track.index(f"left_{name}")] for name in ("shoulder", "elbow", "wrist")}
    upper, fore = part["elbow"] - part["shoulder"], part["wrist"] - part["elbow"]
    np.testing.assert_allclose(upper / np.linalg.norm(upper), -UP, atol=1e-6)
    shoulders = track.landmarks[5, track.index("left_shoulder")] - track.landmarks[5, track.index("right_shoulder")]
    forward = np.cross(shoulders, UP) / np.linalg.norm(shoulders)
    np.testing.assert_allclose(fore / np.linalg.norm(fore), forward, atol=1e-6)


@pytest.mark.slow
@pytest.mark.train
def test_gvhmr_is_read_from_a_file_of_pytorch(tmp_path):
    torch = pytest.importorskip("torch", reason="writing the file needs the extra 'train'")
    pose = torch.tensor(left_arm_up(66), dtype=torch.float32)
    own = {"body_pose": pose[:, 3:], "betas": torch.zeros(ROWS, 10), "global_orient": pose[:, :3]}
    results = {"smpl_params_global": {**own, "transl": torch.zeros(ROWS, 3)}, "K_fullimg": torch.eye(3).expand(2, 3, 3)}
    torch.save(results, tmp_path / "hmr4d_results.pt")
    track = read(tmp_path / "hmr4d_results.pt", fps=30)
    np.testing.assert_allclose(arm(track, "left"), UP, atol=1e-6)
    assert track.warnings[0] == "parameters of the SMPL family"
    with pytest.raises(SourceError, match=r"no frame rate \(fps\); .* \[mocap\] fps"):
        read(tmp_path / "hmr4d_results.pt")


@pytest.mark.parametrize(
    ("text", "program", "times"), [(WHAM, "WHAM", [0, 1, 3, 4]), (HUMANS4D, "4D-Humans", [0, 1, 2, 3])]
)
def test_the_people_of_wham_and_4d_humans_are_read_and_the_one_in_most_frames_is_taken(text, program, times, tmp_path):
    path = tmp_path / "output.pkl"
    path.write_bytes(zlib.decompress(base64.b85decode(text)))
    track = read(path, fps=20)
    np.testing.assert_allclose(arm(track, "left"), UP, atol=1e-6)
    np.testing.assert_allclose(track.t[track.valid.all(axis=1)] * 20, times)
    assert track.warnings[0] == f"parameters of {program}"
    number = next(text for text in track.warnings if "2 people are in the file" in text).split("number ")[1][0]
    other = track_mocap(path, MocapSettings(fps=20), PoseSettings(person=3 - int(number)))
    assert 0 < other.valid.all(axis=1).sum() < len(times)


def test_a_plain_pickle_of_aist_is_read(tmp_path):
    data = {"smpl_poses": left_arm_up(72), "smpl_scaling": np.ones(1), "smpl_trans": np.zeros((ROWS, 3))}
    (tmp_path / "dance.pkl").write_bytes(pickle.dumps(data))
    np.testing.assert_allclose(arm(read(tmp_path / "dance.pkl", fps=60), "left"), UP, atol=1e-6)


class Attack:
    """Runs a command where a pickle is read without care."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, (f"touch {self.target}",)


class Call:
    """Pickles as a call with a state, whatever they are."""

    def __init__(self, *reduced: object) -> None:
        self.reduced = reduced

    def __reduce__(self) -> Any:
        return self.reduced


EMPTY = (np.ndarray, (0,), b"b")
REBUILD = np.zeros(0).__reduce__()[0]
ADDRESSES = b"A" * 32  # as objects these are addresses that nobody owns: reading one ends the process
SCALAR = np.float64(0.0).__reduce__()[0]
OBJECTS = {
    "a call of the type": Call(np.ndarray, ((4,), np.dtype("O"), ADDRESSES)),
    "the type with its class by name": Call(np.ndarray, ((4,), "O", ADDRESSES)),
    "a state of addresses": Call(REBUILD, EMPTY, (1, (4,), np.dtype("O"), False, ADDRESSES)),
    "a state of a list": Call(REBUILD, EMPTY, (1, (2,), np.dtype("O"), False, ["a", "b"])),
    "a field hidden by flags": Call(
        REBUILD,
        EMPTY,
        (
            1,
            (4,),
            Call(
                np.dtype,
                ("V8", False, True),
                (3, "|", None, ("f",), {"f": (np.dtype("O"), 0)}, 8, 1, 0),
            ),
            False,
            ADDRESSES,
        ),
    ),
    "more rows than bytes": Call(REBUILD, EMPTY, (1, (2**62, 4), np.dtype("f8"), False, b"")),
    "rows below zero": Call(REBUILD, EMPTY, (1, (-2, -2), np.dtype("f8"), False, ADDRESSES)),
    "a wider type than it says": Call(
        REBUILD,
        EMPTY,
        (1, (4,), Call(np.dtype, ("S1", False, True), (3, "|", None, None, None, 8, 1, 0)), False, ADDRESSES),
    ),
    "one object": Call(SCALAR, (np.dtype("O"), ADDRESSES)),
}


@pytest.mark.parametrize("data", OBJECTS.values(), ids=OBJECTS)
def test_a_pickle_that_makes_objects_of_bytes_is_refused(data, tmp_path):
    (tmp_path / "evil.pkl").write_bytes(pickle.dumps({"poses": data, "fps": 30}))
    with pytest.raises(SourceError, match=r"evil\.pkl .*(Python object|cannot be read)"):
        read(tmp_path / "evil.pkl")


def test_the_type_of_all_arrays_is_not_changed_by_a_pickle(tmp_path):
    swap = Call(np.dtype, ("f8", False, False), (3, ">", None, None, None, -1, -1, 0))
    (tmp_path / "evil.pkl").write_bytes(pickle.dumps({"poses": np.zeros((9, 72)), "other": swap, "fps": 30}))
    assert len(read(tmp_path / "evil.pkl").t) == 9
    assert np.dtype("f8").isnative


def test_a_pickle_that_runs_code_is_refused(tmp_path):
    (tmp_path / "evil.pkl").write_bytes(pickle.dumps({"poses": Attack(tmp_path / "hacked")}))
    with pytest.raises(SourceError, match=r"holds a Python object .*system"):
        read(tmp_path / "evil.pkl")
    assert not (tmp_path / "hacked").exists()


BAD = {
    "text": (b"hello", "cannot be read as a pickle"),
    "nothing": (b"", "cannot be read as a pickle"),
    "cut": (pickle.dumps({"poses": np.zeros((9, 72))})[:200], "cannot be read as a pickle"),
    "a list": (pickle.dumps([1, 2]), "holds list; expected what GVHMR"),
    "others": (pickle.dumps({"a": 1}), "holds a; expected what GVHMR"),
    "deep": (b"\x80\x04" + b"]" * 100_000 + b"a" * 99_999 + b".", "holds list; expected what GVHMR"),
    "a zip": (b"PK\x03\x04" + bytes(100), "a reference to another file"),
    "wide": (pickle.dumps({"poses": np.zeros((9, 70))}), "shape .9, 70.; expected axis angles .T, 3 N."),
    "no pelvis": (pickle.dumps({"poses": np.zeros((9, 69)), "fps": 30}), "whose number is 22 .the body., 24 .SMPL."),
    "text for numbers": (pickle.dumps({"poses": np.array([["a"] * 72])}), "expected axis angles"),
    "no number": (pickle.dumps({"poses": np.full((9, 72), np.nan), "fps": 30}), "not a number in row 1"),
    "no rate": (pickle.dumps({"poses": np.zeros((9, 72)), "fps": -3}), "the frame rate -3"),
    "unequal": (
        pickle.dumps({"global_orient": np.zeros((9, 3)), "body_pose": np.zeros((8, 63)), "fps": 30}),
        "global_orient. .9, 3. and .body_pose. .8, 63.; expected T rows of joints whose number is 22",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_motion_is_refused_in_one_line(name, tmp_path):
    data, message = BAD[name]
    (tmp_path / "a.pkl").write_bytes(data)
    with pytest.raises(SourceError, match=message) as error:
        read(tmp_path / "a.pkl")
    assert "\n" not in str(error.value)


def test_a_large_array_that_is_not_needed_is_left_alone(tmp_path):
    path = amass(tmp_path / "a.npz", marker_data=np.zeros((200, 50, 3)), labels=np.array(["a", None], dtype=object))
    assert len(read(path).t) == ROWS
