"""Records on disk: Parquet columns named by their axes, and a JSON header with provenance. No pickle.

A record's array field ``p_BE`` with axes (side, xyz) becomes columns ``p_BE.left.x`` … ``p_BE.right.z``, so that a log
reads the same in pandas, DuckDB or a spreadsheet. Files are written beside their place and moved there when complete.
"""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import json
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mimic.config.text_file import from_json
from mimic.errors import AssetError
from mimic.records import AXES, Provenance, Record
from mimic.version import __version__

R = TypeVar("R", bound=Record)

_HEADER = b"mimic"
MOST_ROWS = 20_000_000
"""Maximum number of rows of a record: a joint log of 5 hours at 1 kHz."""


def check_writable(folder: Path) -> None:
    """Make sure that files can be written into a folder that may not exist yet, before work is spent on them.

    Raises:
        AssetError: If they cannot.
    """
    there = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    try:
        if not there.is_dir():
            raise NotADirectoryError(20, "it is a file")
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as reason:
        raise AssetError(
            f"nothing can be written to {folder}: {there}: {reason.strerror}; name another place"
        ) from None


def free_folder(folder: Path) -> Path:
    """Return a folder, or where it exists one with a number behind its name that does not."""
    free = folder
    number = 2
    while free.exists():
        free = folder.with_name(f"{folder.name}-{number}")
        number = number + 1
    return free


def check_file(path: Path) -> None:
    """Make sure that a file can be written, before work is spent on it.

    Raises:
        AssetError: If it cannot.
    """
    if path.is_dir():
        raise AssetError(f"{path} is a folder; name a file in it")
    check_writable(path.parent)


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Yield a path to write to; it becomes ``path`` when the block ends well, and vanishes when it does not."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        yield part
        part.replace(path)
    except OSError as reason:
        if reason.errno is not None and reason.filename is None:  # as where a disk is full
            reason.filename = str(path)
        raise
    finally:
        part.unlink(missing_ok=True)


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, or of those of all Parquet files in a folder, as hexadecimal digits."""
    if path.is_dir():
        own = "".join(sha256_of(file) for file in sorted(path.rglob("*.parquet")))
        return hashlib.sha256(own.encode()).hexdigest()
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def plain(value: Any) -> Any:
    """Return settings, arrays and paths as data that JSON can hold; NaN becomes null."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    if isinstance(value, Path):
        return value.name
    return value


def provenance(*, command: str = "", settings: Any = None, inputs: Mapping[str, Path] | None = None) -> Provenance:
    """Return the provenance of something made now by this version from these inputs (name -> file)."""
    hashes = {name: sha256_of(path) for name, path in (inputs or {}).items()}
    return Provenance(version=__version__, command=command, settings=plain(settings or {}), inputs=hashes)


def _columns(record: Record) -> Iterator[tuple[str, np.ndarray]]:
    for f in dataclasses.fields(record):  # type: ignore[arg-type]
        axes = f.metadata.get("axes")
        if axes is None:
            continue
        value = getattr(record, f.name)
        labels = [
            record.labels(axis) or tuple(map(str, range(n))) for axis, n in zip(axes, value.shape[1:], strict=True)
        ]
        for index in itertools.product(*(range(len(names)) for names in labels)):
            name = ".".join([f.name, *(names[i] for names, i in zip(labels, index, strict=True))])
            yield name, value[(slice(None), *index)]


def save(record: Record, path: Path, *, made_by: Provenance) -> None:
    """Write a record to a Parquet file, complete or not at all."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rest = {
        f.name: plain(getattr(record, f.name))
        for f in dataclasses.fields(record)  # type: ignore[arg-type]
        if "axes" not in f.metadata
    }
    shapes = {
        f.name: list(getattr(record, f.name).shape[1:])
        for f in dataclasses.fields(record)  # type: ignore[arg-type]
        if "axes" in f.metadata
    }
    header = {"record": type(record).__name__, "fields": rest, "shapes": shapes, "provenance": plain(made_by)}
    table = pa.table(dict(_columns(record)))
    table = table.replace_schema_metadata({_HEADER: json.dumps(header, allow_nan=False).encode()})
    with written_whole(path) as part:
        pq.write_table(table, part, compression="zstd")


def header(path: Path) -> dict[str, Any]:
    """Return the JSON header of a record file.

    Raises:
        AssetError: If the file is missing or was not written by mimic.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not path.is_file():
        raise AssetError(f"there is no file {path}")
    try:
        metadata = pq.read_schema(path).metadata or {}
    except (pa.ArrowException, OSError):
        metadata = {}
    if _HEADER not in metadata:
        raise AssetError(f"{path} is not a record of mimic; expected a Parquet file with a mimic header")
    try:
        found = from_json(metadata[_HEADER])
    except ValueError:
        found = None
    parts = {"record": str, "fields": dict, "shapes": dict}
    if not isinstance(found, dict) or not all(isinstance(found.get(name), kind) for name, kind in parts.items()):
        raise AssetError(f"{path} has a broken mimic header; expected JSON with {', '.join(parts)}")
    return found


def load(path: Path, kind: type[R]) -> R:
    """Read a record of the given type.

    Raises:
        AssetError: If the file is missing, is no record, or holds another type.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    head = header(path)
    if head["record"] != kind.__name__:
        raise AssetError(f"{path} holds a {head['record']}; expected a {kind.__name__}")
    try:
        if pq.read_metadata(path).num_rows > MOST_ROWS:
            raise AssetError(f"{path} has more than {MOST_ROWS} rows; no record of mimic is that long")
        return kind(**_values(kind, head, pq.read_table(path)))
    except (pa.ArrowException, KeyError, TypeError, ValueError, OSError) as error:
        raise AssetError(f"{path} is a broken {kind.__name__}: {' '.join(str(error).split())[:200]}") from None


def _values(kind: type[Record], head: dict[str, Any], table: Any) -> dict[str, Any]:
    """Return the fields of a record from the header and the columns of a file."""
    values: dict[str, Any] = dict(head["fields"])
    for f in dataclasses.fields(kind):  # type: ignore[arg-type]
        if f.metadata.get("optional") and f.name not in head["shapes"]:
            values[f.name] = np.full((table.num_rows, *(len(AXES[axis]) for axis in f.metadata["axes"])), np.nan)
        elif "axes" in f.metadata:
            shape = tuple(head["shapes"][f.name])
            names = [n for n in table.column_names if n == f.name or n.startswith(f.name + ".")]
            columns = [np.asarray(table[n].to_numpy()) for n in names]
            values[f.name] = np.stack(columns, axis=1).reshape(table.num_rows, *shape)
        elif isinstance(values.get(f.name), list):
            values[f.name] = tuple(values[f.name])
        elif values.get(f.name) is None and f.type in ("float", float):
            values[f.name] = float("nan")
    return values


def save_json(data: Any, path: Path) -> None:
    """Write plain data as JSON, complete or not at all."""
    with written_whole(path) as part:
        part.write_text(json.dumps(plain(data), indent=2, allow_nan=False) + "\n", encoding="utf-8")


def load_json(path: Path) -> Any:
    """Read plain data from a JSON file.

    Raises:
        AssetError: If it is missing or is no JSON.
    """
    try:
        return from_json(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as reason:
        raise AssetError(f"{path} cannot be read as JSON: {reason}") from None
