from __future__ import annotations

import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from mimic.control.row_file import RowFile, read_rows
from mimic.errors import AssetError, ContractError

SHAPES = {"t": (), "q": (3,), "p": (2, 2)}


def row(number: float) -> dict:
    return {"t": number, "q": number + np.arange(3), "p": number * np.ones((2, 2))}


def test_rows_come_back_with_their_metadata(tmp_path):
    file = RowFile(tmp_path / "deep" / "rows", SHAPES, {"dt": 0.02, "unknown": float("nan")})
    for number in range(5):
        file.add(row(number))
    file.close()
    file.close()
    columns, metadata = read_rows(tmp_path / "deep" / "rows")
    assert {name: column.shape for name, column in columns.items()} == {"t": (5,), "q": (5, 3), "p": (5, 2, 2)}
    assert np.array_equal(columns["q"][4], [4.0, 5.0, 6.0])
    assert np.array_equal(columns["t"], np.arange(5))
    assert metadata == {"dt": 0.02, "unknown": None}


def test_a_row_is_there_before_the_file_is_closed(tmp_path):
    file = RowFile(tmp_path / "rows", SHAPES, {})
    file.add(row(1.0))
    assert len(read_rows(tmp_path / "rows")[0]["t"]) == 1
    file.close()


@pytest.mark.parametrize("cut", [1, 7, 8, 40, 63])
def test_a_row_that_was_cut_short_is_left_out(cut, tmp_path):
    file = RowFile(tmp_path / "rows", SHAPES, {})
    for number in range(3):
        file.add(row(number))
    file.close()
    os.truncate(tmp_path / "rows", (tmp_path / "rows").stat().st_size - cut)
    assert np.array_equal(read_rows(tmp_path / "rows")[0]["t"], [0.0, 1.0])


def test_no_rows_at_all_are_empty_columns(tmp_path):
    RowFile(tmp_path / "rows", SHAPES, {}).close()
    assert {name: column.shape for name, column in read_rows(tmp_path / "rows")[0].items()} == {
        "t": (0,),
        "q": (0, 3),
        "p": (0, 2, 2),
    }


@pytest.mark.parametrize("wrong", [{"t": 0.0}, {**row(0.0), "q": np.zeros(4)}, {**row(0.0), "t": None}])
def test_a_row_of_another_shape_is_refused(wrong, tmp_path):
    file = RowFile(tmp_path / "rows", SHAPES, {})
    if wrong.get("t") is None:
        file.add(wrong)  # not known, but of the right shape
        assert np.isnan(read_rows(tmp_path / "rows")[0]["t"]).all()
    else:
        with pytest.raises(ContractError, match="column q"):
            file.add(wrong)
    file.close()


@pytest.mark.parametrize("content", [b"", b"PAR1", b'{"form": "other"}\n', b"[1, 2]\n"])
def test_another_file_is_refused(content, tmp_path):
    (tmp_path / "rows").write_bytes(content)
    with pytest.raises(AssetError, match="does not hold rows"):
        read_rows(tmp_path / "rows")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(AssetError, match="there is no file"):
        read_rows(tmp_path / "rows")


def test_rows_survive_a_process_that_is_killed(tmp_path):
    code = (
        "import sys, time\nfrom pathlib import Path\nfrom mimic.control.row_file import RowFile\n"
        "file = RowFile(Path(sys.argv[1]), {'t': ()}, {})\n"
        "for number in range(100): file.add({'t': number})\n"
        "print('written', flush=True)\ntime.sleep(600)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code, str(tmp_path / "rows")], stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"written\n"
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    assert np.array_equal(read_rows(tmp_path / "rows")[0]["t"], np.arange(100))
