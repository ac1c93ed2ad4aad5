"""Downloads a package from the registry that pip or uv is set up with."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_PYTHON = "3.12"
"""Python of the wheel. It is not installed: it may be one for another Python and another machine."""
_PIP_PLATFORM = "manylinux2014_x86_64"
"""Its platform, as pip calls it."""
_UV_PLATFORM = "x86_64-manylinux2014"
"""Its platform, as uv calls it."""


class RegistryError(Exception):
    """No program could download the package; the message says why."""


@contextmanager
def download(package: str) -> Iterator[Path]:
    """Yield the wheel of a release, or the folder of its content; it is removed after the block.

    The programs read the user's own settings of registries, proxies and certificates.

    Args:
        package: Name and release, as the program takes them.

    Raises:
        RegistryError: If no program can download it.
    """
    reasons = []
    for program, command in _programs():
        with tempfile.TemporaryDirectory(prefix="mimic-") as folder:
            error = _run([*command, package], Path(folder))
            if error is None:
                place = Path(folder) / "wheel"
                yield next(place.glob("*.whl"), place)
                return
            reasons.append(f"{program}: {error}")
    raise RegistryError("; ".join(reasons) or "neither pip nor uv is here")


def _programs() -> Iterator[tuple[str, list[str]]]:
    """Yield the programs that are here and their commands up to the package; first the one that runs this Python."""
    uv = os.environ.get("UV") or shutil.which("uv") or shutil.which("uv", path=str(Path(sys.executable).parent))
    found = {}
    if importlib.util.find_spec("pip") is not None:
        options = (
            "--quiet --no-deps --only-binary=:all: --disable-pip-version-check --no-input --no-cache-dir "
            f"--implementation cp --python-version {_PYTHON} --platform {_PIP_PLATFORM} --dest wheel"
        )
        found["pip"] = [sys.executable, "-m", "pip", "download", *options.split()]
    if uv is not None:
        options = (
            "--quiet --no-deps --only-binary :all: --no-cache "
            f"--python-version {_PYTHON} --python-platform {_UV_PLATFORM} --target wheel"
        )
        found["uv"] = [uv, "pip", "install", "--python", sys.executable, *options.split()]
    yield from sorted(found.items(), reverse="UV" in os.environ)


def _run(command: list[str], folder: Path) -> str | None:
    """Run a command in a folder, away from any project's own versions; return the reason if it failed."""
    where = {"env": {**os.environ, "TMPDIR": str(folder)}, "cwd": folder}
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace", **where)
    if done.returncode == 0:
        return None
    lines = [line.strip() for line in (done.stdout + done.stderr).splitlines()]
    return next((line for line in reversed(lines) if line.lower().startswith("error")), (lines or ["it failed"])[-1])
