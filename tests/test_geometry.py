from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mimic.geometry import (
    R_BT,
    R_CT,
    heading_from_quat,
    heading_sin_cos,
    rotation_from_quat,
    up_cosine,
    world_axes_in_base,
    wrap_angle,
)

FORWARD, LEFT, UP = np.eye(3)
angles = st.floats(-50.0, 50.0)


def quat(rotation: Rotation) -> np.ndarray:
    return rotation.as_quat(scalar_first=True)


def posture(heading: float, pitch: float, roll: float = 0.0) -> np.ndarray:
    """Base x raised by ``pitch``, then the whole robot turned by ``heading``; wxyz."""
    return quat(Rotation.from_euler("ZYX", [heading, -pitch, roll]))


RANDOM = Rotation.random(200, np.random.default_rng(0))


@pytest.mark.parametrize("rotation", [R_BT, R_CT], ids=["R_BT", "R_CT"])
def test_the_tables_of_axes_are_proper_rotations(rotation):
    assert np.allclose(rotation @ rotation.T, np.eye(3))
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_a_person_who_faces_the_camera_points_at_it_and_has_the_left_hand_on_its_right():
    towards_camera, right_in_image, up_in_image = (0, 0, -1), (1, 0, 0), (0, -1, 0)
    assert np.array_equal(R_CT @ FORWARD, towards_camera)
    assert np.array_equal(R_CT @ LEFT, right_in_image)
    assert np.array_equal(R_CT @ UP, up_in_image)


def test_a_hand_raised_by_the_person_is_a_toe_ahead_of_the_robot():
    assert np.array_equal(R_BT @ UP, (1, 0, 0))
    assert np.array_equal(R_BT @ LEFT, (0, 1, 0))
    assert np.array_equal(R_BT @ FORWARD, (0, 0, -1))


def test_quaternions_are_wxyz_and_turn_base_vectors_into_the_world():
    assert np.allclose(rotation_from_quat(quat(RANDOM)), RANDOM.as_matrix())
    quarter_turn_left = [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]
    assert np.allclose(rotation_from_quat(quarter_turn_left) @ FORWARD, LEFT)


def test_down_and_forward_of_the_world_are_seen_from_the_base():
    down, forward = world_axes_in_base(*quat(RANDOM).T)
    assert np.allclose(np.stack(down, -1), RANDOM.inv().apply(-UP))
    assert np.allclose(np.stack(forward, -1), RANDOM.inv().apply(FORWARD))


@pytest.mark.train
def test_torch_sees_the_same_world_as_numpy():
    torch = pytest.importorskip("torch", reason="needs the extra 'train'")
    parts = quat(RANDOM).T.copy()
    tensors = [torch.from_numpy(p.copy()) for p in parts]
    for seen, expected in zip(world_axes_in_base(*tensors), world_axes_in_base(*parts), strict=True):
        for one, other in zip(seen, expected, strict=True):
            assert torch.is_tensor(one)
            assert np.array_equal(one.numpy(), other)
    for one, other in zip(heading_sin_cos(*tensors), heading_sin_cos(*parts), strict=True):
        assert np.array_equal(one.numpy(), other)
    assert np.array_equal(up_cosine(*tensors).numpy(), up_cosine(*parts))


@pytest.mark.parametrize("heading", [-3.0, -1.2, 0.0, 0.4, 1.5707963, 3.1])
def test_the_heading_stays_while_the_robot_stands_up(heading):
    for pitch in np.linspace(-0.3, np.pi / 2 + 0.3, 60):
        assert heading_from_quat(posture(heading, pitch)) == pytest.approx(heading, abs=1e-9)


def test_the_heading_hardly_moves_when_the_robot_sways_while_it_stands_up():
    pitches = np.linspace(0.0, np.pi / 2, 200)
    sway = 0.2 * np.sin(7 * pitches)
    path = heading_from_quat(np.array([posture(0.5, p, r) for p, r in zip(pitches, sway, strict=True)]))
    assert np.abs(np.diff(path)).max() < 0.05
    assert np.abs(path - 0.5).max() < 0.3


def test_the_heading_turns_with_the_robot_whatever_its_posture():
    turn = Rotation.from_euler("z", 0.7)
    turned = heading_from_quat(quat(turn * RANDOM)) - heading_from_quat(quat(RANDOM))
    assert np.allclose(wrap_angle(turned), 0.7)


def test_up_goes_from_nothing_on_four_feet_to_one_upright():
    assert up_cosine(*posture(0.9, 0.0)) == pytest.approx(0.0)
    assert up_cosine(*posture(0.9, np.pi / 2)) == pytest.approx(1.0)
    assert up_cosine(*posture(0.9, -np.pi / 2)) == pytest.approx(-1.0)


@given(angles)
def test_a_wrapped_angle_points_the_same_way_and_is_at_most_half_a_turn(angle):
    wrapped = wrap_angle(angle)
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-9)
    assert np.sin(wrapped) == pytest.approx(np.sin(angle), abs=1e-9)
    assert abs(wrapped) <= np.pi + 1e-12


@given(angles)
def test_wrapping_twice_is_wrapping_once(angle):
    assert wrap_angle(wrap_angle(angle)) == pytest.approx(wrap_angle(angle), abs=1e-9)
