"""The Unitree Go2, as it ships and from an MJCF of others that the shared test data holds."""

import shutil
from pathlib import Path

import pytest

from mimic.robot.description import RobotDescription, load_description

MJCF = Path(__file__).parents[2] / ".." / "shared" / "data" / "logs" / "go2_air_chirp" / "go2_hung.xml"
MORE = """<keyframe><key name="home" ctrl="0 0 0 0 0 0 0 0 0 0 0 0"/></keyframe>
<sensor><jointpos joint="FL_hip_joint"/></sensor></mujoco>"""
"""Parts that refer to names which change."""


@pytest.fixture(scope="session")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> RobotDescription:
    """Return the Go2 of the description and the MJCF of others, with a mesh whose file is missing; or skip."""
    if not MJCF.is_file():
        pytest.skip("the Go2's MJCF is not beside the repository (../shared/data/logs/go2_air_chirp)")
    folder = tmp_path_factory.mktemp("go2")
    shutil.copy(Path(__file__).parent / "go2" / "robot.toml", folder)
    text = MJCF.read_text(encoding="utf-8").replace("</asset>", '<mesh name="hull" file="hull.obj"/></asset>')
    text = text.replace('<site name="imu"', '<geom class="visual" mesh="hull"/><site name="imu"')
    (folder / "go2.xml").write_text(text.replace("</mujoco>", MORE), encoding="utf-8")
    return load_description(folder)


@pytest.fixture(scope="session", params=["shipped", "foreign"])
def go2(request: pytest.FixtureRequest) -> RobotDescription:
    """Return the Go2 that ships, then that of others."""
    return load_description("go2") if request.param == "shipped" else request.getfixturevalue("foreign")
