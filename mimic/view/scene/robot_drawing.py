"""The robot as Rerun entities: visual shapes, target and actual toe positions, and the floor."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import rerun as rr

from mimic.dynamics.robot_model import load_model
from mimic.geometry import rotation_from_quat
from mimic.records import PHASES, SIDES, FloatArray, RunLog
from mimic.robot.description import RobotDescription
from mimic.view.film import skeleton
from mimic.view.film.skeleton import soft
from mimic.view.scene import layout
from mimic.view.scene.floor import draw_floor
from mimic.view.scene.robot_shapes import (
    TARGET_RADIUS,
    Shapes,
    body_poses,
    in_world,
    qpos_at_ticks,
    visual_shapes,
)
from mimic.view.scene.timing import PHASE_TITLES, camera_path, shared_time

_TRAIL = 0.7
"""Duration of the trail behind a toe [s]."""
_TILE = 0.25
"""Side length of a floor tile [m]."""


def draw_robot(
    scene: rr.RecordingStream,
    log: RunLog,
    description: RobotDescription,
    frames: FloatArray | None = None,
) -> None:
    """Add the robot, its toes, its phases and the floor to a scene.

    Args:
        frames: Times of the frames of the video (F,) [s].
    """
    model = load_model(description)
    qpos = qpos_at_ticks(log, model)
    position, quat = body_poses(model, qpos)
    clock = shared_time(log)
    t = layout.time_columns(clock, frames)
    for body in draw_shapes(scene, model):
        i = model.body(body).id
        poses = rr.Transform3D.columns(translation=position[:, i], quaternion=quat[:, i][:, [1, 2, 3, 0]])
        scene.send_columns(f"{layout.ROBOT}/links/{body}", indexes=t, columns=poses)
    path = camera_path(log, qpos[:, :3])
    eye = np.column_stack([path, np.zeros(len(path))])
    scene.send_columns(layout.EYE, indexes=t, columns=rr.Transform3D.columns(translation=eye))
    draw_floor(scene, f"{layout.ROBOT}/floor", path, tile=_TILE)
    _phases(scene, log, clock, frames)
    _toes(scene, log, qpos, description, frames)


def _phases(scene: rr.RecordingStream, log: RunLog, clock: FloatArray, frames: FloatArray | None) -> None:
    """Say in words what the robot does, from each change on."""
    first = np.flatnonzero(np.diff(log.phase, prepend=-1))
    words = [f"{PHASE_TITLES[PHASES[log.phase[row]]]} (from {clock[row]:.1f} s)" for row in first]
    times = layout.time_columns(clock[first], frames)
    scene.send_columns(layout.PHASE, indexes=times, columns=rr.TextDocument.columns(text=words))


def draw_shapes(scene: rr.RecordingStream, model: mujoco.MjModel) -> list[str]:
    """Add the robot's shapes to a scene; return the names of their bodies."""
    for shapes in visual_shapes(model):
        scene.log(f"{layout.ROBOT}/links/{shapes.body}/{shapes.kind}", rerun_shapes(shapes), static=True)
    return sorted({shapes.body for shapes in visual_shapes(model)})


def rerun_shapes(shapes: Shapes) -> rr.AsComponents:
    """Return the shapes as Rerun components."""
    colours = np.round(255 * shapes.rgba).astype(np.uint8)
    look: dict[str, Any] = {"quaternions": shapes.quat[:, [1, 2, 3, 0]], "colors": colours, "fill_mode": "Solid"}
    if shapes.kind in ("box", "ellipsoid"):
        kind = rr.Boxes3D if shapes.kind == "box" else rr.Ellipsoids3D
        return kind(centers=shapes.position, half_sizes=shapes.size, **look)
    look |= {"radii": shapes.size[:, 0], "lengths": 2 * shapes.size[:, 1]}
    if shapes.kind == "cylinder":
        return rr.Cylinders3D(centers=shapes.position, **look)
    return rr.Capsules3D(translations=capsule_starts(shapes), **look)


def capsule_starts(shapes: Shapes) -> FloatArray:
    """Return the start of each capsule (N, 3) [m]. Rerun draws along z from the start, MuJoCo from the centre."""
    return shapes.position - rotation_from_quat(shapes.quat)[..., 2] * shapes.size[:, 1:2]


def trails(points: FloatArray, ticks: int) -> FloatArray:
    """Return for each of the points (T, 3) the last ``ticks`` points up to it (T, ticks, 3)."""
    rows = np.maximum(np.arange(len(points))[:, None] - np.arange(ticks)[::-1], 0)
    return points[rows]


def _toes(
    scene: rr.RecordingStream,
    log: RunLog,
    qpos: FloatArray,
    description: RobotDescription,
    frames: FloatArray | None,
) -> None:
    target = in_world(qpos, log.p_BE_des)
    actual = in_world(qpos, log.p_BE)
    shown = np.flatnonzero(log.aimed & np.isfinite(target).all(axis=(1, 2)))
    if not len(shown):
        return
    t = layout.time_columns(shared_time(log)[shown], frames)
    ticks = max(2, round(_TRAIL / description.dt))
    see_through = rr.components.FillMode.TransparentFillMajorWireframe
    for i, (side, colour) in enumerate((side, skeleton.COLOURS[side]) for side in SIDES):
        entity = f"{layout.ROBOT}/toes/{side}"
        for name, points, radius, colours, fill in (
            ("target", target, TARGET_RADIUS, (*colour, 110), see_through),
            ("actual", actual, 1.05 * description.toe_radius, colour, rr.components.FillMode.Solid),
        ):
            style = rr.Ellipsoids3D.from_fields(colors=colours, fill_mode=fill)
            centers = points[shown, i]
            # Sizes are logged with the centres: a static size would draw a ball at the origin before the first centre.
            balls = rr.Ellipsoids3D.columns(centers=centers, half_sizes=np.full_like(centers, radius))
            layout.draw_over_time(scene, f"{entity}/{name}", style, t, balls)
        for name, points, line, radius in (
            ("target_trail", target, soft(colour), 0.002),
            ("actual_trail", actual, colour, 0.004),
        ):
            style = rr.LineStrips3D.from_fields(colors=line, radii=radius)
            strips = rr.LineStrips3D.columns(strips=list(trails(points[shown, i], ticks)))
            layout.draw_over_time(scene, f"{entity}/{name}", style, t, strips)
