from __future__ import annotations

import dataclasses
import json
from functools import partial
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

from mimic.config.rewards import RewardWeights
from mimic.config.training import LearnSettings, MdpSettings
from mimic.errors import ConfigError, MimicError
from mimic.policy.runtime import Policy

torch = pytest.importorskip("torch", reason="training needs the extra 'train'")
for library in ("mujoco_warp", "rsl_rl", "onnx", "tensorboard"):
    pytest.importorskip(library, reason="training needs the extra 'train'")
from rsl_rl.runners import OnPolicyRunner  # noqa: E402

from mimic.robot.description import load_description  # noqa: E402
from mimic.train.contract import make_contract  # noqa: E402
from mimic.train.learning.learn import runner_config, settings_text  # noqa: E402
from mimic.train.learning.learn import train as train_robot  # noqa: E402
from mimic.train.learning.runner import TrainingDiverged  # noqa: E402
from mimic.train.stand_track import StandTrackEnv  # noqa: E402

train = partial(train_robot, description=load_description("cyberdog2"))

MDP = MdpSettings(worlds=4)
LEARN = LearnSettings(iterations=1, device="cpu", steps=8, hidden=(32, 16), epochs=2, minibatches=2)


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Path:
    """The folder of one short training."""
    folder = tmp_path_factory.mktemp("training")
    train(folder, MDP, LEARN)
    return folder


def weights(folder: Path) -> dict[str, torch.Tensor]:
    return torch.load(folder / "last.pt", weights_only=False)["actor_state_dict"]


def test_a_training_leaves_policy_checkpoints_settings_and_curves(trained):
    names = [path.name for path in trained.iterdir()]
    assert {"policy.onnx", "last.pt", "model_0.pt", "settings.json"} <= set(names)
    assert any(name.startswith("events.out.tfevents") for name in names)
    settings = json.loads((trained / "settings.json").read_text())
    assert settings["mdp"]["worlds"] == 4
    assert settings["learn"]["hidden"] == [32, 16]


def test_the_exported_policy_carries_its_contract(trained, description):
    policy = Policy(trained / "policy.onnx", description)
    stored = sha256((trained / "settings.json").read_bytes()).hexdigest()
    assert policy.contract == make_contract(description, MDP, stored)


def test_the_exported_policy_answers_as_the_trained_one(trained, description):
    runner = OnPolicyRunner(StandTrackEnv(description, MDP, "cpu", 0), runner_config(LEARN), None, "cpu")
    runner.load(str(trained / "last.pt"), map_location="cpu")
    torch_policy = runner.get_inference_policy("cpu")
    policy = Policy(trained / "policy.onnx", description)
    observations = np.random.default_rng(0).normal(size=(50, policy.contract.observation_size))
    batch = runner.env.get_observations()
    for observation in observations:
        batch["policy"][:] = torch.as_tensor(observation, dtype=torch.float32)
        with torch.inference_mode():
            expected = torch_policy(batch)[0].numpy()
        assert np.abs(policy.act(observation) - expected).max() < 1e-5


def test_the_same_training_gives_the_same_policy(trained, tmp_path):
    train(tmp_path, MDP, LEARN)
    first, second = weights(trained), weights(tmp_path)
    assert all(torch.equal(first[name], second[name]) for name in first)


def test_another_seed_gives_another_policy(trained, tmp_path):
    train(tmp_path, MDP, dataclasses.replace(LEARN, seed=2))
    first, second = weights(trained), weights(tmp_path)
    assert not all(torch.equal(first[name], second[name]) for name in first)


def test_a_training_in_two_sessions_is_that_in_one(tmp_path):
    """Worlds, chance, curriculum, optimiser and critic go on; four updates in one and in two sessions."""
    whole = dataclasses.replace(LEARN, iterations=4, minutes=0.0)
    train(tmp_path / "one", MDP, whole)
    train(tmp_path / "first", MDP, dataclasses.replace(whole, session_minutes=1e-6))
    train(tmp_path / "second", MDP, whole, resume=tmp_path / "first" / "last.pt")
    saved = [torch.load(tmp_path / name / "last.pt", weights_only=False) for name in ("one", "first", "second")]
    assert [each["infos"]["updates"] for each in saved] == [4, 1, 4]
    one, first, second = saved
    for network in ("actor_state_dict", "critic_state_dict"):
        apart = [(one[network][name].double() - second[network][name].double()).abs().max() for name in one[network]]
        assert max(apart) < 1e-6
        assert not torch.equal(first[network]["mlp.0.weight"], second[network]["mlp.0.weight"])


def test_a_training_goes_on_with_new_worlds_where_the_old_ones_were_not_kept(trained, tmp_path):
    (tmp_path / "last.pt").write_bytes((trained / "last.pt").read_bytes())
    train(tmp_path / "on", MDP, dataclasses.replace(LEARN, iterations=2), resume=tmp_path / "last.pt")
    before, after = (torch.load(folder / "last.pt", weights_only=False) for folder in (trained, tmp_path / "on"))
    seen = "obs_normalizer.count"
    assert after["actor_state_dict"][seen] == 2 * before["actor_state_dict"][seen]
    steps = [next(iter(saved["optimizer_state_dict"]["state"].values()))["step"] for saved in (before, after)]
    assert steps[1] == 2 * steps[0]


def test_a_training_that_is_at_its_end_is_not_resumed(trained, tmp_path):
    with pytest.raises(ConfigError, match=r"last\.pt has 1 updates; set iterations to more"):
        train(tmp_path, MDP, LEARN, resume=trained / "last.pt")


def test_each_update_is_reported_with_its_figures(tmp_path):
    rows = []
    train(
        tmp_path, MDP, dataclasses.replace(LEARN, iterations=2), report=lambda update, row: rows.append((update, row))
    )
    assert [update for update, _ in rows] == [0, 1]
    assert [row["steps"] for _, row in rows] == [32, 64]
    assert {"reward", "episode", "std", "elapsed_s", "learning_rate"} <= set(rows[0][1])


def test_a_time_alone_ends_a_training(tmp_path):
    updates = []
    short = dataclasses.replace(LEARN, iterations=0, minutes=1e-6)
    train(tmp_path, MDP, short, report=lambda update, row: updates.append(update))
    assert updates == [0]
    assert LearnSettings(minutes=9.0).updates > 1_000_000
    assert LearnSettings(minutes=9.0, iterations=7).updates == 7
    with pytest.raises(ConfigError, match="never ends"):
        LearnSettings(minutes=0.0)


@pytest.mark.parametrize("size", [1e30, float("inf")])
def test_a_training_that_is_no_longer_finite_stops_with_a_word(size, tmp_path):
    endless = dataclasses.replace(MDP, rewards=RewardWeights(height=size))
    with pytest.raises(TrainingDiverged, match="resume from the last checkpoint") as error:
        train(tmp_path, endless, dataclasses.replace(LEARN, iterations=3, epochs=4, minibatches=4))
    assert isinstance(error.value, MimicError)
    assert not (tmp_path / "policy.onnx").exists()


def test_a_file_that_is_no_checkpoint_is_refused(tmp_path):
    (tmp_path / "odd.pt").write_bytes(b"\xff\xd8")
    with pytest.raises(ConfigError, match=r"odd\.pt is no checkpoint of such a policy"):
        train(tmp_path / "new", MDP, dataclasses.replace(LEARN, iterations=2), resume=tmp_path / "odd.pt")


def test_a_gpu_that_is_not_there_is_reported_before_anything_is_written(tmp_path):
    if torch.cuda.is_available():
        pytest.skip("there is a GPU")
    with pytest.raises(ConfigError, match="PyTorch sees no GPU; add --set device=cpu"):
        train(tmp_path / "new", MDP, dataclasses.replace(LEARN, device="cuda"))
    assert not (tmp_path / "new").exists()


def test_a_device_of_another_kind_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="device is 'tpu'; expected auto, cpu, cuda"):
        train(tmp_path / "new", MDP, dataclasses.replace(LEARN, device="tpu"))
    assert not (tmp_path / "new").exists()


def test_the_text_of_the_settings_identifies_trainings():
    assert settings_text(MDP, LEARN) == settings_text(MdpSettings(worlds=4), LEARN)
    other = dataclasses.replace(MDP, rewards=RewardWeights(slip=-0.123))
    assert settings_text(other, LEARN) != settings_text(MDP, LEARN)
