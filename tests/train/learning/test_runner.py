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
from rsl_rl.runners import OnPolicyRunner  # noqa: E402

from mimic.robot.description import load_description  # noqa: E402
from mimic.train.learning import learn  # noqa: E402
from mimic.train.learning.learn import runner_config  # noqa: E402
from mimic.train.learning.runner import ResumableRunner, own_device, rank  # noqa: E402
from mimic.train.stand_track import StandTrackEnv  # noqa: E402

together = pytest.mark.skipif(
    not (torch.distributed.is_available() and torch.distributed.is_gloo_available()), reason="PyTorch without gloo"
)
MDP = MdpSettings(worlds=2, history=2)
LEARN = LearnSettings(device="cpu", steps=4, hidden=(16, 8), epochs=2, minibatches=2, mirror=0.0)


class OnCpus:
    """rsl_rl's runner has several processes on GPUs only; this part lets it have them on CPUs."""

    def _configure_multi_gpu(self) -> None:
        me, count = rank(), int(os.environ["WORLD_SIZE"])
        self.gpu_world_size, self.gpu_local_rank, self.gpu_global_rank = count, me, me
        self.is_distributed = True
        self.cfg["multi_gpu"] = {"global_rank": me, "local_rank": me, "world_size": count}
        torch.distributed.init_process_group(backend="gloo", rank=me, world_size=count)


class RunnerOnCpus(OnCpus, OnPolicyRunner):
    """rsl_rl's runner on CPUs."""


class ResumableRunnerOnCpus(OnCpus, ResumableRunner):
    """This project's runner on CPUs."""


def learned(env: StandTrackEnv, seed: int, plain: bool) -> torch.Tensor:
    """Learn once from a storage full of noise of a seed; return the policy's parameters."""
    torch.manual_seed(3)
    config = runner_config(LEARN)
    if plain:
        config["algorithm"]["class_name"] = "PPO"
        del config["algorithm"]["mirror_coef"]
    runner = RunnerOnCpus(env, config, None, "cpu")
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
                seen["own"].fill_(1.0)  # all actions count, as they do for rsl_rl
                runner.alg.act(seen)
                ended = torch.zeros(env.num_envs, dtype=torch.long)
                runner.alg.process_env_step(seen, torch.randn(env.num_envs, generator=noise), ended, {})
            runner.alg.compute_returns(seen)
        runner.alg.update()
    state = runner.alg.actor.state_dict()
    return torch.cat([v.double().flatten() for name, v in state.items() if "count" not in name])


def process(folder: str, *ports: str) -> int:
    """What each of two processes of torchrun does: learn from noise by this PPO and by rsl_rl's, then train."""
    from mimic.cli import main

    torchrun = dict(os.environ)
    torch.set_num_threads(1)
    env = StandTrackEnv(load_description("cyberdog2"), MDP, "cpu", 0)
    os.environ.pop("TORCHELASTIC_USE_AGENT_STORE")
    for plain, port in zip((False, True), ports, strict=True):
        os.environ |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port}
        torch.save(learned(env, 1 + rank(), plain), f"{folder}/{rank()}-{plain}.pt")
        torch.distributed.destroy_process_group()
    os.environ |= torchrun
    learn.ResumableRunner = ResumableRunnerOnCpus  # type: ignore[misc]
    words = ["worlds=4", "history=2", "iterations=2", "steps=2", "minibatches=2", "hidden=[16,8]", "device=cpu"]
    return main(["train", f"{folder}/out", "--set", *words])


def free_ports() -> tuple[str, str]:
    """Return two ports that nobody listens on."""
    with socket.socket() as one, socket.socket() as other:
        for free in (one, other):
            free.bind(("127.0.0.1", 0))
        return str(one.getsockname()[1]), str(other.getsockname()[1])


@pytest.mark.slow
@together
def test_two_processes_that_see_different_things_learn_one_policy_as_rsl_rl_does_and_the_first_writes_it(tmp_path):
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    command = [*torchrun, __file__, str(tmp_path), *free_ports()]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=300, env=os.environ | {"MUJOCO_GL": "disable"}
    )
    assert done.returncode == 0, done.stderr
    first, second, plain = (torch.load(tmp_path / f"{name}.pt") for name in ("0-False", "1-False", "0-True"))
    assert torch.equal(first, second)
    assert (first - plain).abs().max() < 2e-5
    assert done.stdout.count("wrote ") == 1
    assert {"policy.onnx", "last.pt", "settings.json"} <= {path.name for path in (tmp_path / "out").iterdir()}
    assert len(list((tmp_path / "out").glob("events.*"))) == 1
    saved = torch.load(tmp_path / "out" / "last.pt", weights_only=False)
    seen_by_both = 2 * 2 * 2 * 2
    assert saved["actor_state_dict"]["obs_normalizer.count"] == seen_by_both


def test_the_first_process_writes_and_each_has_a_gpu_of_its_own(monkeypatch):
    assert (rank(), own_device("cpu")) == (0, "cpu")
    for name, value in (("RANK", "5"), ("LOCAL_RANK", "1"), ("WORLD_SIZE", "8")):
        monkeypatch.setenv(name, value)
    assert (rank(), own_device("cpu")) == (5, "cpu")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    with pytest.raises(ConfigError, match="as many processes as there are GPUs"):
        own_device("auto")


if __name__ == "__main__":
    sys.exit(process(*sys.argv[1:]))
