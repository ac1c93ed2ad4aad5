"""Commands inside what the robot was trained for."""

from __future__ import annotations

import numpy as np
import pytest

from mimic.control.desired import clamp_desired
from mimic.robot.goals import draw_goals
from mimic.robot.leg_kinematics import front_legs


def test_goals_of_the_training_pass_as_they_are(description):
    goals = draw_goals(description, 300, np.random.default_rng(0))
    for toes in goals:
        v, kept, moved = clamp_desired(description.commands.velocity_max, toes, description)
        assert moved == 0
        assert np.array_equal(kept, toes)
        assert np.array_equal(v, description.commands.velocity_max)


@pytest.mark.parametrize("away", [0.5, 5.0])
def test_toes_beyond_the_legs_are_drawn_to_them_and_counted(away, description, contract):
    toes = np.array(contract.neutral_toes).reshape(2, 3)
    toes[1] += away
    _, kept, moved = clamp_desired(np.zeros(2), toes, description)
    assert moved == 1
    assert np.array_equal(kept[0], toes[0])
    leg = front_legs(description)[1]
    assert np.linalg.norm(kept[1] - leg.origin - [0.0, leg.offset, 0.0]) < 0.4
    assert clamp_desired(np.zeros(2), kept + 1e-9 * np.sign(leg.origin - kept), description)[2] == 0


def test_a_walk_faster_than_trained_is_slowed_and_a_walk_sideways_is_not_played(description, contract):
    toes = np.array(contract.neutral_toes).reshape(2, 3)
    v, _, moved = clamp_desired(np.array([-0.9, 0.2]), toes, description)
    assert np.array_equal(v, [-0.3, 0.0])
    assert moved == 2
