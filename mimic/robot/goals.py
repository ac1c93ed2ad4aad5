"""Front-toe goals for training and evaluation: drawn in the description's boxes, kept where both legs can go.

A goal pair is kept when each toe has a joint solution inside the limits with a margin, and when shanks and toes stay
clear of each other, of the trunk and of the head.
"""

from __future__ import annotations

import numpy as np

from mimic.robot.description import RobotDescription
from mimic.robot.model import front_toes
from mimic.types import FloatArray

MARGIN = np.deg2rad(5.0)
"""Distance kept from every joint limit [rad]; the paper ends an episode there."""

CLEARANCE = 0.03
"""Distance kept between a toe's centre and anything else [m]: its radius 0.019 and a centimetre."""


def leg_joints(p_BE: FloatArray, description: RobotDescription) -> tuple[FloatArray, FloatArray]:
    """Return joint positions that bring the front toes to p_BE, by the closed form of a leg.

    Args:
        p_BE: Base -> front toe (..., 2, 3) [m].

    Returns:
        Joint positions (..., 2, 3) [rad], and how far each leg is from a solution (..., 2): 0 where all joints lie
        inside their limits with the margin, otherwise the worst excess [rad]; infinite where out of reach.
    """
    raw = description.raw
    sides = np.array([1.0, -1.0])
    ax, ay, az = raw["abad"]["origin"]
    hy = sides * raw["hip"]["origin"][1]
    x = p_BE[..., 0] - ax
    y = p_BE[..., 1] - sides * ay
    z = p_BE[..., 2] - az
    tx, _, tz = raw["toe"]["position"]
    upper, lower, bend = raw["hip"]["length"], np.hypot(tx, tz), np.arctan2(tx, -tz)
    best_q = np.full((*p_BE.shape[:-1], 3), np.nan)
    best = np.full(p_BE.shape[:-1], np.inf)
    limits = [slice(3 * i, 3 * i + 3) for i in range(2)]
    low = np.stack([description.q_min[s] for s in limits]) + MARGIN
    high = np.stack([description.q_max[s] for s in limits]) - MARGIN
    with np.errstate(invalid="ignore"):
        for sign in (-1.0, 1.0):
            depth = sign * np.sqrt(y**2 + z**2 - hy**2)
            abad = np.arctan2(z, y) - np.arctan2(depth, hy)
            abad = (abad + np.pi) % (2 * np.pi) - np.pi
            cosine = (x**2 + depth**2 - upper**2 - lower**2) / (2 * upper * lower)
            knee = -np.arccos(cosine) + bend
            # toe = upper (-sin hip, -cos hip) + lower (-sin(hip + k), -cos(hip + k)) with k the knee's bend alone
            k = knee - bend
            hip = np.arctan2(-x, -depth) - np.arctan2(lower * np.sin(k), upper + lower * np.cos(k))
            hip = (hip + np.pi / 2) % (2 * np.pi) - np.pi / 2
            q = np.stack([abad, hip, knee], axis=-1)
            excess = np.maximum(np.maximum(low - q, q - high), 0.0).max(axis=-1)
            excess = np.where(np.isfinite(excess), excess, np.inf)
            better = excess < best
            best = np.where(better, excess, best)
            best_q = np.where(better[..., None], q, best_q)
    return best_q, best


def clear_of_body(p_BE: FloatArray, q: FloatArray, description: RobotDescription) -> np.ndarray:
    """Return whether toes and shanks of a pair (..., 2, 3) keep their distance from each other, trunk and head."""
    raw = description.raw
    ok = np.ones(p_BE.shape[:-2], dtype=bool)
    boxes = [(np.array([0.0, 0.0, 0.0]), np.array(raw["body"]["box"]))]
    boxes += [(np.array(h["position"]), np.array(h["size"])) for h in raw["head"]]
    for centre, size in boxes:
        gap = np.maximum(np.abs(p_BE - centre) - size / 2, 0.0)
        ok &= (np.linalg.norm(gap, axis=-1) > CLEARANCE).all(axis=-1)
    knees = _knees(q, description)
    for a in np.linspace(0, 1, 5):
        left = (1 - a) * knees[..., 0, :] + a * p_BE[..., 0, :]
        for b in np.linspace(0, 1, 5):
            right = (1 - b) * knees[..., 1, :] + b * p_BE[..., 1, :]
            ok &= np.linalg.norm(left - right, axis=-1) > 2 * CLEARANCE
    return ok


def _knees(q: FloatArray, description: RobotDescription) -> FloatArray:
    raw = description.raw
    points = []
    for i, side in enumerate((1.0, -1.0)):
        abad, hip = q[..., i, 0], q[..., i, 1]
        ax, ay, az = raw["abad"]["origin"]
        hy, length = side * raw["hip"]["origin"][1], raw["hip"]["length"]
        x, z = -length * np.sin(hip), -length * np.cos(hip)
        y, z = hy * np.cos(abad) - z * np.sin(abad), hy * np.sin(abad) + z * np.cos(abad)
        points.append(np.stack([ax + x, side * ay + y, az + z], axis=-1))
    return np.stack(points, axis=-2)


def draw_goals(
    description: RobotDescription, count: int, rng: np.random.Generator, *, anywhere: float = 0.0
) -> FloatArray:
    """Return ``count`` reachable goal pairs (count, 2, 3), base -> front toe [m].

    Args:
        anywhere: Share drawn over all joint positions of the front legs instead of in the description's boxes.
    """
    goals, kept = description.goals, []
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
