"""Many files at once: played, resumed, interrupted, and listed where they fail."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from mimic.cli import main
from mimic.io import store
from mimic.records import PoseTrack, TargetTrack

STANDING = {
    "left_shoulder": (0.0, 0.2, 1.4),
    "right_shoulder": (0.0, -0.2, 1.4),
    "left_wrist": (0.3, 0.2, 1.2),
    "right_wrist": (0.3, -0.2, 1.2),
    "left_hip": (0.0, 0.1, 0.9),
    "right_hip": (0.0, -0.1, 0.9),
}
OPTIONS = ["--config", str(Path(__file__).parents[1] / "quick.toml"), "--workers", "1"]


def someone(path: Path, sway: float, rows: int = 30) -> Path:
    points = {name: np.zeros((rows, 3)) + place for name, place in STANDING.items()}
    points["left_wrist"] = points["left_wrist"] + sway * np.sin(0.3 * np.arange(rows))[:, None] * [1.0, 0.0, 1.0]
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, points=np.stack(list(points.values()), axis=1), names=list(points), fps=50)
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Two people, a copy, a file that is none, and what is not to be played."""
    where = tmp_path_factory.mktemp("batch") / "in"
    one = someone(where / "one.npz", 0.1)
    someone(where / "deep" / "two [b].npz", 0.2)
    shutil.copy(one, where / "deep" / "copy of one.npz")
    (where / "broken.trc").write_text("<script>alert(1)</script>")
    (where / "notes.txt").write_text("not to be played")
    (where / ".hidden.npz").write_text("not to be played")
    nobody = PoseTrack(
        t=np.zeros(0),
        landmarks=np.zeros((0, 33, 3)),
        image=np.zeros((0, 33, 2)),
        score=np.zeros((0, 33)),
        valid=np.zeros((0, 33), dtype=bool),
        swapped=np.zeros(0, dtype=bool),
    )
    store.save(nobody, where / "nobody.parquet", made_by=store.provenance())
    return where


@pytest.fixture(scope="module")
def played(folder) -> tuple[int, Path]:
    out = folder.parent / "out"
    left_by_a_kill(out).mkdir(parents=True)
    return main(["batch", str(folder), "-o", str(out), *OPTIONS]), out


def left_by_a_kill(out: Path) -> Path:
    return out / "items" / ".a-0123.99.part"


def rows(out: Path) -> dict[str, dict[str, Any]]:
    return {row["file"]: row for row in pq.read_table(out / "summary.parquet").to_pylist()}


@pytest.mark.slow
def test_every_file_has_a_row_and_what_fails_stops_nothing(played):
    status, out = played
    assert status == 4
    found = rows(out)
    assert {name: row["status"] for name, row in found.items()} == {
        "broken.trc": "failed",
        "deep/copy of one.npz": "done",
        "deep/two [b].npz": "done",
        "nobody.parquet": "failed",
        "one.npz": "done",
    }
    assert "must start with PathFileType" in found["broken.trc"]["error"]
    assert found["nobody.parquet"]["error"]


@pytest.mark.slow
def test_a_row_holds_the_figures_of_its_own_folder(played):
    _, out = played
    row = rows(out)["deep/two [b].npz"]
    item = out / row["folder"]
    targets = store.load(item / "targets.parquet", TargetTrack)
    assert row["clamped_share"] == targets.report["clamped_share"]
    assert row["length_s"] == pytest.approx(targets.t[-1])
    assert 0 < row["toe_error_cm"] < 15
    assert row["standing_share"] > 0.9
    assert row["rows_with_person"] == 1.0
    assert {path.name for path in item.iterdir()} == {
        "targets.parquet",
        "log.parquet",
        "health.parquet",
        "joints.parquet",
        "metrics.json",
    }


@pytest.mark.slow
def test_the_page_stands_alone_and_shows_names_as_they_are(played):
    page = (played[1] / "summary.html").read_text()
    assert "two [b].npz" in page
    assert "must start with PathFileType" in page
    assert "http" not in page
    assert "<script" not in page


@pytest.mark.slow
def test_what_is_finished_is_not_played_again_and_what_failed_is_tried_again(played, folder, capsys):
    _, out = played
    before = {path: path.stat().st_mtime_ns for path in (out / "items").rglob("*") if path.is_file()}
    someone(folder / "three.npz", 0.15)
    try:
        assert main(["batch", str(folder), "-o", str(out), *OPTIONS]) == 4
    finally:
        (folder / "three.npz").unlink()
    assert "3 of 6 files were finished before" in capsys.readouterr().out
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert rows(out)["three.npz"]["status"] == "done"
    assert rows(out)["one.npz"]["toe_error_cm"] is not None


@pytest.mark.slow
def test_another_setting_is_another_result(played, folder, tmp_path):
    _, out = played
    copy = tmp_path / "out"
    shutil.copytree(out, copy)
    assert main(["batch", str(folder), "-o", str(copy), *OPTIONS, "--rate", "0.2"]) == 4
    assert rows(copy)["one.npz"]["folder"] != rows(out)["one.npz"]["folder"]
    assert (copy / rows(out)["one.npz"]["folder"]).is_dir()


def listening() -> None:
    """Hear Ctrl-C also where the tests run in the background of a shell, which ignores it for its children."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.mark.slow
def test_ctrl_c_leaves_nothing_half_written_and_the_next_goes_on(tmp_path):
    someone(tmp_path / "in" / "a.npz", 0.1)
    for i in range(3):
        someone(tmp_path / "in" / f"b{i}.npz", 0.1 + 0.01 * i, rows=3000)
    out = tmp_path / "out"
    command = [sys.executable, "-m", "mimic", "batch", str(tmp_path / "in"), "-o", str(out), "--workers", "1"]
    process = subprocess.Popen(
        command,
        start_new_session=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        preexec_fn=listening,
    )
    until = time.monotonic() + 120
    while not list(out.glob("items/*/metrics.json")) and process.poll() is None and time.monotonic() < until:
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)
    shown, _ = process.communicate(timeout=120)
    assert process.returncode == 3, shown.decode()
    assert not list(out.rglob("*.part*"))
    done = list((out / "items").iterdir())
    assert 1 <= len(done) < 4
    assert all((item / "metrics.json").is_file() for item in done)
    assert len(rows(out)) == len(done)


@pytest.mark.slow
def test_what_a_killed_batch_left_is_swept_away(played):
    assert not left_by_a_kill(played[1]).exists()


@pytest.mark.slow
def test_a_batch_in_which_all_fails_is_a_user_error(tmp_path, capsys):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.bvh").write_text("nothing")
    assert main(["batch", str(tmp_path / "in"), "-o", str(tmp_path / "out"), *OPTIONS]) == 2
    assert "a.bvh" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("line", "shown"),
    [
        ("batch nowhere -o out", "nowhere is not a folder"),
        ("batch empty -o out", "no video and no motion file in empty"),
        ("batch full -o full/a.npz", "is a file"),
        ("batch full -o out --policy nowhere.onnx", "there is no policy nowhere.onnx"),
    ],
)
def test_bad_input_is_refused_and_nothing_is_written(line, shown, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    someone(tmp_path / "full" / "a.npz", 0.1)
    assert main(line.split()) == 2
    assert shown in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
