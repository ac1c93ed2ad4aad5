from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mimic.records import LEGS
from mimic.robot.description import load_description
from mimic.robot.leg_kinematics import all_toes
from mimic.robot.reach import FRONT, Reach

REACH = Reach(load_description("cyberdog2"))
DESCRIPTION = load_description("cyberdog2")
MIRROR = np.array([1.0, -1.0, 1.0])

points = arrays(np.float64, (2, 3), elements=st.floats(-0.6, 0.6))
joints = arrays(np.float64, FRONT, elements=st.floats(0.0, 1.0)).map(
    lambda u: REACH.q_min + u * (REACH.q_max - REACH.q_min)
)
away = settings(max_examples=60, deadline=None, derandomize=True)


def test_toes_agree_with_mujoco():
    model = mujoco.MjModel.from_xml_path(str(DESCRIPTION.mjcf))
    data = mujoco.MjData(model)
    q = np.random.default_rng(0).uniform(DESCRIPTION.q_min, DESCRIPTION.q_max, (1000, 12))
    toes = all_toes(q, DESCRIPTION)
    for row in range(len(q)):
        data.qpos[:7] = (0, 0, 0, 1, 0, 0, 0)
        data.qpos[7:] = q[row]
        mujoco.mj_kinematics(model, data)
        expected = [data.site(f"{leg}_toe").xpos for leg in LEGS]
        assert np.abs(toes[row] - expected).max() < 1e-9
    assert np.array_equal(REACH.toes(q), toes[:, :2])


def test_closed_form_leg_agrees_with_the_model_both_ways():
    q = np.random.default_rng(1).uniform(REACH.q_min, REACH.q_max, (300, FRONT))
    p = REACH.toes(q)
    for side, leg in enumerate(REACH.legs):
        assert np.abs(leg.forward(q[:, 3 * side : 3 * side + 3]) - p[:, side]).max() < 1e-12
    for q_row, p_row in zip(q, p, strict=True):
        assert np.abs(REACH.inverse(p_row, q_row) - q_row).max() < 1e-6


def test_bounds_keep_five_degrees_to_the_joint_limits():
    assert np.allclose(REACH.q_min - DESCRIPTION.q_min[:FRONT], np.radians(5), atol=1e-6)
    assert np.allclose(DESCRIPTION.q_max[:FRONT] - REACH.q_max, np.radians(5), atol=1e-6)


@away
@given(p=points)
def test_closest_point_keeps_limits_and_gaps(p):
    found = REACH.closest(p)
    assert np.all(found.q >= REACH.q_min - 1e-8)
    assert np.all(found.q <= REACH.q_max + 1e-8)
    assert REACH.gap(found.q) >= 0.01 - 2e-6
    assert np.abs(REACH.toes(found.q) - found.p_BE).max() < 1e-7
    assert np.allclose(found.moved, np.linalg.norm(found.p_BE - p, axis=1))


@away
@given(p=points)
def test_a_clamped_point_is_not_moved_again(p):
    found = REACH.closest(p)
    assert REACH.closest(found.p_BE, found.q).moved.max() < 1e-6


@away
@given(q=joints)
def test_a_reachable_point_is_unchanged(q):
    p = REACH.toes(q)
    if REACH.is_clear(q):
        found = REACH.closest(p, q)
        assert np.array_equal(found.p_BE, p)
        assert found.moved.max() == 0.0


@away
@given(p=points)
def test_left_and_right_mirror(p):
    """Where each toe keeps to its own side, so that the legs do not choose who passes in front."""
    p = p.copy()
    p[:, 1] = [abs(p[0, 1]) + 0.06, -abs(p[1, 1]) - 0.06]
    one, other = REACH.closest(p), REACH.closest(p[::-1] * MIRROR)
    assert np.abs(one.moved - other.moved[::-1]).max() < 1e-4


@away
@given(q=joints, p=points)
def test_no_reachable_point_nearby_is_closer(q, p):
    """The result is a local minimum: small steps of the joints within the bounds do not come nearer."""
    found = REACH.closest(p)
    best = np.sum(found.moved**2)
    for scale in (1e-3, 1e-2):
        near = found.q + scale * (q - found.q)
        if REACH.gap(near) >= REACH.clearance:
            assert np.sum((REACH.toes(near) - p) ** 2) >= best - 1e-8


def test_legs_stay_clear_when_both_toes_want_the_same_place():
    for p in ([0.2, 0.0, -0.2], [0.1, 0.0, -0.25], [0.256, 0.0, 0.12], [0.0, 0.0, 0.0]):
        assert REACH.is_clear(REACH.closest(np.array([p, p])).q)


def test_a_smooth_motion_through_the_boundary_stays_smooth():
    t = np.arange(0.0, 6.0, 0.02)
    left = np.stack([0.164 + 0.28 * np.sin(t), 0.14 + 0.06 * np.sin(2 * t), -0.20 - 0.06 * np.cos(t)], axis=1)
    wanted = np.stack([left, left * MIRROR], axis=1)
    found = REACH.closest_track(wanted)
    assert 0.2 < np.mean(found.moved > 1e-3) < 0.95
    steps = np.linalg.norm(np.diff(found.p_BE, axis=0), axis=-1)
    assert steps.max() < 3.0 * np.linalg.norm(np.diff(wanted, axis=0), axis=-1).max()


def test_acceleration_leaves_torque_for_the_rest():
    assert REACH.acceleration_max.shape == (FRONT,)
    assert np.all(REACH.acceleration_max * DESCRIPTION.armature[:FRONT] < 0.5 * DESCRIPTION.torque_max[:FRONT])
    assert REACH.speed_max == pytest.approx(0.6 * DESCRIPTION.speed_flat[:FRONT])
