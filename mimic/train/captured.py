"""PPO of rsl-rl-lib as captured graphs: on a GPU, inference, returns and minibatch steps are replayed, not launched.

The arithmetic is that of `rsl_rl.algorithms.PPO`. What differs is where things live: the adaptive learning rate,
the entropy coefficient and the sums of the losses are tensors on the device, so that an update waits for the device
once, at its end; minibatches, which rsl_rl makes the same in every epoch, are gathered and normalised once an update;
and actions are drawn without torch.normal, whose check of the spread waits for the device at every control step.
"""

from __future__ import annotations

import functools
import math
from itertools import chain
from typing import Any

import torch
from rsl_rl.algorithms import PPO
from rsl_rl.modules.distribution import GaussianDistribution
from tensordict import TensorDict
from torch import Tensor, nn

from mimic.train.cuda_graphs import Replayed
from mimic.train.learning.mirror import mirrored_actions, mirrored_observations

RATE_RANGE = (1e-5, 1e-2)
"""Bounds of the adaptive learning rate, those of rsl_rl."""


HALF_LOG_2_PI = 0.5 * math.log(2 * math.pi)


class DeviceGaussian(GaussianDistribution):
    """rsl_rl's Gaussian; draws without a check that waits for the device, and looks at the actions that count only."""

    def sample(self) -> Tensor:
        """Return actions (N, 12)."""
        with torch.no_grad():
            return torch.randn_like(self.mean) * self.std + self.mean

    def log_prob_of(self, actions: Tensor, counts: Tensor) -> Tensor:
        """Return the log probability (N,) of those actions (N, 12) for which counts (N, 12) is 1."""
        away = (actions - self.mean) / self.std
        return -(counts * (0.5 * away.square() + self.std.log() + HALF_LOG_2_PI)).sum(-1)

    def entropy_of(self, counts: Tensor) -> Tensor:
        """Return their entropy (N,)."""
        return (counts * (0.5 + HALF_LOG_2_PI + self.std.log())).sum(-1)

    def divergence_of(self, mean: Tensor, spread: Tensor, counts: Tensor) -> Tensor:
        """Return the KL divergence (N,) of their distribution of now from one with this mean and spread (N, 12)."""
        square = (spread.square() + (mean - self.mean).square()) / (2 * self.std.square())
        return (counts * ((self.std / spread).log() + square - 0.5)).sum(-1)


class CapturedPPO(PPO):
    """rsl_rl's PPO for feed-forward Gaussian policies with the adaptive learning rate, replayed."""

    def __init__(self, actor: Any, critic: Any, storage: Any, *, mirror_coef: float, **settings: Any) -> None:
        self._mirror = mirror_coef
        self.policy_share = 1.0
        """Share of the losses of the policy; 0 while only the critic learns."""
        super().__init__(actor, critic, storage, **settings)
        on_gpu = str(self.device).startswith("cuda")
        self._rate = torch.tensor(self.learning_rate, device=self.device)
        self._entropy_weight = torch.tensor(self.entropy_coef, device=self.device)
        self._wanted_kl = torch.tensor(self.desired_kl, device=self.device)
        self._policy_share = torch.ones((), device=self.device)
        self._losses = ["value", "surrogate", "entropy"] + ["symmetry"] * bool(self._mirror)
        self._sums = torch.zeros(len(self._losses), device=self.device)
        self._own = {"lr": self._rate, "capturable": on_gpu, "fused": on_gpu or None, "foreach": None}
        parameters = list(chain(self.actor.parameters(), self.critic.parameters()))
        self.optimizer = torch.optim.Adam(parameters, **self._own)  # type: ignore[arg-type]
        self._flat = torch.zeros(sum(p.numel() for p in parameters) + 1, device=self.device)
        """Gradients of all parameters, then the KL divergence of the minibatch."""
        begin = 0
        for p in parameters:
            p.grad = self._flat[begin : begin + p.numel()].view_as(p)
            begin += p.numel()
        self._size = storage.num_envs * storage.num_transitions_per_env // self.num_mini_batches
        self._seen: TensorDict | None = None  # stays where it is
        self._batch: dict[str, Tensor] = {}
        self._act = Replayed(self._infer, self.device)
        self._returns = Replayed(self._all_returns, self.device)
        if self.is_multi_gpu:  # gradients meet between two graphs
            self._parts = [
                Replayed(functools.partial(self._gradients, i), self.device) for i in range(self.num_mini_batches)
            ]
            self._step = Replayed(self._apply, self.device)
            self._epoch = self._shared_epoch
        else:
            self._epoch = Replayed(self._whole_epoch, self.device)

    def begin_policy(self) -> None:
        """Let the policy learn from now on, after a time in which only the critic did.

        Adam has then averaged gradients of zero, and makes its first steps three times as large as the learning rate,
        which itself had no reason to fall. A policy with little spread does not survive that. So its averages begin
        anew, and the rate at its smallest. Source: lab/results/training.md.
        """
        self.policy_share = 1.0
        self.learning_rate = RATE_RANGE[0]
        self._rate.fill_(self.learning_rate)
        for parameter in self.actor.parameters():
            for moment in self.optimizer.state.get(parameter, {}).values():
                moment.zero_()

    def act(self, obs: TensorDict) -> Tensor:
        """Draw actions and keep what the update needs."""
        self._seen = obs.clone() if self._seen is None else self._seen.copy_(obs)
        t = self.transition
        t.actions, t.values, t.actions_log_prob, t.distribution_params = self._act()
        t.observations = obs
        return t.actions  # type: ignore[return-value]

    def _infer(self) -> tuple[Any, ...]:
        actions = self.actor(self._seen, stochastic_output=True).detach()
        values = self.critic(self._seen).detach()
        log_prob = self.actor.distribution.log_prob_of(actions, self._seen["own"]).detach()  # type: ignore
        return actions, values, log_prob, tuple(p.detach() for p in self.actor.output_distribution_params)

    def compute_returns(self, obs: TensorDict) -> None:
        """Compute return and advantage targets."""
        assert self._seen is not None
        self._seen.copy_(obs)
        self._returns()

    def _all_returns(self) -> None:
        super().compute_returns(self._seen)  # type: ignore[arg-type]

    def update(self) -> dict[str, float]:
        """Go over the storage in epochs and minibatches; return mean losses."""
        self._rate.fill_(self.learning_rate)
        self._entropy_weight.fill_(self.entropy_coef)
        self._wanted_kl.fill_(self.desired_kl)
        self._policy_share.fill_(self.policy_share)
        self._sums.zero_()
        self._gather()
        for _ in range(self.num_learning_epochs):
            self._epoch()
        seen = self.storage.observations.flatten(0, 1)
        for model in (self.actor, self.critic):
            normalizer: Any = model.obs_normalizer
            spread = normalizer._std  # the graphs read this tensor, but rsl_rl puts another in its place
            model.update_normalization(seen)  # type: ignore[arg-type]
            normalizer._std = spread.copy_(normalizer._std)
        with torch.no_grad():  # the spread after the update, and no tensor of a graph kept alive
            self.actor.distribution.update(torch.zeros(1, self.storage.actions_shape[0], device=self.device))  # type: ignore
        *sums, self.learning_rate = torch.cat([self._sums, self._rate[None]]).tolist()  # waits for the device
        self.storage.clear()
        steps = self.num_learning_epochs * self.num_mini_batches
        return {name: s / steps for name, s in zip(self._losses, sums, strict=True)}

    @torch.no_grad()
    def _gather(self) -> None:
        s = self.storage
        order = torch.randperm(self.num_mini_batches * self._size, device=self.device)
        seen = s.observations.flatten(0, 1)
        mean, spread = s.distribution_params  # type: ignore[misc]
        columns = {
            "actor": self.actor.get_latent(seen),  # type: ignore[arg-type]
            "critic": self.critic.get_latent(seen),  # type: ignore[arg-type]
            "actions": s.actions.flatten(0, 1),
            "values": s.values.flatten(0, 1),
            "returns": s.returns.flatten(0, 1),
            "log_prob": s.actions_log_prob.flatten(),
            "advantages": s.advantages.flatten(),
            "mean": mean.flatten(0, 1),
            "spread": spread.flatten(0, 1),
            "own": seen["own"],
        }
        if self._mirror:
            image = TensorDict({"policy": mirrored_observations(seen["policy"])}, batch_size=seen.batch_size)
            columns["image"] = self.actor.get_latent(image)  # type: ignore[arg-type]
        for name, column in columns.items():
            if name in self._batch:
                torch.index_select(column, 0, order, out=self._batch[name])
            else:
                self._batch[name] = column[order]

    def _whole_epoch(self) -> None:
        for i in range(self.num_mini_batches):
            self._gradients(i)
            self._apply()

    def _shared_epoch(self) -> None:
        for gradients in self._parts:
            gradients()
            torch.distributed.all_reduce(self._flat)
            self._flat /= self.gpu_world_size
            self._step()

    def _gradients(self, i: int) -> None:
        """Put gradients and KL divergence of a minibatch into the flat buffer, and add its losses to the sums."""
        b = {name: column[i * self._size : (i + 1) * self._size] for name, column in self._batch.items()}
        mean = self.actor.mlp(b["actor"])
        values = self.critic.mlp(b["critic"])
        image = self.actor.mlp(b["image"]) if self._mirror else None
        policy: Any = self.actor.distribution
        policy.update(mean)
        log_prob = policy.log_prob_of(b["actions"], b["own"])
        entropy = policy.entropy_of(b["own"]).mean()
        with torch.no_grad():
            kl = policy.divergence_of(b["mean"], b["spread"], b["own"]).mean()
        ratio = torch.exp(log_prob - b["log_prob"])
        surrogate = -b["advantages"] * ratio
        clipped = -b["advantages"] * torch.clamp(ratio, 1.0 - self.clip_param, 1.0 + self.clip_param)
        surrogate_loss = torch.max(surrogate, clipped).mean()
        value_loss = (values - b["returns"]).square().mean()
        losses = [value_loss, surrogate_loss, entropy]
        loss = surrogate_loss - self._entropy_weight * entropy
        if image is not None:
            losses.append((b["own"] * (image - mirrored_actions(mean.detach())).square()).mean())
            loss = loss + self._mirror * losses[-1]
        loss = self._policy_share * loss + self.value_loss_coef * value_loss
        self._flat.zero_()
        loss.backward()
        self._flat[-1:].copy_(kl)
        with torch.no_grad():  # lets go of the minibatch, which would keep its stream alive in the next graph
            self.actor.distribution.update(mean.detach())  # type: ignore[union-attr]
        self._sums += torch.stack(losses).detach()

    def _apply(self) -> None:
        """Adapt the learning rate to the KL divergence and make a step."""
        kl = self._flat[-1]
        rate = self._rate
        down = torch.clamp(rate / 1.5, min=RATE_RANGE[0])
        up = torch.clamp(rate * 1.5, max=RATE_RANGE[1])
        learns = self._policy_share > 0.0
        rate = torch.where((kl < self._wanted_kl / 2.0) & (kl > 0.0) & learns, up, rate)
        self._rate.copy_(torch.where(kl > self._wanted_kl * 2.0, down, rate))
        nn.utils.clip_grad_norm_(self.actor.parameters(), self.max_grad_norm)
        nn.utils.clip_grad_norm_(self.critic.parameters(), self.max_grad_norm)
        self.optimizer.step()

    def load(self, loaded_dict: dict[str, Any], load_cfg: dict[str, Any] | None, strict: bool) -> bool:
        """Take over a checkpoint of PPO or of this class, of a CPU or a GPU, before the first step."""
        optimizer = loaded_dict["optimizer_state_dict"]
        here = {k: v for k, v in self._own.items() if k != "lr"}
        groups = [{**group, **here, "lr": float(group["lr"])} for group in optimizer["param_groups"]]
        loaded = {**loaded_dict, "optimizer_state_dict": {**optimizer, "param_groups": groups}}
        iteration = super().load(loaded, load_cfg, strict)
        for group in self.optimizer.param_groups:
            group["lr"] = self._rate
        return iteration
