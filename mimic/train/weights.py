"""Weights of the reward terms, as they change while a policy is trained."""

from __future__ import annotations

from dataclasses import asdict

from mimic.config.rewards import REFINING_TERMS, REGULARISERS, RESTING_TERMS
from mimic.config.training import MdpSettings

REWARD_SCALE = 0.008
"""Factor on all rewards. Returns are then of the order of ten, which the critic can follow. Unscaled they were 300,
with PPO's limit of 0.2 on the change of a value in an update, and the critic was wrong by 20 to 27 throughout."""

REGULARISATION = 2.0
"""Factor on the weights of REGULARISERS at the end of their ramp."""

RAMP_STEPS = 12_000
"""Control steps of a world in which that factor grows from 1."""

REFINING_SHARE = 0.05
"""Share of their weight that the REFINING_TERMS have at first; it grows to 1."""

SIT_DOWN = {
    "height": 1.6,
    "level": 0.8,
    "roll": -1.0,
    "pose": 2.0,
    "pose_fine": 1.0,
    "still": 0.6,
    "sinking": -15.0,  # per m^2/s^2
    "fast": -2.0,  # per m^2/s^2
    "tumbling": -0.05,  # per rad^2/s^2
    "jolt": -2.0,  # per 20 m/s^2
    "landing": -5.0,  # per m^2/s^2
    "trunk": -1.0,  # per m/s, and 0.3 for the touch
    "thighs": -0.2,  # each
    "head_low": -4.0,
    "slip": -0.25,  # per m/s
    "beyond": -1.0,  # per rad^2
    "elbows": -10.0,  # per rad^2
    "action_rate": -0.008,  # per (unit of action)^2
    "torque": -0.03,  # each as a share of its motor's largest
    "joint_velocity": -4e-4,  # per rad^2/s^2
    "joint_speed": -0.02,  # per rad/s
    "joint_acceleration": -1e-7,  # per rad^2/s^4
    "limits": -2.0,  # per rad
    "fail": -10.0,
}
"""Weight of each reward term of sitting down; one without a unit lies between 0 and 1."""


def passed(steps: float, between: tuple[float, float]) -> float:
    """Return the share of the time between two numbers of control steps that has passed."""
    begin, end = between
    return min(max((steps - begin) / (end - begin), 0.0), 1.0)


def weights_at(settings: MdpSettings, steps: int, ramp: float) -> dict[str, float]:
    """Return the weight of each reward term after some control steps of a world.

    Args:
        settings: Of the training.
        steps: Control steps that each world has made.
        ramp: How far the REFINING_TERMS have grown, 0 to 1, as the robot learns to stand.
    """
    regularised = 1 + (REGULARISATION - 1) * min(1.0, steps / RAMP_STEPS)
    own = SIT_DOWN if settings.task == "sit_down" else asdict(settings.rewards)
    weights = {name: weight * (regularised if name in REGULARISERS else 1.0) for name, weight in own.items()}
    if settings.task == "sit_down":
        return weights
    factors = dict.fromkeys(REFINING_TERMS, REFINING_SHARE + (1 - REFINING_SHARE) * ramp)
    factors |= dict.fromkeys(RESTING_TERMS, passed(steps, settings.rest_steps))
    finished = passed(steps, settings.finish_steps)
    for name, factor in asdict(settings.finish).items():
        factors[name] = factors.get(name, 1.0) * (1 + (factor - 1) * finished)
    return {name: weight * factors.get(name, 1.0) for name, weight in weights.items()}


def weight_table(settings: MdpSettings) -> dict[int, dict[str, float]]:
    """Return what a unit of each term adds to the reward, at each control step where a ramp begins or ends.

    A robot that learns to stand early has the REFINING_TERMS grown earlier; the table has the latest time.
    """
    latest = (settings.curriculum_latest, settings.curriculum_latest + settings.curriculum_steps)
    ends = {0, RAMP_STEPS}
    if settings.task == "stand_track":
        ends |= {round(step) for step in (*latest, *settings.finish_steps, *settings.rest_steps)}
    table = {}
    for step in sorted(end for end in ends if end >= 0):
        weights = weights_at(settings, step, passed(step, latest))
        table[step] = {name: REWARD_SCALE * weight for name, weight in weights.items()}
    return table
