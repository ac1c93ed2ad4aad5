from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
import pytest

from mimic.config.play import NOMINAL
from mimic.config.training import UNDISTURBED, LearnSettings, MdpSettings
from mimic.errors import AssetError
from mimic.geometry import heading_from_quat, up_cosine
from mimic.policy.runtime import Policy

torch = pytest.importorskip("torch", reason="training needs the extra 'train'")
for library in ("mujoco_warp", "rsl_rl", "onnx", "tensorboard"):
    pytest.importorskip(library, reason="training needs the extra 'train'")
from mimic.robot.description import load_description  # noqa: E402
from mimic.train import starts  # noqa: E402
from mimic.train.learning.learn import train as train_robot  # noqa: E402
from mimic.train.sit_down import SitDownEnv  # noqa: E402
from mimic.train.starts import SHARES, SitDownStarts, recorded_states  # noqa: E402
from mimic.train.weights import REWARD_SCALE, SIT_DOWN  # noqa: E402

train = partial(train_robot, description=load_description("cyberdog2"))

SIT = MdpSettings(worlds=8, task="sit_down", noise_q=0.0, noise_axes=0.0, disturbances=UNDISTURBED)


@pytest.fixture(scope="module")
def env(description) -> SitDownEnv:
    return SitDownEnv(description, SIT, "cpu", 3)


def test_training_leaves_a_policy_that_says_what_it_is_for(description, tmp_path):
    learn = LearnSettings(iterations=1, device="cpu", steps=12, hidden=(32, 16), epochs=2, minibatches=2)
    rows = []
    path = train(tmp_path, SIT, learn, report=lambda update, row: rows.append(row))
    contract = Policy(path, description).contract
    assert contract.task == "sit_down"
    assert np.array_equal(contract.default_q, description.poses["upright"])
    assert {"sit_down/lying", "sit_down/failed"} <= set(rows[0])


def test_starts_are_upright_falling_rising_and_lying(description):
    start = SitDownStarts(description, dataclasses.replace(SIT, worlds=2000), "cpu").draw()
    quat, q = start.qpos[:, 3:7].numpy(), start.qpos[:, 7:].numpy()
    up = up_cosine(*quat.T)
    assert abs(float(start.anytime.float().mean()) - SHARES["lying"]) < 0.03
    assert np.mean(up > 0.9) > 0.5
    assert np.mean((up > 0.3) & (up < 0.8)) > 0.05
    assert np.all(np.abs(np.linalg.norm(quat, axis=1) - 1) < 0.01)
    assert np.all(q > description.q_min - 0.1)
    assert np.all(q < description.q_max + 0.1)
    assert np.allclose(start.heading.numpy(), heading_from_quat(quat), atol=1e-3)
    assert np.ptp(start.heading.numpy()) > 6


def to_lie(description) -> torch.Tensor:
    """Actions that ask for the lying pose at once."""
    change = description.poses["lie"] - description.poses["upright"]
    return torch.as_tensor(change / SIT.action_scale, dtype=torch.float32).expand(SIT.worlds, 12)


def test_a_robot_that_lies_and_stays_earns_all_that_can_be_earned(description, monkeypatch):
    monkeypatch.setattr(starts, "SHARES", {"steady": 0.0, "rising": 0.0, "falling": 0.0, "lying": 1.0})
    env = SitDownEnv(description, dataclasses.replace(SIT, randomisation=NOMINAL), "cpu", 1)
    env.episode_length_buf.zero_()
    extras: dict = {}
    for _ in range(96):
        _, reward, done, extras = env.step(to_lie(description))
        assert not done.any()
    most = sum(SIT_DOWN[name] for name in ("height", "level", "pose", "pose_fine", "still"))
    assert reward.min() > 0.85 * REWARD_SCALE * most
    assert extras["log"]["sit_down/lying"] == 1


def test_a_robot_that_drops_pays_for_it(description, monkeypatch):
    monkeypatch.setattr(starts, "SHARES", {"steady": 1.0, "rising": 0.0, "falling": 0.0, "lying": 0.0})
    env = SitDownEnv(description, SIT, "cpu", 1)
    env.episode_length_buf.zero_()
    rewards = [env.step(to_lie(description))[1] for _ in range(20)]
    assert torch.stack(rewards).amin(0).max() < -10.0 * REWARD_SCALE


def test_there_is_a_weight_for_each_term(env):
    env.step(torch.zeros(SIT.worlds, 12))
    terms, _, _ = env._evaluate(torch.ones(SIT.worlds, dtype=torch.bool), env.worlds.lowest())
    assert set(terms) == set(SIT_DOWN)


@pytest.mark.parametrize(("front", "hind", "square"), [(0.5, 2.0, 0.0), (1.0, 0.0, 2 * 0.4**2)])
def test_thighs_of_front_legs_far_behind_the_lying_pose_cost_their_square(env, description, front, hind, square):
    q = torch.as_tensor(description.poses["lie"], dtype=torch.float32).clone()
    q[1:5:3] += front
    q[7::3] += hind
    env.worlds.qpos[:, 7:] = q
    terms, _, _ = env._evaluate(torch.ones(SIT.worlds, dtype=torch.bool), env.worlds.lowest())
    assert terms["elbows"] == pytest.approx(np.full(SIT.worlds, square), abs=1e-5)


def test_states_that_are_not_there_are_reported():
    with pytest.raises(AssetError, match=r"nowhere\.npz"):
        recorded_states("nowhere.npz")
