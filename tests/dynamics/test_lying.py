"""Where a robot lies without power is computed."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mimic.dynamics.lying import sink
from mimic.dynamics.robot_model import load_model
from mimic.robot.description import load_description


@pytest.fixture(params=["cyberdog2", "go2"], scope="module")
def sunk(request):
    robot = load_description(request.param)
    model = load_model(robot, visuals=False)
    data = mujoco.MjData(model)
    data.time = 3.0
    data.qpos[2:7] = robot.pose_height["lie"] + 0.005, 1.0, 0.0, 0.0, 0.0
    data.qpos[7:] = robot.poses["lie"]
    sink(model, data)
    return robot, model, data


def test_it_lies_on_its_trunk_its_knees_on_their_stops_and_its_legs_spread(sunk):
    robot, model, data = sunk
    knees = slice(9, None, 3)
    assert data.qpos[knees] == pytest.approx(robot.q_min[2::3], abs=0.02)
    assert data.qpos[2] < 0.55 * robot.pose_height["lie"]
    touching = {model.geom(contact.geom2).name for contact in data.contact}
    assert "body" in touching
    outward = data.qpos[7::3] * [1, -1, 1, -1]
    assert outward[2:].min() > 0.3


def test_it_stays_where_it_is_and_the_motors_work_again(sunk):
    _, model, data = sunk
    before = data.qpos.copy()
    assert data.time == 3.0
    assert not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_ACTUATION
    sink(model, data)
    assert np.abs(data.qpos - before).max() < 0.01
