"""Front-toe goals for training and evaluation: drawn in the description's boxes, kept where both legs can go.

A goal pair is kept when each toe has a joint solution inside the limits with a margin, and when shanks and toes stay
clear of each other, of the trunk and of the head.
"""

from __future__ import annotations

import numpy as np

from mimic.records import FloatArray
from mimic.robot.description import RobotDescription
from mimic.robot.leg_kinematics import front_legs, front_postures, front_toes

MARGIN = float(np.deg2rad(5.0))
"""Distance kept from every joint limit [rad]; the paper ends an episode there."""

CLEARANCE = 0.011
"""Distance kept between the surface of a toe and anything else [m]."""


def leg_joints(p_BE: FloatArray, description: RobotDescription) -> tuple[FloatArray, FloatArray]:
    """Return joint positions that bring the front toes to p_BE, by the closed form of a leg.

    Args:
        p_BE: Base -> front toe (..., 2, 3) [m].

    Returns:
        Joint positions (..., 2, 3) [rad], and how far each leg is from a solution (..., 2): 0 where all joints lie
        inside their limits with the margin, otherwise the worst excess [rad]; infinite where out of reach.
    """
    q = front_postures(p_BE, description)
    low = (description.q_min[:6] + MARGIN).reshape(2, 1, 3)
    high = (description.q_max[:6] - MARGIN).reshape(2, 1, 3)
    beyond = np.maximum(low - q, q - high).max(-1)
    excess = np.where(np.isnan(beyond), np.inf, np.maximum(beyond, 0.0))
    second = excess[..., 1] < excess[..., 0]
    return np.where(second[..., None], q[..., 1, :], q[..., 0, :]), excess.min(-1)


def clear_of_body(p_BE: FloatArray, q: FloatArray, description: RobotDescription) -> np.ndarray:
    """Return whether toes and shanks of a pair (..., 2, 3) keep their distance from each other, trunk and head."""
    away = description.toe_radius + CLEARANCE
    ok = np.ones(p_BE.shape[:-2], dtype=bool)
    for box in (description.trunk, *description.head):
        gap = np.maximum(np.abs(p_BE - box.centre) - box.size / 2, 0.0)
        ok &= (np.linalg.norm(gap, axis=-1) > away).all(axis=-1)
    knees = np.stack([leg.knee(q[..., i, :]) for i, leg in enumerate(front_legs(description))], axis=-2)
    for a in np.linspace(0, 1, 5):
        left = (1 - a) * knees[..., 0, :] + a * p_BE[..., 0, :]
        for b in np.linspace(0, 1, 5):
            right = (1 - b) * knees[..., 1, :] + b * p_BE[..., 1, :]
            ok &= np.linalg.norm(left - right, axis=-1) > 2 * away
    return ok


def draw_goals(
    description: RobotDescription, count: int, rng: np.random.Generator, *, anywhere: float = 0.0
) -> FloatArray:
    """Return ``count`` reachable goal pairs (count, 2, 3), base -> front toe [m].

    Args:
        anywhere: Share drawn over all joint positions of the front legs instead of in the description's boxes.
    """
    goals = description.goals
    kept: list[FloatArray] = []
    wanted_anywhere = round(count * anywhere)
    for everywhere, wanted in ((True, wanted_anywhere), (False, count - wanted_anywhere)):
        have: list[FloatArray] = []
        while sum(len(h) for h in have) < wanted:
            n = 4 * wanted + 64
            if everywhere:
                q = rng.uniform(description.q_min + MARGIN, description.q_max - MARGIN, (n, 12))
                p = front_toes(q, description)
            else:
                box = rng.choice(len(goals.share), size=(n, 2), p=goals.share)
                p = rng.uniform(goals.low[box], goals.high[box])
                p[:, 1, 1] *= -1
            joints, excess = leg_joints(p, description)
            ok = (excess == 0).all(axis=-1)
            ok[ok] &= clear_of_body(p[ok], joints[ok], description)
            have.append(p[ok])
        kept.append(np.concatenate(have)[:wanted] if have else np.empty((0, 2, 3)))
    pairs = np.concatenate(kept)
    return pairs[rng.permutation(len(pairs))]
