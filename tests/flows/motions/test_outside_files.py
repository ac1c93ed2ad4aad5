"""Files as other people's programs write them: one of each kind from the shared data, and two more made here."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from decimal import Decimal
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from mimic.config.pose import LiveSettings, MocapSettings, PoseSettings
from mimic.config.values import read_toml
from mimic.dynamics.machine import read_machine
from mimic.errors import CalibrationError, ConfigError, MimicError, SourceError
from mimic.flows.batch import batch
from mimic.flows.logs.calibrate import checked_log
from mimic.flows.logs.machine_log import predict_log, simulate_log
from mimic.flows.motions.camera import follow_camera
from mimic.flows.motions.motion import InputSettings, as_motion, load_motion, motion_from_text, retarget, track_video
from mimic.flows.reporter import SilentReporter
from mimic.io.joint_log import read_log, without_marks
from mimic.records import PoseTrack, WristTrack
from mimic.retargeting.commands import command_track
from mimic.retargeting.wrists import wrist_track
from mimic.robot.description import load_description
from mimic.sources.mocap.load import track_mocap
from mimic.sources.video.camera import check_camera
from mimic.sources.video.decoding import open_video
from mimic.sysid.log.checks import check_log

HERE = Path(__file__).parents[3]
PLACES = [up / "shared" / "data" for up in (HERE.parent, HERE.parent.parent)]
DATA = next((place for place in PLACES if place.is_dir()), PLACES[0])


def outside(name: str, folder: str = "outside") -> Path:
    if not DATA.is_dir():
        pytest.skip("the shared test data is not beside the repository (../shared/data)")
    return DATA / folder / name


def one_line(error: pytest.ExceptionInfo[MimicError], *words: str) -> None:
    """The message is one line with these words in it."""
    said = str(error.value)
    assert "\n" not in said
    assert len(said) < 400
    for word in words:
        assert word in said


# ---------------------------------------------------------------------- recorded motion

BODY = {
    "Hips": ("", (0, 0, 0)),
    "Spine": ("Hips", (0, 50, 0)),
    "LeftArm": ("Spine", (18, 0, 0)),
    "LeftForeArm": ("LeftArm", (28, 0, 0)),
    "LeftHand": ("LeftForeArm", (25, 0, 0)),
    "RightArm": ("Spine", (-18, 0, 0)),
    "RightForeArm": ("RightArm", (-28, 0, 0)),
    "RightHand": ("RightForeArm", (-25, 0, 0)),
    "LeftUpLeg": ("Hips", (9, -4, 0)),
    "RightUpLeg": ("Hips", (-9, -4, 0)),
}
ROWS = 60


def bvh(
    called: Callable[[str], str] = str, *, step: float = 1 / 60, people: int = 1, more: int = 0, less: int = 0
) -> str:
    """Someone whose left shoulder swings by 40 degrees; others stand 2 m further to the left and hold still."""
    lines, rows = ["HIERARCHY"], [""] * ROWS

    def joint(name: str) -> None:
        parent, offset = BODY[name]
        lines.extend([f"{'JOINT' if parent else 'ROOT'} {called(name)}", "{", f"OFFSET {' '.join(map(str, offset))}"])
        lines.append(f"CHANNELS {'3' if parent else '6 Xposition Yposition Zposition'} Zrotation Xrotation Yrotation")
        for child, (own, _) in BODY.items():
            if own == name:
                joint(child)
        lines.extend(
            ["End Site", "{", "OFFSET 0 5 0", "}"] * (not any(own == name for own, _ in BODY.values())) + ["}"]
        )

    for person in range(people):
        joint("Hips")
        for row in range(ROWS):
            swing = 40 * np.sin(2 * np.pi * row / ROWS) if person == 0 else 0.0
            turns = [0.0] * 6 + [swing, 0.0, 0.0] + [0.0] * 21
            rows[row] += " ".join(f"{v:.4f}" for v in (200.0 * person, 95, 0, *turns)) + " "
    rows = [" ".join((row.split() + ["0.5"] * more)[: -less or None]) for row in rows]
    return "\n".join([*lines, "MOTION", f"Frames: {ROWS}", f"Frame Time: {step:.9g}", *rows]) + "\n"


def read(path: Path, person: int | str | None = None, **settings: object) -> PoseTrack:
    return track_mocap(path, MocapSettings(**settings), PoseSettings(person=person))


def arms(path: Path, **settings: object) -> np.ndarray:
    return wrist_track(read(path, **settings)).p_SH


@pytest.fixture
def plain(tmp_path: Path) -> np.ndarray:
    """The arms in the file as it should be."""
    (tmp_path / "plain.bvh").write_text(bvh())
    return arms(tmp_path / "plain.bvh")


def trc(called: Callable[[str], str] = str, *, first: float = 0.0, step: float = 1 / 60, unit: str = "mm") -> str:
    """Markers of someone with y up whose left hand swings."""
    places = {
        "LShoulder": (200, 1450, 0), "RShoulder": (-200, 1450, 0), "LElbow": (230, 1200, 0), "RElbow": (-230, 1200, 0),
        "LWrist": (240, 960, 60), "RWrist": (-240, 960, 60), "LHip": (100, 950, 0), "RHip": (-100, 950, 0),
    }  # fmt: skip
    head = "\t".join(["Frame#", "Time", *(f"{called(name)}\t\t" for name in places)])
    table = []
    for row in range(ROWS):
        swing = 100 * np.sin(2 * np.pi * row / ROWS)
        cells = [
            v + (swing if name == "LWrist" and axis == 2 else 0)
            for name, p in places.items()
            for axis, v in enumerate(p)
        ]
        table.append("\t".join([str(row + 1), f"{first + step * row:.6f}", *(f"{v:.3f}" for v in cells)]))
    facts = f"DataRate\tNumFrames\tNumMarkers\tUnits\n60\t{ROWS}\t{len(places)}\t{unit}"
    return "\n".join(["PathFileType\t4\t(X/Y/Z)\ta.trc", facts, head, "\t\tX1", "", *table]) + "\n"


def test_a_byte_order_mark_is_no_part_of_the_text():
    track = read(outside("bom.bvh"))
    assert len(track.t) == 60
    assert track.t[-1] == pytest.approx(59 / 60)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
def test_text_is_read_in_any_encoding(encoding, plain, tmp_path):
    (tmp_path / "a.bvh").write_text(bvh(), encoding=encoding)
    np.testing.assert_allclose(arms(tmp_path / "a.bvh"), plain)
    (tmp_path / "a.trc").write_text(trc(), encoding=encoding)
    (tmp_path / "b.trc").write_text(trc())
    np.testing.assert_allclose(arms(tmp_path / "a.trc"), arms(tmp_path / "b.trc"))


def test_rows_wider_than_the_channels_are_refused():
    with pytest.raises(SourceError) as error:
        load_motion(outside("rows_with_three_more.bvh"))
    one_line(error, "36 numbers in row 1", "33 numbers")


@pytest.mark.parametrize(
    ("change", "words"), [({"more": 1}, ["34 numbers in row 1"]), ({"less": 2}, ["31 numbers in row 1"])]
)
def test_rows_of_another_width_are_refused(change, words, tmp_path):
    (tmp_path / "a.bvh").write_text(bvh(**change))
    with pytest.raises(SourceError) as error:
        read(tmp_path / "a.bvh")
    one_line(error, *words, "33 numbers")


def test_marker_rows_wider_than_the_names_are_refused(tmp_path):
    (tmp_path / "a.trc").write_text("\n".join(line + "\t1.0" * (i > 5) for i, line in enumerate(trc().split("\n"))))
    with pytest.raises(SourceError) as error:
        read(tmp_path / "a.trc")
    one_line(error, "line 7", "27 cells", "26")


def test_a_row_may_go_on_in_the_next_line(plain, tmp_path):
    head, table = bvh().split("Frame Time")
    wrapped = [line.replace(" ", "\n", 12) if "." in line and ":" not in line else line for line in table.split("\n")]
    (tmp_path / "a.bvh").write_text(head + "Frame Time" + "\n".join(wrapped))
    np.testing.assert_allclose(arms(tmp_path / "a.bvh"), plain)


def test_two_people_of_one_name_are_said_and_one_can_be_chosen():
    path = outside("two_people_same_names.bvh")
    assert any("2 people" in text and "--person" in text for text in read(path).warnings)
    assert not np.allclose(arms(path), wrist_track(read(path, 2)).p_SH)
    with pytest.raises(ConfigError) as error:
        read(path, 3)
    one_line(error, "--person 3", "from 1 to 2")


@pytest.mark.parametrize("ending", ["bvh", "trc"])
def test_people_with_names_of_their_own_are_said_and_one_can_be_chosen(ending, tmp_path):
    path = tmp_path / f"a.{ending}"
    if ending == "bvh":
        one, two = (bvh(lambda name, who=who: f"{who}:{name}").split("MOTION\n") for who in ("Anna", "Bob"))
        moved = [" ".join(["300", *row.split()[1:]]) for row in two[1].split("\n")[2:-1]]
        rows = [f"{a} {b}" for a, b in zip(one[1].split("\n")[2:-1], moved, strict=True)]
        head = one[0] + two[0].removeprefix("HIERARCHY\n") + "MOTION\n" + "\n".join(one[1].split("\n")[:2])
        path.write_text(head + "\n" + "\n".join(rows))
    else:
        one, two = (trc(lambda name, who=who: f"{who}_{name}").split("\n") for who in ("p1", "p2"))
        names = "\t".join([one[3].rstrip(), "", "", *two[3].split("\t")[2:]])
        cells = [
            "\t".join([a, *(f"{float(v) + 900:.1f}" for v in b.split("\t")[2:])])
            for a, b in zip(one[6:-1], two[6:-1], strict=True)
        ]
        path.write_text("\n".join([*one[:3], names, *one[4:6], *cells]) + "\n")
    assert any("2 people" in text for text in read(path).warnings)
    np.testing.assert_allclose(arms(path), wrist_track(read(path, 2)).p_SH, atol=1e-3)
    with pytest.raises(ConfigError) as error:
        read(path, "left")
    one_line(error, "number from 1 to 2")


def test_copies_of_one_skeleton_are_one_person(tmp_path):
    two = bvh(people=2).split("\n")
    start = two.index("ROOT Hips", 2)
    two[start : two.index("MOTION")] = [
        line.replace("ROOT ", "ROOT DEF-").replace("JOINT ", "JOINT DEF-") for line in two[start : two.index("MOTION")]
    ]
    table = two.index(f"Frames: {ROWS}") + 2
    same = [" ".join(2 * row.split()[:33]) for row in two[table:-1]]
    (tmp_path / "a.bvh").write_text("\n".join([*two[:table], *same]) + "\n")
    assert not any("people" in text for text in read(tmp_path / "a.bvh").warnings)


def test_a_frame_time_that_is_a_rate_is_refused():
    with pytest.raises(SourceError) as error:
        load_motion(outside("frame_time_is_fps.bvh"))
    one_line(error, "60 s apart", "a rate of 60 Hz", "[mocap] fps")


@pytest.mark.parametrize(
    ("step", "word"),
    [(16.667, "milliseconds"), (16667.0, "microseconds"), (1.6667e7, "nanoseconds"), (2e-5, "another unit")],
)
def test_times_of_another_unit_are_refused(step, word, tmp_path):
    (tmp_path / "a.trc").write_text(trc(step=step).replace("Frame#", "frame#"))
    np.savez(tmp_path / "a.npz", t=step * np.arange(6000), points=np.zeros((6000, 33, 3)))
    for name in ("a.npz",) if step < 1 else ("a.trc", "a.npz"):
        with pytest.raises(SourceError) as error:
            read(tmp_path / name)
        one_line(error, word)


def test_a_frame_rate_is_read_under_any_of_its_names_and_shapes(tmp_path):
    (tmp_path / "a.trc").write_text(trc())
    names, xyz = read(tmp_path / "a.trc").names, read(tmp_path / "a.trc").landmarks
    stamps = np.datetime64("2024-05-01", "ns") + (np.arange(ROWS) / 60 * 1e9).astype("timedelta64[ns]")
    for rate in ({"fps": 60}, {"fps": np.array([60.0])}, {"mocap_framerate": 60}, {"t": stamps}):
        np.savez(tmp_path / "a.npz", points=xyz, names=names, **rate)
        assert read(tmp_path / "a.npz").t[-1] == pytest.approx(59 / 60)


@pytest.mark.parametrize("fault", ["equal", "float32", "jump"])
def test_a_clock_that_cannot_be_true_is_refused(fault, tmp_path):
    t = {
        "equal": np.zeros(600),
        "float32": (1.7640999e9 + np.arange(600) / 60).astype(np.float32),
        "jump": np.arange(600) / 60 + 3600.0 * (np.arange(600) > 200),
    }[fault]
    np.savez(tmp_path / "a.npz", t=t, points=np.zeros((600, 33, 3)))
    with pytest.raises(SourceError) as error:
        read(tmp_path / "a.npz")
    one_line(error, {"equal": "a.npz", "float32": "32 bits", "jump": "jump by 3600"}[fault])


def test_a_prefix_without_a_colon_is_no_part_of_the_name():
    path = outside("mixamorig_without_colon.bvh")
    np.testing.assert_allclose(arms(path), arms(outside("bom.bvh")), atol=1e-6)


NAMINGS = {
    "Character1_": lambda name: f"Character1_{name}",
    "Blender's number": lambda name: f"{name}.001",
    "Biped": lambda name: "Bip01 " + _renamed(name, "{} UpperArm", "{} Forearm", "{} Hand", "{} Thigh"),
    "Rigify": lambda name: "DEF-" + _renamed(name, "upper_arm.{}", "forearm.{}", "hand.{}", "thigh.{}"),
    "VRM": lambda name: (
        name[0].lower() + name[1:].replace("ForeArm", "LowerArm").replace("UpLeg", "UpperLeg")
        if "Hand" in name or "Leg" in name or "Fore" in name
        else (name[0].lower() + name[1:]).replace("tArm", "tUpperArm")
    ),
    "VRoid": lambda name: "J_Bip_" + _renamed(name, "{}_UpperArm", "{}_LowerArm", "{}_Hand", "{}_UpperLeg"),
    "OptiTrack": lambda name: "Skeleton_001_" + _renamed(name, "{}UArm", "{}FArm", "{}Hand", "{}Thigh"),
    "Biovision": lambda name: name.replace("ForeArm", "LowArm").replace("tArm", "tUpArm"),
    "Biovision's joints": lambda name: (
        {"Arm": "Shoulder", "ForeArm": "Elbow", "Hand": "Wrist", "UpLeg": "Hip"}.get(
            name.removeprefix("Left").removeprefix("Right"), ""
        ).join([name[: 4 if name[0] == "L" else 5], ""])
        if name[:4] in ("Left", "Righ")
        else name
    ),
}


def _renamed(name: str, *patterns: str) -> str:
    for part, pattern in zip(("Arm", "ForeArm", "Hand", "UpLeg"), patterns, strict=True):
        for side in ("Left", "Right"):
            if name == side + part:
                return pattern.format(side[0])
    return name


@pytest.mark.parametrize("naming", NAMINGS)
def test_common_names_of_joints_are_recognised(naming, plain, tmp_path):
    (tmp_path / "a.bvh").write_text(bvh(NAMINGS[naming]))
    track = read(tmp_path / "a.bvh")
    assert {"left_elbow", "right_hip"} <= set(track.names)
    np.testing.assert_allclose(arms(tmp_path / "a.bvh"), plain, atol=1e-6)


def test_of_many_unknown_names_those_of_arms_are_shown(tmp_path):
    (tmp_path / "a.trc").write_text(trc(lambda name: f"m{name[0]}{name[2:]}x"))
    with pytest.raises(SourceError) as error:
        read(tmp_path / "a.trc")
    one_line_free = str(error.value)
    assert "mLristx" in one_line_free
    assert "mRipx" in one_line_free  # too few look like arms: all are shown


def test_the_body_is_believed_whatever_a_file_says_of_its_axes(tmp_path):
    points = {"left_shoulder": (0.2, 0, 1.4), "right_shoulder": (-0.2, 0, 1.4), "left_wrist": (0.3, -0.3, 1.0)}
    points |= {"right_wrist": (-0.3, -0.3, 1.0), "left_hip": (0.1, 0, 0.9), "right_hip": (-0.1, 0, 0.9)}
    xyz = np.tile(np.array(list(points.values())), (60, 1, 1))
    for header in ("-z", "y", "-x"):
        np.savez(tmp_path / "a.npz", points=xyz, names=list(points), fps=60, up=header)
        track = read(tmp_path / "a.npz")
        assert any("z up" in text for text in track.warnings)
        assert track.landmarks[0, track.index("left_shoulder"), 1] < -0.4


@pytest.mark.parametrize(("said", "true"), [("m", "mm"), ("cm", "mm"), ("mm", "mm")])
def test_a_unit_that_makes_no_arm_is_said_and_not_believed(said, true, tmp_path):
    (tmp_path / "a.trc").write_text(trc(unit=said))
    track = read(tmp_path / "a.trc")
    assert any(f"the file says {said}" in text for text in track.warnings) == (said != true)
    upper = track.landmarks[0, track.index("left_elbow")] - track.landmarks[0, track.index("left_shoulder")]
    assert np.linalg.norm(upper) == pytest.approx(0.252, abs=0.01)


# ---------------------------------------------------------------------- videos


def clip(path: Path, size: tuple[int, int] = (96, 80)) -> bytes:
    """A white disc on black; returns the file."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 25.0, size)
    for _ in range(9):
        picture = np.zeros((size[1], size[0], 3), np.uint8)
        writer.write(cv2.circle(picture, (size[0] // 2, size[1] // 2), 25, (255, 255, 255), -1))
    writer.release()
    return path.read_bytes()


def with_pixel(data: bytes, wide: int, high: int) -> bytes:
    """The file with a pasp box (shape of a pixel) at the end of its picture's description, as ISO 14496-12 has it."""
    box = struct.pack(">I4sII", 16, b"pasp", wide, high)
    entry = data.index(b"mp4v", data.index(b"stsd")) - 4
    end = entry + struct.unpack_from(">I", data, entry)[0]
    changed = bytearray(data[:end] + box + data[end:])
    for kind in (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stsd"):
        at = data.index(kind, data.index(b"moov")) - 4
        struct.pack_into(">I", changed, at, struct.unpack_from(">I", data, at)[0] + len(box))
    at = entry
    struct.pack_into(">I", changed, at, struct.unpack_from(">I", data, at)[0] + len(box))
    return bytes(changed)


def disc(path: Path) -> tuple[tuple[int, int], float]:
    """The size of the picture, and width over height of what is bright in it."""
    with open_video(path) as video:
        bright = next(iter(video)).rgb.mean(axis=-1) > 128
        return video.size, float(
            np.ptp(np.flatnonzero(bright.any(axis=0))) / np.ptp(np.flatnonzero(bright.any(axis=1)))
        )


def test_pixels_that_are_not_square_are_made_square():
    with open_video(outside("pixels_16_9.mp4")) as video:
        assert video.size == (640, 480)
        assert next(iter(video)).rgb.shape == (480, 640, 3)


@pytest.mark.slow
def test_a_person_in_wide_pixels_moves_as_in_square_ones(tmp_path):
    with open_video(outside("pixels_16_9.mp4")) as video:
        writer = cv2.VideoWriter(str(tmp_path / "square.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, video.size)
        stamps = []
        for frame in video:
            writer.write(frame.rgb[..., ::-1].copy())
            stamps.append(frame.stamp_ms)
        writer.release()
    assert np.median(np.diff(stamps)) == pytest.approx(40.0, abs=7.0)
    wide, square = (
        wrist_track(track_video(path, cache=False)).p_SH
        for path in (outside("pixels_16_9.mp4"), tmp_path / "square.avi")
    )
    assert np.nanmean(np.linalg.norm(wide - square, axis=-1)) < 0.05


@pytest.mark.parametrize(
    ("wide", "high", "size"), [(1, 1, (96, 80)), (3, 2, (144, 80)), (10, 11, (96, 88)), (0, 0, (96, 80))]
)
def test_a_disc_has_the_shape_that_its_pixels_give_it(wide, high, size, tmp_path):
    (tmp_path / "a.mp4").write_bytes(with_pixel(clip(tmp_path / "b.mp4"), wide, high))
    assert disc(tmp_path / "a.mp4")[0] == size
    assert disc(tmp_path / "a.mp4")[1] == pytest.approx((wide or 1) / (high or 1), abs=0.05)


def with_edits(data: bytes, *edits: tuple[int, int]) -> bytes:
    """The file with an edit list: length on the film's clock, and where in the pictures it begins (-1 for nothing)."""
    entries = b"".join(struct.pack(">IiI", length, begin, 0x10000) for length, begin in edits)
    inner = struct.pack(">I4sII", 16 + len(entries), b"elst", 0, len(edits)) + entries
    box = struct.pack(">I4s", 8 + len(inner), b"edts") + inner
    moov = data.index(b"moov")
    old = data.find(b"edts", moov)
    if old >= 0:  # the writer's own, which says nothing
        data = data[:old] + b"free" + data[old + 4 :]
    mdia = data.index(b"mdia", moov) - 4
    changed = bytearray(data[:mdia] + box + data[mdia:])
    for kind in (b"moov", b"trak"):
        at = data.index(kind, moov) - 4
        struct.pack_into(">I", changed, at, struct.unpack_from(">I", data, at)[0] + len(box))
    return bytes(changed)


@pytest.mark.parametrize("edit", ["trimmed", "late"])
def test_a_trimmed_clip_and_a_late_start_lack_no_end(edit, tmp_path):
    data = clip(tmp_path / "a.mp4")
    scale = struct.unpack_from(">I", data, data.index(b"mvhd") + 16)[0]
    ticks = struct.unpack_from(">I", data, data.index(b"mdhd") + 16)[0]
    edits = [(scale * 5 // 25, ticks * 4 // 25)] if edit == "trimmed" else [(scale, -1), (scale * 9 // 25, 0)]
    (tmp_path / "a.mp4").write_bytes(with_edits(data, *edits))
    with open_video(tmp_path / "a.mp4") as video:
        stamps = np.array([frame.stamp_ms for frame in video])
    assert np.diff(stamps) == pytest.approx(40.0)
    assert len(stamps) == (5 if edit == "trimmed" else 9)
    assert video.end_ms == pytest.approx(stamps[-1], abs=500.0)


# ---------------------------------------------------------------------- joint logs

T = 0.005 * np.arange(1600)
ANGLES = 0.8 * np.stack([np.sin(2 * np.pi * 0.4 * T), np.cos(2 * np.pi * 0.3 * T)], -1)


def columns(**change: object) -> dict[str, object]:
    """Two joints that swing by 0.8 rad."""
    named = {f"{channel}.{joint}": ANGLES[:, i] for channel in ("q", "q_des") for i, joint in enumerate("ab")}
    return {"t": T, **named, **{name.replace("__", "."): value for name, value in change.items()}}


def parquet(path: Path, **change: object) -> Path:
    pq.write_table(pa.table(columns(**change)), path)
    return path


def csv(path: Path, encoding: str = "utf-8", **change: object) -> Path:
    own = columns(**change)
    rows = [",".join(str(v) for v in row) for row in zip(*own.values(), strict=True)]
    path.write_text("\n".join([",".join(own), *rows]) + "\n", encoding=encoding)
    return path


def refused(path: Path, *words: str) -> None:
    with pytest.raises(CalibrationError) as error:
        read_log(path)
    one_line(error, *words)


def test_a_column_of_true_and_false_is_read():
    log = read_log(outside("enabled_bool.parquet"))
    off = log.extra["enabled"] == 0.0
    assert set(np.unique(log.extra["enabled"])) == {0.0, 1.0}
    assert (log.t[off].min(), log.t[off].max()) == pytest.approx((3.0, 4.995))


ON = T < 4
SINCE = (1_700_000_000_000_000 + (T * 1e6)).astype("int64")
KINDS = {
    "bool": pa.array(ON),
    "decimal": pa.array([Decimal(int(v)) for v in ON], pa.decimal128(5, 2)),
    "int8": pa.array(ON.astype(np.int8)),
    "float16": pa.array(ON.astype(np.float16)),
    "lists of one": pa.array([[float(v)] for v in ON]),
    "dictionary": pa.array(ON.astype(float)).dictionary_encode(),
    "text of numbers": pa.array(["1" if v else "0" for v in ON]),
}


@pytest.mark.parametrize("kind", KINDS)
def test_numbers_of_any_type_are_read(kind, tmp_path):
    log = read_log(parquet(tmp_path / "a.parquet", enabled=KINDS[kind]))
    np.testing.assert_array_equal(log.extra["enabled"], ON)


def test_a_table_of_other_marks_than_commas_is_refused(tmp_path):
    path = csv(tmp_path / "a.csv")
    for mark in (";", "\t"):
        path.write_text(path.read_text().replace(",", mark))
        refused(path, f"has {mark!r} between its columns")
        path.write_text(path.read_text().replace(mark, ","))


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
def test_time_stamps_are_read_as_seconds(unit, tmp_path):
    t = pa.array(SINCE, pa.timestamp("us")).cast(pa.timestamp(unit))
    log = read_log(parquet(tmp_path / "a.parquet", t=t))
    assert log.t - log.t[0] == pytest.approx(T, abs=1e-6)


def test_lists_are_read_as_a_column_for_each_joint(tmp_path):
    table = pa.table({"t": T, "q": pa.array(ANGLES.tolist()), "q_des": pa.array(ANGLES.tolist())})
    pq.write_table(table.replace_schema_metadata({"mimic_log": '{"joints": ["a", "b"]}'}), tmp_path / "a.parquet")
    log = read_log(tmp_path / "a.parquet")
    assert log.joints == ("a", "b")
    assert log.q == pytest.approx(ANGLES)


@pytest.mark.parametrize(
    ("name", "values", "kind"),
    [
        ("enabled", pa.array(["on" if v else "off" for v in ON]), "of type string"),
        ("tau__a", pa.array([{"x": 1.0}] * len(T)), "struct"),
        ("q__a", pa.array([b"\xff"] * len(T)), "binary"),
        ("temperature__a", pa.array([[1.0], [1.0, 2.0]] * (len(T) // 2)), "list"),
    ],
)
def test_a_column_of_ours_that_is_no_number_is_refused_with_its_type(name, values, kind, tmp_path):
    refused(parquet(tmp_path / "a.parquet", **{name: values}), f"column {name.replace('__', '.')}", kind)


def test_a_column_of_somebody_else_may_be_text(tmp_path):
    log = read_log(parquet(tmp_path / "a.parquet", operator=pa.array(["Kim"] * len(T))))
    assert "operator" not in log.extra


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_words_and_time_stamps_of_a_table_are_read(encoding, tmp_path):
    stamps = [datetime.fromtimestamp(us / 1e6, UTC).isoformat().replace("+00:00", "Z") for us in SINCE.tolist()]
    log = read_log(csv(tmp_path / "a.csv", encoding, t=stamps, enabled=[str(bool(v)) for v in ON]))
    np.testing.assert_array_equal(log.extra["enabled"], ON)
    assert log.t - log.t[0] == pytest.approx(T, abs=1e-5)
    refused(csv(tmp_path / "b.csv", enabled=["on"] * len(T)), "column enabled is of type string")


def test_a_table_row_of_another_width_is_refused(tmp_path):
    path = csv(tmp_path / "a.csv")
    path.write_text(path.read_text() + "9,1,2,3\n")
    refused(path, "Row #1602: Expected 5 columns, got 4")


def test_ticks_are_not_called_degrees():
    with pytest.raises(CalibrationError) as error:
        read_log(outside("ticks.csv"))
    assert "ticks of 4096 a turn (651.9 a radian)" in str(error.value)
    assert "degrees (" not in str(error.value)


@pytest.mark.parametrize(
    ("factor", "whole", "possible", "impossible"),
    [
        (1000.0, False, "milliradians (1000 a radian)", " degrees ("),
        (18_000 / np.pi, False, "centidegrees (5730 a radian)", " degrees ("),
        (180 / np.pi, False, "degrees (57.3 a radian)", "something else"),
        (16384 / (2 * np.pi), True, "ticks of 16384 a turn (2608 a radian)", "degrees ("),
        (65536 / (2 * np.pi), True, "ticks of 65536 a turn (1.043e+04 a radian)", " degrees ("),
        (1000.0, True, "milliradians (1000 a radian)", "degrees ("),
        (0.4 * 180 / np.pi, False, "degrees (57.3 a radian)", "something else"),
    ],
)
def test_a_unit_is_named_only_where_it_can_be(factor, whole, possible, impossible, tmp_path):
    turned = {f"{name.replace('.', '__')}": factor * np.array(x) for name, x in columns().items() if name != "t"}
    path = parquet(tmp_path / "a.parquet", **({n: np.round(x) for n, x in turned.items()} if whole else turned))
    refused(path, "not radians", possible)
    with pytest.raises(CalibrationError) as error:
        read_log(path)
    assert impossible not in str(error.value)


def test_percent_of_a_range_are_named(tmp_path):
    turned = {f"{name.replace('.', '__')}": 60 * np.array(x) for name, x in columns().items() if name != "t"}
    refused(parquet(tmp_path / "a.parquet", **turned), "degrees (57.3 a radian)", "or percent of the joint's range")


def test_a_number_that_stands_for_no_reading_is_none():
    log = read_log(outside("missing_is_9999.csv", "outside_2"))
    check = check_log(log)
    assert "q.a is 9999 in 8 of 700 rows, which is no reading" in check.warnings
    assert np.nanmax(np.abs(check.log.q)) < 1.0


@pytest.mark.parametrize(("mark", "rows"), [(9999.0, slice(30, 1000, 97)), (-1e30, slice(0, 40)), (65535.0, [5, 9])])
def test_any_far_number_that_occurs_again_is_no_reading(mark, rows, tmp_path):
    q = np.array(ANGLES[:, 0])
    q[rows] = mark
    check = check_log(read_log(parquet(tmp_path / "a.parquet", q__a=q)))
    assert f"q.a is {mark:.10g} in {np.sum(q == mark)} of {len(q)} rows, which is no reading" in check.warnings


def test_numbers_that_a_joint_may_come_to_are_readings(tmp_path):
    q = np.array(ANGLES[:, 0])
    q[q > 0.9 * q.max()] = 0.9 * q.max()
    log = read_log(parquet(tmp_path / "a.parquet", q__a=q))
    assert without_marks(log)[1] == []
    assert np.array_equal(without_marks(log)[0].q, log.q)


@pytest.mark.parametrize("steps", [1024, 16384])
def test_turns_of_an_encoder_are_not_radians(steps, tmp_path):
    turned = np.round(ANGLES / (2 * np.pi) * steps) / steps
    path = parquet(tmp_path / "a.parquet", q__a=turned[:, 0], q__b=turned[:, 1])
    refused(path, f"q.a has steps of 1/{steps}", "turns", "factor of 6.28")
    assert read_log(path, {"units": "rad"}).q == pytest.approx(turned)
    in_degrees = parquet(tmp_path / "c.parquet", q__a=360 * turned[:, 0], q__b=360 * turned[:, 1])
    refused(in_degrees, "not radians", "degrees (57.3 a radian)")
    ticks = np.round(ANGLES / (2 * np.pi) * steps) * 2 * np.pi / steps
    read_log(parquet(tmp_path / "b.parquet", q__a=ticks[:, 0], q__b=np.round(ticks[:, 1], 4)))


@pytest.mark.parametrize("bits", [10, 16, 32])
def test_ticks_with_a_sign_bit_are_said(bits, tmp_path):
    ticks = np.round(ANGLES * 4096 / (2 * np.pi)).astype(np.int64)
    ticks = np.where(ticks < 0, 2**bits - ticks, ticks)
    refused(parquet(tmp_path / "a.parquet", q__a=ticks[:, 0], q__b=ticks[:, 1]), "sign bit")


def test_a_reading_that_jumps_is_refused_with_row_and_size():
    path = outside("jump_40deg.csv")
    table = np.genfromtxt(path, delimiter=",", names=True, deletechars="")
    steps = np.diff(table["q.a"])
    row = int(np.abs(steps).argmax())
    refused(path, f"row {row + 2}", f"{steps[row]:+.3f}")


@pytest.mark.parametrize("turns", [1, -2, 5])
def test_an_encoder_that_wraps_around_by_any_number_of_turns_is_said(turns, tmp_path):
    q = ANGLES[:, 1] + 2 * np.pi * turns * (T >= 3)
    refused(parquet(tmp_path / "a.parquet", q__b=q), "q.b jumps by", "row 601", f"{abs(turns)} turn", "unwrap")


@pytest.mark.parametrize("size", [0.2, -0.35, 1.57])
def test_a_jump_of_any_size_is_refused(size, tmp_path):
    noise = np.random.default_rng(1).normal(0, 3e-4, len(T))
    refused(parquet(tmp_path / "a.parquet", q__a=ANGLES[:, 0] + noise + size * (T >= 5)), "q.a jumps by", "row 1001")


def test_a_jump_with_a_reading_on_its_way_is_refused(tmp_path):
    q = ANGLES[:, 0] + 0.6 * np.clip((T - 3.0) / 0.01, 0.0, 1.0)
    refused(parquet(tmp_path / "a.parquet", q__a=q), "q.a jumps by", "row 603")


def test_a_single_reading_that_is_off_and_a_step_of_a_target_are_no_jumps(tmp_path):
    q = np.array(ANGLES[:, 0])
    q[700] += 0.9
    log = read_log(parquet(tmp_path / "a.parquet", q__a=q, q_des__b=ANGLES[:, 1] + (T >= 5)))
    assert log.q[700, 0] == pytest.approx(q[700])


def test_a_clock_of_32_bits_is_refused():
    refused(outside("clock_float32_epoch.parquet"), "32 bits", "128 s")


@pytest.mark.parametrize(
    ("t", "words"),
    [
        (np.zeros(len(T)), ["equal in 1600 of 1600 rows; store"]),
        ((1.7e9 + T).astype(np.float32), ["32 bits"]),
        ((9e4 + T).astype(np.float32), ["32 bits step by 0.00781 s"]),
        (T + 3600.0 * (T > 2), ["jump by 3600.0", "row 401"]),
        (1e3 * T, ["5 s apart", "milliseconds"]),
        (1e6 * T, ["microseconds"]),
        (np.where(T > 2, T - 1, T), ["do not increase", "row 402"]),
    ],
)
def test_a_clock_of_a_log_that_cannot_be_true_is_refused(t, words, tmp_path):
    refused(parquet(tmp_path / "a.parquet", t=t), *words)


def test_a_few_rows_read_twice_are_no_fault_of_the_clock(tmp_path):
    t = np.array(T)
    t[100] = t[101]
    assert len(read_log(parquet(tmp_path / "a.parquet", t=t)).t) == len(T)


# ---------------------------------------------------------------------- models


PENDULUMS = """<mujoco><worldbody>
<body name="ba"><joint name="a" axis="0 1 0"/><inertial pos="0 0 -0.15" mass="0.3" diaginertia="1e-4 1e-4 1e-4"/>
<site name="s"/></body><body name="bb" pos="0.5 0 0"><joint name="b" axis="0 1 0"/>
<inertial pos="0 0 -0.15" mass="0.3" diaginertia="1e-4 1e-4 1e-4"/></body></worldbody>
<actuator>{a}{b}</actuator>{more}</mujoco>"""


def said_of_the_model(path: Path, tmp_path: Path) -> str:
    log = read_log(parquet(tmp_path / "log.parquet"), {"kp": 8.0, "kd": 0.3})
    said = checked_log(log, path, lambda *_: None)[2]
    return " ".join(line for line in said if "leaves out" in line)


def test_what_a_replay_drops_of_a_model_is_said(tmp_path):
    assert "timeconst" in said_of_the_model(outside("act_timeconst.xml"), tmp_path)
    assert "actuators a, b" in said_of_the_model(outside("act_timeconst.xml"), tmp_path)
    assert said_of_the_model(outside("two_pendulums.xml"), tmp_path) == ""


@pytest.mark.parametrize(
    ("a", "more", "said"),
    [
        ('<position joint="a" kp="8"/>', "", ""),
        ('<position joint="a" kp="8" ctrlrange="-1 1"/>', "", "ranges of targets (ctrlrange) of the actuators a"),
        ('<general joint="a" dyntype="filter" dynprm=".1"/>', "", "activation dynamics (timeconst) of the actuators a"),
        ('<motor name="jet" site="s" gear="0 0 1 0 0 0"/>', "", "(at no joint) of the actuators jet"),
        ('<damper joint="a" kv="2" ctrlrange="0 1"/>', "", "gains depend on the state) of the actuators a"),
        ('<motor joint="a"/>', '<sensor><jointpos joint="a"/><gyro site="s"/></sensor>', "2 sensors"),
    ],
)
def test_each_part_that_a_replay_drops_is_named(a, more, said, tmp_path):
    (tmp_path / "a.xml").write_text(PENDULUMS.format(a=a, b='<position joint="b" kp="8"/>', more=more))
    found = said_of_the_model(tmp_path / "a.xml", tmp_path)
    assert said in found if said else not found


def test_the_range_of_a_motor_bounds_its_torque(tmp_path):
    motors = '<motor joint="a" gear="20" ctrlrange="-.4 .4"/>', '<motor joint="b" gear="10" forcerange="-.2 .2"/>'
    (tmp_path / "a.xml").write_text(PENDULUMS.format(a=motors[0], b=motors[1], more=""))
    assert read_machine(tmp_path / "a.xml").drives.torque == pytest.approx([8.0, 2.0])


SAME_MACHINE = {
    "plain.xml": "",
    "default_position.xml": "",
    "default_limited.xml": "ranges of targets (ctrlrange) of the actuators a",
    "actuator_armature.xml": "",
    "general_offset.xml": "constant forces (biasprm) of the actuators a",
}


@pytest.mark.parametrize("name", SAME_MACHINE)
def test_models_that_say_the_same_machine_are_the_same_machine(name):
    plain, found = (read_machine(outside(file, "outside_2")) for file in ("plain.xml", name))
    for field in ("dof_armature", "dof_damping", "actuator_gainprm", "actuator_gear", "actuator_forcelimited"):
        assert np.array_equal(getattr(found.model, field), getattr(plain.model, field)), field
    assert (found.drives.kp, found.drives.kd) == (plain.drives.kp, plain.drives.kd)
    assert list(found.dropped) == ([SAME_MACHINE[name]] if SAME_MACHINE[name] else [])


@pytest.mark.slow  # 3 s a model
def test_models_that_say_the_same_machine_predict_the_same():
    log = outside("one_joint.csv", "outside_2")
    found = [predict_log(log, model=outside(name, "outside_2")) for name in SAME_MACHINE]
    assert len({predicted.errors["as given"]["all"] for predicted in found}) == 1


def test_what_a_simulated_log_leaves_out_of_a_model_is_said(tmp_path):
    servos = '<position joint="a" kp="8" ctrlrange="-1 1"/>', '<position joint="b" kp="8" kv=".3"/>'
    (tmp_path / "a.xml").write_text(PENDULUMS.format(a=servos[0], b=servos[1], more=""))
    heard = Heard()
    with pytest.raises(ConfigError, match="has no range"):
        simulate_log(model=tmp_path / "a.xml", reporter=heard)
    assert heard.said == ["mimic leaves out of the model: ranges of targets (ctrlrange) of the actuators a"]


# ---------------------------------------------------------------------- sources


@pytest.mark.parametrize("address", ["https://somewhere.example/dance.mp4", "rtsp://192.168.0.2/stream"])
@pytest.mark.parametrize("open_it", [load_motion, check_camera])
def test_an_address_as_source_says_what_to_do(address, open_it):
    with pytest.raises(SourceError) as error:
        open_it(address)
    one_line(error, "address", "download")


def test_a_second_video_is_refused_where_there_is_no_first_one(tmp_path):
    two = InputSettings(pose=PoseSettings(also=Path("side.mp4")))
    (tmp_path / "a.bvh").write_text(bvh())
    for play in (
        lambda: load_motion(tmp_path / "a.bvh", two),
        lambda: motion_from_text("wave the left hand", two),
        lambda: batch(tmp_path, tmp_path / "out", two),
        lambda: follow_camera("0", two, LiveSettings(), description=load_description("cyberdog2")).__enter__(),
    ):
        with pytest.raises(ConfigError) as error:
            play()
        one_line(error, "--also gives the second of two videos", "leave it out")


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_settings_are_read_in_any_encoding(encoding, tmp_path):
    (tmp_path / "a.toml").write_text("[retarget]\nrate = 0.2\n", encoding=encoding)
    assert read_toml(tmp_path / "a.toml") == {"retarget": {"rate": 0.2}}


# ---------------------------------------------------------------------- tracks from a program


def wrists(scale: float = 1.0, rate: float = 50.0, arm: float = 0.6) -> WristTrack:
    t = np.arange(200) / rate
    swing = np.stack([0.6 * np.sin(2 * np.pi * 0.01 * np.arange(200)), np.full(200, 0.1), np.full(200, -0.7)], -1)
    p = scale * np.stack([swing, swing * [1, -1, 1]], axis=1)
    return WristTrack(t=t, p_SH=p, heading=np.zeros(200), valid=np.ones((200, 2), bool), arm_length=arm)


class Heard(SilentReporter):
    """Keeps the warnings."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def warn(self, text: str) -> None:
        self.said.append(text)


@pytest.mark.parametrize(("scale", "said"), [(600.0, "556 arm lengths"), (0.01, "arm lengths")])
def test_wrists_in_another_unit_are_refused(scale, said):
    with pytest.raises(SourceError) as error:
        retarget(wrists(scale))
    one_line(error, said, "divide them by the length of the arm")


def test_stored_targets_in_another_unit_are_refused():
    targets = retarget(wrists())
    for wrong, said in (
        (replace(targets, t=1e3 * targets.t), "milliseconds"),
        (replace(targets, t=targets.t / 60), "another unit"),
        (replace(targets, p_BE=1e3 * targets.p_BE), "in metres"),
        (replace(targets, heading=np.append(np.nan, targets.heading[1:])), "row 1 of the motion holds a number"),
        (replace(targets, p_BE=np.full_like(targets.p_BE, np.nan)), "row 1 of the motion holds a number"),
    ):
        for track in (wrong, command_track(wrong)):
            with pytest.raises(SourceError) as error:
                as_motion(track)
            one_line(error, said)


@pytest.mark.parametrize(("rate", "said"), [(0.05, "20 s apart"), (1e6, "1e-06 s apart")])
def test_times_of_wrists_in_another_unit_are_refused(rate, said):
    with pytest.raises(SourceError) as error:
        retarget(wrists(rate=rate))
    one_line(error, said)


@pytest.mark.parametrize(("change", "said"), [({"rate": 1500.0}, "arm lengths a second"), ({}, None)])
def test_hands_that_are_too_fast_are_said(change, said):
    heard = Heard()
    retarget(wrists(**change), reporter=heard)
    assert any(said in text for text in heard.said) if said else not heard.said


@pytest.mark.parametrize(
    ("turned", "said"),
    [
        (lambda p: p[:, ::-1], "the sides are exchanged"),
        (lambda p: p[..., [0, 2, 1]] * [1, 1, -1], "if y is up or down"),
        (lambda p: p, None),
    ],
)
def test_exchanged_sides_and_another_axis_up_are_said(turned, said):
    spread = wrists()
    out = np.nan_to_num(spread.p_SH) * 0.1 + [[0.0, 0.6, -0.7], [0.0, -0.6, -0.7]]
    heard = Heard()
    retarget(replace(spread, p_SH=turned(out)), reporter=heard)
    assert any(said in text for text in heard.said) if said else not heard.said


@pytest.mark.parametrize("arm", [0.0, 17.0, 600.0])
def test_arms_of_no_persons_length_are_refused(arm):
    with pytest.raises(SourceError) as error:
        retarget(wrists(arm=arm))
    one_line(error, f"{arm:g} m long")
