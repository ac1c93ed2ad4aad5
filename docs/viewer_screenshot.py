"""A screenshot of the Rerun viewer without a display."""

from __future__ import annotations

import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
from rerun.experimental import ViewerClient

from mimic.errors import AssetError, MimicError
from mimic.io.store import written_whole
from mimic.view.scene.layout import TIMELINE
from mimic.view.scene.viewer import HERE, end, run_rerun

_LOAD_TIME = 3.0
"""Waiting time before a screenshot, in which the viewer loads and decodes the scene [s]."""
_MENU_HEIGHT = 37
"""Height of the viewer's menu bar, which is cropped [px]."""
_START_TIMEOUT = 30.0
"""Time limit for the start of the viewer [s]."""


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
    if not scene.is_file():
        raise AssetError(f"there is no scene {scene}; make one with a run")
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
        probe.bind((HERE, 0))
        port = int(probe.getsockname()[1])
    options = ["--headless", "--hide-welcome-screen", "--port", str(port), "--window-size", f"{size[0]}x{size[1]}"]
    with tempfile.TemporaryFile("w+") as output:
        process = run_rerun(options, output)
        try:
            yield _connected(process, f"rerun+http://{HERE}:{port}/proxy")
        except (OSError, RuntimeError) as error:  # it may also end later, at the first picture
            output.seek(0)
            raise _no_viewer(output.read(), error) from error
        finally:
            end(process)


def _connected(process: subprocess.Popen[Any], address: str) -> ViewerClient:
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
