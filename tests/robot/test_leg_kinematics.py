from __future__ import annotations

import mujoco
import numpy as np

from mimic.dynamics.robot_model import load_model
from mimic.robot.leg_kinematics import all_toes, front_toes
from mimic.robot.model import TOES


def test_toes_are_where_the_model_has_them(description):
    model = load_model(description, visuals=False)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    q = rng.uniform(description.q_min, description.q_max, (20, 12))
    found = all_toes(q, description)
    for row, joints in enumerate(q):
        data.qpos[:7] = 0, 0, 1, 1, 0, 0, 0
        data.qpos[7:] = joints
        mujoco.mj_kinematics(model, data)
        expected = [data.site_xpos[model.site(name).id] - [0, 0, 1] for name in TOES]
        assert np.allclose(found[row], expected, atol=1e-6)
    assert np.array_equal(found[:, :2], front_toes(q, description))
