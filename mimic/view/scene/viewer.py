"""The Rerun viewer: opens a scene in a window, or takes a screenshot without a display."""

from __future__ import annotations

import logging
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mimic.errors import AssetError, MimicError
from mimic.io.store import written_whole
from mimic.view.scene.layout import TIMELINE

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

log = logging.getLogger(__name__)

_HERE = "127.0.0.1"
"""Address that only this computer reaches."""
_LOAD_TIME = 3.0
"""Waiting time before a screenshot, in which the viewer loads and decodes the scene [s]."""
_MENU_HEIGHT = 37
"""Height of the viewer's menu bar, which is cropped [px]."""
_START_TIMEOUT = 30.0
"""Time limit for the start of the viewer [s]."""


def display_available() -> bool:
    """Return whether a window could be opened here."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def open_viewer(path: Path) -> bool:
    """Open a scene in a separate viewer that outlives this process; return False if there is no display.

    Raises:
        AssetError: If there is no such file.
    """
    _check(path)
    if not display_available():
        log.info("there is no display; open the scene elsewhere with: rerun %s", path)
        return False
    start_viewer(str(path))
    return True


def start_viewer(*arguments: str) -> None:
    """Start a viewer that outlives this process and listens on this computer only."""
    _rerun(arguments, subprocess.DEVNULL)


def _rerun(arguments: Sequence[str], output: Any) -> subprocess.Popen[str]:
    """Run the viewer's command in a process group of its own; it listens on this computer only."""
    words = [sys.executable, "-m", "rerun", *arguments, "--bind", _HERE]
    return subprocess.Popen(words, stdout=output, stderr=subprocess.STDOUT, text=True, start_new_session=True)


def serve_scene(path: Path, show: Callable[[str], None]) -> None:
    """Serve a scene to browsers on this computer until Ctrl-C.

    Args:
        path: A scene file.
        show: Receives the address to open.

    Raises:
        AssetError: If there is no such file.
        MimicError: If the server ends by itself.
    """
    _check(path)
    options = ["--serve-web", "--port", "auto", "--web-viewer-port", "0"]
    process = _rerun([str(path), *options], subprocess.PIPE)
    said = ""
    try:
        assert process.stdout is not None
        for line in process.stdout:
            said += line
            address = re.search(rf"connect at (http://{re.escape(_HERE)}\S+)", line)
            if address:
                show(address[1].replace("localhost", _HERE))
        raise MimicError(f"the Rerun server ended: {said.strip()[-400:] or 'no output'}")
    finally:
        _end(process)


def screenshot(scene: Path, picture: Path, *, time_s: float, size: tuple[int, int] = (1600, 900)) -> None:
    """Write a PNG of the viewer, without its menu bar, at a time in the scene; needs no display.

    Args:
        scene: A scene file.
        picture: PNG file to write.
        time_s: Time on the shared clock [s].
        size: Width and height [px].

    Raises:
        AssetError: If there is no such scene.
        MimicError: If the viewer finds no Vulkan driver, or does not answer.
    """
    import cv2

    _check(scene)
    with written_whole(picture) as part:
        _take(scene, part, time_s, size)
        image = cv2.imread(str(part))
        if image is None:
            raise MimicError(f"the Rerun viewer wrote no picture of {scene}")
        cv2.imwrite(str(part), image[_MENU_HEIGHT:])


def _take(scene: Path, picture: Path, time_s: float, size: tuple[int, int]) -> None:
    with _headless((size[0], size[1] + _MENU_HEIGHT)) as viewer:
        viewer.open(str(scene.resolve()))
        for _ in range(2):  # the first call makes the views load video and plots
            viewer.set_time(TIMELINE, duration=time_s, play_state="paused")
            time.sleep(_LOAD_TIME / 2)
        viewer.save_screenshot(str(picture.resolve()))


@contextmanager
def _headless(size: tuple[int, int]) -> Iterator[ViewerClient]:
    """Run a viewer without a window, and end it on exit."""
    with socket.socket() as probe:
        probe.bind((_HERE, 0))
        port = int(probe.getsockname()[1])
    options = ["--headless", "--hide-welcome-screen", "--port", str(port), "--window-size", f"{size[0]}x{size[1]}"]
    with tempfile.TemporaryFile("w+") as output:
        process = _rerun(options, output)
        try:
            yield _connected(process, f"rerun+http://{_HERE}:{port}/proxy")
        except (OSError, RuntimeError) as error:  # it may also end later, at the first picture
            output.seek(0)
            raise _no_viewer(output.read(), error) from error
        finally:
            _end(process)


def _connected(process: subprocess.Popen[Any], address: str) -> ViewerClient:
    from rerun.experimental import ViewerClient

    deadline = time.monotonic() + _START_TIMEOUT
    while True:
        try:
            viewer = ViewerClient.connect(address)
            viewer.get_state()
            return viewer
        except (OSError, RuntimeError):
            if process.poll() is not None or time.monotonic() > deadline:
                raise
            time.sleep(0.2)


def _no_viewer(output: str, error: Exception) -> MimicError:
    if "graphics adapter" in output or "render context" in output:
        return MimicError(
            "the Rerun viewer found no Vulkan driver; without a graphics card it needs the software one "
            "(Debian and Ubuntu: apt-get install mesa-vulkan-drivers)"
        )
    return MimicError(f"the Rerun viewer took no picture: {output.strip()[-400:] or error}")


def _end(process: subprocess.Popen[Any]) -> None:
    """End the viewer and its process group, because the command starts another program; return when both are gone."""
    if sys.platform == "win32":
        subprocess.run(["taskkill", "/PID", str(process.pid), "/T", "/F"], capture_output=True, check=False)
        process.wait(timeout=10)
        return
    for kind in (signal.SIGTERM, signal.SIGKILL):
        with suppress(ProcessLookupError):
            os.killpg(process.pid, kind)
        with suppress(subprocess.TimeoutExpired):
            process.communicate(timeout=5)  # to the end of the output, which all of the group write to
            return


def _check(path: Path) -> None:
    if not path.is_file():
        raise AssetError(f"there is no scene {path}; make one with a run")
