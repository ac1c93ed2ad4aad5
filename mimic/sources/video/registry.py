"""Downloads a package from the registry that pip, uv or npm is set up with."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

_PYTHON, _PIP_PLATFORM, _UV_PLATFORM = "3.12", "manylinux2014_x86_64", "x86_64-manylinux2014"
"""The wheel is not installed: it may be one for another Python and another machine."""


class RegistryError(Exception):
    """No program could download the package; the message says why."""


@contextmanager
def download_wheel(
    name: str, version: str, *, progress: Callable[[int, int | None], None] | None = None
) -> Iterator[Path]:
    """Yield the wheel of a release, or the folder of its content; it is removed after the block.

    pip and uv read the user's own settings of registries, proxies and certificates.

    Args:
        name, version: The release.
        progress: Called with the megabytes that are there, and None.

    Raises:
        RegistryError: If neither pip nor uv can download it.
    """
    reasons = []
    for program, command in _programs():
        with tempfile.TemporaryDirectory(prefix="mimic-") as folder:
            place = Path(folder) / "wheel"
            error = _run([*command, str(place), f"{name}=={version}"], Path(folder), progress)
            if error is None:
                yield next(place.glob("*.whl"), place)
                return
            reasons.append(f"{program}: {error}")
    raise RegistryError("; ".join(reasons) or "neither pip nor uv is in this environment or on the path")


@contextmanager
def download_package(
    name: str, version: str, *, progress: Callable[[int, int | None], None] | None = None
) -> Iterator[Path]:
    """Yield the archive (.tgz) of a release in npm's registry; it is removed after the block.

    Raises:
        RegistryError: If npm is not there, or cannot download it.
    """
    npm = shutil.which("npm")
    if npm is None:
        raise RegistryError("npm, which comes with Node.js, is not on the path")
    with tempfile.TemporaryDirectory(prefix="mimic-") as folder:
        error = _run([npm, "pack", "--silent", f"{name}@{version}"], Path(folder), progress)
        if error is not None:
            raise RegistryError(f"npm: {error}")
        yield next(Path(folder).glob("*.tgz"))


def _programs() -> Iterator[tuple[str, list[str]]]:
    """Yield the programs that are here and their commands up to the folder; first the one that runs this Python."""
    uv = os.environ.get("UV") or shutil.which("uv") or shutil.which("uv", path=str(Path(sys.executable).parent))
    uv_first = "UV" in os.environ
    found = {}
    if importlib.util.find_spec("pip") is not None:
        found["pip"] = [
            *(sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary=:all:"),
            *("--disable-pip-version-check", "--no-input", "--no-cache-dir", "--implementation", "cp"),
            *("--python-version", _PYTHON, "--platform", _PIP_PLATFORM, "--dest"),
        ]
    if uv is not None:
        found["uv"] = [
            *(uv, "pip", "install", "--quiet", "--no-deps", "--only-binary", ":all:", "--no-cache"),
            *("--python", sys.executable, "--python-version", _PYTHON, "--python-platform", _UV_PLATFORM, "--target"),
        ]
    yield from sorted(found.items(), reverse=uv_first)


def _run(command: list[str], folder: Path, progress: Callable[[int, int | None], None] | None) -> str | None:
    """Run a command in a folder, away from any project's own versions; return the reason if it failed."""
    environment = {**os.environ, "TMPDIR": str(folder)}
    output = folder / "output"
    with (
        open(output, "w") as stream,
        subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=stream, stderr=stream, env=environment, cwd=folder
        ) as process,
    ):
        try:
            while process.poll() is None:
                if progress is not None:
                    progress(_megabytes(folder), None)
                time.sleep(0.1)
        except BaseException:
            process.terminate()
            raise
    if process.returncode == 0:
        return None
    lines = [line.strip() for line in output.read_text(errors="replace").splitlines()]
    return next((line for line in reversed(lines) if line.lower().startswith("error")), (lines or ["it failed"])[-1])


def _megabytes(folder: Path) -> int:
    total = 0
    for place, _, names in os.walk(folder):
        for name in names:
            try:
                total += os.lstat(os.path.join(place, name)).st_size
            except OSError:  # moved meanwhile
                continue
    return total // 1_000_000
