"""A second robot: the Unitree Go2, described here, with an MJCF that the shared test data holds."""

import shutil
from pathlib import Path

import pytest

from mimic.robot.description import RobotDescription, load_description

MJCF = Path(__file__).parents[2] / ".." / "shared" / "data" / "logs" / "go2_air_chirp" / "go2_hung.xml"


@pytest.fixture(scope="session")
def go2(tmp_path_factory: pytest.TempPathFactory) -> RobotDescription:
    """Return the description of the Go2 in a folder of its own, or skip where its MJCF is absent."""
    if not MJCF.is_file():
        pytest.skip("the Go2's MJCF is not beside the repository (../shared/data/logs/go2_air_chirp)")
    folder = tmp_path_factory.mktemp("go2")
    shutil.copy(Path(__file__).parent / "go2" / "robot.toml", folder)
    shutil.copy(MJCF, folder / "go2.xml")
    return load_description(folder)
