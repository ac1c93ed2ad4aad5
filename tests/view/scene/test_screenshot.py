"""The screenshot of the viewer that the documentation's pictures are made with."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import cv2
import pytest

from mimic.errors import AssetError, MimicError
from mimic.records import RunLog
from mimic.robot.description import RobotDescription
from mimic.view.scene.scene import save_scene

spec = importlib.util.spec_from_file_location(
    "viewer_screenshot", Path(__file__).parents[3] / "docs" / "viewer_screenshot.py"
)
assert spec
assert spec.loader
module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)


def test_a_missing_scene_is_named(tmp_path: Path) -> None:
    with pytest.raises(AssetError, match=r"no\.rrd"):
        module.screenshot(tmp_path / "no.rrd", tmp_path / "no.png", time_s=0.0)


@pytest.mark.slow
def test_screenshot_needs_no_display(log: RunLog, description: RobotDescription, tmp_path: Path) -> None:
    scene, picture = tmp_path / "scene.rrd", tmp_path / "scene.png"
    save_scene(scene, log=log, description=description)
    try:
        module.screenshot(scene, picture, time_s=0.5, size=(640, 400))
    except MimicError as error:
        if "no Vulkan driver" not in str(error):
            raise
        pytest.skip(str(error))
    image = cv2.imread(str(picture))
    assert image is not None
    assert image.shape == (400, 640, 3)
    assert image.std() > 20
