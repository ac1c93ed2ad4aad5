"""A test of joints, legs and IMU before a robot stands up: each joint moves a little, and the trunk must answer.

A robot on four feet tilts as its legs say: the plane through its feet stays level with the ground. Readings of a joint
agree with its commands even if its sign is wrong, or its motor sits in another place; the IMU then shows another tilt
than the legs. Which mistake explains it is found by trying them: signs, motors swapped in a leg, and swapped legs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from mimic.frozen import frozen_arrays
from mimic.geometry import rotation_from_quat
from mimic.records import JOINTS, LEGS, FloatArray, IntArray
from mimic.robot.description import RobotDescription
from mimic.robot.leg_kinematics import all_toes

TILT = 0.02
"""A joint moves so far that the trunk tilts by this [rad],"""
LEAST = 0.1
"""… but at least so far [rad],"""
MOST = 0.25
"""… and at most so far [rad]."""

MOVE_TICKS = 12
"""Control steps of a joint's motion, there and back."""
REST_TICKS = 2
"""Control steps until the next motion."""

STEP = 1e-4
"""Of a derivative [rad]."""

FOLLOWS = 0.08
"""Share of its motion that a joint follows at least; in simulation 0.2, of knees that carry a Go2."""

EXPLAINED = 0.5
"""A mistake is named where it leaves less than this share of the squares of what it explains."""

UNEXPLAINED = 0.7
"""Share of the squares of the tilts by a leg's joints that may be left; in simulation at most 0.46, of a joint 1.0."""

TURNED = 0.12
"""Largest turn of the IMU about the vertical [rad]; in simulation at most 0.04."""


@frozen_arrays
class Mistake:
    """What may be wrong with a robot: the joint that is named i is order[i], with this sign."""

    text: str
    order: IntArray
    """(12,)"""
    sign: FloatArray
    """(12,)"""

    @property
    def touches(self) -> IntArray:
        """Joints of which it is a mistake."""
        return np.flatnonzero((self.order != np.arange(len(JOINTS))) | (self.sign < 0.0))


@frozen_arrays
class Answer:
    """What a joint's motion did."""

    share: float
    """Share of its motion that the joint followed."""
    tilted: FloatArray
    """x and y of up by the IMU, base axes, less their means (T, 2)."""
    expected: FloatArray
    """The same by the legs (T, 2)."""
    left: FloatArray
    """Sum of squares of their difference, for each mistake (M,)."""


def _mistakes() -> Iterator[Mistake]:
    """Return none at first, and then all that are looked for."""
    joints = np.arange(len(JOINTS))
    plus = np.ones(len(JOINTS))
    swaps = dict[str, list[tuple[int, int]]]()
    yield Mistake(text="", order=joints, sign=plus)
    for joint, name in enumerate(JOINTS):
        yield Mistake(text=f"the sign of {name} is wrong", order=joints, sign=np.where(joints == joint, -1.0, 1.0))
    for a, b in combinations(range(len(JOINTS)), 2):
        if a // 3 == b // 3:
            swaps[f"the motors {JOINTS[a]} and {JOINTS[b]}"] = [(a, b)]
    for (a, one), (b, other) in combinations(enumerate(LEGS), 2):
        swaps[f"the legs {one} and {other}"] = [(3 * a + i, 3 * b + i) for i in range(3)]
    for text, pairs in swaps.items():
        order = joints.copy()
        for one, other in pairs:
            order[[one, other]] = other, one
        yield Mistake(text=f"{text} are swapped", order=order, sign=plus)


def ground_normal(q: FloatArray, description: RobotDescription) -> FloatArray:
    """Return x and y of up by the legs (..., 2), base axes: of the plane nearest to the feet; q (..., 12)."""
    toes = all_toes(q, description)
    away = toes - toes.mean(axis=-2, keepdims=True)
    x, y, z = np.moveaxis(away, -1, 0)
    xx, xy, yy, xz, yz = (np.sum(one * other, axis=-1) for one, other in ((x, x), (x, y), (y, y), (x, z), (y, z)))
    slope = np.stack([xz * yy - yz * xy, yz * xx - xz * xy], axis=-1) / (xx * yy - xy**2)[..., None]
    return -slope / np.sqrt(1.0 + np.sum(slope**2, axis=-1, keepdims=True))


class JointTest:
    """How the joints of a robot are moved, and what its trunk does then."""

    def __init__(self, description: RobotDescription) -> None:
        self._description = d = description
        self._lie = d.poses["lie"]
        self.mistakes = tuple(_mistakes())
        """What is looked for; the first one is none."""
        steps = STEP * np.eye(len(JOINTS))
        tilts = (ground_normal(self._lie + steps, d) - ground_normal(self._lie - steps, d)) / (2.0 * STEP)
        heights = (all_toes(self._lie + steps, d) - all_toes(self._lie - steps, d))[..., 2].sum(axis=-1)
        size = np.clip(TILT / np.maximum(np.linalg.norm(tilts, axis=-1), STEP), LEAST, MOST)
        self._size = np.where(heights > 0.0, -size, size)

    def targets(self, joint: int) -> Iterator[FloatArray]:
        """Return the targets (12,) of each control step of a joint's motion [rad]; it presses the foot down."""
        for tick in range(MOVE_TICKS + REST_TICKS):
            q = self._lie.copy()
            q[joint] += self._size[joint] * 0.5 * (1.0 - math.cos(2.0 * math.pi * min((tick + 1) / MOVE_TICKS, 1.0)))
            yield q

    def answer(self, joint: int, q: FloatArray, quat_WB: FloatArray) -> Answer:
        """Return what a joint's motion did, from the joints (T, 12) [rad] and orientations (T, 4) after each target."""
        tilted = _changes(rotation_from_quat(quat_WB)[..., 2, :2])
        expected = _changes(ground_normal(self._placed(q), self._description))
        return Answer(
            share=float(np.ptp(q[:, joint]) / abs(self._size[joint])),
            tilted=tilted,
            expected=expected[0],
            left=np.square(tilted - expected).sum(axis=(1, 2)),
        )

    def fault(self, answers: Sequence[Answer]) -> str:
        """Return what is wrong with the robot, as a sentence without its full stop; empty where nothing is."""
        for name, answer in zip(JOINTS, answers, strict=True):
            if not answer.share > FOLLOWS:
                return f"{name} does not follow its motor: it moved by {answer.share:.0%} of what was asked of it"
        return self._mistake(np.array([answer.left for answer in answers])) or _unexplained(answers) or _turn(answers)

    def _placed(self, q: FloatArray) -> FloatArray:
        """Return where the joints (..., 12) are if it were each of the mistakes (M, ..., 12) [rad]."""
        placed = np.broadcast_to(self._lie, (len(self.mistakes), *q.shape)).copy()
        for made, mistake in zip(placed, self.mistakes, strict=True):
            made[..., mistake.order] += mistake.sign * (q - self._lie)
        return placed

    def _mistake(self, left: FloatArray) -> str:
        """Return the mistake that explains most, from the squares that each leaves of each joint's tilt (12, M)."""
        gains = [0.0]
        for mistake, rest in zip(self.mistakes[1:], left.T[1:], strict=True):
            before = left[mistake.touches, 0].sum()
            after = rest[mistake.touches].sum()
            gains.append(before - after if after < EXPLAINED * before else 0.0)
        return self.mistakes[int(np.argmax(gains))].text


def _unexplained(answers: Sequence[Answer]) -> str:
    """Return the leg whose tilts are least like what its joints say, where that is too little."""
    left = _by_leg([answer.left[0] for answer in answers])
    tilted = _by_leg([np.square(answer.tilted).sum() for answer in answers])
    expected = _by_leg([np.square(answer.expected).sum() for answer in answers])
    share = left / np.maximum(tilted, expected)
    worst = int(np.argmax(share))
    if share[worst] < UNEXPLAINED:
        return ""
    by_imu = np.rad2deg(np.sqrt(tilted[worst] / len(answers[0].tilted)))
    by_legs = np.rad2deg(np.sqrt(expected[worst] / len(answers[0].tilted)))
    return (
        f"{LEGS[worst]} moves, and the trunk does not tilt as it should ({by_imu:.1f} deg by the IMU, {by_legs:.1f} "
        "by the legs); does every foot touch the ground, and are its motors and the IMU where the wiring says?"
    )


def _by_leg(of_joints: Sequence[float]) -> FloatArray:
    """Return sums over the joints of each leg (4,)."""
    return np.reshape(of_joints, (len(LEGS), -1)).sum(axis=1)


def _turn(answers: Sequence[Answer]) -> str:
    """Return by how much the IMU is turned about the vertical, if it is."""
    tilted = np.concatenate([answer.tilted for answer in answers])
    expected = np.concatenate([answer.expected for answer in answers])
    across = np.sum(expected[:, 0] * tilted[:, 1] - expected[:, 1] * tilted[:, 0])
    angle = math.atan2(across, np.sum(expected * tilted))
    return f"the IMU is turned by {np.rad2deg(angle):.0f} deg about the vertical" if abs(angle) > TURNED else ""


def _changes(rows: FloatArray) -> FloatArray:
    """Return rows (..., T, 2) less their mean over time."""
    return rows - rows.mean(axis=-2, keepdims=True)
