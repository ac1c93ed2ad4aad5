"""Error of the training physics against a converged solver during the stand-up, for several iteration limits; on a CPU.

    python -m lab.hidden_effects.solver_accuracy [policies/stand_track.onnx]

The same random robots from the same lying starts get the actions of the policy in the reference. The error is the
largest difference of a joint position in each world.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch

from mimic.config.training import MdpSettings
from mimic.policy.runtime import Policy
from mimic.robot.description import load_description
from mimic.train.stand_track import StandTrackEnv

WORLDS, STEPS = 32, 30
FULL = {"solver_iterations": 100, "linesearch_iterations": 50}
LIMITS: list[dict[str, Any]] = [
    {"solver_iterations": 3, "linesearch_iterations": 6},
    {"solver_iterations": 4, "linesearch_iterations": 6},
    {"solver_iterations": 5, "linesearch_iterations": 6},
    {"solver_iterations": 5, "linesearch_iterations": 4},
    {"solver_iterations": 7, "linesearch_iterations": 6},
    {"solver_iterations": 10, "linesearch_iterations": 6},
]


def play(
    policy: Policy, actions: list[np.ndarray] | None, **changes: Any
) -> tuple[np.ndarray, list[np.ndarray], float]:
    """Return joint positions (steps, worlds, 12) [rad], the actions, and the share of worlds at the iteration limit.

    Args:
        policy: Acts where no actions are given.
        actions: For each step, those of all worlds.
        changes: Settings of the physics.
    """
    settings = MdpSettings(worlds=WORLDS, upright_share=0.0, noise_q=0.0, noise_axes=0.0, **changes)
    env = StandTrackEnv(load_description(), settings, "cpu", 0)
    env.episode_length_buf.zero_()
    seen, taken, positions, at_limit = env.get_observations(), [], [], []
    for step in range(STEPS):
        if actions is None:
            taken.append(np.stack([policy.act(row) for row in seen["policy"].numpy().astype(np.float64)]))
        else:
            taken.append(actions[step])
        seen, *_ = env.step(torch.as_tensor(taken[-1], dtype=torch.float32))
        positions.append(env.worlds.qpos[:, 7:].numpy().copy())
        at_limit.append((env.worlds.data.solver_niter.numpy() >= settings.solver_iterations).mean())
    return np.array(positions), taken, float(np.mean(at_limit))


def main() -> None:
    path = Path(sys.argv[1] if len(sys.argv) > 1 else "policies/stand_track.onnx")
    policy = Policy(path, load_description())
    reference, actions, _ = play(policy, None, **FULL)
    for limit in LIMITS:
        found, _, at_limit = play(policy, actions, **limit)
        away = np.abs(found - reference).max(-1)
        early, late = away[STEPS // 2 - 1], away[-1]
        print(
            f"{limit}: at the limit {at_limit:.2%}; after 0.3 s 90 % within {np.quantile(early, 0.9):.1e} rad, largest "
            f"{early.max():.1e}; after 0.6 s {np.quantile(late, 0.9):.1e}, {late.max():.1e}",
            flush=True,
        )


if __name__ == "__main__":
    main()
