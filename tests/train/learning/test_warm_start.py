from __future__ import annotations

import dataclasses
from functools import partial
from itertools import pairwise

import numpy as np
import pytest

from mimic.config.training import LearnSettings, MdpSettings
from mimic.errors import AssetError, ConfigError
from mimic.policy.contract import ARM_TERMS, FRAME_SIZE, PAPER_TERMS, TERMS
from mimic.policy.runtime import Policy

torch = pytest.importorskip("torch", reason="training needs the extra 'train'")
for library in ("mujoco_warp", "rsl_rl", "onnx", "tensorboard"):
    pytest.importorskip(library, reason="training needs the extra 'train'")

from mimic.robot.description import load_description  # noqa: E402
from mimic.train.learning.learn import train as train_robot  # noqa: E402
from mimic.train.learning.onnx_file import export_network  # noqa: E402

train = partial(train_robot, description=load_description("cyberdog2"))

MDP = MdpSettings(worlds=4, history=3)
ONCE = sum(width for _, width in ARM_TERMS)
LEARN = LearnSettings(
    device="cpu", seed=2, steps=4, iterations=1, hidden=(16, 8), epochs=1, minibatches=1, critic_updates=100
)


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    return train(tmp_path_factory.mktemp("first"), MDP, LEARN)


def first_layer(folder, network="actor"):
    saved = torch.load(folder / "last.pt", weights_only=False)
    return saved[f"{network}_state_dict"]["mlp.0.weight"]


def answers(path, description, observations):
    plays = Policy(path, description)
    return np.array([plays.act(row) for row in observations])


@pytest.mark.parametrize("more", [0, 2])
def test_a_training_that_goes_on_from_a_policy_begins_as_that_policy_acts(policy, more, description, tmp_path):
    mdp = dataclasses.replace(MDP, history=3 + more)
    taken = train(tmp_path, mdp, LEARN, resume=policy)
    seen = np.random.default_rng(0).normal(size=(20, FRAME_SIZE * (3 + more) + ONCE)).astype(np.float32)
    old = answers(policy, description, seen[:, FRAME_SIZE * more :])
    assert np.abs(answers(taken, description, seen) - old).max() < 1e-4
    assert np.abs(old).max() > 1e-2


def test_only_the_critic_learns_at_first_and_then_both(policy, tmp_path):
    def weights(name, updates):
        train(tmp_path / name, MDP, dataclasses.replace(LEARN, iterations=2, critic_updates=updates), resume=policy)
        return first_layer(tmp_path / name), first_layer(tmp_path / name, "critic")

    actor, critic = weights("critic", 5)
    both, _ = weights("both", 0)
    one, _ = weights("one", 1)
    first = first_layer(policy.parent)
    assert torch.equal(actor, first)
    assert not torch.equal(both, first)
    assert not torch.equal(one, first)
    assert not torch.equal(one, both)
    assert critic.isfinite().all()


def test_the_critic_changes_while_it_learns_alone(policy, tmp_path):
    saved = []
    for name, rate in (("still", 1e-9), ("learns", 1e-3)):
        train(tmp_path / name, MDP, dataclasses.replace(LEARN, learning_rate=rate), resume=policy)
        saved.append(first_layer(tmp_path / name, "critic"))
    assert (saved[0] - saved[1]).abs().max() > 1e-4


def test_the_first_step_of_the_policy_is_as_small_as_the_smallest_learning_rate(policy, tmp_path):
    train(tmp_path, MDP, dataclasses.replace(LEARN, iterations=3, critic_updates=2), resume=policy)
    step = (first_layer(tmp_path) - first_layer(policy.parent)).abs().max().item()
    assert 0.5e-5 < step < 1.1e-5


@pytest.mark.parametrize(("changes", "sizes"), [({"hidden": (8, 8)}, "259-16-8-12"), ({"history": 2}, "259-16-8-12")])
def test_a_policy_of_another_size_is_refused(policy, changes, sizes, tmp_path):
    learn = dataclasses.replace(LEARN, **{k: v for k, v in changes.items() if k == "hidden"})
    mdp = dataclasses.replace(MDP, **{k: v for k, v in changes.items() if k == "history"})
    with pytest.raises(ConfigError, match=sizes):
        train(tmp_path, mdp, learn, resume=policy)


def test_a_policy_whose_actions_mean_something_else_is_refused(policy, tmp_path):
    with pytest.raises(ConfigError, match=r"policy\.onnx has action_scale \(0\.5, .*; the settings have \(0\.25, "):
        train(tmp_path, dataclasses.replace(MDP, action_scale=0.25), LEARN, resume=policy)


def test_what_is_no_policy_is_refused(tmp_path):
    (tmp_path / "text.onnx").write_text("hello")
    with pytest.raises(AssetError, match="no ONNX file"):
        train(tmp_path / "out", MDP, LEARN, resume=tmp_path / "text.onnx")


class Reaching(torch.nn.Module):
    """A network that has not learnt, of the shape that a training writes."""

    def __init__(self, seen: int) -> None:
        super().__init__()
        torch.manual_seed(1)
        self.register_buffer("mean", 0.1 * torch.randn(1, seen))
        self.register_buffer("scale", 0.5 + torch.rand(1, seen))
        widths = (seen, *LEARN.hidden)
        hidden = [torch.nn.Sequential(torch.nn.Linear(*pair), torch.nn.ELU()) for pair in pairwise(widths)]
        self.layers = torch.nn.Sequential(*hidden, torch.nn.Linear(widths[-1], 12))

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        return self.layers((seen - self.mean) / self.scale)


def test_a_training_goes_on_from_a_policy_that_saw_toe_commands_as_it_acts_for_neutral_toes(
    policy, description, tmp_path
):
    contract = dataclasses.replace(Policy(policy, description).contract, terms=PAPER_TERMS, once=())
    reaching = tmp_path / "reaching.onnx"
    export_network(Reaching(contract.observation_size), contract, description, reaching)
    taken = train(tmp_path / "taken", MDP, LEARN, resume=reaching)
    new = Policy(taken, description).contract
    rng = np.random.default_rng(0)
    frames = {name: 0.2 * rng.normal(size=(5, contract.history, width)) for name, width in (*contract.terms, *TERMS)}
    frames["toe_command"] = np.tile(contract.neutral_toes, (5, contract.history, 1))
    old = np.concatenate([frames[name] for name, _ in contract.terms], -1).reshape(5, -1)
    seen = np.concatenate([frames[name] for name, _ in new.terms], -1).reshape(5, -1)
    once = rng.normal(size=(5, ONCE))
    before = answers(reaching, description, old)
    assert np.abs(answers(taken, description, np.concatenate([seen, once], -1)) - before).max() < 1e-3
    assert np.abs(before).max() > 1e-2


def test_a_training_goes_on_from_the_policy_of_another_robot_with_an_easy_task(policy, tmp_path):
    def terminations(name: str) -> float:
        rows = []
        robot = load_description(name)
        learn = dataclasses.replace(LEARN, iterations=3)
        train_robot(tmp_path / name, MDP, learn, robot, resume=policy, report=lambda _, row: rows.append(row))
        return rows[-1]["track/termination_share"]

    assert (terminations("cyberdog2"), terminations("go2")) == (1.0, 0.0)
