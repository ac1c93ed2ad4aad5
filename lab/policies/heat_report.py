"""Time until the hottest motor reaches its limit, while standing and while playing a video.

python -m lab.policies.heat_report policies/stand_track.onnx [examples/videos/boxing.mp4]

Nominal robot in plain MuJoCo; the motion is repeated for ever, without the stand-up.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from mimic.cli.console import ConsoleReporter
from mimic.config.play import RunSettings
from mimic.dynamics.thermal import seconds_to_limit
from mimic.evaluation.episode import play_episode
from mimic.flows.motion import InputSettings, load_motion
from mimic.policy.runtime import Policy, load_policy
from mimic.records import JOINTS, CommandTrack, FloatArray
from mimic.retargeting.commands import command_track
from mimic.robot.description import load_description
from mimic.simulation.plant import SimulatedPlant

SECONDS = 20.0
"""How long it stands [s]."""


def standing(policy: Policy, dt: float) -> CommandTrack:
    """Return commands that ask for nothing but neutral toes."""
    ticks = round(SECONDS / dt)
    neutral = np.array(policy.contract.neutral_toes).reshape(1, 2, 3)
    still = np.zeros((ticks, 2))
    return CommandTrack(t=np.arange(ticks) * dt, v=still, heading=still[:, 0], p_BE=np.repeat(neutral, ticks, axis=0))


def torques(policy: Policy, track: CommandTrack) -> FloatArray:
    """Return the torques from blend to hold (ticks, 12) [N m]."""
    result = play_episode(SimulatedPlant(load_description(), samples=False), policy, track, RunSettings())
    assert result.fell_at is None, "the robot fell"
    return result.log.tau[result.log.aimed]


def main() -> None:
    """Print the four motors that warm most, for each thing that is played."""
    description = load_description()
    policy = load_policy(sys.argv[1], description)
    played = {f"standing, {SECONDS:g} s": standing(policy, description.dt)}
    for video in sys.argv[2:]:
        targets = load_motion(Path(video), InputSettings(), reporter=ConsoleReporter()).targets
        assert targets is not None
        played[Path(video).stem] = command_track(targets)
    print("| played | minutes to the limit | motors that warm most, N m rms: minutes |\n|---|---|---|")
    for name, track in played.items():
        tau = torques(policy, track)
        minutes = seconds_to_limit(tau, description.dt, description) / 60
        rms = np.sqrt(np.mean(tau**2, axis=0))
        order = np.argsort(-rms)[:4]
        motors = ", ".join(f"{JOINTS[i]} {rms[i]:.1f}: {minutes[i]:.0f}" for i in order)
        print(f"| {name} | {minutes.min():.0f} | {motors.replace('inf', 'never')} |")


if __name__ == "__main__":
    main()
