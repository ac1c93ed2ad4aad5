"""The Rerun viewer: opening a scene on a screen, and taking a picture of it without one."""

from __future__ import annotations

import logging
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from mimic.errors import AssetError, MimicError
from mimic.store import written_whole
from mimic.view.layout import TIMELINE

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

log = logging.getLogger(__name__)

_SETTLE = 3.0
"""The viewer loads and decodes in the background; it gets this long before its picture is taken [s]."""
_MENU = 37
"""Height of the viewer's own menu, which is cut off [px]."""
_START = 30.0
"""A viewer that does not answer by then will not [s]."""


def display_available() -> bool:
    """Return whether a window could be opened here."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def open_viewer(path: Path) -> bool:
    """Open a scene in a viewer of its own that outlives this process; return False where there is no display.

    Raises:
        AssetError: If there is no such file.
    """
    _check(path)
    if not display_available():
        log.info("there is no display; open the scene elsewhere with: rerun %s", path)
        return False
    subprocess.Popen(
        [sys.executable, "-m", "rerun", str(path)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    return True


def screenshot(scene: Path, picture: Path, *, time_s: float, size: tuple[int, int] = (1600, 900)) -> None:
    """Write a PNG of the viewer without its menu at a moment of the scene; needs no display.

    Args:
        scene: A scene file.
        picture: Where the PNG goes.
        time_s: Moment on the shared clock [s].
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
        cv2.imwrite(str(part), image[_MENU:])


def _take(scene: Path, picture: Path, time_s: float, size: tuple[int, int]) -> None:
    with _headless((size[0], size[1] + _MENU)) as viewer:
        try:
            viewer.open(str(scene.resolve()))
            for _ in range(2):  # the first time wakes the views up, so that video and plots load
                viewer.set_time(TIMELINE, duration=time_s, play_state="paused")
                time.sleep(_SETTLE / 2)
            viewer.save_screenshot(str(picture.resolve()))
        except (RuntimeError, OSError) as error:
            raise MimicError(f"the Rerun viewer could not take a picture of {scene}: {error}") from error


@contextmanager
def _headless(size: tuple[int, int]) -> Iterator[ViewerClient]:
    """Run a viewer without a window, and end it."""
    from rerun.experimental import ViewerClient

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    options = ["--headless", "--hide-welcome-screen", "--bind", "127.0.0.1", "--port", str(port)]
    with tempfile.TemporaryFile("w+") as said:
        process = subprocess.Popen(
            [sys.executable, "-m", "rerun", *options, "--window-size", f"{size[0]}x{size[1]}"],
            stdout=said,
            stderr=said,
            start_new_session=True,
        )
        try:
            until = time.monotonic() + _START
            while True:
                try:
                    viewer = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
                    viewer.get_state()
                    break
                except (OSError, RuntimeError) as error:
                    if process.poll() is None and time.monotonic() < until:
                        time.sleep(0.2)
                        continue
                    said.seek(0)
                    raise _no_viewer(said.read()) from error
            yield viewer
        finally:
            _end(process)


def _no_viewer(said: str) -> MimicError:
    if "graphics adapter" in said:
        return MimicError(
            "the Rerun viewer found no Vulkan driver; without a graphics card it needs the software one "
            "(Debian and Ubuntu: apt-get install mesa-vulkan-drivers)"
        )
    return MimicError(f"the Rerun viewer did not start: {said.strip()[-400:] or 'it said nothing'}")


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the viewer: the command starts a program of its own, so its whole group of processes."""
    if sys.platform == "win32":
        subprocess.run(["taskkill", "/PID", str(process.pid), "/T", "/F"], capture_output=True, check=False)
    else:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGTERM)
    process.wait(timeout=10)


def _check(path: Path) -> None:
    if not path.is_file():
        raise AssetError(f"there is no scene {path}; make one with a run")
