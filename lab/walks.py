"""How fast a policy walks when it is asked for a speed: the [walks] table of its .toml.

    python -m lab.walks [POLICY]      # the robot as described, in simulation; two minutes

Each speed is walked for 3 and for 6 s, each time from where a run begins: the difference of the distances gives the
speed, and what the longer walk lacks against it the time that is lost to get going. Last, what a walk loses that
follows one in the other direction.
"""

from __future__ import annotations

import argparse

import numpy as np

from mimic.config.play import RunSettings
from mimic.control.desired import TRACK
from mimic.flows.play import load_policy, play
from mimic.policy.runtime import Policy
from mimic.records import CommandTrack
from mimic.robot.reach import Reach

SPEEDS = (-0.3, -0.25, -0.2, -0.15, -0.1, 0.1, 0.15, 0.2, 0.25, 0.3)
"""Asked [m/s]."""
WALKS = (3.0, 6.0)
"""Durations of a walk [s]."""
TURNED = ((0.2, 3.5), (-0.25, 5.0))
"""Walks that follow each other [m/s, s]: about those of "forward and back"."""
ENDING = 0.6
"""How long a walk goes on after its command [s]."""


def gone(policy: Policy, pieces: list[tuple[float, float]], seed: int) -> np.ndarray:
    """Return how far it has come at the end of each piece of speed [m/s] and duration [s]."""
    robot = policy.description
    q = robot.poses["upright"][:6]
    v = np.concatenate([np.full(round(seconds / robot.dt), speed) for speed, seconds in [*pieces, (0.0, ENDING)]])
    toes = np.tile(Reach(robot).toes(q), (len(v), 1, 1))
    track = CommandTrack(t=robot.dt * np.arange(len(v)), v=np.stack([v, 0 * v], axis=1), heading=0 * v, p_BE=toes)
    log = play(track, robot=robot.name, policy=policy, settings=RunSettings(seed=seed)).log
    start = int(np.flatnonzero(log.phase == TRACK)[0])
    ends = start + np.cumsum([round(seconds / robot.dt) for _, seconds in pieces])
    ends[-1] += round(ENDING / robot.dt) - 1
    return log.p_WB[ends, 0] - log.p_WB[start, 0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("policy", nargs="?", help="ONNX file; default: the shipped one")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    policy = load_policy(options.policy)
    far = np.array([[gone(policy, [(v, t)], options.seed)[0] for t in WALKS] for v in SPEEDS])
    walked = (far[:, 1] - far[:, 0]) / (WALKS[1] - WALKS[0])
    print("asked =", list(SPEEDS))
    print("walked =", walked.round(3).tolist())
    print("lost =", (WALKS[1] - far[:, 1] / walked).round(2).tolist())
    there = np.diff(gone(policy, list(TURNED) * 4, options.seed))[:-1]
    back_after_forward, forward_after_back = there[0::2], there[1::2]
    lost = []
    for (asked, seconds), distances in zip(TURNED[::-1], (back_after_forward, forward_after_back), strict=True):
        lost.append(seconds - float(np.mean(distances)) / float(np.interp(asked, SPEEDS, walked)))
    print("reversed =", np.round(lost, 2).tolist())


if __name__ == "__main__":
    main()
