"""Mutants: which tokens are changed, and what the runs say of them, in a tree of two small folders."""

from __future__ import annotations

import ast
import json
import sys
from pathlib import Path

import pytest

from lab.mutants import __main__ as mutants
from lab.mutants.places import drawn, places
from lab.mutants.runs import Copy, Folder, folder_of, forget_compiled, nearest_first

CODE = '''"""Text with 1 + 1 and True."""

from math import pi as PI  # 1

HALF: float = 0.5
SIDES = 4

def inside(length: float | int = 2.0, *more) -> bool | None:
    """Text with 3."""
    é = f"{length + 7}"; area = SIDES * length
    if not area > 1 and more is not None:
        area += HALF
    return (length
        ) < area
'''

KNOWN = "def double(x):\n    return 2 * x\n"

CODES = {
    "mimic/__init__.py": "",
    "mimic/a/known.py": KNOWN,
    "mimic/a/unknown.py": "def unknown(x):\n    return -x\n",
    "mimic/b/absent.py": "def absent(x):\n    return x + 1\n",
}

TESTS = {
    "tests/a/test_known.py": "from mimic.a.known import double\ndef test_it():\n    assert double(3) == 6\n",
    "tests/a/test_other.py": "def test_fails_already():\n    assert False\ndef test_fine():\n    pass\n",
    "tests/b/test_absent.py": "import a_library_that_is_absent\n",
}


def write(root: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return root


def test_code_has_places_and_texts_annotations_and_imports_have_none(tmp_path: Path) -> None:
    found = [(one.line, one.before) for one in places(write(tmp_path, {"mimic/a.py": CODE}))]
    assert found == [
        (5, "0.5"),
        (6, "4"),
        (8, "2.0"),
        (10, "SIDES"),
        (10, "*"),
        (11, "not"),
        (11, ">"),
        (11, "1"),
        (11, "and"),
        (11, "is not"),
        (12, "+="),
        (12, "HALF"),
        (14, "<"),
    ]


def test_every_mutant_differs_in_one_line_and_can_be_read(tmp_path: Path) -> None:
    every = list(drawn(write(tmp_path, {"mimic/a.py": CODE}), seed=3))
    assert len(every) == 13
    for mutant in every:
        changed = mutant.of(CODE)
        ast.parse(changed)
        lines = zip(CODE.splitlines(), changed.splitlines(), strict=True)
        assert [i for i, (before, after) in enumerate(lines, 1) if before != after] == [mutant.line]


def test_a_seed_draws_the_same_mutants_again_and_another_seed_others(tmp_path: Path) -> None:
    write(tmp_path, {"mimic/a.py": CODE})
    assert list(drawn(tmp_path, 1)) == list(drawn(tmp_path, 1))
    assert list(drawn(tmp_path, 1)) != list(drawn(tmp_path, 2))


def test_the_tests_of_a_file_come_first_then_those_beside_it(tmp_path: Path) -> None:
    tests = ("tests/a/c/test_x.py", "tests/a/c/test_y.py", "tests/a/test_c.py", "tests/a/test_z.py")
    assert nearest_first("mimic/a/c/y.py", tests) == [tests[1], tests[2], tests[0], tests[3]]
    (tmp_path / "tests" / "a").mkdir(parents=True)
    assert folder_of(tmp_path, "mimic/a/c/y.py") == "tests/a"
    assert folder_of(tmp_path, "mimic/d/y.py") == "tests"
    assert folder_of(tmp_path, "mimic/y.py") == "tests"


def test_mutants_are_judged_by_tests_that_pass_as_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    tree = write(tmp_path / "tree", CODES | TESTS)
    out = tmp_path / "out.jsonl"
    monkeypatch.setattr(sys, "argv", ["mutants", str(out), "--tree", str(tree), "--jobs", "1", "--runs", "99"])
    assert mutants.main() == 0
    rows = [json.loads(line) for line in out.read_text(encoding="utf-8").splitlines()]
    results = {(row["file"], row["before"]): row["result"] for row in rows if "result" in row}
    # One file of mimic/a is tested and the other is not; nothing of mimic/b can be judged.
    assert results == {
        ("mimic/a/known.py", "2"): "caught",
        ("mimic/a/known.py", "*"): "caught",
        ("mimic/a/unknown.py", "-"): "survived",
    }
    told = capsys.readouterr().out
    assert "deselected: tests/a/test_other.py::test_fails_already" in told
    assert "passed over, as no test of the folder can run here: 2 places of tests/b" in told
    assert "| tests/a | 3 | 2 | 0 | 67% |" in told
    assert (tree / "mimic/a/known.py").read_text(encoding="utf-8") == KNOWN
    # Nothing is run again.
    lines = len(rows)
    assert mutants.main() == 0
    assert len(out.read_text(encoding="utf-8").splitlines()) == lines


def test_what_a_mutant_damages_is_mended(tmp_path: Path) -> None:
    test = "from pathlib import Path\ndef test_it():\n    Path(__file__).with_name('data').write_text('none')\n"
    code = "def known(x):\n    return -x\n"
    files = {"mimic/__init__.py": "", "mimic/a/known.py": code, "tests/a/test_known.py": test, "tests/a/data": "one"}
    copy = Copy(write(tmp_path / "tree", files), tmp_path / "copy")
    mutant = next(drawn(copy.root, 0))
    copy.judge(mutant, Folder("tests/a", files=("tests/a/test_known.py",)))
    assert {name: (copy.root / name).read_text(encoding="utf-8") for name in files} == files


def test_a_mutant_that_does_not_end_hangs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lab.mutants.runs.PATIENCE", 1.0)
    monkeypatch.setattr("lab.mutants.runs.GRACE", 2.0)
    waits = "def wait(n):\n    while n:\n        n -= n\n"
    test = "from mimic.a.wait import wait\ndef test_it():\n    wait(3)\n"
    tree = write(tmp_path / "tree", {"mimic/__init__.py": "", "mimic/a/wait.py": waits, "tests/a/test_wait.py": test})
    out = tmp_path / "out.jsonl"
    monkeypatch.setattr(sys, "argv", ["mutants", str(out), "--tree", str(tree), "--jobs", "1"])
    assert mutants.main() == 0
    rows = [json.loads(line) for line in out.read_text(encoding="utf-8").splitlines()]
    assert [row["result"] for row in rows if "result" in row] == ["hung"]


def test_what_numba_has_compiled_of_a_folder_is_forgotten(tmp_path: Path) -> None:
    cache = tmp_path / "__pycache__"
    cache.mkdir()
    for name in ("low.pyc", "low.f-1.py311.nbi", "low.f-1.py311.1.nbc"):
        (cache / name).touch()
    forget_compiled(tmp_path)
    assert [path.name for path in cache.iterdir()] == ["low.pyc"]
