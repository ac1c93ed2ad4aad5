from __future__ import annotations

import numpy as np
import pytest

from mimic.robot.goals import CLEARANCE, MARGIN, clear_of_body, draw_goals, leg_joints
from mimic.robot.leg_kinematics import front_toes


def draw(description, count: int = 200, seed: int = 0, **options: float) -> np.ndarray:
    return draw_goals(description, count, np.random.default_rng(seed), **options)


def test_joints_of_a_toe_bring_the_toe_there(description):
    rng = np.random.default_rng(1)
    q = rng.uniform(description.q_min + MARGIN, description.q_max - MARGIN, (500, 12))
    toes = front_toes(q, description)
    joints, excess = leg_joints(toes, description)
    found = q.copy()
    found[:, :6] = joints.reshape(-1, 6)
    assert not excess.any()
    assert np.abs(front_toes(found, description) - toes).max() < 1e-9


def test_a_toe_out_of_reach_is_infinitely_far_from_a_solution(description):
    _, excess = leg_joints(np.array([[1.0, 0.1, 0.0], [0.0, -0.1, 2.0]]), description)
    assert np.isinf(excess).all()


def test_a_toe_beyond_a_limit_shows_by_how_much(description):
    q = description.poses["upright"].copy()
    q[0] = description.q_max[0] - MARGIN + 0.05
    _, excess = leg_joints(front_toes(q, description), description)
    assert excess[0] == pytest.approx(0.05)
    assert excess[1] == 0.0


@pytest.mark.parametrize("anywhere", [0.0, 0.5, 1.0])
def test_goals_are_where_both_legs_can_go(anywhere, description):
    goals = draw(description, anywhere=anywhere)
    assert goals.shape == (200, 2, 3)
    joints, excess = leg_joints(goals, description)
    assert not excess.any()
    for leg in range(2):
        rows = slice(3 * leg, 3 * leg + 3)
        assert np.all(joints[:, leg] >= description.q_min[rows] + MARGIN)
        assert np.all(joints[:, leg] <= description.q_max[rows] - MARGIN)
    assert clear_of_body(goals, joints, description).all()
    assert np.linalg.norm(goals[:, 0] - goals[:, 1], axis=-1).min() > 2 * (description.toe_radius + CLEARANCE)


def test_goals_of_the_paper_lie_in_its_boxes(description):
    goals = draw(description)
    goals[:, 1, 1] *= -1
    low, high = description.goals.low, description.goals.high
    inside = ((goals[..., None, :] >= low) & (goals[..., None, :] <= high)).all(-1).any(-1)
    assert inside.all()


def test_the_same_seed_draws_the_same_goals(description):
    assert np.array_equal(draw(description, seed=3), draw(description, seed=3))
    assert not np.array_equal(draw(description, seed=3), draw(description, seed=4))


def test_goals_anywhere_reach_beyond_the_boxes(description):
    assert draw(description, anywhere=1.0)[..., 0].max() > draw(description)[..., 0].max()


def test_toes_that_touch_are_not_clear(description):
    q = description.poses["upright"][None]
    toes = front_toes(q, description)
    joints, _ = leg_joints(toes, description)
    assert clear_of_body(toes, joints, description).all()
    together = toes.copy()
    together[:, :, 1] = [[0.01, -0.01]]
    joints, _ = leg_joints(together, description)
    assert not clear_of_body(together, joints, description).any()
