"""The trunk over its feet, against MuJoCo."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mimic.dynamics.robot_model import load_model
from mimic.errors import AssetError
from mimic.robot.description import load_description
from mimic.robot.model import TOES
from mimic.robot.trunk import TrunkPoses

HIND_TOES = TOES[2:]


def standing(description, height: float, pitch: float) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A robot whose trunk is there, with its hind toes where they are when it stands by itself."""
    numbers = description.trunk_numbers
    model = load_model(description)
    data = mujoco.MjData(model)
    pose = TrunkPoses(description).of(height, pitch)
    lean = numbers.lean + pitch
    data.qpos[:3] = [pose.base[0], 0.0, 1.0 + pose.base[1]]
    mujoco.mju_axisAngle2Quat(data.qpos[3:7], np.array([0.0, 1.0, 0.0]), lean - np.pi / 2)
    data.qpos[7:13] = description.poses["upright"][:6]
    data.qpos[13:] = [*numbers.stance, *(numbers.stance * [-1.0, 1.0, 1.0])] + pose.joints
    mujoco.mj_forward(model, data)
    return model, data


def carried(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Torques of the hind legs of a robot of which each hind toe carries half."""
    weight = model.body_mass.sum() * 9.81
    force = np.zeros(model.nv)
    for toe in HIND_TOES:
        site = model.site(toe)
        mujoco.mj_applyFT(
            model, data, np.array([0, 0, weight / 2]), np.zeros(3), data.site_xpos[site.id], int(site.bodyid[0]), force
        )
    return (data.qfrc_bias - force)[12:]


@pytest.mark.parametrize("robot", ["cyberdog2", "go2"])
@pytest.mark.parametrize(("height", "share"), [(-0.05, 0.0), (0.0, 0.86), (-0.065, 0.5)])
def test_toes_and_centre_of_mass_stay_while_the_hips_come_down(robot, height, share):
    description = load_description(robot)
    pitch = share * description.trunk_numbers.pitch[1]
    model, before = standing(description, 0.0, 0.0)
    _, after = standing(description, height, pitch)
    for toe in HIND_TOES:
        site = model.site(toe).id
        np.testing.assert_allclose(after.site_xpos[site], before.site_xpos[site], atol=1e-3)
    np.testing.assert_allclose(after.subtree_com[1][:2], before.subtree_com[1][:2], atol=2e-3)
    hip = model.body("RL_abad").id
    assert after.xpos[hip][2] - before.xpos[hip][2] == pytest.approx(height, abs=1e-3)


@pytest.mark.parametrize("robot", ["cyberdog2", "go2"])
def test_the_torque_is_what_the_weight_needs_more(robot):
    description = load_description(robot)
    before = carried(*standing(description, 0.0, 0.0))
    after = carried(*standing(description, -0.05, 0.1))
    torque = TrunkPoses(description).of(-0.05, 0.1).torque
    np.testing.assert_allclose(torque, after - before, atol=0.03)


def test_many_heights_at_once_are_those_of_one_after_another(description):
    poses = TrunkPoses(description)
    heights = np.array([0.0, -0.013, -0.07])
    pitches = np.array([0.0, 0.11, 0.35])
    together = poses.of(heights, pitches)
    for row in range(3):
        np.testing.assert_allclose(together.joints[row], poses.of(heights[row], pitches[row]).joints)


def test_torch_gives_what_numpy_gives(description):
    torch = pytest.importorskip("torch", reason="training needs the extra 'train'")
    there = TrunkPoses(description, torch).of(torch.tensor([-0.033, 0.0]), torch.tensor([0.21, 0.04]))
    here = TrunkPoses(description).of(np.array([-0.033, 0.0]), np.array([0.21, 0.04]))
    for a, b in zip(there, here, strict=True):
        np.testing.assert_allclose(a.numpy(), b, atol=1e-5)


def test_a_height_that_no_leg_reaches_is_refused(description):
    deep = replace(description.trunk_numbers, height=np.array([-0.3, 0.0]))
    with pytest.raises(AssetError, match="do not reach"):
        TrunkPoses(replace(description, trunk_numbers=deep))
    with pytest.raises(AssetError, match="cannot crouch or lean"):
        TrunkPoses(replace(description, trunk_numbers=None))
