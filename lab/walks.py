"""How fast a policy walks when it is asked for a speed: the [walks] table of its .toml.

    python -m lab.walks [POLICY]      # the robot as described, in simulation; 90 s

Each speed is walked for 3 and for 6 s from a stand: the difference of the two distances gives the speed, and what the
longer walk lacks against it the time that is lost to get going.
"""

from __future__ import annotations

import argparse

import numpy as np

from mimic.config.play import RunSettings
from mimic.flows.play import load_policy, play
from mimic.records import CommandTrack
from mimic.robot.description import load_description

SPEEDS = (-0.3, -0.25, -0.2, -0.15, -0.1, 0.1, 0.15, 0.2, 0.25, 0.3)
"""Asked [m/s]."""
WALKS = (3.0, 6.0)
"""Durations of a walk [s]."""
STAND = 2.5
"""Time between two walks [s]; its distance is not counted but for the first 0.6 s, in which a walk ends."""
ENDING = 0.6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("policy", nargs="?", help="ONNX file; default: the shipped one")
    parser.add_argument("--robot-model", default="cyberdog2")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    robot = load_description(options.robot_model)
    policy = load_policy(options.policy, robot)
    walks = [(speed, seconds) for speed in SPEEDS for seconds in WALKS]
    pieces = [piece for speed, seconds in walks for piece in ((0.0, STAND), (speed, seconds))] + [(0.0, STAND)]
    v = np.concatenate([np.full(round(seconds / robot.dt), speed) for speed, seconds in pieces])
    toes = np.tile(np.reshape(policy.contract.neutral_toes, (1, 2, 3)), (len(v), 1, 1))
    commands = CommandTrack(
        t=robot.dt * np.arange(len(v)), v=np.stack([v, 0 * v], axis=1), heading=0 * v, p_BE=toes
    )
    log = play(commands, robot=options.robot_model, policy=policy, settings=RunSettings(seed=options.seed)).log
    at = np.flatnonzero(np.diff(np.abs(log.v_des[:, 0]) > 0, prepend=False, append=False)).reshape(-1, 2)
    ends = np.minimum(at[:, 1] + round(ENDING / robot.dt), len(log.t) - 1)
    gone = (log.p_WB[ends, 0] - log.p_WB[at[:, 0], 0]).reshape(len(SPEEDS), 2)
    walked = (gone[:, 1] - gone[:, 0]) / (WALKS[1] - WALKS[0])
    lost = WALKS[1] - gone[:, 1] / walked
    print("asked  =", list(SPEEDS))
    print("walked =", walked.round(3).tolist())
    print("lost   =", lost.round(2).tolist())
    print("gone   =", gone.round(3).tolist())


if __name__ == "__main__":
    main()
