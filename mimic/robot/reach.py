"""Where the toes are and where the front toes can be: kinematics and the closest reachable point, by Pinocchio.

Pinocchio reads the same MJCF as MuJoCo, its collision shapes included. A pair of front toe points is reachable where
some joint angles keep a margin to their limits and leave the front legs clear of each other, of the trunk, of the head
and of the hind legs' motors; the numbers are in ``[reach]`` of robot.toml.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
import pinocchio as pin

from mimic.records import JOINTS, FloatArray
from mimic.robot.arm_torques import cross
from mimic.robot.description import RobotDescription
from mimic.robot.leg_kinematics import front_legs, front_postures, front_toes
from mimic.robot.model import TOES
from mimic.robot.projection import Local, project
from mimic.robot.rigid_body import rigid_body_model

FRONT = 6
"""Joints of the front legs: the first six."""
GRID = (9, 24, 12)
"""Postures of a leg among which a search without a start chooses its own: abad, hip, knee."""
FAR = 0.05
"""A search that ends farther than this looks elsewhere too [m]."""
BETTER = 0.02
"""… and goes there where that is so much nearer [m]."""
ROUNDING = 1e-6
"""Gaps that are short by no more than this are open [m]."""
NEAR = 0.05
"""Pairs of shapes farther apart than this do not limit a step [m]."""


@dataclass(frozen=True, slots=True)
class Closest:
    """The reachable points nearest to the wanted ones."""

    q: FloatArray
    """Front legs (..., 6) [rad]."""
    p_BE: FloatArray
    """Base -> front toes (..., 2, 3) [m]."""
    moved: FloatArray
    """Distance from the wanted points (..., 2) [m]; 0 where they are reachable."""


class Reach:
    """Kinematics of the robot and the reachable set of its front toes. Not to be shared between threads."""

    def __init__(self, description: RobotDescription) -> None:
        """Read the robot.

        Raises:
            AssetError: If the MJCF lacks a part that the description names.
        """
        self.description = description
        self._model, self._geometry = rigid_body_model(self.description)
        self._joints = [self._model.getJointId(name) for name in JOINTS]
        self._at_q = np.array([self._model.joints[i].idx_q for i in self._joints])
        self._at_v = np.array([self._model.joints[i].idx_v for i in self._joints])
        self._frames = [self._model.getFrameId(name, pin.FrameType.OP_FRAME) for name in TOES[:2]]
        self._data = self._model.createData()
        self._qpos = pin.neutral(self._model)
        self._qpos[self._at_q] = self.description.poses["upright"]
        self._pairs = self._add_pairs()
        self._space = self._geometry.createData()
        workspace = self.description.workspace
        self.clearance = workspace.clearance
        """Least gap between shapes [m]."""
        self.q_min = self.description.q_min[:FRONT] + workspace.margin
        """Lower bounds of the front legs, margin included (6,) [rad]."""
        self.q_max = self.description.q_max[:FRONT] - workspace.margin
        """Upper bounds of the front legs, margin included (6,) [rad]."""
        self._clear = self.description.poses["upright"][:FRONT].copy()
        self.legs = front_legs(self.description)
        """The front legs in closed form."""
        self.speed_max = workspace.speed_share * self.description.speed_flat[:FRONT]
        """Joint speeds that targets may ask for (6,) [rad/s]."""

    def toes(self, q: FloatArray) -> FloatArray:
        """Return base -> front toes, left and right, (..., 2, 3) [m] for joints (..., 12) or front joints (..., 6)."""
        return front_toes(np.asarray(q, dtype=np.float64), self.description)

    def gap(self, q: FloatArray) -> float:
        """Return the least gap between a front leg and what it must not touch, for front joints (6,) [m]."""
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._space, self._full(q))
        pin.computeDistances(self._geometry, self._space)
        return min(result.min_distance for result in self._space.distanceResults)

    def is_clear(self, q: FloatArray) -> bool:
        """Return whether front joints (6,) [rad] leave the clearance everywhere."""
        return self.gap(q) >= self.clearance - ROUNDING

    def inverse(self, p_BE: FloatArray, q_near: FloatArray) -> FloatArray:
        """Return front joints (6,) within bounds that put the toes at p_BE (2, 3); NaN for a leg without any.

        Of two postures the one nearer to q_near (6,) is taken. Gaps are not looked at.
        """
        return _nearer(self._postures(p_BE), np.asarray(q_near))

    def closest(self, p_wanted: FloatArray, q_start: FloatArray | None = None) -> Closest:
        """Return the reachable toe points nearest to the wanted ones; reachable points are returned unchanged.

        Args:
            p_wanted: Base -> front toes (2, 3), base axes [m].
            q_start: Front joints (6,) of the row before [rad]; a smooth motion then stays smooth. Without it the
                search begins at the nearest posture of a grid.
        """
        return self._closest(np.asarray(p_wanted, dtype=np.float64), self._postures(p_wanted), q_start)

    def closest_track(self, p_wanted: FloatArray) -> Closest:
        """Return `closest` for rows in time (T, 2, 3), each started from the row before."""
        p_wanted = np.asarray(p_wanted, dtype=np.float64)
        rows = []
        q_start = None
        for p, postures in zip(p_wanted, self._postures(p_wanted), strict=True):
            rows.append(self._closest(p, postures, q_start))
            q_start = rows[-1].q
        return Closest(
            q=np.stack([row.q for row in rows]),
            p_BE=np.stack([row.p_BE for row in rows]),
            moved=np.stack([row.moved for row in rows]),
        )

    @cached_property
    def acceleration_max(self) -> FloatArray:
        """Joint acceleration that targets may ask for (6,) [rad/s^2].

        A share of the peak torque over the largest inertia that the joint meets within its bounds, where every front
        joint of the leg accelerates alike: the greatest row sum of the mass matrix with the base held.
        """
        rng = np.random.default_rng(0)
        greatest = np.zeros(FRONT)
        for q in rng.uniform(self.q_min, self.q_max, (256, FRONT)):
            mass = pin.crba(self._model, self._data, self._full(q))
            mass = np.triu(mass) + np.triu(mass, 1).T
            front = mass[np.ix_(self._at_v[:FRONT], self._at_v[:FRONT])]
            greatest = np.maximum(greatest, np.sum(np.abs(front), axis=1))
        greatest = np.tile(np.maximum(greatest[:3], greatest[3:]), 2)
        return self.description.workspace.torque_share * self.description.torque_max[:FRONT] / greatest

    def _full(self, q: FloatArray) -> FloatArray:
        """Return Pinocchio's configuration with the base at the origin; hind legs stay where no joints are given."""
        qpos = self._qpos.copy()
        qpos[self._at_q[: len(q)]] = q
        return qpos

    def _add_pairs(self) -> list[tuple[int, int]]:
        """Watch the gaps of the front legs; return the two Pinocchio joints that carry each pair's shapes."""
        shapes = self.description.names.shapes
        pairs: list[tuple[str, str]] = []
        for front, hind in (("FL", "RL"), ("FR", "RR")):
            others = (*shapes("trunk", "head"), *shapes("shoulder", legs=(hind,)))
            pairs += product(shapes("shank", "toe", legs=(front,)), others)
        left, right = (shapes("shank", "toe", legs=(leg,)) for leg in ("FL", "FR"))
        pairs += product(left, (*right, *shapes("thigh", legs=("FR",))))
        pairs += product(shapes("thigh", legs=("FL",)), right)
        shape = self._geometry.getGeometryId
        ids = [(shape(one), shape(other)) for one, other in pairs]
        for one, other in ids:
            self._geometry.addCollisionPair(pin.CollisionPair(one, other))
        objects = self._geometry.geometryObjects
        return [(objects[one].parentJoint, objects[other].parentJoint) for one, other in ids]

    def _postures(self, p_BE: FloatArray) -> FloatArray:
        """Return both postures of each front leg (..., 2, 2, 3) for toes at (..., 2, 3); NaN out of bounds."""
        both = front_postures(np.asarray(p_BE, dtype=np.float64), self.description)
        low, high = (bound.reshape(2, 1, 3) for bound in (self.q_min - 1e-9, self.q_max + 1e-9))
        return np.where(np.all((both >= low) & (both <= high), axis=-1, keepdims=True), both, np.nan)

    def _closest(self, p_wanted: FloatArray, postures: FloatArray, q_start: FloatArray | None) -> Closest:
        start = self._clear if q_start is None else np.asarray(q_start)
        q = _nearer(postures, start)
        unknown = np.isnan(q)
        if not unknown.any() and self.is_clear(q):
            return Closest(q, p_wanted.copy(), np.zeros(2))
        warm = None if q_start is None else self._search(p_wanted, np.where(unknown, start, q))
        if warm is not None and np.max(warm.moved) <= FAR:
            return warm
        seed, hint = self._coarse(p_wanted)
        if warm is not None and np.max(warm.moved - hint) <= BETTER:
            return warm
        cold = self._search(p_wanted, np.where(unknown, seed, q))
        return cold if warm is None or np.sum(warm.moved - cold.moved) > BETTER else warm

    def _coarse(self, p_wanted: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the front joints (6,) of a coarse grid that come nearest to (2, 3), and how near (2,) [m]."""
        q = np.empty(FRONT)
        distance = np.empty(2)
        for index, (postures, p_BE) in enumerate(self._grid):
            away = np.linalg.norm(p_BE - p_wanted[index], axis=1)
            best = np.argmin(away)
            q[3 * index : 3 * index + 3] = postures[best]
            distance[index] = away[best]
        return q, distance

    @cached_property
    def _grid(self) -> list[tuple[FloatArray, FloatArray]]:
        """Postures (N, 3) and toes (N, 3) of each front leg over its bounds."""
        grids: list[tuple[FloatArray, FloatArray]] = []
        for index, leg in enumerate(self.legs):
            bounds = zip(self.q_min[3 * index :], self.q_max[3 * index :], GRID, strict=False)
            axes = np.meshgrid(*(np.linspace(*each) for each in bounds), indexing="ij")
            postures = np.stack([axis.ravel() for axis in axes], axis=1)
            grids.append((postures, leg.forward(postures)))
        return grids

    def _search(self, p_wanted: FloatArray, q: FloatArray) -> Closest:
        q, here = project(self._look, p_wanted.ravel(), q, self.q_min, self.q_max)
        if np.any(here.gap < -ROUNDING):  # stuck where shapes overlap: begin where none do
            q, here = project(self._look, p_wanted.ravel(), self._clear, self.q_min, self.q_max)
        if np.any(here.gap < -ROUNDING):
            q = self._clear
            here = self._look(self._clear)
        p = here.p.reshape(2, 3).copy()
        return Closest(q, p, np.linalg.norm(p - p_wanted, axis=-1))

    def _look(self, q: FloatArray) -> Local:
        """Return toe positions, their derivatives and the near gaps at front joints (6,)."""
        pin.computeJointJacobians(self._model, self._data, self._full(q))
        pin.updateFramePlacements(self._model, self._data)
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._space)
        pin.computeDistances(self._geometry, self._space)
        axes = self._data.J[3:, self._at_v[:FRONT]].T
        origins = np.array([self._data.oMi[i].translation for i in self._joints[:FRONT]])
        p = np.array([self._data.oMf[frame].translation for frame in self._frames])
        columns = cross(axes, np.repeat(p, 3, axis=0) - origins)
        jacobian = np.zeros((6, FRONT))
        jacobian[:3, :3] = columns[:3].T
        jacobian[3:, 3:] = columns[3:].T

        def curvature(weights: FloatArray) -> FloatArray:
            total = np.zeros((FRONT, FRONT))
            for leg in (slice(0, 3), slice(3, 6)):
                # d2p / dq_i dq_j = axis_i x (dp / dq_j) for i at or above j; = (w x axis_i) . column_j under weights w
                upper = np.triu(cross(np.broadcast_to(weights[leg], (3, 3)), axes[leg]) @ columns[leg].T)
                total[leg, leg] = upper + np.triu(upper, 1).T
            return total

        gaps = []
        rows = []
        for result, joints in zip(self._space.distanceResults, self._pairs, strict=True):
            if result.min_distance > NEAR:
                continue
            row = np.zeros(FRONT)
            for sign, joint, point in zip(
                (-1.0, 1.0), joints, (result.getNearestPoint1(), result.getNearestPoint2()), strict=True
            ):
                if joint in self._joints[:FRONT]:
                    last = self._joints.index(joint)
                    chain = slice(last - last % 3, last + 1)
                    row[chain] += sign * (cross(axes[chain], point - origins[chain]) @ result.normal)
            gaps.append(result.min_distance - self.clearance)
            rows.append(row)
        return Local(p.ravel(), jacobian, curvature, np.array(gaps), np.array(rows).reshape(-1, FRONT))


def _nearer(postures: FloatArray, near: FloatArray) -> FloatArray:
    """Return of each leg's two postures (2, 2, 3) the one nearer to near (6,), as front joints (6,)."""
    q = np.empty(FRONT)
    for index in range(2):
        part = slice(3 * index, 3 * index + 3)
        one, other = postures[index]
        if np.isnan(one[0]) or np.linalg.norm(other - near[part]) < np.linalg.norm(one - near[part]):
            one = other
        q[part] = one
    return q
