"""Shipped files are found wherever mimic is started."""

import tomllib
from pathlib import Path

import pytest

from mimic.errors import AssetError
from mimic.io import assets
from mimic.io.assets import DEMO_CLIP, shipped

ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_the_demo_clip_is_found_in_a_checkout() -> None:
    assert shipped(*DEMO_CLIP).samefile(ROOT / "examples" / "videos" / "waving.mp4")


def test_an_installed_package_has_its_files_inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "site-packages" / "mimic"
    clip = package.joinpath(*DEMO_CLIP)
    clip.parent.mkdir(parents=True)
    clip.touch()
    monkeypatch.setattr(assets, "_PACKAGE", package)
    assert shipped(*DEMO_CLIP) == clip
    assert shipped("examples") == package / "examples"


def test_a_missing_file_is_named() -> None:
    with pytest.raises(AssetError, match="assets/no_robot is missing"):
        shipped("assets", "no_robot")


def test_wheel_and_source_archive_take_the_demo_clip_along() -> None:
    build = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]
    clip = "/".join(DEMO_CLIP)
    assert build["wheel"]["force-include"][clip] == f"mimic/{clip}"
    assert f"/{clip}" not in build["sdist"]["exclude"]
    assert not any("*" in pattern for pattern in build["sdist"]["exclude"])
