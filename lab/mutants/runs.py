"""Runs of the tests in a copy of the tree."""

from __future__ import annotations

import compileall
import contextlib
import json
import os
import py_compile
import resource
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from lab.mutants.places import Mutant

LEFT_OUT = shutil.ignore_patterns(".git", ".gpu*", ".venv", "__pycache__", ".*_cache", ".hypothesis", "runs", "site")
"""What a copy of the tree goes without."""

OWN_FILES = {"__pycache__", ".hypothesis"}
"""Folders that runs may write to."""

OWN_ROOT = Path(__file__).resolve().parents[2]

LONGEST = 1800.0
"""Time limit of a folder's tests with the code as it is [s]."""

PATIENCE = 3.0
"""Tests of a mutant that take longer than this many times the folder's time, and `GRACE`, hang."""

GRACE = 30.0
"""[s]"""

MEMORY = 32 * 2**30
"""Most address space of a run [bytes]."""

COLLECTED = (0, 5)
"""Exit statuses of pytest for tests that are found, and for none."""

USAGE_ERROR = 4
"""Exit status of pytest when a conftest.py cannot be imported."""

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")


@dataclass(frozen=True)
class Folder:
    """A folder of tests, as it is without a mutant."""

    folder: str
    seconds: float = 0.0
    passed: int = 0
    files: tuple[str, ...] = ()
    """Files of which at least one test passes."""
    deselected: tuple[str, ...] = ()
    """Tests that fail, and files that cannot be imported."""


@dataclass
class Ended:
    """How a run of pytest ended."""

    status: int | None
    """Exit status, or None at the time limit."""
    seconds: float
    passed: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    output: str = ""


def folder_of(root: Path, file: str) -> str:
    """Return the folder of tests that mirrors a file: tests/a for mimic/a/b.py, or tests where there is none."""
    parts = Path(file).parts
    mirrored = f"tests/{parts[1]}"
    return mirrored if (root / mirrored).is_dir() else "tests"


def test_files(root: Path, folder: str) -> list[str]:
    """Return the files of tests in a folder and those inside it; of `tests`, those of itself."""
    pattern = "test_*.py" if folder == "tests" else "**/test_*.py"
    return sorted(str(path.relative_to(root)) for path in (root / folder).glob(pattern))


def nearest_first(file: str, tests: tuple[str, ...]) -> list[str]:
    """Return the files of tests, a file's own first, then those of its folder, then the others."""
    path = Path("tests", *Path(file).parts[1:])
    own = [str(up.parent / f"test_{up.stem.removeprefix('_')}.py") for up in (path, *path.parents[:-2])]

    def distance(test: str) -> tuple[int, int]:
        beside = Path(test).parent == path.parent
        return own.index(test) if test in own else len(own), 0 if beside else 1

    return sorted(tests, key=distance)


class Copy:
    """A copy of the tree, in which one run at a time is made.

    Everything in it is compiled once, and Python compares each file with what was compiled (PEP 552, checked hash): a
    changed file is never taken for the old one. Runs write no compiled files themselves. A copy that a mutant has
    damaged is made anew.
    """

    def __init__(self, source: Path, place: Path) -> None:
        self.root = place / "tree"
        self.work = place / "work"
        self._source = source
        self._make()

    def _make(self) -> None:
        shutil.copytree(self._source, self.root, ignore=LEFT_OUT, symlinks=True)
        checked = py_compile.PycInvalidationMode.CHECKED_HASH
        for name in ("mimic", "tests"):
            compileall.compile_dir(self.root / name, quiet=2, invalidation_mode=checked)
        self._made = self._files()

    def _files(self) -> dict[Path, tuple[int, int]]:
        """Return size and time of change of each file, without compiled ones and those of hypothesis."""
        files = [path for path in self.root.rglob("*") if path.is_file() and not OWN_FILES & {*path.parts}]
        return {path: (path.stat().st_size, path.stat().st_mtime_ns) for path in files}

    def pytest(self, files: list[str], options: list[str], limit: float) -> Ended:
        """Run files of tests in the fast tier, for some seconds at the most."""
        shutil.rmtree(self.work, ignore_errors=True)
        self.work.mkdir(parents=True)
        outcomes = self.work / "outcomes.json"
        command = [sys.executable, "-m", "pytest", "-q", "--assert=plain", f"--rootdir={self.root}"]
        command += ["-p", "no:cacheprovider", "-p", "lab.mutants.outcomes", *options, *files]
        own = {
            "PYTHONPATH": os.pathsep.join([str(self.root), str(OWN_ROOT)]),  # the second for the plugin
            "PYTHONDONTWRITEBYTECODE": "1",
            "MUTANTS_OUTCOMES": str(outcomes),
            "TMPDIR": str(self.work),
            "XDG_STATE_HOME": str(self.work),
            "CUDA_VISIBLE_DEVICES": "",
        }
        begun = time.monotonic()
        with (self.work / "output.txt").open("w+", encoding="utf-8", errors="replace") as output:
            process = subprocess.Popen(
                command,
                cwd=self.root,
                env=os.environ | ONE_THREAD | own,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=_prepare,
            )
            status: int | None = None
            try:
                status = process.wait(limit)
            except subprocess.TimeoutExpired:
                pass
            finally:
                _kill(process)
            seconds = time.monotonic() - begun
            output.seek(0)
            text = output.read()
        ended = Ended(status, round(seconds, 1), output=text)
        if outcomes.exists():
            told = json.loads(outcomes.read_text(encoding="utf-8"))
            ended.passed = told["passed"]
            ended.failed = told["failed"]
        return ended

    def as_it_is(self, folder: str) -> Folder:
        """Run a folder's tests with no mutant, and return which of them can judge one."""
        files = test_files(self.root, folder)
        dropped: list[str] = []
        ended = self.pytest(files, ["--continue-on-collection-errors"], LONGEST)
        if ended.status == USAGE_ERROR:
            files, dropped = self._importable(files)
            ended = self.pytest(files, ["--continue-on-collection-errors"], LONGEST)
        usable = dict.fromkeys(test.split("::")[0] for test in ended.passed)
        return Folder(
            folder,
            ended.seconds,
            len(ended.passed),
            tuple(file for file in files if file in usable),
            tuple(dropped + ended.failed),
        )

    def _importable(self, files: list[str]) -> tuple[list[str], list[str]]:
        """Return the files in folders whose conftest.py can be imported, and the others."""
        good: list[str] = []
        bad: list[str] = []
        for parent in dict.fromkeys(Path(file).parent for file in files):
            inside = [file for file in files if Path(file).parent == parent]
            ended = self.pytest(inside, ["--collect-only", "--continue-on-collection-errors"], LONGEST)
            (bad if ended.status == USAGE_ERROR else good).extend(inside)
        return good, bad

    def judge(self, mutant: Mutant, folder: Folder) -> dict[str, Any]:
        """Run the tests against a mutant, its own first, until one fails; return the row."""
        path = self.root / mutant.file
        source = path.read_text(encoding="utf-8")
        _, changed = self._made[path]
        files = nearest_first(mutant.file, folder.files)
        # A file without a test that passes is not among the files, and need not be deselected.
        options = [f"--deselect={test}" for test in folder.deselected if test.split("::")[0] in files]
        path.write_text(mutant.of(source), encoding="utf-8")
        forget_compiled(path.parent)
        try:
            ended = self.pytest(files, ["-x", *options], PATIENCE * folder.seconds + GRACE)
        finally:
            path.write_text(source, encoding="utf-8")
            os.utime(path, ns=(changed, changed))
            forget_compiled(path.parent)
            if self._files() != self._made:
                shutil.rmtree(self.root)
                self._make()
        row = {**asdict(mutant), "folder": folder.folder, "result": "caught", "seconds": ended.seconds}
        if ended.status is None:
            return {**row, "result": "hung"}
        if ended.status in COLLECTED:
            return {**row, "result": "survived"}
        last = ended.output.strip().splitlines()[-1:]
        return {**row, "by": (ended.failed or last or [f"status {ended.status}"])[0]}


def forget_compiled(folder: Path) -> None:
    """Remove what numba has compiled of a folder: it looks for changes of a function's file, not of those it calls."""
    for file in (folder / "__pycache__").glob("*.nb[ci]"):
        file.unlink()


def _prepare() -> None:
    """Hold the process below `MEMORY`, and let it hear Ctrl-C, which shells take from what runs in the background."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End a run and all processes that it has started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
