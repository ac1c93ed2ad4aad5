"""Who does what in each clip, where, and from where the camera looks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from lab.people import rooms
from lab.people.mannequin import Look
from lab.people.skeleton import Build, Motion, pose
from lab.people.surface import Array


@dataclass(frozen=True, kw_only=True, slots=True)
class Clip:
    """Who does it, where, and from where the camera looks."""

    look: Look
    build: Build
    room: rooms.Room
    camera_yaw: float
    """Direction from the person to the camera, from where the person looks toward the left [rad]."""
    distance: float
    height: float
    aim: float
    """Height that the camera looks at [m]."""
    fovy: float = 27.0
    crf: int = 25


def clip_of(name: str) -> Clip:
    """Return the setting of a clip."""
    if name == "boxing":
        look = Look(
            skin=(0.74, 0.53, 0.42), hair=(0.10, 0.07, 0.05), lips=(0.60, 0.33, 0.29), iris=(0.24, 0.15, 0.09),
            top=(0.12, 0.15, 0.20), bottom=(0.66, 0.11, 0.11), trim=(0.90, 0.88, 0.83), shoes=(0.13, 0.13, 0.15),
            soles=(0.92, 0.91, 0.88), top_style="tank", bottom_style="shorts", hands="gloves",
        )  # fmt: skip
        return Clip(
            look=look, build=Build(), room=rooms.gym(), camera_yaw=np.deg2rad(-58), distance=4.5, height=1.15, aim=0.93
        )
    if name == "ballet":
        look = Look(
            skin=(0.90, 0.71, 0.61), hair=(0.24, 0.13, 0.07), lips=(0.74, 0.30, 0.32), iris=(0.25, 0.34, 0.25),
            top=(0.42, 0.10, 0.20), bottom=(0.93, 0.78, 0.74), trim=(0.62, 0.24, 0.34), shoes=(0.93, 0.70, 0.66),
            soles=(0.80, 0.60, 0.56), bun=True, top_style="leotard", bottom_style="tights", hands="soft", slender=1.0,
        )  # fmt: skip
        build = Build(shoulder_half=0.162, upper_arm=0.280, forearm=0.245, hip_half=0.088)
        return Clip(
            look=look, build=build, room=rooms.studio(), camera_yaw=np.deg2rad(-18), distance=5.1, height=1.15, aim=1.06
        )
    look = Look(
        skin=(0.83, 0.62, 0.50), hair=(0.36, 0.21, 0.11), lips=(0.70, 0.38, 0.34), iris=(0.20, 0.36, 0.50),
        top=(0.20, 0.47, 0.46), bottom=(0.20, 0.25, 0.36), trim=(0.92, 0.88, 0.80), shoes=(0.92, 0.91, 0.89),
        soles=(0.86, 0.50, 0.30), top_style="tee", bottom_style="trousers", hands="open",
    )  # fmt: skip
    return Clip(
        look=look, build=Build(), room=rooms.lounge(), camera_yaw=np.deg2rad(8), distance=4.7, height=1.2, aim=0.98
    )


def truth(motion: Motion, clip: Clip) -> Array:
    """Return the joints (n, 13, 3) in camera axes [m]: x right in the image, y down, z away; origin on the floor."""
    joints = pose(motion, clip.build)[1]
    return joints @ camera_axes(clip).T


def camera_axes(clip: Clip, room: bool = False) -> Array:
    """Rows: right, down and away of the camera, in world (or room) axes."""
    pitch = np.arctan2(clip.height - clip.aim, clip.distance)
    right = np.array([0.0, 1.0, 0.0])
    away = np.array([-np.cos(pitch), 0.0, -np.sin(pitch)])
    axes = np.stack([right, np.cross(away, right), away])
    return axes if room else axes @ Rotation.from_euler("z", clip.camera_yaw).as_matrix().T
