"""A person in a room before a camera, as a MuJoCo model."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np

from lab.people import rooms
from lab.people.mannequin import Look, Skin, face_geoms, skin_file
from lab.people.skeleton import Build, rest_frames
from lab.people.surface import Array


@dataclass(frozen=True, kw_only=True, slots=True)
class Shot:
    """Where the camera is, in the axes of the room, and how the picture is lit."""

    eye: Array
    """Place of the camera (3,) [m]."""
    axes: Array
    """Rows: right, down and away of the camera (3, 3)."""
    fovy: float
    """Vertical field of view [degrees]."""
    yaw: float
    """Turn of the room about the person [rad]."""
    size: tuple[int, int]
    """Width and height of the picture [px]."""
    visual: str
    """MJCF of quality and headlight."""
    lights: str
    """MJCF of the lights of the room."""
    gloss: float = 0.6
    """Specular share over shininess of the skins."""


def build_scene(room: rooms.Room, look: Look, build: Build, skins: Iterable[Skin], shot: Shot) -> mujoco.MjModel:
    """Return the scene: one free-floating body per bone, the skins on them, the room turned toward the camera."""
    files = dict(room.files)
    materials = tags = ""
    for part in skins:
        files[f"{part.name}.skn"] = skin_file(part, build)
        materials += (
            f'<material name="m_{part.name}" rgba="{text(part.colour)} 1" specular="{shot.gloss * part.shine}" '
            f'shininess="{part.shine}"/>'
        )
        tags += f'<skin name="{part.name}" file="{part.name}.skn" material="m_{part.name}"/>'
    bodies = ""
    for name in rest_frames(build):
        inside = "\n".join(face_geoms(look)) if name == "head" else ""
        bodies += f'<body name="{name}" mocap="true">{inside}</body>'
    right, down, _ = shot.axes
    width, height = shot.size
    xml = f"""
    <mujoco>
      <compiler angle="degree"/>
      <statistic center="0 0 1" extent="2.6"/>
      <visual>
        <global offwidth="{width}" offheight="{height}"/>
        {shot.visual}
      </visual>
      <asset>
        <texture name="sky_" type="skybox" builtin="flat" rgb1="0.7 0.66 0.62" width="64" height="64"/>
        {room.assets}{materials}
      </asset>
      <default><geom contype="0" conaffinity="0"/></default>
      <worldbody>
        <body name="room" euler="0 0 {np.rad2deg(shot.yaw):.6f}">
          {shot.lights}
          <camera name="film" pos="{text(shot.eye)}" xyaxes="{text(right)} {text(-down)}" fovy="{shot.fovy}"/>
          {room.geoms}
        </body>
        {bodies}
      </worldbody>
      <deformable>{tags}</deformable>
    </mujoco>"""
    return mujoco.MjModel.from_xml_string(xml, files)


def text(values: Array | list[float] | tuple[float, ...]) -> str:
    """Return numbers as MJCF has them."""
    return " ".join(f"{v:.7g}" for v in values)
