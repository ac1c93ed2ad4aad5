"""A trial of off-policy learning in the training worlds, to compare with PPO: soft actor-critic as in FastSAC.

    python -m benchmarks.off_policy OUT worlds=4096 history=10 minutes=10 seed=1 snapshots=[4,7] --student 1

``name=value`` sets a field of MdpSettings or LearnSettings as in ``python -m mimic.train``; of the latter seed, device,
minutes, snapshots, reaching, reaching_share and mirror count. Writes OUT/policy.onnx and
OUT/settings.json; with ``--student MINUTES`` also OUT/student.onnx, the policy distilled into a network as PPO has it;
``python -m mimic.train --resume`` goes on from that. The options are the fields of SacSettings, and explained there.

Source of the method: Seo et al. 2025, "Learning sim-to-real humanoid locomotion in 15 minutes", and the values of its
public code. Here both critics learn from the mean of the two target distributions, the entropy that is asked for falls,
and the policy pays for answers that are not mirror images of each other.
"""

from __future__ import annotations

import argparse
import itertools
import json
import logging
import math
import sys
import time
from collections.abc import Iterable
from copy import deepcopy
from dataclasses import asdict, dataclass, fields, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import torch
from torch import nn
from torch.nn import functional as F

from mimic.config.training import LearnSettings, MdpSettings
from mimic.dynamics.cuda_graphs import Replayed
from mimic.errors import MimicError
from mimic.io.store import plain, save_json
from mimic.policy.contract import PolicyContract
from mimic.robot.description import load_description
from mimic.train.learn import settings_hash
from mimic.train.mirror import mirrored_actions, mirrored_observations
from mimic.train.onnx_file import export_network
from mimic.train.overrides import with_overrides
from mimic.train.runner import Ranks, TrainingDiverged, short_names
from mimic.train.stand_track import StandTrackEnv

log = logging.getLogger(__name__)

LOG_STD = (-5.0, 0.0)
"""Range of the logarithm of the policy's spread, before tanh."""
ENTROPY_SHARE = 0.8
"""Share of the time in which the entropy that is asked for falls."""
WARM_UP = 10
"""Control steps before learning begins."""
STUDENT_RATE = (1e-3, 1e-4)
"""Learning rate of a student at the beginning and at the end."""
STUDENT_SPREAD = 0.1
"""Spread of the noise on its actions, so that it also sees where PPO will take it."""
SEEN_MOST = 10.0
"""Normalised observations are clipped to plus and minus this."""


@dataclass(frozen=True, kw_only=True)
class SacSettings:
    """Each field is an option of the command line."""

    updates: int = 8
    """Of the critics for each control step of all worlds."""
    policy_delay: int = 4
    """Updates of the critics for each one of the policy."""
    batch: int = 8192
    buffer_steps: int = 512
    """Newest control steps of all worlds in the replay buffer."""
    gamma: float = 0.97
    tau: float = 0.125
    """Share by which the target critics follow the critics in each update."""
    learning_rate: float = 3e-4
    """Learning rate of policy, critics and temperature."""
    weight_decay: float = 0.001
    """Weight decay."""
    temperature: float = 0.001
    """At the beginning; learned."""
    target_entropy: float = 0.0
    """Of the policy, for each action, in units of actions: 0 is a spread of 0.24."""
    target_entropy_end: float = -1.2
    """… and from ENTROPY_SHARE of the time on, falling evenly until then: -1.2 is a spread of 0.07."""
    mixed_precision: bool = False
    """Networks of the updates in bfloat16."""
    student: float = 0.0
    """Minutes after the training in which the policy is distilled into a network as PPO has it."""
    value_range: float = 20.0
    """Returns are between plus and minus this."""
    atoms: int = 101
    """Points at which a critic gives the probability of a return."""


def network(sizes: Iterable[int], out: int) -> nn.Sequential:
    """Return a network with layer normalisation and SiLU between its layers."""
    before, *hidden = sizes
    layers: list[nn.Module] = []
    for size in hidden:
        layers += [nn.Linear(before, size), nn.LayerNorm(size), nn.SiLU()]
        before = size
    return nn.Sequential(*layers, nn.Linear(before, out))


class Guarded(Replayed):
    """Replayed on a GPU if it can be captured, and otherwise run as written."""

    def __call__(self) -> Any:
        """Return what the function returns."""
        try:
            return super().__call__()
        except RuntimeError as reason:
            if not self._on_gpu or not self._warm or self._graph is not None:
                raise
            torch.cuda.synchronize()
            log.info("%s is not captured: %s", self._function.__name__, str(reason).splitlines()[0])
            self._on_gpu = False
            return self._function()


def descend(optimizer: torch.optim.Optimizer, loss: torch.Tensor) -> None:
    """Make a step of the optimiser; nothing else gets gradients."""
    parameters = [p for group in optimizer.param_groups for p in group["params"]]
    for parameter, gradient in zip(parameters, torch.autograd.grad(loss, parameters), strict=True):
        parameter.grad = gradient
    optimizer.step()


class Actor(nn.Module):
    """Observation -> mean action; also what is written as ONNX.

    The buffers mean and spread belong to the critic's observation, whose first numbers are the actor's.
    """

    bound: torch.Tensor
    mean: torch.Tensor
    spread: torch.Tensor

    def __init__(self, inputs: int, bound: torch.Tensor, mean: torch.Tensor, spread: torch.Tensor) -> None:
        super().__init__()
        self.layers = network((inputs, 512, 256, 128), 2 * len(bound))
        last: Any = self.layers[-1]
        nn.init.normal_(last.weight, std=1e-3)
        nn.init.zeros_(last.bias)
        self.inputs = inputs
        self.register_buffer("bound", bound)
        self.register_buffer("mean", mean)
        self.register_buffer("spread", spread)

    def squashed(self, seen: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the middle and the logarithm of the spread before tanh, from normalised observations."""
        middle, raw = self.layers(seen[:, : self.inputs]).float().chunk(2, -1)
        return middle, LOG_STD[0] + 0.5 * (LOG_STD[1] - LOG_STD[0]) * (torch.tanh(raw) + 1)

    def draw(self, seen: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return actions, the logarithm of their density, mean actions and spread before tanh."""
        middle, log_std = self.squashed(seen)
        noise = torch.randn_like(middle)
        before = middle + log_std.exp() * noise
        density = -0.5 * noise.square() - log_std - 0.5 * math.log(2 * math.pi) - self.bound.log()
        density = density - 2 * (math.log(2) - before - F.softplus(-2 * before))  # log(1 - tanh^2)
        return torch.tanh(before) * self.bound, density.sum(-1), torch.tanh(middle) * self.bound, log_std.exp()

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        n = self.inputs
        seen = ((observation - self.mean[:n]) / self.spread[:n]).clamp(-SEEN_MOST, SEEN_MOST)
        return torch.tanh(self.squashed(seen)[0]) * self.bound


class Learner:
    """Soft actor-critic with a ring of the newest control steps; knows nothing of robots.

    For each control step: act, learn if wanted, step the worlds, remember.

    Args:
        worlds: How many are stepped at once.
        inputs: Width of the actor's observation, which is the beginning of the critic's.
        seen: Width of the critic's.
        bound: Largest action of each kind (actions,), on the device.
        settings: How it learns.
        shown: To how many of the first actions the policy is pulled by examples.
        mirror: Weight of the loss that asks the policy for mirrored actions in mirrored states.
        half: Networks of the updates in bfloat16.
    """

    def __init__(
        self,
        worlds: int,
        inputs: int,
        seen: int,
        bound: torch.Tensor,
        settings: SacSettings,
        *,
        shown: int = 0,
        mirror: float = 0.0,
        half: bool = False,
    ) -> None:
        s, device, actions = settings, bound.device, len(bound)
        self._mirror = mirror
        self.settings, self.device, self._worlds, self._shown, self._half = s, device, worlds, shown, half
        self._seen_mean, self._seen_var = torch.zeros(seen, device=device), torch.ones(seen, device=device)
        self._spread, self._count = torch.ones(seen, device=device), torch.zeros((), device=device)
        self.actor = Actor(inputs, bound, self._seen_mean, self._spread).to(device)
        self.critics = nn.ModuleList(network((seen + actions, 768, 384, 192), s.atoms) for _ in range(2)).to(device)
        self._targets = deepcopy(self.critics).requires_grad_(False)
        self._log_alpha = torch.tensor(math.log(s.temperature), device=device, requires_grad=True)
        self._support = torch.linspace(-s.value_range, s.value_range, s.atoms, device=device)
        on_gpu = device.type == "cuda"
        adam: dict[str, Any] = {"lr": s.learning_rate, "betas": (0.9, 0.95), "capturable": on_gpu, "fused": on_gpu}
        self._actor_steps = torch.optim.AdamW(self.actor.parameters(), weight_decay=s.weight_decay, **adam)
        self._critic_steps = torch.optim.AdamW(self.critics.parameters(), weight_decay=s.weight_decay, **adam)
        self._alpha_steps = torch.optim.AdamW([self._log_alpha], weight_decay=0.0, **adam)
        kept, plain_float = (s.buffer_steps, worlds), {"device": device, "dtype": torch.float32}
        self._ring = {
            "seen": torch.zeros(*kept, seen, device=device, dtype=torch.float16),
            "action": torch.zeros(*kept, actions, **plain_float),
            "reward": torch.zeros(*kept, **plain_float),
            "goes_on": torch.zeros(*kept, **plain_float),  # 0 after a termination
            "known": torch.zeros(*kept, **plain_float),  # 0 where a time-out hid what came next
        }
        if shown:
            self._ring["shown"] = torch.zeros(*kept, 2 * shown, device=device, dtype=torch.float16)
        self._row = torch.zeros(1, dtype=torch.long, device=device)
        self._filled = torch.zeros(1, dtype=torch.long, device=device)
        """Steps before that of _row which are whole."""
        self._now = torch.zeros(worlds, seen, device=device)
        self._shown_now = torch.zeros(worlds, 2 * shown, device=device)
        self._result = torch.zeros(3, worlds, device=device)
        self.shown_weight = torch.zeros((), device=device)
        self.target_entropy = torch.full((), s.target_entropy, device=device)
        self.figures = torch.zeros(5, device=device)
        """Critic loss, entropy of the policy for each action, spread of its actions, mean return that it expects, share
        of its mean actions that are within a tenth of their bound."""
        self._updates = 0
        self._act, self._remember = Guarded(self._one_act, str(device)), Guarded(self._one_step, str(device))
        self._learn_critics = Guarded(self._critic_update, str(device))
        self._learn_policy = Guarded(self._policy_update, str(device))

    @property
    def temperature(self) -> torch.Tensor:
        """Return the weight of the entropy."""
        return self._log_alpha.detach().exp()

    # ------------------------------------------------------------------ one control step

    def act(self, seen: torch.Tensor, shown: torch.Tensor | None = None) -> torch.Tensor:
        """Return actions (worlds, actions) for the critic's observation (worlds, seen)."""
        self._now.copy_(seen)
        if shown is not None:
            self._shown_now.copy_(shown)
        return self._act()

    def remember(self, reward: torch.Tensor, done: torch.Tensor, time_out: torch.Tensor) -> None:
        """Keep what came of the actions (worlds,)."""
        self._result.copy_(torch.stack([reward, 1.0 - (done.bool() & ~time_out).float(), 1.0 - time_out.float()]))
        self._remember()

    def learn(self) -> None:
        """Make the updates of a control step, after ``act``."""
        for _ in range(self.settings.updates):
            self._learn_critics()
            self._updates += 1
            if self._updates % self.settings.policy_delay == 0:
                self._learn_policy()

    def _put(self, name: str, value: torch.Tensor) -> None:
        ring = self._ring[name]
        ring.index_copy_(0, self._row, value[None].to(ring.dtype))

    @torch.no_grad()
    def _one_act(self) -> torch.Tensor:
        now = self._now
        self._count.add_(self._worlds)
        var, mean = torch.var_mean(now, 0, correction=0)
        share, away = self._worlds / self._count, mean - self._seen_mean
        self._seen_mean.add_(share * away)
        self._seen_var.add_(share * (var - self._seen_var + (1 - share) * away.square()))
        self._spread.copy_(self._seen_var.sqrt() + 0.01)
        actions = self.actor.draw(self.normalised(now))[0]
        self._put("seen", now)
        if self._shown:
            self._put("shown", self._shown_now)
        self._put("action", actions)
        return actions

    @torch.no_grad()
    def _one_step(self) -> None:
        for name, value in zip(("reward", "goes_on", "known"), self._result, strict=True):
            self._put(name, value)
        self._row.add_(1).remainder_(self.settings.buffer_steps)
        self._filled.add_(1).clamp_(max=self.settings.buffer_steps - 1)

    # ------------------------------------------------------------------ updates

    def normalised(self, seen: torch.Tensor) -> torch.Tensor:
        """Return the critic's observations, or their first numbers (batch, k), as the networks take them."""
        k = seen.shape[1]
        return ((seen.float() - self._seen_mean[:k]) / self._spread[:k]).clamp(-SEEN_MOST, SEEN_MOST)

    def sample(self) -> dict[str, torch.Tensor]:
        """Return transitions drawn evenly; ``next`` is the critic's observation one step later, not normalised."""
        size, kept = self.settings.batch, self.settings.buffer_steps
        age = 1 + torch.minimum((torch.rand(size, device=self.device) * self._filled).long(), self._filled - 1)
        row, world = self._row - age, torch.randint(self._worlds, (size,), device=self.device)
        here, later = row % kept * self._worlds + world, (row + 1) % kept * self._worlds + world
        found = {name: column.flatten(0, 1).index_select(0, here) for name, column in self._ring.items()}
        return found | {"next": self._ring["seen"].flatten(0, 1).index_select(0, later)}

    def _autocast(self) -> torch.autocast:
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self._half, cache_enabled=False)

    def _logits(self, critics: nn.ModuleList, seen: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        both = torch.cat([seen, actions / self.actor.bound], -1)
        with self._autocast():
            return torch.stack([critic(both) for critic in critics]).float()

    def _drawn(self, seen: torch.Tensor) -> tuple[torch.Tensor, ...]:
        with self._autocast():
            return self.actor.draw(seen)

    @torch.no_grad()
    def target(self, b: dict[str, torch.Tensor], later: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the wanted probabilities (batch, atoms), and the density of the next actions."""
        s = self.settings
        actions, density, *_ = self._drawn(later)
        likely = self._logits(self._targets, later, actions).softmax(-1).mean(0)
        soft = self._support - (self._log_alpha.exp() * density)[:, None]
        returns = (b["reward"][:, None] + s.gamma * b["goes_on"][:, None] * soft).clamp(-s.value_range, s.value_range)
        place = (returns + s.value_range) * ((s.atoms - 1) / (2 * s.value_range))
        below = place.floor().clamp(0, s.atoms - 2)
        share, index = place - below, below.nan_to_num().long()  # a loss that is not finite is seen in the figures
        wanted = torch.zeros_like(likely).scatter_add_(1, index, likely * (1 - share))
        return wanted.scatter_add_(1, index + 1, likely * share), density

    def _critic_update(self) -> None:
        b = self.sample()
        wanted, density = self.target(b, self.normalised(b["next"]))
        found = self._logits(self.critics, self.normalised(b["seen"]), b["action"]).log_softmax(-1)
        cross = -(wanted * found).sum(-1).mean(0)
        loss = (b["known"] * cross).sum() / b["known"].sum().clamp(min=1.0)
        descend(self._critic_steps, 2 * loss)
        lacking = density.mean() + self.target_entropy * len(self.actor.bound)
        descend(self._alpha_steps, -self._log_alpha.exp() * lacking)
        with torch.no_grad():
            for slow, fast in zip(self._targets.parameters(), self.critics.parameters(), strict=True):
                slow.lerp_(fast, self.settings.tau)
            self.figures[0].copy_(loss)

    def _policy_update(self) -> None:
        b = self.sample()
        seen = self.normalised(b["seen"])
        actions, density, mean, spread = self._drawn(seen)
        value = (self._logits(self.critics, seen, actions).softmax(-1) @ self._support).mean(0)
        loss = (self._log_alpha.exp().detach() * density - value).mean()
        if self._shown:
            shown, counts = b["shown"].float().chunk(2, -1)
            loss = loss + self.shown_weight * (counts * (mean[:, : self._shown] - shown).square()).mean()
        if self._mirror:
            image = mirrored_observations(b["seen"][:, : self.actor.inputs].float())
            with self._autocast():
                middle, _ = self.actor.squashed(self.normalised(image))
            there = torch.tanh(middle) * self.actor.bound
            loss = loss + self._mirror * (there - mirrored_actions(mean.detach())).square().mean()
        descend(self._actor_steps, loss)
        with torch.no_grad():
            bound = self.actor.bound
            entropy, used = -density.mean() / len(bound), mean / bound
            width = (spread * bound * (1 - used.square())).mean()  # tanh narrows it near the bound
            at_bound = (used.abs() > 0.9).float().mean()
            self.figures[1:].copy_(torch.stack([entropy, width, value.mean(), at_bound]))


def bounds(contract: PolicyContract, device: str) -> torch.Tensor:
    """Return the largest action of each joint: that which commands the farther end of its range."""
    q, low, high, scale = (
        torch.tensor(v, dtype=torch.float32, device=device)
        for v in (contract.default_q, contract.q_min, contract.q_max, contract.action_scale)
    )
    return (torch.maximum(high - q, q - low) / scale).clamp(max=contract.action_clip)


def export(actor: Actor | Student, env: StandTrackEnv, contract: PolicyContract, path: Path) -> None:
    """Write the policy as ONNX with its contract in the metadata."""
    if not all(bool(torch.isfinite(p).all()) for p in actor.parameters()):
        raise TrainingDiverged("the weights of the policy are not finite")
    export_network(deepcopy(actor), contract, env.description, path)


class Student(nn.Module):
    """A network as PPO has it: observation normalisation, ELU, nothing after the last layer."""

    mean: torch.Tensor
    scale: torch.Tensor

    def __init__(self, actor: Actor, hidden: tuple[int, ...]) -> None:
        super().__init__()
        self.inputs = actor.inputs
        sizes = (actor.inputs, *hidden, len(actor.bound))
        pairs = list(itertools.pairwise(sizes))
        layers = [m for a, b in pairs for m in (nn.Linear(a, b), nn.ELU())][:-1]
        self.layers = nn.Sequential(*layers)
        self.register_buffer("mean", actor.mean[: actor.inputs].clone()[None])
        self.register_buffer("scale", actor.spread[: actor.inputs].clone()[None])

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        return self.layers((observation - self.mean) / self.scale)


def imitate(actor: Actor, env: StandTrackEnv, hidden: tuple[int, ...], minutes: float, every: int) -> Student:
    """Distil the policy into a student on the states that the student's actions lead to (DAgger, Ross et al. 2011)."""
    student = Student(actor, hidden).to(env.device)
    on_gpu = str(env.device).startswith("cuda")
    rate = torch.tensor(STUDENT_RATE[0], device=env.device)
    steps = torch.optim.Adam(student.parameters(), lr=rate, capturable=on_gpu, fused=on_gpu or None)
    seen = torch.zeros(env.num_envs, actor.inputs, device=env.device)
    missed = torch.zeros((), device=env.device)

    def update() -> torch.Tensor:
        with torch.no_grad():
            wanted = actor(seen)
        found = student(seen)
        loss = (found - wanted).square().mean()
        descend(steps, loss)
        missed.copy_(loss.detach())
        return found.detach()

    learn, begin, step = Guarded(update, str(env.device)), time.monotonic(), 0
    while (elapsed := time.monotonic() - begin) < 60 * minutes:
        seen.copy_(env.get_observations()["policy"])
        share = elapsed / (60 * minutes)
        rate.fill_(STUDENT_RATE[0] ** (1 - share) * STUDENT_RATE[1] ** share)
        actions = learn()
        env.step(actions + STUDENT_SPREAD * torch.randn_like(actions))
        step += 1
        if step % every == 0:
            line = f"student {step} elapsed_s={elapsed:.3g} off={math.sqrt(float(missed)):.3g}"
            sys.stderr.write(line + "\n")
    return student


class Progress:
    """Adds up what happened on the device, and prints it."""

    def __init__(self, worlds: int, device: str) -> None:
        self._sums, self._alive = torch.zeros(3, device=device), torch.zeros(worlds, device=device)
        self._logs: list[dict[str, torch.Tensor]] = []
        self._steps, self._since, self._begin = 0, time.monotonic(), time.monotonic()

    def add(self, reward: torch.Tensor, done: torch.Tensor, extras: dict[str, Any]) -> None:
        """Count a control step."""
        self._alive += 1
        self._sums += torch.stack([reward.mean(), (self._alive * done).sum(), done.sum().float()])
        self._alive *= 1 - done
        self._steps += 1
        if "log" in extras:
            self._logs.append(extras["log"])

    def write(self, step: int, learner: Learner) -> None:
        """Print a line; waits for the device.

        Raises:
            TrainingDiverged: If a figure of the learner is not finite.
        """
        loss, entropy, spread, value, at_bound = learner.figures.tolist()
        reward, lived, ended = self._sums.tolist()
        temperature = float(learner.temperature)
        now, worlds = time.monotonic(), len(self._alive)
        row = {
            "elapsed_s": now - self._begin,
            "reward": reward / self._steps,
            "episode": lived / ended if ended else float("nan"),
            "temperature": temperature,
            "critic_loss": loss,
            "value": value,
            "std": spread,
            "entropy": entropy,
            "at_bound": at_bound,
            "M_per_s": self._steps * worlds / 1e6 / (now - self._since),
        }
        if self._logs:
            means = torch.stack([torch.stack([v.float() for v in one.values()]) for one in self._logs]).mean(0).tolist()
            found = dict(zip(self._logs[0], means, strict=True))
            row |= short_names(found)
        figures = " ".join(f"{name}={v:.3g}" for name, v in row.items())
        sys.stderr.write(f"{step} {step * worlds / 1e6:.1f}M {figures}\n")
        sys.stderr.flush()
        self._sums.zero_()
        self._logs.clear()
        self._steps, self._since = 0, now
        if not all(map(math.isfinite, (loss, entropy, spread, value, temperature))):
            raise TrainingDiverged(f"the losses are not finite at control step {step}")


def train(folder: Path, mdp: MdpSettings, learn: LearnSettings, sac: SacSettings, every: int) -> Path:
    """Train a policy and export it.

    Raises:
        TrainingDiverged: If a loss is not finite.
    """
    device = Ranks.of_environment().device(learn.device)
    torch.backends.cuda.matmul.allow_tf32 = True
    folder.mkdir(parents=True, exist_ok=True)
    stored = {"mdp": plain(mdp), "learn": plain(learn), "off_policy": asdict(sac)}
    save_json(stored, folder / "settings.json")
    env = StandTrackEnv(load_description(), mdp, device, learn.seed)
    whole = settings_hash(mdp, learn) + json.dumps(asdict(sac), sort_keys=True)
    contract = replace(env.contract, training=sha256(whole.encode()).hexdigest())
    obs = env.get_observations()
    inputs, seen = obs["policy"].shape[1], obs["critic"].shape[1]
    if not torch.equal(obs["critic"][:, :inputs], obs["policy"]):
        raise SystemExit("the critic's observation does not begin with the actor's, as this trial needs it")
    bound, shown = bounds(contract, device), 6 if learn.reaching else 0
    learner = Learner(mdp.worlds, inputs, seen, bound, sac, shown=shown, mirror=learn.mirror, half=sac.mixed_precision)
    progress, begin, due, step = Progress(mdp.worlds, device), time.monotonic(), sorted(learn.snapshots), 0
    try:
        while (elapsed := time.monotonic() - begin) < 60 * learn.minutes:
            left = 1 - elapsed / (60 * learn.minutes * learn.reaching_share)
            learner.shown_weight.fill_(learn.reaching * max(left, 0.0))
            fallen = min(elapsed / (60 * learn.minutes * ENTROPY_SHARE), 1.0)
            learner.target_entropy.fill_(sac.target_entropy + fallen * (sac.target_entropy_end - sac.target_entropy))
            actions = learner.act(obs["critic"], obs["reaching"].flatten(1) if shown else None)
            if step >= WARM_UP:
                learner.learn()
            obs, reward, done, extras = env.step(actions)
            learner.remember(reward, done, extras["time_outs"])
            progress.add(reward, done, extras)
            step += 1
            if step % every == 0:
                progress.write(step, learner)
            if due and elapsed > 60 * due[0]:
                export(learner.actor, env, contract, folder / f"policy_{due.pop(0):g}min.onnx")
    except KeyboardInterrupt:
        sys.stderr.write(f"stopped by Ctrl-C at control step {step}\n")
    export(learner.actor, env, contract, folder / "policy.onnx")
    if sac.student:
        student = imitate(learner.actor, env, learn.hidden, sac.student, every)
        export(student, env, contract, folder / "student.onnx")
    return folder / "policy.onnx"


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.off_policy",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("--every", type=int, default=200, help="control steps between two lines of figures")
    for f in fields(SacSettings):
        kind: Any = type(f.default)
        option, told = f"--{f.name.replace('_', '-')}", f"default: {f.default:g}"
        parser.add_argument(option, type=kind, default=f.default, help=told)
    parser.add_argument("overrides", nargs="*")
    options = parser.parse_intermixed_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    try:
        mdp, learn = with_overrides(MdpSettings(), LearnSettings(minutes=10.0), options.overrides)
        sac = SacSettings(**{f.name: getattr(options, f.name) for f in fields(SacSettings)})
        path = train(options.out, mdp, learn, sac, options.every)
    except MimicError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    sys.stderr.write(f"wrote {path}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
