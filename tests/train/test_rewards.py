"""Reward terms: values worked out by hand."""

from __future__ import annotations

import math

import pytest

torch = pytest.importorskip("torch", reason="training needs the extra 'train'")
from mimic.train import rewards  # noqa: E402


def of(*values: float) -> torch.Tensor:
    return torch.tensor(values)


def test_height_is_asked_along_the_stand_up_and_more_than_all_of_it_is_no_error(description):
    numbers = description.training
    middle = (numbers.rise_from + numbers.rise_to) / 2
    base = of(numbers.rise_from, middle, numbers.rise_to + 0.2, numbers.rise_to - 0.1, middle + 0.1)
    earned = rewards.height(base, of(0.0, 0.5, 1.0, 1.0, 0.5), numbers)
    assert earned.tolist() == pytest.approx([1.0, 1.0, 1.0, math.exp(-1), math.exp(-1)], rel=1e-5)


def test_the_trunk_is_asked_to_lie_at_first_and_to_stand_in_the_end():
    lying = 1.4  # between base x and the upright direction [rad]
    up = torch.cos(of(lying, lying - 0.4, 0.7, 0.0, math.pi))
    earned = rewards.upright(up, of(0.0, 0.0, 0.5, 1.0, 1.0), lying)
    assert earned.tolist() == pytest.approx([1.0, math.exp(-1), 1.0, 1.0, 0.0], abs=1e-4)


def test_velocity_and_heading_earn_at_most_one_and_nothing_where_the_robot_lies():
    still = torch.zeros(2, 2)
    assert rewards.velocity(still, still, of(1.0, 0.0)).tolist() == pytest.approx([1.0, 0.0])
    assert rewards.heading(torch.zeros(2), of(1.0, 0.0)).tolist() == pytest.approx([1.0, 0.0])
    turned = rewards.heading(of(0.5, -0.5, math.pi), torch.ones(3))
    assert (
        turned[0]
        == turned[1]
        == pytest.approx(0.15 * (1 + math.cos(0.5)) + 0.35 * math.exp(-0.5) + 0.35 * math.exp(-0.25 / 0.03), rel=1e-5)
    )
    assert turned[2] < 1e-3


def test_who_is_asked_to_stand_earns_by_bearing_weight_on_both_feet():
    planted = rewards.both_planted(torch.tensor([[0.5, 0.5], [0.9, 0.1], [1.0, 0.0]]))
    stepping = torch.tensor([[1.0, 0.5]] * 3)
    assert rewards.gait(stepping, planted, torch.zeros(3, 1), torch.ones(3)).tolist() == pytest.approx([1.0, 0.5, 0.0])
    assert rewards.gait(stepping, planted, torch.ones(3, 1), of(1.0, 1.0, 0.5)).tolist() == pytest.approx(
        [0.75, 0.75, 0.375]
    )


def test_costs_have_a_largest_value():
    assert rewards.drift(of(0.1, 9.0, 9.0), of(1.0, 1.0, 0.0)).tolist() == pytest.approx([0.1, 0.3, 0.0])
    assert rewards.unrest(torch.tensor([[1.0, 1.0], [9.0, 9.0]]), torch.ones(2)).tolist() == pytest.approx([2.0, 6.0])
    shuffled = rewards.shuffle(torch.tensor([[0.2, 9.0], [0.2, 9.0]]), torch.tensor([[1.0, 1.0], [1.0, 0.0]]), of(1, 1))
    assert shuffled.tolist() == pytest.approx([0.25, 0.1])
    assert rewards.heat(of(1.5, 7.0)).tolist() == pytest.approx([1.5, 2.0])


def test_feet_in_the_air_and_legs_near_the_ground_are_counted():
    assert rewards.flight(torch.tensor([[0.02, 0.03], [0.0, 0.03]])).tolist() == [1.0, 0.0]
    assert rewards.low(torch.tensor([[0.01, 0.02, 0.04], [0.1, 0.1, 0.1]])).tolist() == [2.0, 0.0]
    way = torch.tensor([[[0.03, 0.04, 0.0], [0.0, 0.0, 0.0]]])
    assert rewards.foot_shift(way, of(1.0)).tolist() == pytest.approx([0.025])


def test_joints_pay_for_speed_and_angle_beyond_their_limits_only():
    assert rewards.joint_speed(torch.tensor([[5.0, -12.0, 11.0]]), 10.0).tolist() == pytest.approx([3.0])
    q = torch.tensor([[0.0, 1.2, -1.5]])
    beyond = rewards.limits(q, torch.full((3,), -1.0), torch.full((3,), 1.0), torch.tensor([[1.0, 1.0, 0.0]]))
    assert beyond.tolist() == pytest.approx([0.2])
