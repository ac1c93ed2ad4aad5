from __future__ import annotations

import dataclasses
import hashlib
import json
import resource
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from mimic import __version__, records
from mimic.config.play import RunSettings
from mimic.errors import AssetError
from mimic.io import store
from mimic.records import CommandTrack, PoseTrack, Record, RunLog, TargetTrack, WristTrack

RECORDS = [kind for kind in vars(records).values() if isinstance(kind, type) and issubclass(kind, Record)]
RECORDS.remove(Record)

EXTRAS = {
    PoseTrack: {"size": (640, 480), "warnings": ("the camera moves", "two people"), "names": records.LANDMARKS},
    WristTrack: {"arm_length": 0.53, "warnings": ()},
    TargetTrack: {"report": {"targets": 3, "pose": {"share": 0.25, "axis": [0, 1]}}, "warnings": ("slow",)},
    RunLog: {"metadata": {"dt": 0.02, "fell_at": None, "settings": {"seed": 3}}},
}


def example(kind: type[Record], rows: int = 4) -> Record:
    """A record filled with random numbers and some NaN."""
    rng = np.random.default_rng(rows)
    free = {"landmark": len(records.LANDMARKS), "observation": 123}
    values = {}
    for f in dataclasses.fields(kind):
        if "axes" not in f.metadata:
            continue
        shape = (rows, *(free.get(axis) or len(records.AXES[axis]) for axis in f.metadata["axes"]))
        value = rng.normal(size=shape) * 10.0 ** rng.integers(-9, 9, shape)
        if f.metadata["dtype"] is np.float64 and rows:
            value.reshape(-1)[:1] = np.nan
        values[f.name] = (value if f.metadata["dtype"] is np.float64 else value > 0).astype(f.metadata["dtype"])
    return kind(**values, **EXTRAS.get(kind, {}))


def wrists(**changes: object) -> WristTrack:
    return dataclasses.replace(example(WristTrack), **changes)


NOBODY = store.provenance()


@pytest.mark.parametrize("rows", [0, 1, 4])
@pytest.mark.parametrize("kind", RECORDS, ids=lambda kind: kind.__name__)
def test_what_is_read_is_what_was_saved(kind, rows, tmp_path):
    saved = example(kind, rows)
    store.save(saved, tmp_path / "a.parquet", made_by=NOBODY)
    read = store.load(tmp_path / "a.parquet", kind)
    for f in dataclasses.fields(kind):
        one, other = getattr(saved, f.name), getattr(read, f.name)
        if "axes" in f.metadata:
            assert one.dtype == other.dtype
            assert one.shape == other.shape
            assert one.tobytes() == other.tobytes(), f.name
        else:
            assert one == other
            assert type(one) is type(other)


def test_a_number_that_is_missing_stays_missing(tmp_path):
    store.save(wrists(arm_length=float("nan")), tmp_path / "a.parquet", made_by=NOBODY)
    assert np.isnan(store.load(tmp_path / "a.parquet", WristTrack).arm_length)


def test_columns_are_named_by_side_axis_and_joint(tmp_path):
    store.save(example(RunLog), tmp_path / "log.parquet", made_by=NOBODY)
    names = set(pq.read_schema(tmp_path / "log.parquet").names)
    assert {"t", "phase", "p_BE.left.x", "p_BE.right.z", "q.FL_abad", "tau.RR_knee", "quat_WB.w", "v_des.y"} <= names


def test_a_file_of_no_directory_yet_makes_it(tmp_path):
    path = tmp_path / "a" / "b" / "c.parquet"
    store.save(wrists(), path, made_by=NOBODY)
    assert path.is_file()


def test_a_saved_record_names_version_command_settings_and_inputs_by_hash(tmp_path):
    video = tmp_path / "me.mp4"
    video.write_bytes(b"moving pictures")
    made_by = store.provenance(command="mimic me.mp4", settings=RunSettings(seed=5), inputs={"video": video})
    store.save(wrists(), tmp_path / "a.parquet", made_by=made_by)
    head = store.header(tmp_path / "a.parquet")
    assert head["record"] == "WristTrack"
    assert head["provenance"]["version"] == __version__
    assert head["provenance"]["command"] == "mimic me.mp4"
    assert head["provenance"]["settings"]["seed"] == 5
    assert head["provenance"]["inputs"] == {"video": hashlib.sha256(b"moving pictures").hexdigest()}


def files(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


class DiskFull(OSError):
    pass


@pytest.fixture
def full_disk(monkeypatch):
    """Writing a table leaves half a file and fails."""

    def half(table: pa.Table, path: Path, **options: object) -> None:
        Path(path).write_bytes(b"PAR1")
        raise DiskFull

    monkeypatch.setattr(pq, "write_table", half)


@pytest.mark.usefixtures("full_disk")
def test_a_failed_save_leaves_no_file(tmp_path):
    with pytest.raises(DiskFull):
        store.save(wrists(), tmp_path / "a.parquet", made_by=NOBODY)
    assert files(tmp_path) == []


def test_a_failed_save_keeps_the_file_that_was_there(tmp_path, request):
    path = tmp_path / "a.parquet"
    store.save(wrists(arm_length=0.6), path, made_by=NOBODY)
    request.getfixturevalue("full_disk")
    with pytest.raises(DiskFull):
        store.save(wrists(arm_length=0.7), path, made_by=NOBODY)
    assert files(tmp_path) == ["a.parquet"]
    assert store.load(path, WristTrack).arm_length == 0.6


def test_a_save_replaces_the_file_that_was_there(tmp_path):
    path = tmp_path / "a.parquet"
    for length in (0.6, 0.7):
        store.save(wrists(arm_length=length), path, made_by=NOBODY)
    assert store.load(path, WristTrack).arm_length == 0.7
    assert files(tmp_path) == ["a.parquet"]


def test_an_interrupted_write_leaves_no_file(tmp_path):
    def write() -> None:
        with store.written_whole(tmp_path / "a.txt") as part:
            part.write_text("half of")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write()
    assert files(tmp_path) == []


def test_what_cannot_be_json_is_refused_before_anything_is_written(tmp_path):
    strange = dataclasses.replace(example(TargetTrack), report={"what": object()})
    with pytest.raises(TypeError):
        store.save(strange, tmp_path / "a.parquet", made_by=NOBODY)
    with pytest.raises(TypeError):
        store.save_json({"what": object()}, tmp_path / "a.json")
    assert files(tmp_path) == []


def test_json_holds_arrays_settings_and_missing_numbers(tmp_path):
    data = {"settings": RunSettings(), "nan": float("nan"), "inf": np.inf, "array": np.eye(2), "one": np.float32(1)}
    store.save_json(data, tmp_path / "a.json")
    read = json.loads((tmp_path / "a.json").read_text())
    assert read["settings"]["stand_up"] == RunSettings().stand_up
    assert read["nan"] is None
    assert read["inf"] is None
    assert read["array"] == [[1.0, 0.0], [0.0, 1.0]]
    assert read["one"] == 1.0


def test_another_type_of_record_is_reported_by_name(tmp_path):
    store.save(wrists(), tmp_path / "a.parquet", made_by=NOBODY)
    with pytest.raises(AssetError, match=r"a\.parquet holds a WristTrack; expected a CommandTrack"):
        store.load(tmp_path / "a.parquet", CommandTrack)


def test_a_missing_file_is_reported(tmp_path):
    with pytest.raises(AssetError, match=r"there is no file .*nowhere\.parquet"):
        store.load(tmp_path / "nowhere.parquet", WristTrack)


@pytest.mark.parametrize("content", [b"", b"name,value\n", b"PAR1 and then nothing"])
def test_a_file_that_is_no_table_is_reported(content, tmp_path):
    path = tmp_path / "a.parquet"
    path.write_bytes(content)
    with pytest.raises(AssetError, match="not a record of mimic"):
        store.load(path, WristTrack)


def test_a_table_of_someone_else_is_reported(tmp_path):
    pq.write_table(pa.table({"t": [0.0]}), tmp_path / "a.parquet")
    with pytest.raises(AssetError, match="not a record of mimic"):
        store.header(tmp_path / "a.parquet")


def test_half_of_a_record_is_reported(tmp_path):
    path = tmp_path / "a.parquet"
    store.save(wrists(), path, made_by=NOBODY)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(AssetError, match="not a record of mimic"):
        store.load(path, WristTrack)


def test_the_hash_is_that_of_the_content(tmp_path):
    for name, content in (("a", b"same"), ("b", b"same"), ("c", b"other")):
        (tmp_path / name).write_bytes(content)
    a, b, c = (store.sha256_of(tmp_path / name) for name in "abc")
    assert a == b != c


BROKEN_HEADERS = {
    "no JSON": b"{",
    "deep": b"[" * 100_000,
    "a list": b"[]",
    "no record": b'{"fields": {}, "shapes": {}}',
    "fields that are a number": b'{"record": "CommandTrack", "fields": 3, "shapes": {}}',
    "no shapes": b'{"record": "CommandTrack", "fields": {}, "shapes": {}}',
    "shapes that do not fit": b'{"record": "CommandTrack", "fields": {}, "shapes": {"t": [], "v": [7], "p_BE": [9]}}',
    "an unknown field": b'{"record": "CommandTrack", "fields": {"x": 1}, "shapes": {"t": []}}',
}


@pytest.mark.parametrize("name", BROKEN_HEADERS)
def test_a_record_with_a_broken_header_is_refused_in_one_line(name, tmp_path):
    path = tmp_path / "commands.parquet"
    table = pa.table({"t": [0.0, 1.0], "v.0": [0.0, 0.0]}).replace_schema_metadata({b"mimic": BROKEN_HEADERS[name]})
    pq.write_table(table, path)
    with pytest.raises(AssetError, match=r"broken") as error:
        store.load(path, CommandTrack)
    assert "\n" not in str(error.value)


def test_bytes_that_are_no_parquet_are_refused(tmp_path):
    path = tmp_path / "commands.parquet"
    path.write_bytes(b"PAR1" + bytes(100) + b"\xff\xff\xff\x7fPAR1")
    with pytest.raises(AssetError, match="not a record of mimic"):
        store.load(path, CommandTrack)


def _save_log(path: Path) -> None:
    store.save(example(RunLog), path, made_by=store.provenance())


def _save_words(path: Path) -> None:
    store.save_json(["word"] * 1000, path)


@pytest.mark.parametrize("write", [_save_log, _save_words])
def test_where_there_is_no_room_the_file_is_named(tmp_path: Path, write: Callable[[Path], None]) -> None:
    path = tmp_path / "log.file"
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))
    try:
        with pytest.raises(OSError, match=path.name) as caught:
            write(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert caught.value.filename == str(path)
    assert caught.value.strerror
    assert list(tmp_path.iterdir()) == []
