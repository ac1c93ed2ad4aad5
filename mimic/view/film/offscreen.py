"""Off-screen rendering of a MuJoCo model with EGL, OSMesa, or the OpenGL of the system."""

from __future__ import annotations

import os
import sys
from contextlib import AbstractContextManager
from importlib import import_module
from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from mimic.errors import MimicError
from mimic.records import FloatArray

SUPERSAMPLE = 1.25
"""Supersampling factor; at 1.5 a picture takes 1.3 times as long and looks the same."""
_SHADOW_SIZE = 1024
_SHADOW_CLIP = 1.6
"""Radius of the shadows around the point that the camera looks at [extents of the model]."""
_LIGHT_DISTANCE = 1.0
"""Distance from that point to the light [m]; at other distances the floor shadows itself."""
_SLICES = 14
"""Slices of a sphere."""


class NoOffscreenGL(MimicError):
    """Off-screen rendering is not available on this computer."""

    def __init__(self, tried: dict[str, str]) -> None:
        self.tried = tried
        reasons = "; ".join(f"{name}: {reason}" for name, reason in tried.items())
        super().__init__(
            f"cannot render the robot: no off-screen OpenGL works ({reasons}); install one (Debian and Ubuntu: "
            "apt-get install libegl1 libgl1-mesa-dri) or run without a film"
        )


def _backends() -> list[str]:
    """Return the backends to try, best first; the environment variable MUJOCO_GL decides if it is set."""
    asked = os.environ.get("MUJOCO_GL", "").lower().strip()
    if asked in ("egl", "osmesa", "glfw", "cgl"):
        return [asked]
    if sys.platform == "darwin":
        return ["cgl", "glfw"]
    if sys.platform == "win32":
        return ["glfw"]
    shown = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return ["egl", "osmesa", "glfw"] if shown else ["egl", "osmesa"]


def _context_of(backend: str, width: int, height: int) -> Any:
    """Return a current MuJoCo OpenGL context of this backend; MuJoCo itself chooses one only at import."""
    context = import_module(f"mujoco.{backend}").GLContext(width, height)
    context.make_current()
    return context


class Offscreen(AbstractContextManager["Offscreen"]):
    """Renders one model to RGB pictures. Use it in one thread, and close it or use a ``with`` block."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int, *, shadows: bool = True) -> None:
        """Prepare rendering; lowers the visual quality of ``model`` to suit software rendering.

        Args:
            model: The robot.
            width: Width of the pictures [px].
            height: Height of the pictures [px].
            shadows: Whether the robot casts one; without, a picture takes 0.4 of the time.

        Raises:
            NoOffscreenGL: If off-screen rendering is not available.
        """
        self.model = model
        self.size = (width, height)
        self._drawn = round(width * SUPERSAMPLE), round(height * SUPERSAMPLE)
        quality = model.vis.quality
        view = model.vis.global_
        quality.shadowsize = _SHADOW_SIZE
        quality.offsamples = 0
        quality.numslices = _SLICES
        quality.numstacks = _SLICES // 2
        model.vis.map.shadowclip = _SHADOW_CLIP
        model.mat_reflectance[:] = 0.0
        view.offwidth, view.offheight = self._drawn
        self._light_dirs = model.light_dir.copy()
        tried: dict[str, str] = {}
        self._gl: Any = None
        for backend in _backends():
            try:
                self._gl = _context_of(backend, *self._drawn)
                self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
                break
            except Exception as error:  # each backend raises its own errors
                tried[backend] = str(error).strip().split("\n")[0] or type(error).__name__
                self._gl = None
        if self._gl is None:
            raise NoOffscreenGL(tried)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        self.data = mujoco.MjData(model)
        self.scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 200)
        self.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = shadows
        self._camera = mujoco.MjvCamera()
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = [1, 0, 1, 0, 0, 0]
        self._option.sitegroup[:] = 0
        self._pixels = np.empty((self._drawn[1], self._drawn[0], 3), dtype=np.uint8)

    def pose(self, qpos: FloatArray, lookat: FloatArray, *, distance: float, azimuth: float, elevation: float) -> None:
        """Place the robot, the camera and the light, which shines from beside the camera.

        Args:
            qpos: MuJoCo's positions (nq,).
            lookat: Point at the centre of the picture (3,) [m].
            distance: Distance from that point to the camera [m].
            azimuth: Viewing direction of the camera about z [rad].
            elevation: Viewing direction above horizontal [rad].
        """
        model = self.model
        data = self.data
        camera = self._camera
        data.qpos[:] = qpos
        model.light_dir[:] = Rotation.from_euler("z", azimuth - np.pi).apply(self._light_dirs)
        model.light_pos[:] = [lookat[0], lookat[1], 0.3] - _LIGHT_DISTANCE * model.light_dir
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)
        camera.lookat[:] = lookat
        camera.distance = distance
        camera.azimuth = np.degrees(azimuth)
        camera.elevation = np.degrees(elevation)
        every = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(model, data, self._option, None, camera, every, self.scene)

    def add_ball(self, centre: FloatArray, radius: float, rgba: tuple[float, float, float, float]) -> None:
        """Add a ball to the current picture; its centre (3,) is in world axes [m]."""
        self._add(mujoco.mjtGeom.mjGEOM_SPHERE, np.full(3, radius), centre, rgba)

    def add_arrow(
        self, begin: FloatArray, end: FloatArray, radius: float, rgba: tuple[float, float, float, float]
    ) -> None:
        """Add an arrow to the current picture, from one point (3,) to another, world axes [m]."""
        arrow = mujoco.mjtGeom.mjGEOM_ARROW
        if np.allclose(begin, end):
            return
        geom = self._add(arrow, np.zeros(3), np.zeros(3), rgba)
        if geom is not None:
            mujoco.mjv_connector(geom, arrow, radius, np.asarray(begin), np.asarray(end))

    def _add(self, kind: Any, size: FloatArray, position: FloatArray, rgba: tuple[float, float, float, float]) -> Any:
        """Return a shape added to the current picture; None where no more fits."""
        if self.scene.ngeom >= self.scene.maxgeom:
            return None
        geom = self.scene.geoms[self.scene.ngeom]
        colour = np.array(rgba, dtype=np.float32)
        mujoco.mjv_initGeom(geom, kind, size, np.asarray(position), np.eye(3).ravel(), colour)
        self.scene.ngeom += 1
        return geom

    def picture(self) -> np.ndarray:
        """Return the picture (H, W, 3), RGB."""
        import cv2

        self._gl.make_current()
        area = mujoco.MjrRect(0, 0, *self._drawn)
        mujoco.mjr_render(area, self.scene, self._context)
        mujoco.mjr_readPixels(self._pixels, None, area, self._context)
        upright = self._pixels[::-1]
        if self._drawn == self.size:
            return upright.copy()
        return cv2.resize(upright, self.size, interpolation=cv2.INTER_AREA)

    def close(self) -> None:
        """Release the graphics memory."""
        if self._gl is not None:
            self._gl.make_current()
            self._context.free()
            self._gl.free()
            self._gl = None

    def __exit__(self, *_: object) -> None:
        self.close()
