"""Soft actor-critic of the off-policy trial: its memory, its targets, and whether it learns at all."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch", reason="the train extra brings PyTorch")
pytest.importorskip("rsl_rl", reason="the train extra brings rsl-rl-lib")

from lab.policies.off_policy import Learner, SacSettings, Student  # noqa: E402

WORLDS, KEPT = 16, 12


def made(settings, inputs=2, seen=4, bound=(1.0, 2.0), **ways):
    torch.manual_seed(0)
    return Learner(WORLDS, inputs, seen, torch.tensor(bound), settings, **ways)


def test_what_is_remembered_is_followed_by_what_came_next_in_the_same_world():
    learner = made(SacSettings(batch=512, buffer_steps=KEPT))
    episode, age = torch.zeros(WORLDS), torch.zeros(WORLDS)
    for step in range(3 * KEPT):
        learner.act(torch.stack([torch.full((WORLDS,), float(step)), torch.arange(WORLDS).float(), age, episode], 1))
        if step:
            found = learner.sample()
            now, later = found["seen"].float(), found["next"].float()
            torch.testing.assert_close(later[:, :2], now[:, :2] + torch.tensor([1.0, 0.0]))
            torch.testing.assert_close(found["reward"], 100 * now[:, 0] + now[:, 1])
            goes_on = (found["known"] == 1) & (found["goes_on"] == 1)
            torch.testing.assert_close(later[goes_on, 2], now[goes_on, 2] + 1)
            assert (later[~goes_on, 3] == now[~goes_on, 3] + 1).all()
            assert (int(now[:, 0].min()), int(now[:, 0].max())) == (max(0, step - KEPT + 1), step - 1)
        done = torch.rand(WORLDS) < 0.2
        learner.remember(100.0 * step + torch.arange(WORLDS), done.long(), done & (torch.rand(WORLDS) < 0.5))
        age, episode = torch.where(done, 0.0, age + 1), episode + done.float()


@pytest.mark.slow
def test_it_finds_the_best_answer_of_a_task_of_one_step():
    torch.set_num_threads(1)
    learner = made(SacSettings(batch=128, buffer_steps=128, updates=2, policy_delay=2), inputs=4)
    scale = torch.tensor([0.5, 1.5])

    def best(seen):
        return torch.stack([0.8 * torch.sin(2 * seen[:, 0]), 2 * seen[:, 1] * seen[:, 2]], 1)

    def missed(seen, action):
        return ((action - best(seen)) / scale).square().sum(1)

    def drawn(count):
        return 2 * torch.rand(count, 4) - 1

    exam = drawn(2000)
    before = float(missed(exam, learner.actor(exam)).mean())
    for step in range(250):
        seen = drawn(WORLDS)
        action = learner.act(seen)
        if step > 10:
            learner.learn()
        ended = torch.ones(WORLDS, dtype=torch.long)
        learner.remember(0.4 - missed(seen, action), ended, torch.zeros(WORLDS, dtype=torch.bool))
    assert float(missed(exam, learner.actor(exam)).mean()) < 0.3 * before


def test_an_end_is_worth_its_reward_and_a_survivor_also_what_comes_after():
    learner = made(SacSettings(batch=4, buffer_steps=KEPT, gamma=0.5, value_range=8.0, atoms=161, temperature=1.0))
    row = {"reward": torch.tensor([1.0, -0.7]), "goes_on": torch.tensor([0.0, 1.0])}
    wanted, density = learner.target(row, torch.zeros(2, 4))
    worth = (wanted * torch.linspace(-8.0, 8.0, 161)).sum(-1)
    assert wanted.sum(-1).tolist() == pytest.approx([1.0, 1.0], abs=1e-5)
    assert float(worth[0]) == pytest.approx(1.0, abs=1e-4)
    # its critics, fresh, expect about nothing of rewards; the entropy counts
    assert abs(float(density[1])) > 1.0
    assert float(worth[1]) == pytest.approx(-0.7 - 0.5 * float(density[1]), abs=0.3)


def test_a_student_is_a_network_that_ppo_can_go_on_from(tmp_path):
    onnx = pytest.importorskip("onnx")
    student = Student(made(SacSettings(buffer_steps=KEPT)).actor, (8, 8))
    torch.onnx.export(student, (torch.zeros(1, 2),), tmp_path / "s.onnx", opset_version=17, dynamo=False)
    kinds = [node.op_type for node in onnx.load(tmp_path / "s.onnx").graph.node]
    assert kinds == ["Sub", "Div", "Gemm", "Elu", "Gemm", "Elu", "Gemm"]


def test_figures_show_actions_that_rest_at_their_bound():
    learner = made(SacSettings(batch=8, buffer_steps=KEPT, updates=1, policy_delay=1))
    with torch.no_grad():
        learner.actor.layers[-1].bias[0] = 3.0  # of the first of two actions, before tanh
    for step in range(3):
        learner.act(torch.randn(WORLDS, 4))
        if step == 2:
            learner.learn()
        learner.remember(torch.zeros(WORLDS), torch.zeros(WORLDS, dtype=torch.long), torch.zeros(WORLDS).bool())
    _, _, spread, _, at_bound = learner.figures.tolist()
    assert at_bound == 0.5
    # the logarithm of the spread is -2.5 before tanh; the first action's is next to nothing after it
    assert spread == pytest.approx(0.5 * 2.0 * 0.0821, rel=0.05)
