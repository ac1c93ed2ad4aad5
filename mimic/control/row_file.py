"""Rows of numbers on disk that are whole up to the last one, whatever happens to the process.

A line of JSON with the columns, then 64-bit floats, row after row, each handed to the system at once: what was written
survives the process. A row that was cut short is left out on reading. Made to be turned into Parquet at the end of a run.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mimic.errors import AssetError, ContractError
from mimic.store import plain
from mimic.types import FloatArray

_FORM = "mimic rows 1"


class RowFile:
    """A file that rows are appended to."""

    def __init__(self, path: Path, shapes: Mapping[str, tuple[int, ...]], metadata: Mapping[str, Any]) -> None:
        """Begin a file.

        Args:
            path: Where; its folder is made.
            shapes: Name of each column and the shape of a row of it.
            metadata: Plain data, kept beside.
        """
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path, self._shapes = path, {name: tuple(shape) for name, shape in shapes.items()}
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND, 0o644)
        head = {"form": _FORM, "shapes": self._shapes, "metadata": plain(metadata)}
        os.write(self._file, json.dumps(head).encode() + b"\n")

    def add(self, values: Mapping[str, Any]) -> None:
        """Append a row.

        Raises:
            ContractError: If a column is missing or has another shape.
        """
        parts = []
        for name, shape in self._shapes.items():
            part = np.asarray(values.get(name), dtype=np.float64)
            if part.shape != shape or name not in values:
                raise ContractError(f"column {name} of the row has shape {part.shape}; expected {shape}")
            parts.append(part.reshape(-1))
        os.write(self._file, np.concatenate(parts).astype("<f8").tobytes())

    def close(self) -> None:
        """Close the file; safe to call twice."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


def read_rows(path: Path) -> tuple[dict[str, FloatArray], dict[str, Any]]:
    """Return the columns of all whole rows, each (rows, *shape), and the metadata.

    Raises:
        AssetError: If the file is missing or is something else.
    """
    if not path.is_file():
        raise AssetError(f"there is no file {path}")
    with open(path, "rb") as file:
        try:
            head = json.loads(file.readline())
            shapes = {name: tuple(shape) for name, shape in head["shapes"].items()}
            known = head["form"] == _FORM
        except (ValueError, KeyError, TypeError, AttributeError):
            known, head, shapes = False, {}, {}
        if not known:
            raise AssetError(f"{path} does not hold rows of a run; expected a file that begins with {_FORM!r}")
        numbers = file.read()
    sizes = [int(np.prod(shape, dtype=int)) for shape in shapes.values()]
    width = sum(sizes)
    rows = len(numbers) // (8 * width)
    table = np.frombuffer(numbers[: rows * 8 * width], dtype="<f8").reshape(rows, width)
    ends = np.cumsum(sizes)
    columns = {
        name: table[:, end - size : end].reshape(rows, *shape)
        for (name, shape), size, end in zip(shapes.items(), sizes, ends, strict=True)
    }
    return columns, dict(head["metadata"])
