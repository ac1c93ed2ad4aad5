"""The description that a second physics engine reads."""

import importlib.util

import mujoco
import numpy as np
import pytest

from lab.engines.second_engine import main, plain_mjcf
from mimic.dynamics.robot_model import load_model
from mimic.records import JOINTS
from mimic.robot.description import load_description


def test_the_plain_robot_has_the_masses_joints_and_collision_shapes_of_the_whole_one() -> None:
    plain = mujoco.MjModel.from_xml_string(plain_mjcf(load_description("cyberdog2").mjcf))
    whole = load_model(load_description("cyberdog2"), visuals=False)
    assert plain.nu == 0
    assert [plain.joint(i).name for i in range(1, plain.njnt)] == list(JOINTS)
    np.testing.assert_allclose(plain.body_mass.sum(), whole.body_mass.sum())
    np.testing.assert_allclose(plain.jnt_range[1:], whole.jnt_range[1:])
    assert plain.ngeom == whole.ngeom - 1  # without the floor


@pytest.mark.skipif(importlib.util.find_spec("pydrake") is not None, reason="Drake is installed")
def test_without_the_engine_it_says_what_to_install(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert "pip install drake" in capsys.readouterr().err
