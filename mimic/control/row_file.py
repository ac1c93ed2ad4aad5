"""Rows of numbers on disk that survive the process that writes them.

The file is a line of JSON with the columns, then 64-bit floats, row after row.
Reading leaves out an incomplete last row. At the end of a run the rows are stored as Parquet.
"""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mimic.config.text_file import from_json
from mimic.errors import AssetError, ContractError
from mimic.io.store import plain
from mimic.records import FloatArray

_FORM = "mimic rows 1"


class RowFile:
    """A file that rows are appended to."""

    def __init__(self, path: Path, shapes: Mapping[str, tuple[int, ...]], metadata: Mapping[str, Any]) -> None:
        """Begin a file.

        Args:
            path: Where; its folder is made.
            shapes: Name of each column and the shape of a row of it.
            metadata: Plain data, stored in the first line.
        """
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path = path
        self._row = np.zeros((), _layout(shapes))
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND, 0o644)
        head = {"form": _FORM, "shapes": plain(shapes), "metadata": plain(metadata)}
        os.write(self._file, json.dumps(head).encode() + b"\n")

    def packed(self, values: Mapping[str, Any]) -> bytes:
        """Return a row as `write` takes it.

        Raises:
            ContractError: If a column is missing or has another shape.
        """
        for name, (kind, _) in self._row.dtype.fields.items():  # type: ignore[union-attr]
            part = np.asarray(values.get(name), dtype=np.float64)
            if part.shape != kind.shape or name not in values:
                raise ContractError(f"column {name} of the row has shape {part.shape}; expected {kind.shape}")
            self._row[name] = part
        return self._row.tobytes()

    def write(self, rows: bytes) -> None:
        """Append packed rows.

        Raises:
            OSError: If they cannot be written; the file may then end with a row that is not complete.
        """
        if os.write(self._file, rows) < len(rows):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.path))

    def add(self, values: Mapping[str, Any]) -> None:
        """Append a row.

        Raises:
            ContractError, OSError: As `packed` and `write` do.
        """
        self.write(self.packed(values))

    def close(self) -> None:
        """Close the file; safe to call twice."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


def _layout(shapes: Mapping[str, Sequence[int]]) -> np.dtype[Any]:
    return np.dtype([(name, "<f8", tuple(shape)) for name, shape in shapes.items()])


def read_rows(path: Path) -> tuple[dict[str, FloatArray], dict[str, Any]]:
    """Return the columns of all complete rows, each (rows, *shape), and the metadata.

    Raises:
        AssetError: If the file is missing or has another format.
    """
    if not path.is_file():
        raise AssetError(f"there is no file {path}")
    line, _, numbers = path.read_bytes().partition(b"\n")
    try:
        head = from_json(line)
        layout = _layout(head["shapes"])
        if head["form"] != _FORM:
            raise ValueError
    except (ValueError, KeyError, TypeError, AttributeError):
        raise AssetError(f"{path} does not hold rows of a run; expected one that begins with {_FORM!r}") from None
    table = np.frombuffer(numbers, layout, len(numbers) // layout.itemsize)
    return {name: table[name] for name in layout.names or ()}, dict(head["metadata"])
