from __future__ import annotations

import os
import socket
import subprocess
import sys

import pytest

from mimic.config.training import LearnSettings, MdpSettings
from mimic.errors import ConfigError

torch = pytest.importorskip("torch", reason="training needs the extra 'train'")
for library in ("mujoco_warp", "rsl_rl", "onnx", "tensorboard"):
    pytest.importorskip(library, reason="training needs the extra 'train'")
from mimic.robot.description import load_description  # noqa: E402
from mimic.train.learn import runner_config  # noqa: E402
from mimic.train.runner import Ranks, Runner  # noqa: E402
from mimic.train.stand_track import StandTrackEnv  # noqa: E402

together = pytest.mark.skipif(
    not (torch.distributed.is_available() and torch.distributed.is_gloo_available()), reason="PyTorch without gloo"
)
MDP = MdpSettings(worlds=2, history=2)
LEARN = LearnSettings(device="cpu", steps=4, hidden=(16, 8), epochs=2, minibatches=2, reaching=0.0)


def learned(env: StandTrackEnv, seed: int, plain: bool) -> torch.Tensor:
    """Learn once from a storage full of noise of a seed; return the policy's parameters."""
    torch.manual_seed(3)
    config = runner_config(LEARN)
    if plain:
        config["algorithm"]["class_name"] = "PPO"
        del config["algorithm"]["reaching_coef"]
    runner = Runner(env, config, None, "cpu")
    if runner.is_distributed:
        runner.alg.broadcast_parameters()
    noise = torch.Generator().manual_seed(seed)
    for update in range(2):
        torch.manual_seed(100 * seed + update)
        with torch.inference_mode():
            for _ in range(LEARN.steps):
                seen = env.get_observations()
                for tensor in seen.values():
                    tensor.copy_(torch.randn(tensor.shape, generator=noise))
                runner.alg.act(seen)
                ended = torch.zeros(env.num_envs, dtype=torch.long)
                runner.alg.process_env_step(seen, torch.randn(env.num_envs, generator=noise), ended, {})
            runner.alg.compute_returns(seen)
        runner.alg.update()
    state = runner.alg.actor.state_dict()
    return torch.cat([v.double().flatten() for name, v in state.items() if "count" not in name])


def process(rank: int, ports: tuple[int, int], seeds: tuple[int, int], folder: str) -> None:
    os.environ |= {"RANK": str(rank), "LOCAL_RANK": str(rank), "WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1"}
    torch.set_num_threads(1)
    env = StandTrackEnv(load_description(), MDP, "cpu", 0)
    for plain, port in zip((False, True), ports, strict=True):
        os.environ["MASTER_PORT"] = str(port)
        found = learned(env, seeds[rank], plain)
        torch.save(found, f"{folder}/{rank}-{plain}.pt")
        torch.distributed.destroy_process_group()


def free_ports() -> tuple[int, int]:
    """Return two ports that nobody listens on."""
    with socket.socket() as one, socket.socket() as other:
        for free in (one, other):
            free.bind(("127.0.0.1", 0))
        return one.getsockname()[1], other.getsockname()[1]


@pytest.mark.slow
@together
def test_two_processes_that_see_different_things_learn_one_policy_as_rsl_rl_does(tmp_path):
    torch.multiprocessing.spawn(process, args=(free_ports(), (1, 2), str(tmp_path)), nprocs=2)
    first, second, plain = (torch.load(tmp_path / f"{name}.pt") for name in ("0-False", "1-False", "0-True"))
    assert torch.equal(first, second)
    assert (first - plain).abs().max() < 2e-5


@pytest.mark.slow
@together
def test_torchrun_trains_one_policy_and_the_first_process_writes_it(tmp_path):
    words = ["worlds=2", "history=2", "iterations=2", "steps=2", "minibatches=2", "hidden=[16,8]", "device=cpu"]
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    command = [*torchrun, "-m", "mimic", "train", str(tmp_path / "out"), "--set", *words]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=300, env=os.environ | {"MUJOCO_GL": "disable"}
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("wrote ") == 1
    assert {"policy.onnx", "last.pt", "settings.json"} <= {path.name for path in (tmp_path / "out").iterdir()}
    assert len(list((tmp_path / "out").glob("events.*"))) == 1
    saved = torch.load(tmp_path / "out" / "last.pt", weights_only=False)
    seen_by_both = 2 * 2 * 2 * 2
    assert saved["actor_state_dict"]["obs_normalizer.count"] == seen_by_both


def test_the_first_process_writes_and_each_has_a_gpu_of_its_own(monkeypatch):
    assert Ranks.of_environment() == Ranks(rank=0, local=0, count=1)
    for name, value in (("RANK", "5"), ("LOCAL_RANK", "1"), ("WORLD_SIZE", "8")):
        monkeypatch.setenv(name, value)
    ranks = Ranks.of_environment()
    assert not ranks.first
    assert ranks.device("cpu") == "cpu"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    with pytest.raises(ConfigError, match="as many processes as there are GPUs"):
        ranks.device("auto")
