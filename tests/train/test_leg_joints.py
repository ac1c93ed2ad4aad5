from __future__ import annotations

import numpy as np
import pytest

from mimic.robot.goals import draw_goals, leg_joints


def test_the_closed_form_is_the_same_in_pytorch(description):
    torch = pytest.importorskip("torch", reason="training needs the extra 'train'")
    toes = draw_goals(description, 50, np.random.default_rng(3), anywhere=0.5)
    toes[:5] += 1.0  # out of reach
    joints, excess = leg_joints(toes, description)
    same, other = leg_joints(torch.as_tensor(toes), description, torch)
    assert np.allclose(same.numpy(), joints, atol=1e-12, equal_nan=True)
    assert np.allclose(other.numpy(), excess, atol=1e-12)
    assert np.isinf(excess[:5]).all()
