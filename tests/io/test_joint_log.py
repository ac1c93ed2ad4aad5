import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from mimic.errors import CalibrationError
from mimic.io.joint_log import JointLog, is_joint_log, read_log, write_log


@pytest.fixture
def log() -> JointLog:
    t = 1.7e9 + 0.005 * np.arange(40)
    q = np.stack([np.sin(t), np.cos(t)], -1)
    return JointLog(
        joints=("a", "b"),
        t=t,
        q=q,
        q_des=q + 0.1,
        tau=2 * q,
        extra={"temperature.a": np.linspace(30, 31, 40)},
        metadata={"kp": {"a": 30.0, "b": 20.0}, "kd": 3.0, "note": "hung up"},
    )


@pytest.mark.parametrize("name", ["log.parquet", "log.csv"])
def test_a_log_comes_back_as_it_was(log: JointLog, tmp_path: Path, name: str) -> None:
    again = read_log(write_log(log, tmp_path / name))
    assert again.joints == log.joints
    assert again.dq is None
    for channel in ("t", "q", "q_des", "tau"):
        assert getattr(again, channel) == pytest.approx(getattr(log, channel), rel=1e-8)
    assert np.diff(again.t) == pytest.approx(np.diff(log.t), abs=1e-6)
    assert again.extra["temperature.a"] == pytest.approx(log.extra["temperature.a"])
    assert again.metadata == log.metadata


def test_rows_and_joints_are_picked_together(log: JointLog) -> None:
    part = log.part(slice(10, 20)).of(["b"])
    assert part.joints == ("b",)
    assert np.array_equal(part.q[:, 0], log.q[10:20, 1])
    assert len(part.extra["temperature.a"]) == 10


def test_arrays_cannot_be_changed(log: JointLog) -> None:
    with pytest.raises(ValueError, match="read-only"):
        log.q[0] = 0.0


def test_a_joint_that_the_log_lacks_is_named(log: JointLog) -> None:
    with pytest.raises(CalibrationError, match="the model has joint 'c', but the log has a, b"):
        log.of(["a", "c"])


def test_a_channel_of_another_shape_is_refused(log: JointLog) -> None:
    with pytest.raises(CalibrationError, match=r"tau of the log has shape \(40, 1\), expected \(40, 2\)"):
        replace(log, tau=np.zeros((40, 1)))


def test_two_joints_of_one_name_are_refused(log: JointLog) -> None:
    with pytest.raises(CalibrationError, match="the same name"):
        replace(log, joints=("a", "a"))


@pytest.mark.parametrize(
    ("columns", "reason"),
    [
        (["q.a", "q_des.a"], "no column t"),
        (["t", "q_a", "qdes_a"], r"no column q\.<joint>"),
        (["t", "q.a"], r"neither q_des\.<joint> nor force\.<joint>"),
        (["t", "q.a", "q.b", "q_des.a"], r"has q_des\.a but no q_des\.b"),
        (["t", "q.a", "q_des.a", "tau.b"], r"has tau\.b, but no q\.b"),
    ],
)
def test_a_missing_column_is_named(tmp_path: Path, columns: list[str], reason: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(",".join(columns) + "\n" + ",".join("0" for _ in columns) + "\n")
    with pytest.raises(CalibrationError, match=reason):
        read_log(path)


@pytest.mark.parametrize(
    ("notes", "reason"),
    [
        ("[1]", "holds a list"),
        ("{", "is not JSON"),
        ('{"kp": "stiff"}', "kp is 'stiff'"),
        ('{"kd": {"a": -1}}', "kd is"),
    ],
)
def test_notes_that_cannot_be_gains_are_refused(log: JointLog, tmp_path: Path, notes: str, reason: str) -> None:
    path = write_log(log, tmp_path / "log.csv")
    path.with_suffix(".json").write_text(notes)
    with pytest.raises(CalibrationError, match=reason):
        read_log(path)


def test_notes_beside_a_parquet_file_win(log: JointLog, tmp_path: Path) -> None:
    path = write_log(log, tmp_path / "log.parquet")
    path.with_suffix(".json").write_text(json.dumps({"kd": 1.5}))
    assert read_log(path).metadata["kd"] == 1.5
    assert read_log(path).metadata["note"] == "hung up"


def test_what_is_no_log_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.parquet").write_text("not parquet")
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "header.csv").write_text("t,q.a,q_des.a\n")
    (tmp_path / "semicolons.csv").write_text("t;q.a;q_des.a\n0;1;2\n")
    pq.write_table(pa.table([pa.array([0.0]), pa.array([0.0])], names=["t", "t"]), tmp_path / "twice.parquet")
    for name, reason in (
        ("text.parquet", "cannot be read as Parquet"),
        ("empty.csv", "cannot be read as CSV with a header line: Empty CSV file"),
        ("header.csv", "has a header, but no rows"),
        ("semicolons.csv", "has ';' between its columns"),
        ("twice.parquet", "cannot be read as Parquet"),
        ("missing.csv", "does not exist"),
        ("", "folder without joints.parquet"),
    ):
        with pytest.raises(CalibrationError, match=reason):
            read_log(tmp_path / name)


def test_missing_values_become_nan(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t,q.a,q_des.a\n0,1,2\n0.01,,2\n")
    assert np.isnan(read_log(path).q[1, 0])


def test_the_rate_is_that_of_the_clock_without_gaps() -> None:
    t = np.cumsum(np.tile([0.000998, 0.000998, 0.001004], 1000))  # a median of 0.998 ms, a mean of 1 ms
    t[2000:] += 0.7
    log = JointLog(joints=("a",), t=t, q=np.zeros((3000, 1)), q_des=np.zeros((3000, 1)))
    assert log.rate == pytest.approx(1000.0, rel=1e-5)


def test_angles_in_degrees_are_reported_by_a_note(log: JointLog, tmp_path: Path) -> None:
    assert log.q_des is not None
    degrees = replace(log, q=np.rad2deg(log.q), q_des=np.rad2deg(log.q_des), metadata={**log.metadata, "units": "deg"})
    found = read_log(write_log(degrees, tmp_path / "log.parquet"))
    assert found.q == pytest.approx(log.q)
    assert found.q_des == pytest.approx(log.q_des)
    assert read_log(write_log(found, tmp_path / "again.parquet")).q == pytest.approx(log.q)


@pytest.mark.parametrize(
    ("note", "reason"),
    [
        ('{"units": "grad"}', "units is 'grad'; expected"),
        ('{"gravity": 9.81}', r"gravity is 9.81; expected \[x, y, z\]"),
        ('{"gravity": [0, 0]}', "gravity is"),
    ],
)
def test_notes_of_units_and_gravity_must_be_such(log: JointLog, tmp_path: Path, note: str, reason: str) -> None:
    path = write_log(log, tmp_path / "log.csv")
    (tmp_path / "log.json").write_text(note)
    with pytest.raises(CalibrationError, match=reason):
        read_log(path)


@pytest.mark.parametrize(
    ("kp", "reason"),
    [({"a": 5.0}, "has no kp for b"), ({"a": 5.0, "b": 5.0, "c": 5.0}, "has a kp for c")],
)
def test_gains_by_joint_are_those_of_the_joints(tmp_path: Path, kp: dict[str, float], reason: str) -> None:
    t = np.arange(3.0)
    q = np.zeros((3, 2))
    path = write_log(JointLog(joints=("a", "b"), t=t, q=q, q_des=q, metadata={"kp": kp}), tmp_path / "log.csv")
    with pytest.raises(CalibrationError, match=reason):
        read_log(path)


def test_the_snippet_of_the_documentation_writes_a_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).parents[2] / "docs" / "manual" / "log-format.md").read_text(encoding="utf-8")
    section = page.split("## From another logger")[1]
    snippet = "\n".join(line[4:] for line in section.splitlines() if line.startswith("    "))
    monkeypatch.chdir(tmp_path)
    exec(compile(snippet, "log-format.md", "exec"), {})
    log = read_log("log.parquet")
    assert log.joints == ("hip", "knee")
    assert log.metadata["kp"] == 20.0


def test_a_joint_log_is_known_by_its_file(log: JointLog, tmp_path: Path) -> None:
    assert is_joint_log(write_log(log, tmp_path / "log.parquet"))
    assert not is_joint_log(write_log(log, tmp_path / "log.csv"))
    assert not is_joint_log(tmp_path / "none.parquet")


def test_lists_of_one_number_are_columns_of_one_joint(tmp_path: Path) -> None:
    rows = np.linspace(0.0, 1.0, 20)
    lists = pa.array([[value] for value in rows], pa.list_(pa.float64()))
    path = tmp_path / "one.parquet"
    pq.write_table(pa.table({"t": 0.01 * np.arange(20), "q.knee": lists, "q_des.knee": lists}), path)
    log = read_log(path)
    assert log.joints == ("knee",)
    assert log.q[:, 0] == pytest.approx(rows)
