"""Datasets: what a reader of LeRobotDataset v3 finds in them."""

from __future__ import annotations

import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from mimic.io import lerobot
from mimic.io.lerobot import Episode, write_dataset


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return a dataset of three episodes, one file in each folder."""
    monkeypatch.setattr(lerobot, "CHUNK", 1)
    episodes = [
        Episode(task=task, columns={"action": np.array([[value, -value], [value + 1.0, 0.0]])})
        for task, value in (("wave", 1.0), ("box", 2.0), ("wave", 3.0))
    ]
    write_dataset(tmp_path / "set", episodes, names={"action": ["a", "b"]}, fps=10, robot="dog", picture=None)
    return tmp_path / "set"


def test_each_episode_has_a_file_where_the_metadata_says(folder):
    meta = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for number, row in enumerate(meta):
        where = f"data/chunk-{row['data/chunk_index']:03d}/file-{row['data/file_index']:03d}.parquet"
        table = pq.read_table(folder / where).to_pydict()
        assert where == f"data/chunk-{number:03d}/file-000.parquet"
        assert table["episode_index"] == [number, number]
        assert table["index"] == list(range(row["dataset_from_index"], row["dataset_to_index"]))
        assert table["timestamp"] == pytest.approx([0.0, 0.1])
        assert table["task_index"] == [[0, 0], [1, 1], [0, 0]][number]


def test_the_statistics_are_those_of_all_rows(folder):
    info = json.loads((folder / "meta/info.json").read_text())
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (3, 6, 2)
    rows = np.array([[1.0, -1.0], [2.0, 0.0], [2.0, -2.0], [3.0, 0.0], [3.0, -3.0], [4.0, 0.0]])
    found = json.loads((folder / "meta/stats.json").read_text())["action"]
    for name, expected in (("min", rows.min(0)), ("max", rows.max(0)), ("mean", rows.mean(0)), ("std", rows.std(0))):
        assert found[name] == pytest.approx(expected)
