"""Runs as a LeRobotDataset v3: Parquet tables, metadata, and a video for each episode.

Source: huggingface/lerobot, LeRobotDataset v3.0 (docs/source/lerobot-dataset-v3.mdx): meta/info.json, meta/stats.json,
meta/tasks.parquet, meta/episodes, data, videos. Each episode has a data and a video file of its own here.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mimic.io.store import save_json
from mimic.records import FloatArray

VERSION = "v3.0"
CAMERA = "observation.images.side"
_DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_VIDEO = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
CHUNK = 1000
"""Files in a folder at most."""
_INDICES = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Episode:
    """A run with equal time steps."""

    task: str
    """What was done, in words."""
    columns: Mapping[str, FloatArray]
    """Feature -> values (T, N)."""
    film: Callable[[Path], tuple[FloatArray, FloatArray, FloatArray, FloatArray]] | None = None
    """Writes an MP4 with a frame for each row to a path; returns minimum, maximum, mean and standard deviation of its
    colours (3,), 0 to 1. None without a video."""


def write_dataset(
    folder: Path,
    episodes: Sequence[Episode],
    *,
    names: Mapping[str, Sequence[str]],
    fps: int,
    robot: str,
    picture: tuple[int, int] | None,
) -> None:
    """Write a dataset, complete or not at all.

    Args:
        folder: New folder.
        episodes: All with the features of ``names``; with or without films, all alike.
        names: Feature -> names of its values.
        fps: Rows per second.
        robot: Type of the robot.
        picture: Height and width of the films [px]; None without.
    """
    import pyarrow as pa

    part = folder.with_name(f".{folder.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.parent.mkdir(parents=True, exist_ok=True)
    tasks = list(dict.fromkeys(episode.task for episode in episodes))
    rows: list[dict[str, Any]] = []
    stats: list[dict[str, dict[str, Any]]] = []
    start = 0
    try:
        for number, episode in enumerate(episodes):
            count = len(next(iter(episode.columns.values())))
            where = {"chunk_index": number // CHUNK, "file_index": number % CHUNK}
            indices = {
                "timestamp": np.arange(count) / fps,
                "frame_index": np.arange(count),
                "episode_index": np.full(count, number),
                "index": start + np.arange(count),
                "task_index": np.full(count, tasks.index(episode.task)),
            }
            _save_table(part / _DATA.format(**where), episode.columns, indices)
            own = {name: _stats(values) for name, values in {**episode.columns, **indices}.items()}
            row: dict[str, Any] = {
                "episode_index": number,
                "tasks": [episode.task],
                "length": count,
                **{f"data/{key}": value for key, value in where.items()},
                "dataset_from_index": start,
                "dataset_to_index": start + count,
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
            }
            if episode.film is not None:
                path = part / _VIDEO.format(video_key=CAMERA, **where)
                path.parent.mkdir(parents=True, exist_ok=True)
                low, high, mean, std = (np.reshape(v, (3, 1, 1)).tolist() for v in episode.film(path))
                own[CAMERA] = {"min": low, "max": high, "mean": mean, "std": std, "count": [count]}
                row |= {f"videos/{CAMERA}/{key}": value for key, value in where.items()}
                row |= {f"videos/{CAMERA}/from_timestamp": 0.0, f"videos/{CAMERA}/to_timestamp": count / fps}
            row |= {f"stats/{name}/{key}": value for name, values in own.items() for key, value in values.items()}
            rows.append(row)
            stats.append(own)
            start += count
        _save(part / "meta/episodes/chunk-000/file-000.parquet", pa.Table.from_pylist(rows))
        _save_tasks(part / "meta/tasks.parquet", tasks)
        together = {}
        for name in stats[0]:
            together[name] = _together([own[name] for own in stats])
        save_json(together, part / "meta/stats.json")
        save_json(_info(names, fps, robot, picture, len(rows), start, len(tasks)), part / "meta/info.json")
        part.rename(folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _info(
    names: Mapping[str, Sequence[str]],
    fps: int,
    robot: str,
    picture: tuple[int, int] | None,
    episodes: int,
    frames: int,
    tasks: int,
) -> dict[str, Any]:
    features: dict[str, Any] = {
        name: {"dtype": "float32", "shape": [len(own)], "names": list(own)} for name, own in names.items()
    }
    if picture is not None:
        height, width = picture
        features[CAMERA] = {
            "dtype": "video",
            "shape": [height, width, 3],
            "names": ["height", "width", "channels"],
            "info": {
                "video.height": height,
                "video.width": width,
                "video.codec": "h264",
                "video.pix_fmt": "yuv420p",
                "video.is_depth_map": False,
                "video.fps": fps,
                "video.channels": 3,
                "has_audio": False,
            },
        }
    features |= {name: {"dtype": dtype, "shape": [1], "names": None} for name, dtype in _INDICES.items()}
    return {
        "codebase_version": VERSION,
        "robot_type": robot,
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": tasks,
        "chunks_size": CHUNK,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{episodes}"},
        "data_path": _DATA,
        "video_path": _VIDEO if picture is not None else None,
        "features": features,
    }


def _stats(values: np.ndarray) -> dict[str, list[Any]]:
    own = values.reshape(len(values), -1).astype(np.float64)
    return {
        "min": own.min(axis=0).tolist(),
        "max": own.max(axis=0).tolist(),
        "mean": own.mean(axis=0).tolist(),
        "std": own.std(axis=0).tolist(),
        "count": [len(own)],
    }


def _together(parts: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the statistics of several episodes as of one."""
    counts = np.array([part["count"][0] for part in parts], dtype=np.float64)
    shares = counts / counts.sum()
    means = [np.array(part["mean"]) for part in parts]
    mean = sum(share * own for share, own in zip(shares, means, strict=True))
    spread = [np.array(part["std"]) ** 2 + (own - mean) ** 2 for part, own in zip(parts, means, strict=True)]
    variance = sum(share * own for share, own in zip(shares, spread, strict=True))
    return {
        "min": np.min([part["min"] for part in parts], axis=0).tolist(),
        "max": np.max([part["max"] for part in parts], axis=0).tolist(),
        "mean": np.asarray(mean).tolist(),
        "std": np.sqrt(np.asarray(variance)).tolist(),
        "count": [int(counts.sum())],
    }


def _save_table(path: Path, columns: Mapping[str, FloatArray], indices: Mapping[str, np.ndarray]) -> None:
    import pyarrow as pa

    lists = {
        name: pa.array(values.astype(np.float32).tolist(), type=pa.list_(pa.float32()))
        for name, values in columns.items()
    }
    scalars = {name: pa.array(indices[name].astype(dtype)) for name, dtype in _INDICES.items()}
    _save(path, pa.table({**lists, **scalars}))


def _save(path: Path, table: Any) -> None:
    import pyarrow.parquet as pq

    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, path)


def _save_tasks(path: Path, tasks: list[str]) -> None:
    """Write the tasks as pandas would: an index of texts and the column task_index."""
    import pyarrow as pa

    def column(name: str, pandas_type: str, numpy_type: str) -> dict[str, Any]:
        types = {"pandas_type": pandas_type, "numpy_type": numpy_type}
        return {"name": name, "field_name": name, **types, "metadata": None}

    pandas = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [column("task_index", "int64", "int64"), column("task", "unicode", "object")],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.2.0",
    }
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), "task": tasks})
    _save(path, table.replace_schema_metadata({"pandas": json.dumps(pandas)}))
