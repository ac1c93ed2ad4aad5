from __future__ import annotations

import dataclasses
from functools import partial

import pytest

from mimic.config.training import LearnSettings, MdpSettings

torch = pytest.importorskip("torch", reason="training needs the extra 'train'")
for library in ("mujoco_warp", "rsl_rl", "onnx", "tensorboard"):
    pytest.importorskip(library, reason="training needs the extra 'train'")
from rsl_rl.runners import OnPolicyRunner  # noqa: E402
from tensordict import TensorDict  # noqa: E402

from mimic.robot.description import load_description  # noqa: E402
from mimic.train.learning.learn import runner_config  # noqa: E402
from mimic.train.learning.learn import train as train_robot  # noqa: E402
from mimic.train.learning.mirror import mirrored_actions, mirrored_observations  # noqa: E402
from mimic.train.stand_track import StandTrackEnv  # noqa: E402

train = partial(train_robot, description=load_description("cyberdog2"))

MDP = MdpSettings(worlds=6, history=3)  # small, as the networks below
LEARN = LearnSettings(device="cpu", steps=8, hidden=(32, 16), epochs=3, minibatches=2)


@pytest.fixture(scope="module")
def env(description) -> StandTrackEnv:
    return StandTrackEnv(description, MDP, "cpu", 0)


def runner(env: StandTrackEnv, learn: LearnSettings, *, plain: bool = False, **algorithm: object) -> OnPolicyRunner:
    """Return a runner with the captured algorithm, or with rsl_rl's own."""
    torch.manual_seed(5)
    config = runner_config(learn)
    config["algorithm"] |= algorithm
    if plain:
        config["actor"]["distribution_cfg"]["class_name"] = "GaussianDistribution"
        config["algorithm"]["class_name"] = "PPO"
        del config["algorithm"]["mirror_coef"]
        mirrored = {"data_augmentation_func": with_mirrored, "use_mirror_loss": True, "mirror_loss_coeff": learn.mirror}
        config["algorithm"]["symmetry_cfg"] = mirrored if learn.mirror else None
    return OnPolicyRunner(env, config, None, "cpu")


def with_mirrored(env: object, obs: TensorDict | None, actions: torch.Tensor | None) -> tuple:
    """Return observations and actions followed by their mirror images, in the form rsl_rl asks for."""
    seen = torch.cat([obs["policy"], mirrored_observations(obs["policy"])]) if obs is not None else None
    both = TensorDict({"policy": seen}, batch_size=[len(seen)]) if seen is not None else None
    return both, torch.cat([actions, mirrored_actions(actions)]) if actions is not None else None


def rollout(runner: OnPolicyRunner, seed: int) -> None:
    """Fill the storage from noise, so that it does not depend on the environment's state."""
    noise = torch.Generator().manual_seed(seed)
    env, alg = runner.env, runner.alg
    torch.manual_seed(seed)
    with torch.inference_mode():
        for _ in range(runner.cfg["num_steps_per_env"]):
            seen = env.get_observations()
            for tensor in seen.values():
                tensor.copy_(torch.randn(tensor.shape, generator=noise))
            seen["own"].fill_(1.0)
            alg.act(seen)
            rewards = torch.randn(env.num_envs, generator=noise)
            ended = torch.rand(env.num_envs, generator=noise) < 0.1
            time_outs = ended & (torch.rand(env.num_envs, generator=noise) < 0.5)
            alg.process_env_step(seen, rewards, ended.long(), {"time_outs": time_outs})
        alg.compute_returns(seen)


def update(runner: OnPolicyRunner, seed: int) -> dict[str, float]:
    torch.manual_seed(100 + seed)
    return runner.alg.update()


def weights(runner: OnPolicyRunner) -> torch.Tensor:
    models = (runner.alg.actor, runner.alg.critic)
    return torch.cat([v.detach().double().flatten() for model in models for v in model.state_dict().values()])


def same_course(one: OnPolicyRunner, other: OnPolicyRunner, seeds: range) -> list[float]:
    """Let both learn from the same storage; return the learning rates passed."""
    rates = []
    for seed in seeds:
        rollout(one, seed)
        rollout(other, seed)
        assert update(one, seed) == pytest.approx(update(other, seed), rel=1e-3, abs=1e-5)
        assert one.alg.learning_rate == pytest.approx(other.alg.learning_rate, rel=1e-5)
        assert (weights(one) - weights(other)).abs().max() < 2e-5
        rates.append(one.alg.learning_rate)
    return rates


@pytest.mark.parametrize("desired_kl", [1e-5, 0.01, 1.0])
def test_an_update_is_that_of_rsl_rl_learning_rate_and_all(env, desired_kl):
    plain, captured = (runner(env, LEARN, plain=own, desired_kl=desired_kl) for own in (True, False))
    before = weights(captured)
    rates = same_course(plain, captured, range(3))
    assert (weights(captured) - before).abs().max() > 1e-3
    assert rates[-1] != pytest.approx(LEARN.learning_rate)


def test_the_mirror_loss_is_that_of_rsl_rl(env):
    plain, captured = (runner(env, dataclasses.replace(LEARN, mirror=0.5), plain=own) for own in (True, False))
    same_course(plain, captured, range(3))
    without = runner(env, dataclasses.replace(LEARN, mirror=0.0))
    rollout(without, 0)
    assert "symmetry" not in update(without, 0)


def test_the_entropy_bonus_may_change_during_a_run(env):
    runners = [runner(env, LEARN), runner(env, LEARN), runner(env, LEARN, plain=True)]
    for each, weight in zip(runners, (0.004, 0.5, 0.5), strict=True):
        rollout(each, 0)
        update(each, 0)
        each.alg.entropy_coef = weight
        rollout(each, 1)
        update(each, 1)
    none, captured, plain = (weights(each) for each in runners)
    assert (captured - plain).abs().max() < 2e-5
    assert (captured - none).abs().max() > 1e-3


@pytest.mark.parametrize("plain", [True, False])
def test_a_checkpoint_of_either_is_taken_over(env, plain, tmp_path):
    first = runner(env, LEARN, plain=plain)
    rollout(first, 0)
    update(first, 0)
    first.save(str(tmp_path / "one.pt"))
    again = runner(env, LEARN)
    again.load(str(tmp_path / "one.pt"))
    assert again.alg.learning_rate == pytest.approx(first.alg.learning_rate)
    same_course(first, again, range(1, 3))


def test_a_captured_training_runs_from_start_to_policy(tmp_path):
    learn = dataclasses.replace(LEARN, iterations=2)
    rows = []
    path = train(tmp_path, MDP, learn, report=lambda update, row: rows.append(row))
    assert path.exists()
    assert [row["steps"] for row in rows] == [48, 96]
    resumed = train(tmp_path / "again", MDP, dataclasses.replace(learn, iterations=3), resume=tmp_path / "last.pt")
    assert resumed.exists()


def test_actions_that_do_not_count_are_not_learned_from(env):
    """The same storage, but for what was drawn for the front legs while inverse kinematics moved them."""

    def learned(drawn: float) -> torch.Tensor:
        one = runner(env, dataclasses.replace(LEARN, mirror=0.0))
        rollout(one, 0)
        one.alg.storage.observations["own"][..., :6] = 0.0
        actions = one.alg.storage.actions
        own = one.alg.storage.observations["own"]
        params = one.alg.storage.distribution_params
        spread = torch.distributions.Normal(*params)
        one.alg.storage.actions_log_prob.copy_((own * spread.log_prob(actions)).sum(-1, keepdim=True))
        actions[..., :6] += drawn
        update(one, 0)
        return weights(one)

    still, moved = learned(0.0), learned(1.0)
    assert (still - moved).abs().max() < 1e-6
    fresh = weights(runner(env, LEARN))
    assert (still - fresh).abs().max() > 1e-3


def test_what_a_graph_reads_stays_where_it_is(env, tmp_path):
    """A graph replays addresses: a tensor that is replaced would go on being read as it was."""
    one = runner(env, LEARN)

    def places() -> list[int]:
        models = (one.alg.actor, one.alg.critic)
        return [t.data_ptr() for model in models for t in (*model.parameters(), *model.buffers())]

    before, values = places(), weights(one)
    for seed in range(2):
        rollout(one, seed)
        update(one, seed)
    one.save(str(tmp_path / "one.pt"))
    one.load(str(tmp_path / "one.pt"))
    assert places() == before
    assert not torch.equal(weights(one), values)
