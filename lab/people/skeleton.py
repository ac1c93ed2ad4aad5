"""Where every bone of the mannequin is, from a few curves over time.

World axes: x where the person looks, y to the person's left, z up, origin on the floor between the feet [m].
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from lab.people.surface import Array

SIDES = ("L", "R")
SIGN = {"L": 1.0, "R": -1.0}
"""Sign of y on each side."""
TRUTH_NAMES = (
    "nose", "shoulderL", "shoulderR", "elbowL", "elbowR", "wristL", "wristR",
    "hipL", "hipR", "kneeL", "kneeR", "ankleL", "ankleR",
)  # fmt: skip
DROOP = np.deg2rad(30.0)
"""Angle of the arms below the horizontal in the pose that the meshes are made in."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Build:
    """Bone lengths and joint places of a person about 1.75 m tall, standing [m]."""

    upper_arm: float = 0.290
    forearm: float = 0.255
    thigh: float = 0.425
    shin: float = 0.405
    hip_half: float = 0.092
    hip_z: float = 0.915
    waist_z: float = 1.06
    chest_z: float = 1.20
    shoulder_half: float = 0.178
    shoulder_z: float = 1.425
    neck_z: float = 1.47
    head_z: float = 1.555
    head_x: float = 0.015
    ankle_z: float = 0.085
    ball_x: float = 0.13
    """The ball of the foot in front of the ankle."""
    nose: tuple[float, float, float] = (0.122, 0.0, 0.056)
    """Tip of the nose from the head joint."""

    @property
    def arm(self) -> float:
        """Shoulder to wrist, straight [m]."""
        return self.upper_arm + self.forearm

    def shoulder(self, side: str) -> Array:
        """Shoulder in the pose that the meshes are made in."""
        return np.array([-0.01, SIGN[side] * self.shoulder_half, self.shoulder_z])

    def arm_direction(self, side: str) -> Array:
        """Direction of the straight arm in the pose that the meshes are made in."""
        return np.array([0.0, SIGN[side] * np.cos(DROOP), -np.sin(DROOP)])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Motion:
    """Everything a clip decides, sampled at the frames; angles are yaw (left), pitch (forward), roll (to the right)."""

    t: Array
    pelvis: Array
    """(n, 3) offset of the pelvis from upright standing [m]."""
    pelvis_ypr: Array
    chest_ypr: Array
    """(n, 3) against the world [rad]."""
    head_ypr: Array
    wrist: dict[str, Array]
    """Per side (n, 3): wrist from its own shoulder, world axes, in arm lengths."""
    elbow: dict[str, Array]
    """Per side (n, 3): where the elbow points."""
    palm: dict[str, Array]
    """Per side (n, 3): where the palm faces."""
    fingers: dict[str, Array]
    """Per side (n, 3): where the fingers point."""
    foot: dict[str, tuple[float, float, float]]
    """Per side: x, y of the ankle [m] and yaw of the foot [rad]."""
    heel: dict[str, Array] = field(default_factory=dict)
    """Per side (n,): pitch of the foot on its ball, heel off the floor [rad]."""


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Poses over time of one bone."""

    p: Array
    """(n, 3) [m]."""
    R: Array
    """(n, 3, 3), columns are the bone's axes."""


def pose(motion: Motion, build: Build) -> tuple[dict[str, Frames], Array]:
    """Return the frames of all bones and the truth joints (n, 13, 3) in world axes [m]."""
    n = len(motion.t)
    bones: dict[str, Frames] = {}

    pelvis_R, chest_R, head_R = (_rotation(a) for a in (motion.pelvis_ypr, motion.chest_ypr, motion.head_ypr))
    waist_R, neck_R = _halfway(pelvis_R, chest_R), _halfway(chest_R, head_R)
    pelvis_p = motion.pelvis + np.array([0.0, 0.0, build.hip_z])
    waist_p = pelvis_p + pelvis_R @ np.array([0.0, 0.0, build.waist_z - build.hip_z])
    chest_p = waist_p + waist_R @ np.array([0.0, 0.0, build.chest_z - build.waist_z])
    neck_p = chest_p + chest_R @ np.array([0.0, 0.0, build.neck_z - build.chest_z])
    head_p = neck_p + neck_R @ np.array([build.head_x, 0.0, build.head_z - build.neck_z])
    bones |= {
        "pelvis": Frames(pelvis_p, pelvis_R),
        "waist": Frames(waist_p, waist_R),
        "chest": Frames(chest_p, chest_R),
        "neck": Frames(neck_p, neck_R),
        "head": Frames(head_p, head_R),
    }
    joints = {"nose": head_p + head_R @ np.array(build.nose)}

    for side in SIDES:
        reach = motion.wrist[side]
        local = np.einsum("nji,nj->ni", chest_R, reach)
        girdle = np.zeros((n, 3))
        girdle[:, 0] = 0.035 * np.clip(local[:, 0], -0.3, 1.0)
        lift = 0.5 * (1.0 + np.tanh(2.5 * (local[:, 2] - 0.2)))
        girdle[:, 1] = -SIGN[side] * 0.025 * lift
        girdle[:, 2] = 0.05 * lift
        at_rest = build.shoulder(side) - np.array([0.0, 0.0, build.chest_z])
        shoulder = chest_p + np.einsum("nij,nj->ni", chest_R, at_rest + girdle)
        arm = _two_bones(shoulder, shoulder + build.arm * reach, motion.elbow[side], build.upper_arm, build.forearm)
        joints |= {f"shoulder{side}": shoulder, f"elbow{side}": arm.middle, f"wrist{side}": arm.end}
        bones |= _arm_bones(side, build, arm, chest_R, motion.palm[side], motion.fingers[side])

        x, y, yaw = motion.foot[side]
        heel = motion.heel.get(side, np.zeros(n))
        foot_R = _rotation(np.stack([np.full(n, yaw), heel, np.zeros(n)], axis=1))
        ball = np.array([x, y, 0.0]) + build.ball_x * np.array([np.cos(yaw), np.sin(yaw), 0.0])
        ankle = ball + foot_R @ np.array([-build.ball_x, 0.0, build.ankle_z])
        hip = pelvis_p + pelvis_R @ np.array([0.0, SIGN[side] * build.hip_half, 0.0])
        knee_to = np.tile([np.cos(yaw), np.sin(yaw), 0.0], (n, 1))
        leg = _two_bones(hip, ankle, knee_to, build.thigh, build.shin)
        joints |= {f"hip{side}": hip, f"knee{side}": leg.middle, f"ankle{side}": leg.end}
        bones |= {
            f"thigh{side}": Frames(hip, _frame(leg.middle - hip, leg.toward)),
            f"shin{side}": Frames(leg.middle, _frame(leg.end - leg.middle, leg.toward)),
            f"foot{side}": Frames(leg.end, foot_R),
        }
    return bones, np.stack([joints[name] for name in TRUTH_NAMES], axis=1)


def rest_frames(build: Build) -> dict[str, Frames]:
    """Frames (n = 1) of all bones in the pose that the meshes are made in: legs straight down, arms out and down."""
    one = {
        "pelvis": [0.0, 0.0, build.hip_z],
        "waist": [0.0, 0.0, build.waist_z],
        "chest": [0.0, 0.0, build.chest_z],
        "neck": [0.0, 0.0, build.neck_z],
        "head": [build.head_x, 0.0, build.head_z],
    }
    frames = {name: Frames(np.array([p]), np.eye(3)[None]) for name, p in one.items()}
    back, ahead, down = np.array([[-1.0, 0, 0]]), np.array([[1.0, 0, 0]]), np.array([[0, 0, -1.0]])
    for side in SIDES:
        along = build.arm_direction(side)[None]
        shoulder = build.shoulder(side)[None]
        elbow, wrist = shoulder + build.upper_arm * along, shoulder + build.arm * along
        arm_R = _frame(along, back)
        for i in range(3):
            frames[f"upper{i}{side}"] = Frames(shoulder, arm_R)
            frames[f"fore{i}{side}"] = Frames(elbow, arm_R)
        frames[f"hand{side}"] = Frames(wrist, _hand_frame(along, _rest_palm(build, side)))
        hip = np.array([[0.0, SIGN[side] * build.hip_half, build.hip_z]])
        knee = hip + build.thigh * down
        frames[f"thigh{side}"] = Frames(hip, _frame(down, ahead))
        frames[f"shin{side}"] = Frames(knee, _frame(down, ahead))
        frames[f"foot{side}"] = Frames(knee + build.shin * down, np.eye(3)[None])
    return frames


@dataclass(frozen=True, slots=True, eq=False)
class _Limb:
    root: Array
    middle: Array
    end: Array
    toward: Array


def _two_bones(root: Array, target: Array, toward: Array, first: float, second: float) -> _Limb:
    """Place the middle joint between root and target by the law of cosines; a target out of reach is pulled in."""
    line = target - root
    distance = np.linalg.norm(line, axis=1, keepdims=True)
    u = line / distance
    d = np.clip(distance, abs(first - second) + 1e-3, (first + second) * 0.9985)
    along = (first**2 - second**2 + d**2) / (2 * d)
    n = _unit(toward - (toward * u).sum(axis=1, keepdims=True) * u)
    middle = root + along * u + np.sqrt(first**2 - along**2) * n
    return _Limb(root, middle, root + d * u, n)


def _arm_bones(side: str, build: Build, arm: _Limb, chest_R: Array, palm: Array, fingers: Array) -> dict[str, Frames]:
    """Split both halves of an arm in three, so that the skin twists gradually from shoulder to hand."""
    rest_R = _frame(build.arm_direction(side)[None], np.array([[-1.0, 0, 0]]))
    upper_R = _frame(arm.middle - arm.root, arm.toward)
    swing = _shortest(chest_R @ rest_R[0][:, 0], upper_R[:, :, 0]) @ chest_R @ rest_R
    twist = np.unwrap(_twist(swing, upper_R))
    fore_R = _frame(arm.end - arm.middle, arm.toward)
    hand_R = _hand_frame(fingers, palm)
    wrist_R = _frame(fore_R[:, :, 0], -palm)
    rest_wrist = _frame(build.arm_direction(side)[None], -_rest_palm(build, side))
    turn = np.unwrap(_wrapped(_twist(fore_R, wrist_R) - _twist(rest_R, rest_wrist)))
    bones = {f"hand{side}": Frames(arm.end, hand_R)}
    for i, share in enumerate((0.0, 0.5, 1.0)):
        bones[f"upper{i}{side}"] = Frames(arm.root, swing @ _about_x(share * twist))
        bones[f"fore{i}{side}"] = Frames(arm.middle, fore_R @ _about_x(share * turn))
    return bones


def _rest_palm(build: Build, side: str) -> Array:
    x, y, z = build.arm_direction(side)
    return np.array([[x, SIGN[side] * z, -abs(y)]])


def _unit(v: Array) -> Array:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def _frame(x: Array, y_hint: Array) -> Array:
    x = _unit(np.asarray(x, float))
    y = _unit(y_hint - (y_hint * x).sum(axis=1, keepdims=True) * x)
    return np.stack([x, y, np.cross(x, y)], axis=2)


def _hand_frame(fingers: Array, palm: Array) -> Array:
    """x along the fingers, z out of the back of the hand."""
    x = _unit(np.asarray(fingers, float))
    z = -_unit(palm - (palm * x).sum(axis=1, keepdims=True) * x)
    return np.stack([x, np.cross(z, x), z], axis=2)


def _rotation(ypr: Array) -> Array:
    return Rotation.from_euler("ZYX", ypr).as_matrix()


def _halfway(a: Array, b: Array) -> Array:
    difference = Rotation.from_matrix(np.swapaxes(a, 1, 2) @ b).as_rotvec()
    return a @ Rotation.from_rotvec(0.5 * difference).as_matrix()


def _shortest(a: Array, b: Array) -> Array:
    axis = np.cross(a, b)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine, (a * b).sum(axis=1, keepdims=True))
    return Rotation.from_rotvec(axis / np.maximum(sine, 1e-9) * angle).as_matrix()


def _twist(a: Array, b: Array) -> Array:
    """Angle about the common x axis that takes frame a to frame b [rad]."""
    y = b[:, :, 1]
    return np.arctan2((y * a[:, :, 2]).sum(axis=1), (y * a[:, :, 1]).sum(axis=1))


def _wrapped(angle: Array) -> Array:
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _about_x(angle: Array) -> Array:
    return Rotation.from_rotvec(angle[:, None] * np.array([1.0, 0.0, 0.0])).as_matrix()
