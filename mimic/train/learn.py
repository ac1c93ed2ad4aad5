"""PPO by rsl-rl-lib: training run, checkpoints, resuming, and the export to ONNX with the contract inside."""

from __future__ import annotations

import contextlib
import io
import json
import math
import time
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import torch
from rsl_rl.runners import OnPolicyRunner

from mimic.config.training import LearnSettings, MdpSettings
from mimic.io.store import plain, written_whole
from mimic.robot.description import RobotDescription
from mimic.train.contract import make_contract
from mimic.train.onnx_file import export_network
from mimic.train.runner import QuietLogger, Report, TimeIsUp, own_device, processes, rank
from mimic.train.sit_down import SitDownEnv
from mimic.train.stand_track import StandTrackEnv
from mimic.train.warm_start import take_over

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
    device, first = own_device(learn.device), rank() == 0
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
        runner = OnPolicyRunner(env, runner_config(learn), str(folder), device)
    runner.logger.__class__ = QuietLogger
    deadline = time.monotonic() + 60 * learn.minutes if learn.minutes > 0 else math.inf

    contract = make_contract(description, mdp, sha256(settings.encode()).hexdigest())
    critic_alone = 0

    def progressed(share: float) -> None:
        nonlocal critic_alone
        if critic_alone:
            critic_alone -= 1
            if not critic_alone:
                runner.alg.begin_policy()  # type: ignore[attr-defined]
        runner.alg.entropy_coef = learn.entropy * (learn.entropy_end / learn.entropy) ** min(share, 1.0)
        runner.alg.desired_kl = learn.desired_kl * (learn.desired_kl_end / learn.desired_kl) ** min(share, 1.0)

    runner.logger.attach(report, deadline, progressed)  # type: ignore[attr-defined]
    if resume is not None and resume.suffix == ".onnx":
        if take_over(runner.alg.actor, resume, contract, learn.resume_std):
            steps = max(mdp.curriculum_latest + mdp.curriculum_steps, *mdp.finish_steps, *mdp.rest_steps)
            env.resume_at(math.ceil(steps))
        critic_alone = learn.critic_updates
        runner.alg.policy_share = float(critic_alone == 0)  # type: ignore[attr-defined]
    elif resume is not None:
        runner.load(str(resume), map_location=device)
        env.resume_at(runner.current_learning_iteration * learn.steps)
    with contextlib.suppress(TimeIsUp):
        runner.learn(learn.updates)
    if torch.distributed.is_initialized():
        torch.distributed.destroy_process_group()
    if first:
        runner.save(str(folder / "last.pt"), {"contract": contract.to_json()})
        policy = runner.alg.get_policy().as_onnx(verbose=False)
        export_network(policy, contract, description, folder / "policy.onnx")
    return folder / "policy.onnx"
