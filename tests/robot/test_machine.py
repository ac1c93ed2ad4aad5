from pathlib import Path

import pytest

from mimic.errors import AssetError
from mimic.robot.machine import read_machine

SLIDE = """<mujoco><worldbody><body name="cart"><inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/>
<joint name="{joint}" type="{type}" axis="1 0 0" frictionloss="3"/></body></worldbody></mujoco>"""


def written(folder: Path, joint: str = "slide", type: str = "slide") -> Path:
    path = folder / "robot.xml"
    path.write_text(SLIDE.format(joint=joint, type=type))
    return path


def test_a_sliding_joint_is_read_in_metres_with_its_friction(tmp_path: Path) -> None:
    machine = read_machine(written(tmp_path), {"kp": 100.0, "kd": {"slide": 5.0}})
    assert machine.unit == "m"
    assert (machine.drives.kp[0], machine.drives.kd[0], machine.drives.friction[0]) == (100.0, 5.0, 3.0)


def test_a_free_base_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "robot.xml"
    path.write_text(
        SLIDE.format(joint="base", type="slide").replace('type="slide" axis="1 0 0" frictionloss="3"', 'type="free"')
    )
    with pytest.raises(AssetError, match="'base' is free or a ball"):
        read_machine(path)


def test_a_file_that_is_no_model_is_refused(tmp_path: Path) -> None:
    (tmp_path / "robot.xml").write_text("<mujoco>")
    with pytest.raises(AssetError, match="not an MJCF"):
        read_machine(tmp_path / "robot.xml")
