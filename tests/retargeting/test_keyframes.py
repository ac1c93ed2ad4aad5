from __future__ import annotations

import numpy as np
import pytest

from mimic.config.retarget import RetargetSettings
from mimic.io.keyframes import KeyFrame, KeyFrames
from mimic.retargeting.keyframes import keyframe_commands
from mimic.robot.arm_mapping import posture
from mimic.robot.description import load_description
from mimic.robot.reach import Reach


@pytest.fixture(scope="module")
def reach() -> Reach:
    return Reach(load_description("cyberdog2"))


def test_toes_are_where_the_angles_put_them_when_a_frame_is_reached(reach):
    names = ("up", "forward", "down")
    frames = tuple(KeyFrame(duration=1.0, velocity=(0.0, 0.0), heading=0.0, q=posture(n, reach)) for n in names)
    commands, targets = keyframe_commands(KeyFrames(frames=frames), reach, RetargetSettings())
    assert np.allclose(np.diff(commands.t), reach.description.dt)
    for second, name in enumerate(names, 1):
        row = round(second / reach.description.dt)
        np.testing.assert_allclose(commands.p_BE[row], reach.toes(posture(name, reach)), atol=0.01)
    np.testing.assert_allclose(commands.p_BE[0], reach.toes(reach.description.poses["upright"])[:2], atol=1e-3)
    assert targets.report["clamped_share"] == 0.0


def test_velocity_is_that_of_the_frame_on_the_way_and_heading_goes_straight(reach):
    q = reach.description.poses["upright"][:6]
    frames = (
        KeyFrame(duration=1.0, velocity=(0.2, 0.0), heading=0.0, q=q),
        KeyFrame(duration=2.0, velocity=(-0.1, 0.0), heading=1.0, q=q),
    )
    commands, targets = keyframe_commands(KeyFrames(frames=frames), reach, RetargetSettings())
    assert len(commands.t) == 151
    assert set(commands.v[:50, 0]) == {0.2}
    assert set(commands.v[50:, 0]) == {-0.1}
    assert commands.heading[50] == pytest.approx(0.0)
    assert commands.heading[100] == pytest.approx(0.5)
    assert commands.heading[-1] == pytest.approx(1.0)
    assert np.array_equal(commands.p_BE, targets.p_BE)


def test_angles_that_touch_are_clamped_like_any_target(reach):
    inward = np.radians([-34.0, 45.0, -70.0, 34.0, 45.0, -70.0])
    frames = (KeyFrame(duration=1.0, velocity=(0.0, 0.0), heading=0.0, q=inward),)
    _, targets = keyframe_commands(KeyFrames(frames=frames), reach, RetargetSettings())
    assert targets.report["clamped_share"] > 0
    assert targets.moved[-1].max() > 0.01
