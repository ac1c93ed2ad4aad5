"""The logger of rsl_rl for one process or several (torchrun), and what all processes agree on."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from typing import Any

import torch
from rsl_rl.runners import OnPolicyRunner
from rsl_rl.utils.logger import Logger

from mimic.errors import ConfigError, MimicError

Report = Callable[[int, dict[str, float]], None]
"""Called after each update with its number and the figures of the run."""


class TrainingDiverged(MimicError):
    """A loss is not finite; the last checkpoint is whole."""


class TimeIsUp(Exception):
    """The time is over."""


def rank() -> int:
    """Return which process of a training (torchrun) this is; the first one, 0, writes."""
    return int(os.environ.get("RANK", 0))


def processes() -> int:
    """Return how many processes of a training there are."""
    return int(os.environ.get("WORLD_SIZE", 1))


def own_device(wanted: str) -> str:
    """Return the device of this process; each of several has the GPU of its number on this machine.

    Raises:
        ConfigError: If it is not there.
    """
    device = wanted if wanted != "auto" else ("cuda" if torch.cuda.is_available() else "cpu")
    if not device.startswith(("cpu", "cuda")):
        raise ConfigError(f"device is {device!r}; expected auto, cpu, cuda or one GPU, such as cuda:1")
    if device.startswith("cuda") and not torch.cuda.is_available():
        raise ConfigError(f"device is {device}, but PyTorch sees no GPU; add --set device=cpu, or install a CUDA build")
    if processes() == 1 or not device.startswith("cuda"):
        return device
    local = int(os.environ["LOCAL_RANK"])
    if local >= torch.cuda.device_count():
        raise ConfigError(
            f"process {local} of this machine has no GPU of its own, there are {torch.cuda.device_count()}; "
            "start as many processes as there are GPUs"
        )
    torch.cuda.set_device(local)
    return f"cuda:{local}"


class ResumableRunner(OnPolicyRunner):
    """rsl_rl's runner, whose checkpoints say how far the training has come."""

    told: Callable[[], dict[str, Any]] = dict
    """Returns what else a checkpoint says."""

    def save(self, path: str, infos: dict[str, Any] | None = None) -> None:
        """Write a checkpoint."""
        assert isinstance(self.logger, QuietLogger)
        more = {"updates": self.current_learning_iteration + 1, "elapsed_s": self.logger.elapsed, **self.told()}
        super().save(path, (infos or {}) | more)


class QuietLogger(Logger):
    """rsl_rl's logger without its console table and without waiting for the device at each step.

    Every process of a training has one; only the first writes, but all stop together.
    """

    def attach(
        self, report: Report | None, seconds: float, session: float, before: float, progressed: Callable[[float], None]
    ) -> None:
        """Say what to call, how long training and session may last, and how long the training has lasted [s]."""
        self._report = report
        self._progressed = progressed
        self._begin = time.monotonic() - before
        self._seconds = seconds
        self._last = min(seconds, before + session)
        self._ended = torch.zeros(3, device=self.device)

    @property
    def elapsed(self) -> float:
        """Time of the training by now [s]."""
        return time.monotonic() - self._begin

    def _store_code_state(self) -> list[str]:
        return []  # the settings and their hash are stored; a copy of the user's git state is not asked for

    def process_env_step(self, rewards: Any, dones: Any, extras: Any, intrinsic_rewards: Any = None) -> None:
        """Add up what has ended."""
        if self.writer is None:
            return
        if "log" in extras:
            self.ep_extras.append(extras["log"])
        self.cur_reward_sum += rewards
        self.cur_episode_length += 1
        done = dones > 0
        sums = torch.stack([self.cur_reward_sum, self.cur_episode_length, torch.ones_like(self.cur_reward_sum)])
        self._ended += (sums * done).sum(-1)
        self.cur_reward_sum *= ~done
        self.cur_episode_length *= ~done

    def log(self, it: int, **figures: Any) -> None:  # pyrefly: ignore[bad-override]
        """Write the figures of an update; stop the training when it is over.

        Raises:
            TrainingDiverged: In every process, if a loss is not finite in one.
            TimeIsUp: In every process, if the time is over in one.
        """
        losses = figures["loss_dict"]
        elapsed = self.elapsed
        broken = not all(math.isfinite(v) for v in losses.values())
        share = max((it + 1) / figures["total_it"], elapsed / self._seconds)
        broken, over, share = self._agreed(broken, elapsed > self._last, share)
        if broken:
            raise TrainingDiverged(
                f"the losses of update {it} are not finite (here {losses}); resume from the last checkpoint"
            )
        if self.writer is not None:
            self._write(it, elapsed, figures)
        self._progressed(share)
        if over:
            raise TimeIsUp

    def _agreed(self, *values: float) -> list[float]:
        """Return the largest of each value over all processes."""
        if not torch.distributed.is_initialized():
            return list(values)
        tensor = torch.tensor(values, dtype=torch.float64, device=self.device)
        torch.distributed.all_reduce(tensor, op=torch.distributed.ReduceOp.MAX)
        return tensor.tolist()

    def _write(self, it: int, elapsed: float, figures: dict[str, Any]) -> None:
        rewards, lengths, count = self._ended.tolist()
        self._ended.zero_()
        self.tot_timesteps += self.cfg["num_steps_per_env"] * self.num_envs * self.gpu_world_size
        row = {f"loss/{name}": value for name, value in figures["loss_dict"].items()}
        for extras in self.ep_extras:  # one wait for the device instead of one a figure
            row |= dict(zip(extras, torch.stack([v.float() for v in extras.values()]).tolist(), strict=True))
        self.ep_extras.clear()
        row |= {
            "reward": rewards / count if count else math.nan,
            "episode": lengths / count if count else math.nan,
            "std": float(figures["action_std"].detach().mean()),
            "learning_rate": figures["learning_rate"],
            "collect_s": figures["collect_time"],
            "learn_s": figures["learn_time"],
            "steps": self.tot_timesteps,
            "elapsed_s": elapsed,
        }
        for name, value in row.items():
            self.writer.add_scalar(name, value, it)  # type: ignore[union-attr]
        if self._report is not None:
            self._report(it, row)
