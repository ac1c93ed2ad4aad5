"""Models of other robots: what is changed in them."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from mimic.robot.model import leave_out

BACKWARD = """<mujoco><worldbody><body><joint name="hinge" axis="0 -1 0" range="-60 90" actuatorfrcrange="-3 5"/>
<geom size="0.1"/></body></worldbody></mujoco>"""


def test_limits_of_a_hinge_that_is_turned_change_their_sides():
    spec = mujoco.MjSpec.from_string(BACKWARD)
    leave_out(spec, Path("backward.xml"))
    model = spec.compile()
    assert model.jnt_axis[0] == pytest.approx([0.0, 1.0, 0.0])
    assert model.jnt_range[0] == pytest.approx(np.radians([-90.0, 60.0]))
    assert model.jnt_actfrcrange[0] == pytest.approx([-5.0, 3.0])
