"""Light, camera and rendering."""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from lab.people.clips import Clip, camera_axes
from lab.people.mannequin import skins
from lab.people.scene import Shot, build_scene, text
from lab.people.skeleton import Frames, Motion, pose
from lab.people.surface import Array

WIDTH, HEIGHT = 640, 480


def build_model(clip: Clip) -> mujoco.MjModel:
    """Return the scene of a clip."""
    key = clip.room.key
    warm = np.array(clip.room.warmth)
    visual = """
        <quality shadowsize="3072" offsamples="0" numslices="64" numquads="4"/>
        <map znear="0.1" zfar="20" shadowclip="0.56"/>
        <headlight ambient="0.27 0.27 0.285" diffuse="0.10 0.10 0.10" specular="0 0 0"/>"""
    lights = f"""
          <light name="key" directional="true" castshadow="true"
            pos="{text(np.array([0, 0, 0.9]) - 3 * np.array(key))}" dir="{text(key)}"
            diffuse="{text(0.56 * warm)}" specular="0.25 0.25 0.22" ambient="0 0 0"/>
          <light name="fill" directional="true" castshadow="false" pos="3 {-4 * key[1]:.3f} 2"
            dir="-0.8 {-key[1]:.3f} -0.25" diffuse="0.17 0.18 0.20" specular="0 0 0"/>
          <light name="rim" directional="true" castshadow="false" pos="-2 {3 * key[1]:.3f} 3"
            dir="0.75 {-1.4 * key[1]:.3f} -0.55" diffuse="0.20 0.19 0.18" specular="0.1 0.1 0.1"/>"""
    shot = Shot(
        eye=np.array([clip.distance, 0.0, clip.height]),
        axes=camera_axes(clip, room=True),
        fovy=clip.fovy,
        yaw=clip.camera_yaw,
        size=(WIDTH, HEIGHT),
        visual=visual,
        lights=lights,
    )
    return build_scene(clip.room, clip.look, clip.build, skins(clip.look, clip.build), shot)


class Film:
    """Renders frames of one clip."""

    width, height = WIDTH, HEIGHT

    def __init__(self, motion: Motion, clip: Clip, passes: int) -> None:
        """Prepare the scene; `passes` pictures with shifted light and pixels are averaged to one soft frame."""
        self._model = build_model(clip)
        self._data = mujoco.MjData(self._model)
        self._bones: dict[str, Frames] = pose(motion, clip.build)[0]
        self._mocap = {name: int(self._model.body(name).mocapid[0]) for name in self._bones}
        self._passes = passes
        self._renderer = mujoco.Renderer(self._model, HEIGHT, WIDTH)
        y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
        away = np.hypot((x - WIDTH / 2) / WIDTH, (y - 0.55 * HEIGHT) / HEIGHT)
        self._vignette = (1.0 - 0.42 * np.clip(away - 0.25, 0, None) ** 1.5)[:, :, None]

    def frame(self, index: int) -> np.ndarray:
        """Return frame `index` as (height, width, 3) RGB bytes."""
        for name, bone in self._bones.items():
            i = self._mocap[name]
            self._data.mocap_pos[i] = bone.p[index]
            self._data.mocap_quat[i] = np.roll(Rotation.from_matrix(bone.R[index]).as_quat(), 1)
        mujoco.mj_forward(self._model, self._data)
        self._renderer.update_scene(self._data, "film")
        scene = self._renderer.scene
        total = np.zeros((HEIGHT, WIDTH, 3))
        number = next(i for i in range(scene.nlight) if scene.lights[i].castshadow)
        aim = np.array(scene.lights[number].dir)
        camera = [(np.array(c.frustum_center), float(c.frustum_bottom), float(c.frustum_top)) for c in scene.camera]
        for k in range(self._passes):
            angle, radius = 2.399963 * k, 0.045 * np.sqrt((k + 0.5) / self._passes)
            shifted = aim + radius * (np.cos(angle) * _across(aim)[0] + np.sin(angle) * _across(aim)[1])
            scene.lights[number].dir = shifted / np.linalg.norm(shifted)
            for c, (_, bottom, top) in zip(scene.camera, camera, strict=True):
                pixel = (top - bottom) / HEIGHT
                dx, dy = (k + 0.5) / self._passes - 0.5, (0.618034 * k) % 1.0 - 0.5
                c.frustum_center = dx * pixel
                c.frustum_bottom, c.frustum_top = bottom + dy * pixel, top + dy * pixel
            total += self._renderer.render()
        return self._graded(total / (255.0 * self._passes))

    def _graded(self, rgb: np.ndarray) -> np.ndarray:
        """A gentle contrast curve, slightly warmer lights, darker corners."""
        curve = rgb + 0.16 * rgb * (1 - rgb) * (2 * rgb - 0.72)
        graded = curve * self._vignette * np.array([1.02, 1.0, 0.975])
        return (255.0 * np.clip(graded, 0, 1) + 0.5).astype(np.uint8)


def _across(direction: Array) -> tuple[Array, Array]:
    side = np.cross(direction, [0.0, 0.0, 1.0])
    side = side / np.linalg.norm(side)
    return side, np.cross(direction, side)
