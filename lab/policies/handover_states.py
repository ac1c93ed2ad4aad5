"""States at which the policy may switch to sitting down, recorded in plain MuJoCo: the starts of that training.

python -m lab.policies.handover_states policies/stand_track.onnx --write policies/handovers.npz

Three kinds of rows: while standing, walking and turning; while standing up; and while falling after a hard push.
"""

from __future__ import annotations

import argparse
import dataclasses
from functools import partial
from pathlib import Path

import numpy as np

from mimic.config.training import TRAINING_RANDOMISATION
from mimic.evaluation.episode import OF_EPISODES, play_episode
from mimic.evaluation.policy import TIMING, command_script
from mimic.geometry import up_cosine
from mimic.io.store import written_whole
from mimic.jobs.local import run_all
from mimic.policy.runtime import cached_policy
from mimic.records import RunLog
from mimic.robot.description import load_description
from mimic.simulation.plant import SimulatedPlant

SECONDS = 10.0
"""Length of an episode [s]."""

HARD_PUSH = dataclasses.replace(TRAINING_RANDOMISATION, push=(0.5, 1.3), push_interval=3.0)
"""Pushes that most robots do not survive [m/s]."""

HOPELESS_COSINE = 0.35
"""Cosine between base x and up, below which no policy can recover."""


def rows_of(log: RunLog) -> np.ndarray:
    """Return qpos (19), qvel (18) and the command in effect (12) at each tick, the base at the origin."""
    at_origin = np.concatenate([np.zeros((len(log.t), 2)), log.p_WB[:, 2:]], axis=1)
    before = np.concatenate([log.q[:1], log.q_sent[:-1]])
    return np.concatenate([at_origin, log.quat_WB, log.q, log.v_WB, log.omega_B, log.dq, before], axis=1)


def play(seed: int, policy: str, robot: str) -> dict[str, np.ndarray]:
    """Return the rows of one episode; of three seeds one is pushed hard."""
    description = load_description(robot)
    pushed = seed % 3 == 0
    rng = np.random.default_rng([seed, 83])
    track = command_script(description, SECONDS - TIMING.stand_up - TIMING.blend, rng)
    ranges = HARD_PUSH if pushed else TRAINING_RANDOMISATION
    plant = SimulatedPlant(description, ranges=ranges, seed=100_000 + seed, **OF_EPISODES)
    log = play_episode(plant, cached_policy(policy, robot), track, TIMING).log
    rows, up = rows_of(log), up_cosine(*log.quat_WB.T)
    since = (log.t - HARD_PUSH.push_interval) % HARD_PUSH.push_interval
    falling = pushed & (log.t > HARD_PUSH.push_interval) & (since < 0.8) & (up < 0.95) & (up > HOPELESS_COSINE)
    rising = (log.t < 0.8) & (log.t > 0.04)
    steady = (log.t > 1.0) & (not pushed) & (up > 0.8)
    return {
        "steady": rng.permutation(rows[steady])[:12],
        "rising": rng.permutation(rows[rising])[:2],
        "falling": rng.permutation(rows[falling])[:8],
    }


def main() -> None:
    """Collect and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("policy", type=Path)
    parser.add_argument("--robot", default="cyberdog2")
    parser.add_argument("--episodes", type=int, default=450)
    parser.add_argument("--write", type=Path, required=True)
    options = parser.parse_args()
    found = run_all(partial(play, policy=str(options.policy), robot=options.robot), range(options.episodes))
    kinds = {kind: np.concatenate([rows[kind] for rows in found]) for kind in found[0]}
    with written_whole(options.write) as part:
        np.savez_compressed(part, **{kind: rows.astype(np.float16) for kind, rows in kinds.items()})
    sizes = ", ".join(f"{len(rows)} {kind}" for kind, rows in kinds.items())
    print(f"wrote {options.write}: {sizes}, {options.write.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
