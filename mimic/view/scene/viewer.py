"""The Rerun viewer: opens a scene in a window, or serves it to browsers."""

from __future__ import annotations

import logging
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from mimic.errors import AssetError, MimicError

log = logging.getLogger(__name__)

MARK = b"RRF2"
"""First bytes of a scene file."""
FOOTER = b"RRF2FOOT"
"""Stands in its last bytes once it is complete."""
HERE = "127.0.0.1"
"""Address that only this computer reaches."""


def display_available() -> bool:
    """Return whether a window could be opened here."""
    if sys.platform == "darwin":
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def open_viewer(path: Path) -> bool:
    """Open a scene in a separate viewer that outlives this process; return False if there is no display.

    Raises:
        AssetError: If there is no such file, or it is damaged.
    """
    _check(path)
    if not display_available():
        log.info("there is no display; open the scene elsewhere with: rerun %s", path)
        return False
    start_viewer(str(path))
    return True


def start_viewer(*arguments: str) -> None:
    """Start a viewer that outlives this process and listens on this computer only."""
    run_rerun(arguments, subprocess.DEVNULL)


def run_rerun(arguments: Sequence[str], output: Any) -> subprocess.Popen[str]:
    """Run the viewer's command in a process group of its own; it listens on this computer only."""
    words = [sys.executable, "-m", "rerun", *arguments, "--bind", HERE]
    return subprocess.Popen(words, stdout=output, stderr=subprocess.STDOUT, text=True, start_new_session=True)


def serve_scene(path: Path, show: Callable[[str], None]) -> None:
    """Serve a scene to browsers on this computer until Ctrl-C.

    Args:
        path: A scene file.
        show: Receives the address to open.

    Raises:
        AssetError: If there is no such file, or it is damaged.
        MimicError: If the server ends by itself.
    """
    _check(path)
    options = ["--serve-web", "--port", "auto", "--web-viewer-port", "0"]
    process = run_rerun([str(path), *options], subprocess.PIPE)
    said = ""
    try:
        assert process.stdout is not None
        for line in process.stdout:
            said += line
            address = re.search(rf"connect at (http://{re.escape(HERE)}\S+)", line)
            if address:
                show(address[1].replace("localhost", HERE))
        raise MimicError(f"the Rerun server ended: {said.strip()[-400:] or 'no output'}")
    finally:
        end(process)


def end(process: subprocess.Popen[Any]) -> None:
    """End the viewer and its process group, because the command starts another program; return when both are gone."""
    for kind in (signal.SIGTERM, signal.SIGKILL):
        with suppress(ProcessLookupError):
            os.killpg(process.pid, kind)
        with suppress(subprocess.TimeoutExpired):
            process.communicate(timeout=5)  # to the end of the output, which all of the group write to
            return


def _check(path: Path) -> None:
    if not path.is_file():
        raise AssetError(f"there is no scene {path}; make one with a run")
    with path.open("rb") as file:
        begin = file.read(len(MARK))
        file.seek(max(path.stat().st_size - 4 * len(FOOTER), 0))
        end = file.read()
    if begin != MARK:
        raise AssetError(f"{path} is no Rerun scene; name the folder of a run, or its scene.rrd")
    if FOOTER not in end:
        raise AssetError(f"{path} is cut short; copy it again or repeat the run. To see what is left: rerun {path}")
