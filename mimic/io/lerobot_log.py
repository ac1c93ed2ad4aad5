"""A LeRobot dataset as a log of servos: positions and targets of its motors, in radians.

Source: huggingface/lerobot: LeRobotDataset v2.1 and v3.0 (meta/info.json, data/**/*.parquet), and its calibration file,
which has ``range_min`` and ``range_max`` [steps of the encoder] of each motor. What it records is -100 to 100 over that
range, or degrees from the middle of it; grippers have 0 to 100.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mimic.config.text_file import from_json, read_text
from mimic.errors import CalibrationError
from mimic.io.assets import manual
from mimic.records import FloatArray

INFO = Path("meta/info.json")
CALIBRATION = "calibration"
"""Note: the calibration file of LeRobot."""
STEPS = 4096
"""Steps of the encoder in a turn: Feetech STS3215, Dynamixel XL330 and XL430."""
GRIPPER = "gripper"
"""Motors with this in their name have 0 to 100 of their range."""
BETWEEN = 1.0
"""Time between two episodes [s]: rows after so long a gap begin anew."""


def is_dataset(folder: Path) -> bool:
    """Return whether a folder holds a LeRobot dataset."""
    return (folder / INFO).is_file()


def read_dataset(folder: Path, notes: Mapping[str, Any]) -> dict[str, FloatArray]:
    """Return the columns t, q.MOTOR and q_des.MOTOR [s, rad] of all episodes.

    An action is sent after its row was read, so that it is in effect in the next row.

    Args:
        folder: The dataset.
        notes: ``calibration``, the file, or ``units``, "deg" or "rad", for what the values are.

    Raises:
        CalibrationError: If the dataset has no positions or actions of motors, or nothing says what its values are.
    """
    features = from_json(read_text(folder / INFO)).get("features", {})
    motors = _motors(features, "observation.state", folder)
    if _motors(features, "action", folder) != motors:
        raise CalibrationError(f"{folder} has other motors in action than in observation.state; expected the same")
    tables = [_table(path, len(motors)) for path in sorted((folder / "data").rglob("*.parquet"))]
    if not tables:
        raise CalibrationError(f"{folder} has no data/**/*.parquet; expected the rows of a LeRobot dataset")
    state, action, episode, time = (np.concatenate(parts) for parts in zip(*tables, strict=True))
    before = np.roll(action, 1, axis=0)
    begins = np.append(True, np.diff(episode) != 0)
    before[begins] = np.nan
    lasts = time[np.append(np.flatnonzero(begins)[1:] - 1, len(time) - 1)]
    starts = np.append(0.0, np.cumsum(lasts + BETWEEN)[:-1])
    columns = {"t": time + starts[np.cumsum(begins) - 1]}
    scales = _scales(motors, notes, folder)
    for j, motor in enumerate(motors):
        if motor not in scales:
            columns[f"percent.{motor}"] = state[:, j]
            continue
        middle, scale = scales[motor]
        columns[f"q.{motor}"] = (state[:, j] - middle) * scale
        columns[f"q_des.{motor}"] = (before[:, j] - middle) * scale
    return columns


def _motors(features: Mapping[str, Any], name: str, folder: Path) -> list[str]:
    names = features.get(name, {}).get("names") if isinstance(features.get(name), Mapping) else None
    if isinstance(names, Mapping):  # of version 2: {"motors": [...]}
        names = next(iter(names.values()), None)
    if not isinstance(names, list) or not names:
        raise CalibrationError(f"{folder / INFO} names no motors of {name}; expected a list of names")
    return [str(motor).removesuffix(".pos") for motor in names]


def _table(path: Path, count: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return positions and actions (T, motors), episodes and times [s] (T,) of a file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(path, columns=["observation.state", "action", "episode_index", "timestamp"])
        columns = [np.array(column.to_pylist(), dtype=np.float64) for column in table.columns]
    except (OSError, pa.ArrowException, ValueError, TypeError) as reason:
        raise CalibrationError(f"{path} is not a table of a LeRobot dataset: {reason}") from None
    if columns[0].shape != columns[1].shape or columns[0].shape[1:] != (count,):
        raise CalibrationError(f"{path} has rows of {columns[0].shape[1:]} positions; expected {count}")
    return columns[0], columns[1], columns[2], columns[3]


def _scales(motors: list[str], notes: Mapping[str, Any], folder: Path) -> dict[str, tuple[float, float]]:
    """Return the middle of the values of each motor, and radians for each unit of them."""
    units = notes.get("units")
    if CALIBRATION not in notes and units not in ("deg", "rad"):
        raise CalibrationError(
            f"{folder} is a LeRobot dataset, whose values may be percent, degrees or radians; give "
            f"--note {CALIBRATION}=FILE, the calibration file of that robot, for percent, or --note units=deg or "
            f"units=rad. See {manual('log-format.md')}"
        )
    ranges = _ranges(Path(str(notes[CALIBRATION])), motors) if CALIBRATION in notes else {}
    scales = {}
    for motor in motors:
        grips = GRIPPER in motor
        if units in ("deg", "rad") and not grips:
            scales[motor] = 0.0, np.pi / 180 if units == "deg" else 1.0
        elif motor in ranges:
            scales[motor] = 50.0 if grips else 0.0, ranges[motor] / (100.0 if grips else 200.0)
    return scales


def _ranges(path: Path, motors: list[str]) -> dict[str, float]:
    """Return the range of each motor [rad]."""
    raw = from_json(read_text(path))
    ranges = {}
    for motor in motors:
        try:
            ranges[motor] = (raw[motor]["range_max"] - raw[motor]["range_min"]) * 2 * np.pi / STEPS
        except (KeyError, TypeError):
            raise CalibrationError(
                f"{path} has no range_min and range_max of {motor}; expected a calibration file of LeRobot"
            ) from None
    return ranges
