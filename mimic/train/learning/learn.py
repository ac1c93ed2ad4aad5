"""PPO by rsl-rl-lib: training run, checkpoints, resuming, and the export to ONNX with the contract inside."""

from __future__ import annotations

import contextlib
import io
import json
import math
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch

from mimic.config.training import LearnSettings, MdpSettings
from mimic.errors import ConfigError
from mimic.io.store import plain, written_whole
from mimic.robot.description import RobotDescription
from mimic.train.contract import make_contract
from mimic.train.learning.onnx_file import export_network
from mimic.train.learning.runner import QuietLogger, Report, ResumableRunner, TimeIsUp, own_device, processes, rank
from mimic.train.learning.warm_start import take_over
from mimic.train.sit_down import SitDownEnv
from mimic.train.stand_track import StandTrackEnv

WORLDS = "worlds_{}.pt"
"""File of the worlds of a process at the end of a session, beside last.pt; without it worlds begin anew."""

SAVE_EVERY = 100
"""Updates between two checkpoints."""


def runner_config(settings: LearnSettings) -> dict[str, Any]:
    """Return the settings in the form rsl_rl takes, whose defaults hold for what is not named."""
    model = {"class_name": "MLPModel", "hidden_dims": list(settings.hidden), "obs_normalization": True}
    spread = {"std_type": "log", "std_range": list(settings.std_range)}
    return {
        "num_steps_per_env": settings.steps,
        "save_interval": SAVE_EVERY,
        "check_for_nan": False,
        "obs_groups": {"actor": ["policy"], "critic": ["critic"]},
        "actor": {**model, "distribution_cfg": {"class_name": "mimic.train.captured:DeviceGaussian", **spread}},
        "critic": dict(model),
        "algorithm": {
            "class_name": "mimic.train.captured:CapturedPPO",
            "num_learning_epochs": settings.epochs,
            "num_mini_batches": settings.minibatches,
            "entropy_coef": settings.entropy,
            "learning_rate": settings.learning_rate,
            "desired_kl": settings.desired_kl,
            "use_clipped_value_loss": False,
            "mirror_coef": settings.mirror,
        },
    }


class Schedule:
    """What changes as a training goes on: entropy bonus, wanted divergence, and when a policy begins to learn."""

    def __init__(self, settings: LearnSettings, algorithm: Any) -> None:
        self._settings = settings
        self._algorithm = algorithm
        self._share = 0.0
        self._critic_alone = 0

    def critic_first(self) -> None:
        """Let only the critic learn for a while."""
        self._critic_alone = self._settings.critic_updates
        self._algorithm.policy_share = float(self._critic_alone == 0)

    def reached(self, share: float) -> None:
        """Go on after an update, at this share of the training."""
        if self._critic_alone:
            self._critic_alone -= 1
            if not self._critic_alone:
                self._algorithm.begin_policy()
        self._set(share)

    def _set(self, share: float) -> None:
        s = self._settings
        self._share = min(share, 1.0)
        self._algorithm.entropy_coef = s.entropy * (s.entropy_end / s.entropy) ** self._share
        self._algorithm.desired_kl = s.desired_kl * (s.desired_kl_end / s.desired_kl) ** self._share

    def state(self) -> dict[str, Any]:
        """Return what a checkpoint keeps."""
        return {"share": self._share, "critic_alone": self._critic_alone}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from there."""
        self._critic_alone = state["critic_alone"]
        self._algorithm.policy_share = float(self._critic_alone == 0)
        self._set(state["share"])


def _go_on(runner: Any, env: StandTrackEnv, schedule: Schedule, checkpoint: Path, device: str) -> float:
    """Take over a checkpoint, and the worlds where they were kept; return how long its training has lasted [s]."""
    try:
        infos = runner.load(str(checkpoint), map_location=device)
        runner.current_learning_iteration = infos["updates"]
        schedule.restore(infos)
        env.resume(infos["env"])
    except (UnpicklingError, EOFError, RuntimeError, KeyError, TypeError) as reason:
        told = str(reason).partition("\n")[0]
        raise ConfigError(f"{checkpoint} is no checkpoint of such a policy ({told}); expected last.pt of one") from None
    kept = checkpoint.with_name(WORLDS.format(rank()))
    if kept.is_file():
        state = torch.load(kept, weights_only=False, map_location=device)
        if state["updates"] == infos["updates"]:
            env.restore(state)
    return float(infos["elapsed_s"])


def settings_text(mdp: MdpSettings, learn: LearnSettings) -> str:
    """Return everything that decides a training run as JSON: the text of settings.json."""
    return json.dumps({"mdp": plain(mdp), "learn": plain(learn)}, indent=2) + "\n"


def train(
    folder: Path,
    mdp: MdpSettings,
    learn: LearnSettings,
    description: RobotDescription,
    *,
    resume: Path | None = None,
    report: Report | None = None,
) -> Path:
    """Train a policy and export it.

    Started by torchrun, every process has its part of the worlds, drawn from a seed of its own, on a GPU of its own;
    all learn one policy, and the first process writes.

    Args:
        folder: Receives checkpoints, TensorBoard files, settings.json and policy.onnx.
        resume: Checkpoint (.pt) to go on from; the settings must shape the same networks. Or a policy (.onnx): its
            critic is learned anew. The task is as hard as at the end of a training from the first step on, unless the
            policy is another robot's: standing and stepping carry over, and the task begins easy.

    Returns:
        Path of the ONNX file.

    Raises:
        TrainingDiverged: If a loss is not finite.
        ConfigError: If the device is not there.
    """
    device = own_device(learn.device)
    first = rank() == 0
    if mdp.task == "sit_down":  # its clock tells the time, which has no mirror image
        learn = replace(learn, mirror=0.0)
    torch.backends.cuda.matmul.allow_tf32 = True
    settings = settings_text(mdp, learn)
    if first:
        folder.mkdir(parents=True, exist_ok=True)
        with written_whole(folder / "settings.json") as part:
            part.write_text(settings, encoding="utf-8")
    kind = SitDownEnv if mdp.task == "sit_down" else StandTrackEnv
    own = replace(mdp, worlds=mdp.worlds // processes())
    env = kind(description, own, device, learn.seed + 1000 * rank())
    with contextlib.redirect_stdout(io.StringIO()):
        runner = ResumableRunner(env, runner_config(learn), str(folder), device)
    runner.logger.__class__ = QuietLogger

    contract = make_contract(description, mdp, sha256(settings.encode()).hexdigest())
    schedule = Schedule(learn, runner.alg)
    runner.told = lambda: {"contract": contract.to_json(), "env": env.progress(), **schedule.state()}
    before = 0.0
    if resume is not None and resume.suffix == ".onnx":
        if take_over(runner.alg.actor, resume, contract, learn.resume_std):
            steps = max(mdp.curriculum_latest + mdp.curriculum_steps, *mdp.finish_steps, *mdp.rest_steps)
            env.resume_at(math.ceil(steps))
        schedule.critic_first()
    elif resume is not None:
        before = _go_on(runner, env, schedule, resume, device)
    if runner.current_learning_iteration >= learn.updates:
        raise ConfigError(f"{resume} has {runner.current_learning_iteration} updates; set iterations to more than that")
    limits = (60 * minutes if minutes > 0 else math.inf for minutes in (learn.minutes, learn.session_minutes))
    runner.logger.attach(report, *limits, before, schedule.reached)  # type: ignore[attr-defined]
    with contextlib.suppress(TimeIsUp):
        runner.learn(learn.updates - runner.current_learning_iteration)
    state = {"updates": runner.current_learning_iteration + 1, **env.state()}
    torch.save(state, folder / WORLDS.format(rank()))
    if torch.distributed.is_initialized():
        torch.distributed.destroy_process_group()
    if first:
        runner.save(str(folder / "last.pt"))
        policy = runner.alg.get_policy().as_onnx(verbose=False)
        export_network(policy, contract, description, folder / "policy.onnx")
    return folder / "policy.onnx"
