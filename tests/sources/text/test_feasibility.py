from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mimic.io.keyframes import KeyFrame, KeyFrames
from mimic.robot.arm_mapping import POSTURES, posture
from mimic.robot.description import load_description
from mimic.robot.reach import Reach
from mimic.sources.text.feasibility import violations


@pytest.fixture(scope="module")
def reach() -> Reach:
    return Reach(load_description("cyberdog2"))


@pytest.fixture(scope="module")
def still(reach) -> KeyFrame:
    """A second of standing."""
    return KeyFrame(duration=1.0, velocity=(0.0, 0.0), heading=0.0, q=reach.description.poses["upright"][:6])


def wrong(reach: Reach, *frames: KeyFrame, max_seconds: float = 60.0) -> list[str]:
    return violations(KeyFrames(frames=frames), reach, max_seconds)


def test_standing_and_every_posture_can_be_done(reach, still):
    frames = [dataclasses.replace(still, q=posture(name, reach)) for name in POSTURES]
    assert wrong(reach, still, *frames) == []


def test_every_posture_keeps_its_bounds_and_clearance(reach):
    for name in POSTURES:
        q = posture(name, reach)
        assert np.all((q >= reach.q_min - 1e-9) & (q <= reach.q_max + 1e-9)), name
        assert reach.is_clear(q), name


def test_a_joint_beyond_its_limit_is_named_with_the_limit(reach, still):
    q = still.q.copy()
    q[2] = -1.2 * np.pi / 180  # radians taken for degrees
    (message,) = wrong(reach, still, dataclasses.replace(still, q=q))
    assert message == "frame 2: FL_knee is -1 deg; it must be from -140 to -35 deg"


def test_a_joint_that_must_turn_too_fast_is_advised_how_long_to_take(reach, still):
    up = dataclasses.replace(still, q=posture("up", reach), duration=0.1)
    message = wrong(reach, still, up)
    assert any("FL_hip turns by" in text and "take at least 0.1" in text for text in message)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"velocity": (0.5, 0.0)}, "velocity forward is 0.5 m/s; it must be within ±0.3"),
        ({"velocity": (0.0, 0.1)}, "velocity left is 0.1 m/s; it must be within ±0"),
        ({"heading": np.pi}, "take at least 5.2 s"),
        ({"duration": 0.0}, "it must be at least 0.1 s"),
        ({"duration": -1.0}, "it must be at least 0.1 s"),
    ],
)
def test_what_the_base_cannot_do_is_reported(change, message, reach, still):
    assert message in wrong(reach, dataclasses.replace(still, **change))[0]


def test_a_motion_that_takes_too_long_is_reported(reach, still):
    assert wrong(reach, *[still] * 5, max_seconds=4.0) == ["the motion takes 5 s in all; at most 4 s are played"]


def test_arms_that_touch_are_reported(reach, still):
    inward = np.radians([-34.0, 45.0, -70.0, 34.0, 45.0, -70.0])
    (message,) = wrong(reach, dataclasses.replace(still, q=inward))
    assert "come within" in message


def test_arms_that_meet_on_the_way_are_reported(reach, still):
    """Each hand goes past the other one: both ends are clear, the middle is not."""
    one = np.radians([-30.0, 100.0, -40.0, 30.0, -40.0, -40.0])
    other = one[[3, 4, 5, 0, 1, 2]] * [-1, 1, 1, -1, 1, 1]
    assert reach.is_clear(one)
    assert reach.is_clear(other)
    found = wrong(
        reach, dataclasses.replace(still, q=one, duration=3.0), dataclasses.replace(still, q=other, duration=3.0)
    )
    assert any("on the way" in text for text in found)
