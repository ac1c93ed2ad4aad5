"""Runs as a LeRobotDataset v3 (by its published schema), CSV and NPZ."""

from __future__ import annotations

import dataclasses
import json
import sys
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from mimic.cli import main
from mimic.config.play import RunSettings
from mimic.errors import AssetError, ConfigError, MissingExtra
from mimic.flows.export import export
from mimic.flows.motions.motion import motion_from_text
from mimic.flows.play import play
from mimic.flows.reporter import SilentReporter
from mimic.flows.run_folder import save_logs, save_motion
from mimic.io import store
from mimic.records import JOINTS, RunLog


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A short run in simulation, without its scene."""
    folder = tmp_path_factory.mktemp("runs") / "wave"
    motion = motion_from_text("raise the left hand")
    played = play(motion, settings=RunSettings(hold_last=0.0))
    made_by = store.provenance(command="test")
    save_logs(played, folder, made_by)
    save_motion(motion, folder, made_by)
    return folder


@pytest.fixture(scope="module")
def log(run) -> RunLog:
    return store.load(run / "log.parquet", RunLog)


@pytest.fixture
def batch(run, tmp_path) -> Path:
    """The folder of a batch with that run twice."""
    for name in ("one-0123456789ab", "two-0123456789ab"):
        (tmp_path / "out" / "items" / name).mkdir(parents=True)
        (tmp_path / "out" / "items" / name / "log.parquet").write_bytes((run / "log.parquet").read_bytes())
    return tmp_path / "out"


def test_a_dataset_has_the_log_in_the_published_layout(run, log, tmp_path):
    export(run, tmp_path / "ds", video=False)
    info = json.loads((tmp_path / "ds/meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0"
    assert (info["fps"], info["total_episodes"], info["total_frames"]) == (50, 1, len(log.t))
    assert info["features"]["action"]["names"] == [f"{name}.pos" for name in JOINTS]
    table = pq.read_table(tmp_path / "ds" / info["data_path"].format(chunk_index=0, file_index=0))
    assert set(table.column_names) == set(info["features"])
    np.testing.assert_allclose(np.array(table["action"].to_pylist()), log.q_des, atol=1e-6)
    np.testing.assert_allclose(np.array(table["observation.state"].to_pylist())[:, :12], log.q, atol=1e-6)
    np.testing.assert_allclose(table["timestamp"].to_numpy(), log.t - log.t[0], atol=1e-4)
    tasks = pq.read_table(tmp_path / "ds/meta/tasks.parquet")
    assert tasks["task"].to_pylist() == ["raise the left hand"]
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]
    stats = json.loads((tmp_path / "ds/meta/stats.json").read_text())
    np.testing.assert_allclose(stats["action"]["mean"], log.q_des.mean(axis=0), atol=1e-9)


def test_runs_of_a_batch_are_episodes_of_one_dataset(batch, log):
    export(batch, batch / "lerobot", video=False)
    episodes = pq.read_table(batch / "lerobot/meta/episodes/chunk-000/file-000.parquet").to_pylist()
    rows = len(log.t)
    assert [row["length"] for row in episodes] == [rows, rows]
    assert [(row["dataset_from_index"], row["dataset_to_index"]) for row in episodes] == [(0, rows), (rows, 2 * rows)]
    assert [row["tasks"] for row in episodes] == [["follow one"], ["follow two"]]
    second = pq.read_table(batch / "lerobot/data/chunk-000/file-001.parquet")
    assert second["index"].to_pylist() == list(range(rows, 2 * rows))
    assert set(second["episode_index"].to_pylist()) == {1}
    stats = json.loads((batch / "lerobot/meta/stats.json").read_text())
    np.testing.assert_allclose(stats["action"]["std"], log.q_des.std(axis=0), atol=1e-9)
    assert stats["action"]["count"] == [2 * rows]


@pytest.mark.slow
def test_each_row_of_a_dataset_has_its_frame(run, log, tmp_path, monkeypatch):
    av = pytest.importorskip("av")
    monkeypatch.setattr("mimic.flows.export.PICTURE", (48, 64))
    seen = []
    reporter = SilentReporter()
    reporter.progress = lambda what: nullcontext(lambda done, total: seen.append((done, total)))
    export(run, tmp_path / "ds", reporter=reporter)
    assert seen == [(row + 1, len(log.t)) for row in range(len(log.t))]
    with av.open(str(tmp_path / "ds/videos/observation.images.side/chunk-000/file-000.mp4")) as film:
        frames = list(film.decode(video=0))
    np.testing.assert_allclose([float(frame.time) for frame in frames], np.arange(len(log.t)) / 50, atol=1e-4)
    assert (frames[0].height, frames[0].width) == (48, 64)
    colours = np.stack([frame.to_ndarray(format="rgb24") for frame in frames]) / 255
    stats = json.loads((tmp_path / "ds/meta/stats.json").read_text())["observation.images.side"]
    np.testing.assert_allclose(np.ravel(stats["mean"]), colours.mean(axis=(0, 1, 2)), atol=0.02)


def test_csv_and_npz_have_every_column(run, log, tmp_path):
    assert main(["export", str(run), "--format", "csv", "-o", str(tmp_path / "a.csv")]) == 0
    export(run, tmp_path / "a.npz", "npz")
    table = np.genfromtxt(tmp_path / "a.csv", delimiter=",", names=True, deletechars="")
    np.testing.assert_allclose(table["q.FL_knee"], log.q[:, JOINTS.index("FL_knee")], atol=1e-6)
    np.testing.assert_allclose(table["p_BE_des.right.z"], log.p_BE_des[:, 1, 2], atol=1e-6)
    arrays = np.load(tmp_path / "a.npz")
    assert np.array_equal(arrays["q_sent"], log.q_sent)
    assert arrays["joint_names"].tolist() == list(JOINTS)


def test_what_cannot_be_exported_is_reported_and_nothing_is_written(run, batch, tmp_path):
    (tmp_path / "there").mkdir()
    for source, out, form, error, message in [
        (tmp_path / "there", "ds", "lerobot", AssetError, "there is no run in"),
        (run, "there", "lerobot", ConfigError, "exists; name another place"),
        (run, "a.txt", "csv", ConfigError, "ends with .csv"),
        (run, "a.npz", "lerobot", ConfigError, "name of a folder"),
        (batch, "a.npz", "npz", ConfigError, "holds 2 runs"),
        (batch, "a.csv", "csv", ConfigError, "holds 2 runs"),
    ]:
        with pytest.raises(error, match=message):
            export(source, tmp_path / out, form)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "there"]


def test_a_run_of_one_tick_is_no_dataset(log, tmp_path):
    arrays = {f.name: getattr(log, f.name)[:1] for f in dataclasses.fields(log) if "axes" in f.metadata}
    store.save(dataclasses.replace(log, **arrays), tmp_path / "run/log.parquet", made_by=store.provenance())
    with pytest.raises(AssetError, match="has 1 tick"):
        export(tmp_path / "run", tmp_path / "ds", video=False)
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_a_dataset_that_cannot_be_finished_is_not_there(run, log, tmp_path, monkeypatch):
    def broken(*arguments: object) -> None:
        raise OSError("no space left")

    monkeypatch.setattr("mimic.io.lerobot._save_tasks", broken)
    with pytest.raises(OSError, match="no space left"):
        export(run, tmp_path / "ds", video=False)
    assert list(tmp_path.iterdir()) == []


def test_an_mcap_file_is_read_back_by_the_readers_of_mcap(run, log, tmp_path):
    from mcap_ros2.reader import read_ros2_messages

    assert main(["export", str(run), "--format", "mcap", "-o", str(tmp_path / "run.mcap")]) == 0
    found: dict[str, list] = {}
    for message in read_ros2_messages(str(tmp_path / "run.mcap")):
        found.setdefault(message.channel.topic, []).append(message)
    assert set(found) == {"/joint_states", "/joint_commands", "/tf", "/left_toe_target", "/right_toe_target"}
    states = [one.ros_msg for one in found["/joint_states"]]
    assert tuple(states[0].name) == JOINTS
    np.testing.assert_array_equal([one.position for one in states], log.q)
    np.testing.assert_array_equal([one.effort for one in states], log.tau)
    np.testing.assert_array_equal([one.ros_msg.position for one in found["/joint_commands"]], log.q_des)
    np.testing.assert_allclose([one.log_time_ns / 1e9 for one in found["/tf"]], log.t, atol=1e-8)
    base = found["/tf"][-1].ros_msg.transforms[0]
    moved, turned = base.transform.translation, base.transform.rotation
    np.testing.assert_allclose([moved.x, moved.y, moved.z], log.p_WB[-1])
    np.testing.assert_allclose([turned.w, turned.x, turned.y, turned.z], log.quat_WB[-1])
    assert len(found["/tf"][-1].ros_msg.transforms) >= 13
    left = [one.ros_msg.point for one in found["/left_toe_target"]]
    asked = log.p_BE_des[np.isfinite(log.p_BE_des[:, 0]).all(axis=1), 0]
    np.testing.assert_array_equal([[p.x, p.y, p.z] for p in left], asked)
    assert found["/left_toe_target"][0].ros_msg.header.frame_id == base.child_frame_id


def test_without_the_mcap_library_its_package_is_named(run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mcap_ros2.writer", None)
    with pytest.raises(MissingExtra, match="pip install 'mcap-ros2-support"):
        export(run, tmp_path / "run.mcap", "mcap")
    assert list(tmp_path.iterdir()) == []
