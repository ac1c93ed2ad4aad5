"""Extremes of healthy robots: the measurements behind [safety] in robot.toml.

python -m lab.policies.safety_envelope [episodes [robot]]

Robots of the paper's Table II stand up, follow random commands, and sit down, in plain MuJoCo. The IMU is read as an
MTi gives it: quaternion in steps of 1/32767, rate of turn in steps of 2^-9 rad/s. Episodes in which the robot was about
to fall, or did not end lying, are left out: they are what the limits should stop.
"""

from __future__ import annotations

import sys
from functools import partial
from typing import Any

import numpy as np

from mimic.config.play import NOMINAL, EffectsSettings, Randomisation, RunSettings
from mimic.control.loop import run_policy
from mimic.control.plant import damping_command
from mimic.evaluation.episode import Job
from mimic.evaluation.sit_down import final_pose, lies, play_policy_switch
from mimic.geometry import rotation_from_quat
from mimic.jobs.local import run_all
from mimic.metrics import uprightness
from mimic.policy.runtime import cached_policy, find_policy
from mimic.records import PHASES, CommandTrack, RunLog
from mimic.robot.description import load_description
from mimic.robot.leg_kinematics import all_toes
from mimic.simulation.plant import SimulatedPlant

KD_MOST = 5.0
"""What a motor takes [N m s/rad]."""


def as_read(log: RunLog) -> tuple[np.ndarray, np.ndarray]:
    """Return quaternion and rate of turn as an MTi sends them."""
    return np.round(log.quat_WB * 32767) / 32767, np.round(log.omega_B * 512) / 512


def turning_mismatch(quat: np.ndarray, omega: np.ndarray, dt: float) -> np.ndarray:
    """Return by how much orientation and rate of turn disagree from a tick to the next [rad]."""
    R = rotation_from_quat(quat)
    change = np.swapaxes(R[:-1], 1, 2) @ R[1:]
    turned = 0.5 * np.stack(
        [change[:, 2, 1] - change[:, 1, 2], change[:, 0, 2] - change[:, 2, 0], change[:, 1, 0] - change[:, 0, 1]], -1
    )
    return np.linalg.norm(turned - 0.5 * dt * (omega[:-1] + omega[1:]), axis=-1)


def longest_repeat(quat: np.ndarray, omega: np.ndarray) -> int:
    """Return the most samples in a row that equal the one before."""
    longest = now = 0
    for same in np.all(np.diff(quat, axis=0) == 0, axis=1) & np.all(np.diff(omega, axis=0) == 0, axis=1):
        now = now + 1 if same else 0
        longest = max(longest, now)
    return longest


def figures(seed: int, robot: str, tracker: str, sit_down: str) -> dict[str, Any] | None:
    description = load_description(robot)
    settings = EffectsSettings(robot_model=robot)
    job = Job(seed=seed, seconds=10.0, ranges=Randomisation(), robot=settings)
    result, _ = play_policy_switch(job, cached_policy(tracker, robot), cached_policy(sit_down, robot))
    if result.fell_at is not None or not lies(final_pose(result.log, description)):
        return None
    log = result.log
    quat, omega = as_read(log)
    R = rotation_from_quat(quat)
    toes = np.einsum("tij,tlj->tli", R, all_toes(log.q, description))[:, :, 2]
    found: dict[str, Any] = {}
    phase = np.array([PHASES[i] for i in log.phase])
    mismatch = np.concatenate([[0.0], turning_mismatch(quat, omega, description.dt)])
    stands = np.isin(phase, ("blend", "track", "hold"))
    upright = uprightness(quat, description)
    apart = np.abs(toes[:, 2] - toes[:, 3])
    for name, rows in (("stand_up", phase == "stand_up"), ("upright", stands), ("sit_down", phase == "sit_down")):
        found[name] = {
            "side_tilt_max": float(np.abs(R[rows, 2, 1]).max()),
            "back_min": float(R[rows, 2, 2].min()),
            "upright_min": float(upright[rows].min()),
            "hind_toes_apart_max": float(apart[rows].max()),
            "hind_toes_apart_three_ticks": float(
                np.minimum.reduce([apart[rows][k : k - 2 or None] for k in range(3)]).max()
            ),
            "lowest_toe_front": float((toes[rows][:, :2].min(1) - toes[rows][:, 2:].min(1)).min()),
            "mismatch_max": float(mismatch[rows].max()),
            "longest_repeat": longest_repeat(quat[rows], omega[rows]),
            "rate_max": float(np.abs(omega[rows]).max()),
            "dq_max": float(np.abs(log.dq[rows]).max()),
            "q_step_max": float(np.abs(np.diff(log.q[rows], axis=0)).max()),
            "q_outside_max": float(np.maximum(log.q[rows] - description.q_max, description.q_min - log.q[rows]).max()),
        }
    return found


def seconds_to_rest(description, tracker: str) -> float:
    """Return how long an upright robot that is only damped takes to come to rest."""
    policy = cached_policy(tracker, description.name)
    neutral = np.array(policy.contract.neutral_toes).reshape(1, 2, 3)
    plant = SimulatedPlant(description, ranges=NOMINAL)
    track = CommandTrack(t=np.zeros(1), v=np.zeros((1, 2)), heading=np.zeros(1), p_BE=neutral)
    run_policy(plant, policy, track, RunSettings(hold_last=0.0))
    state, moved = plant._state(), 0.0
    for tick in range(500):
        state = plant.step(damping_command(state.q, KD_MOST)).state
        if np.abs(state.dq).max() > 0.1:
            moved = (tick + 1) * description.dt
    return moved


def main() -> None:
    episodes = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    robot = sys.argv[2] if len(sys.argv) > 2 else "cyberdog2"
    tracker, sit_down = (str(find_policy(name, robot)) for name in ("stand_track", "sit_down"))
    rows = run_all(partial(figures, robot=robot, tracker=tracker, sit_down=sit_down), range(1, episodes + 1), workers=1)
    kept = [r for r in rows if r is not None]
    print(f"{len(kept)} of {episodes} episodes count")
    for phase in ("stand_up", "upright", "sit_down"):
        print(phase)
        for name in kept[0][phase]:
            values = np.array([r[phase][name] for r in kept])
            print(f"  {name:22s} min {values.min():8.4f}  median {np.median(values):8.4f}  max {values.max():8.4f}")
    print(f"damped upright robot at rest after {seconds_to_rest(load_description(robot), tracker):.2f} s")


if __name__ == "__main__":
    main()
